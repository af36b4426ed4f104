"""A `PolynomialNlp` over its free variables, scaled at the start: what the interior point sees."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.local.nlp import PolynomialNlp

ROUNDING = 10 * float(np.finfo(float).eps)  # relative to what was added up
_STEEPEST = 100.0  # of a cost or row at the start, once scaled (Wächter & Biegler sec. 3.8)


@dataclass(frozen=True)
class Point:
    """Free variables y (nf,), with what is known there without derivatives.

    Attributes:
        y: The free variables.
        cost: s f.
        rows: s c (ma,).
        slacks: Distances to lower bounds, then to upper bounds (nb,), kept positive.
    """

    y: Floats
    cost: float
    rows: Floats
    slacks: Floats

    @cached_property
    def violation(self) -> float:
        """θ = ‖s c‖₁."""
        return float(np.sum(np.abs(self.rows)))

    @cached_property
    def _log_slacks(self) -> float:
        return float(np.sum(np.log(self.slacks)))

    def barrier(self, mu: float) -> float:
        """Returns φ_μ = s f − μ Σ log slack."""
        return self.cost - mu * self._log_slacks if self.slacks.size else self.cost


@dataclass(frozen=True)
class Duals:
    """Multipliers of the rows, λ (ma,), and of the bounds, z ≥ 0 (nb,)."""

    rows: Floats
    bounds: Floats


@dataclass(frozen=True)
class Linearization:
    """Derivatives at a point: s ∇f (nf,), Aᵀλ (nf,) and the KKT matrix [W Aᵀ; A 0] as stored."""

    gradient: Floats
    row_force: Floats
    band: Floats


class ScaledProblem:
    """Minimize s f(y) subject to s c(y) = 0 and bounds, over the variables that are not held.

    Bounds are numbered: nb of them, the lower ones first. The cost is divided by its unit; then,
    factors ≤ 1 keep its and every row's largest slope at the start from exceeding a hundred.

    Attributes:
        structure: Where the unknowns stand in KKT matrices.
        lower: Lower bounds (nf,).
        upper: Upper bounds (nf,).
        bounded: Free variable that each bound is on (nb,).
        num_lower: Number of lower bounds among them.
        held_residual: Largest residual of a row that reads no free variable.
        cost_scale: s of the cost.
        row_scales: s of the rows (ma,).
    """

    def __init__(self, nlp: PolynomialNlp, x: Floats, cost_unit: float = 1.0) -> None:
        """Holds the variables with equal bounds, and scales at x (n,), which is within bounds."""
        self._nlp, self._x = nlp, x
        self.structure = nlp.kkt_structure
        free = self.structure.free
        self.lower, self.upper = nlp.lower[free], nlp.upper[free]
        low, high = np.flatnonzero(np.isfinite(self.lower)), np.flatnonzero(np.isfinite(self.upper))
        self.bounded = np.concatenate([low, high])
        self.num_lower = low.size
        self._signs = np.repeat([1.0, -1.0], [low.size, high.size])
        self._limits = np.concatenate([self.lower[low], -self.upper[high]])
        # On a bound, which rounding leads to, barriers are infinite: a slack too small to move y.
        least = np.finfo(float).eps ** 1.5 * np.abs(self._limits)
        self._least_slacks = np.maximum(least, np.finfo(float).tiny)
        held_rows = np.delete(nlp.evaluate(x)[1], self.structure.rows)
        self.held_residual = float(np.max(np.abs(held_rows), initial=0.0))
        self._scales = np.ones(nlp.num_costs + nlp.num_rows)
        self.cost_scale, self.row_scales = self._find_scales(x, cost_unit)
        self._scales[: nlp.num_costs] = self.cost_scale
        self._scales[nlp.num_costs + self.structure.rows] = self.row_scales

    def _find_scales(self, x: Floats, cost_unit: float) -> tuple[float, Floats]:
        no_multipliers = np.zeros(self.structure.rows.size)
        gradient, band = self.structure.assemble(x, self._scales, no_multipliers)
        steepest = np.max(np.abs(gradient), initial=0.0)
        slopes = self.structure.steepest_slopes(band)
        return (
            float(_STEEPEST / max(_STEEPEST, steepest / cost_unit) / cost_unit),
            _STEEPEST / np.maximum(_STEEPEST, slopes),
        )

    def full(self, y: Floats) -> Floats:
        """Returns all variables x (n,), held ones included."""
        x = self._x.copy()
        x[self.structure.free] = y
        return x

    def start(self, x: Floats, push: float) -> Point:
        """Returns the point of x (n,), moved inside bounds by `push` of their size and distance."""
        y, low, high = x[self.structure.free], *np.split(self.bounded, [self.num_lower])
        room = np.minimum(
            np.maximum(1.0, np.abs(self._limits)), (self.upper - self.lower)[self.bounded]
        )
        least = push * room
        y[low] = np.maximum(y[low], self.lower[low] + least[: self.num_lower])
        y[high] = np.minimum(y[high], self.upper[high] - least[self.num_lower :])
        return self.point(y)

    def point(self, y: Floats) -> Point:
        """Evaluates."""
        cost, rows = self._nlp.evaluate(self.full(y))
        slacks = np.maximum(self._signs * y[self.bounded] - self._limits, self._least_slacks)
        return Point(y, self.cost_scale * cost, self.row_scales * rows[self.structure.rows], slacks)

    def cost_rounding(self, y: Floats) -> float:
        """Returns how far s f may be off: relative to its terms, not to what they leave."""
        return ROUNDING * self.cost_scale * self._nlp.cost_magnitude(self.full(y))

    def row_roundings(self, y: Floats) -> Floats:
        """Returns how far each s c may be off (ma,)."""
        magnitudes = self._nlp.row_magnitudes(self.full(y))[self.structure.rows]
        return ROUNDING * self.row_scales * magnitudes

    def linearize(self, y: Floats, multipliers: Floats) -> Linearization:
        """Differentiates, with W for these multipliers of the rows."""
        gradient, band = self.structure.assemble(self.full(y), self._scales, multipliers)
        force = self.structure.multiply(band, self.structure.join(0.0, multipliers))
        return Linearization(gradient, self.structure.split(force)[0], band)

    def bound_force(self, pushes: Floats) -> Floats:
        """Returns Σ over bounds of a push away from each (nb,), over the free variables (nf,)."""
        return self.bound_curvature(self._signs * pushes)

    def bound_curvature(self, curvatures: Floats) -> Floats:
        """Returns Σ over bounds of a curvature of each (nb,), over the free variables (nf,)."""
        total = np.zeros(self.lower.size)
        np.add.at(total, self.bounded, curvatures)
        return total

    def slack_step(self, step: Floats) -> Floats:
        """Returns the change of the slacks (nb,) with a step of the free variables."""
        return self._signs * step[self.bounded]

    def longest(self, point: Point, step: Floats, fraction: float) -> float:
        """Returns the part of a step, up to 1, that uses at most a fraction of any slack."""
        return longest(point.slacks, self.slack_step(step), fraction)


def longest(values: Floats, steps: Floats, fraction: float) -> float:
    """Returns the part of a step, up to 1, that uses at most a fraction of any of these values."""
    falling = np.max(-steps / values, initial=0.0)
    return 1.0 if falling <= fraction else float(fraction / falling)
