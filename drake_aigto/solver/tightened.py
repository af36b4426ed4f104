"""Complementarities 0 ≤ λ ⊥ s ≥ 0 as λ s ≤ ε, ε falling, for interior points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.local import InteriorPoint, LocalResult, PolynomialNlp
from drake_aigto.solver.complementarity import Complementarity
from drake_aigto.terms import FunctionKind, Part, Sum, TermBlock, add, with_own_variables

_TIGHTENED, _LAST, _STEPS = 0.01, 1e-5, 100  # how ε falls, where to, and steps on each
_BARRIER, _PUSH = 1e-4, 1e-6  # from a point of a larger ε


class TightenedProgram:
    """A program with a variable p for each product λ s, which a bound ε keeps small.

    Scholtes (2001), "Convergence properties of a regularization scheme for mathematical programs
    with complementarity constraints", SIAM J. Optim. 11:918-936: λ s ≤ ε has an inside, however
    many complementarities share a λ or s, where equations λ s = ε may have none in common.
    """

    def __init__(self, nlp: PolynomialNlp, found: Sequence[Complementarity]) -> None:
        """Adds variables.

        Args:
            nlp: costs and all other rows, over y (n,).
            found: the complementarities (k,).
        """
        self._size = nlp.num_variables
        self._allowed = np.array([each.allowed for each in found])
        rows = [self._row(i, each) for i, each in enumerate(found)]
        others = nlp.blocks[len(nlp.costs) :]
        self._nlp = PolynomialNlp(
            *(self._size + len(found), nlp.costs, (*others, *rows)),
            np.append(nlp.lower, np.full(len(found), -np.inf)),
            np.append(nlp.upper, np.full(len(found), np.inf)),
        )

    def _row(self, number: int, each: Complementarity) -> TermBlock:
        own: Sum = {(Part(self._size + number, FunctionKind.POWER),): -1.0}
        terms, read = with_own_variables(add(each.product, own))
        return TermBlock("complementarity", terms, [read])

    def solve(self, local: InteriorPoint, y: Floats, most: Floats | float) -> LocalResult:
        """Returns an optimum from y (n,) for bounds ε (k,) of the products, over (y, p)."""
        upper = self._nlp.upper.copy()
        upper[self._size :] = np.maximum(most, self._allowed)
        nlp = self._nlp.with_bounds(self._nlp.lower, upper)
        start = np.append(y, np.zeros(self._allowed.size))
        start[self._size :] = nlp.evaluate(start)[1][nlp.num_rows - self._allowed.size :]
        return local.solve(nlp, np.clip(start, nlp.lower, nlp.upper))

    def tighten(self, y: Floats, sizes: Floats, first: float, is_warm: bool) -> tuple[Floats, int]:
        """Returns the point that y (n,) becomes on ever smaller ε, and steps.

        Args:
            y: the start.
            sizes: what the products vary by (k,).
            first: the largest ε, relative to `sizes`.
            is_warm: whether y is near an optimum already.
        """
        steps, relaxation = 0, first
        while True:
            local = InteriorPoint(max_iterations=_STEPS)
            if steps or is_warm:
                local = InteriorPoint.warm(
                    max_iterations=_STEPS, initial_barrier=_BARRIER, bound_push=_PUSH
                )
            found = self.solve(local, y, relaxation * sizes)
            y, steps = found.x[: self._size], steps + found.iterations
            if relaxation <= _LAST:
                return y, steps
            relaxation = max(_LAST, _TIGHTENED * relaxation)
