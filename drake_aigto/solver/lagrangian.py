"""Augmented Lagrangians: what boxes minimize in place of a program with equality rows."""

from __future__ import annotations

import numpy as np

from drake_aigto.aigo import Box
from drake_aigto.arrays import Floats
from drake_aigto.box import BoxPolynomial
from drake_aigto.solver.program import AigoProgram
from drake_aigto.terms import TermBlock


class AugmentedLagrangian:
    """f + λᵀr + W Σ r² of a program, whose mean over boxes is as closed as that of f.

    Multipliers start at 0 and follow the method of multipliers, λ ← λ + 2 W r at a minimizer for λ
    and W (Hestenes 1969, Powell 1969): there, constraints hold without W having to grow until f no
    longer counts. Rows have no mean of their own in a penalty; λᵀr gives each one.

    W = factor · (variation of f over the first box) / (variation of Σ r²).
    """

    def __init__(self, program: AigoProgram, first: Box) -> None:
        """Joins the tables of f, r and r² once."""
        costs, penalties, nlp = program.costs, program.penalties, program.nlp
        # Copies of a row have a multiplier each. No cost's name begins as a row's does.
        copies = [
            (block, copy) for block in nlp.blocks[len(nlp.costs) :] for copy in block.variables
        ]
        linear = [
            TermBlock(f"{block.name}, multiplier {i}", block.terms, copy, weight=0.0)
            for i, (block, copy) in enumerate(copies)
        ]
        self._nlp = nlp
        self._names = tuple(block.name for block in linear)
        self._penalties = tuple(penalties.weights)
        self._merged = BoxPolynomial(
            costs.num_variables, (*costs.blocks, *penalties.blocks, *linear)
        )
        self._unit = max(variation(costs, first), 1e-3) / max(variation(penalties, first), 1e-12)
        self._multipliers = np.zeros(nlp.num_rows)

    @property
    def is_finite(self) -> bool:
        """Whether there is a weight: exponentials overflow where bounds let x be far out."""
        return bool(np.isfinite(self._unit))

    @property
    def multipliers(self) -> Floats:
        """λ, shape (m,)."""
        return self._multipliers.copy()

    def function(self, factor: float) -> BoxPolynomial:
        """Returns f + λᵀr + W Σ r²."""
        weights = dict(zip(self._names, self._multipliers.tolist(), strict=True))
        weights |= dict.fromkeys(self._penalties, factor * self._unit)
        return self._merged.with_weights(weights)

    def update(self, factor: float, y: Floats) -> None:
        """Moves the multipliers, y (n,) being a minimizer of the function of this factor."""
        _, residuals = self._nlp.evaluate(y)
        with np.errstate(invalid="ignore"):  # Rows that overflow move nothing.
            moved = self._multipliers + 2 * factor * self._unit * residuals
        if np.all(np.isfinite(moved)):
            self._multipliers = moved


def variation(f: BoxPolynomial, box: Box) -> float:
    """Returns how much f's mean differs between faces, or from face to middle, at most."""
    _, by_center, by_log_width = f.gradient(box.center, box.half_width)
    differences = np.maximum(box.half_width * np.abs(by_center), np.abs(by_log_width))
    return float(np.max(differences, initial=0.0))
