"""Filter line search of Wächter & Biegler (2006), sec. 2.3-2.4, and restoration of feasibility."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drake_aigto.local.kkt import max_norm
from drake_aigto.local.newton import ROUNDING, NewtonSearch, NewtonStep, Point, ScaledProblem

_GAMMA_THETA, _GAMMA_PHI = 1e-5, 1e-8  # margins of θ and φ
_DELTA, _S_THETA, _S_PHI = 1.0, 1.1, 2.3  # switching condition
_ETA_PHI = 1e-8  # Armijo condition
_GAMMA_ALPHA = 0.05  # shortest step
_LEAST_FAR_LENGTH = 1e-4  # ours
_SHORTEST = 1e-16  # ours: at θ = 0 the others are 0, and no length is shorter than that
_KAPPA_SOC, _CORRECTIONS = 0.99, 4
_PATIENCE = 5  # idle steps in a row
_LOWER = 0.9  # of a violation or an error: lower by more than rounding


_Pair = tuple[float, float]

# Of the restoration: the share of any slack that a step may use; dampings ν; ‖Aᵀc‖ / ‖c‖ at which
# no direction helps; relative rounding of ‖c‖².
_FRACTION, _ARMIJO = 0.99, 1e-4
_FIRST_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING = 1e-4, 1e-12, 1e12
_HARDER, _SOFTER = 8.0, 0.25
_STATIONARY, _NOISE = 1e-9, 1e-15


class Filter:
    """Pairs (θ, φ); a point that is worse than one of them in both is not accepted."""

    def __init__(self, first_violation: float) -> None:
        """Starts with θ ≥ 10⁴ max(1, θ(x₀)) shut off."""
        self.least_violation = 1e-4 * max(1.0, first_violation)
        self._largest_violation = 1e4 * max(1.0, first_violation)
        self._entries: list[_Pair] = []

    def clear(self) -> None:
        """Forgets all entries, as φ changes with μ."""
        self._entries = []

    def accepts(self, violation: float, barrier: float) -> bool:
        """Returns whether a finite point is better than every entry in θ or in φ."""
        return (
            violation < self._largest_violation
            and math.isfinite(barrier)
            and all(violation < theta or barrier < phi for theta, phi in self._entries)
        )

    def add(self, violation: float, barrier: float) -> None:
        """Shuts off points that are not better than this by the margins."""
        entry = (1 - _GAMMA_THETA) * violation, barrier - _GAMMA_PHI * violation
        self._entries.append(entry)


@dataclass(frozen=True)
class LineSearch:
    """The choice of a step length from one point."""

    problem: ScaledProblem  # The problem
    filter: Filter  # Pairs that are shut off; a step for feasibility's sake adds one
    point: Point  # Where the step starts
    mu: float  # μ of φ
    fraction: float  # Share τ of any slack that a step may use

    @cached_property
    def rounding(self) -> float:
        """Rounding of φ where the step starts."""
        of_cost = self.problem.cost_rounding(self.point.y)
        return ROUNDING * abs(self.point.barrier(self.mu)) + of_cost

    def run(self, step: NewtonStep) -> tuple[Point, float] | None:
        """Returns the next point and the step length; None where only a restoration can help."""
        longest = length = self.problem.longest(self.point, step.dy, self.fraction)
        if max_norm(step.dy / (1 + np.abs(self.point.y))) < ROUNDING:
            return self.problem.point(self.point.y + length * step.dy), length
        least = self._least_length(step.slope)
        while length >= least:
            tried = self.problem.point(self.point.y + length * step.dy)
            if self._take(tried, length, step.slope):
                return tried, length
            if length == longest and tried.violation >= self.point.violation:
                corrected = self._correct(step, tried, length)
                if corrected is not None:
                    return corrected, length
            length /= 2
        return None

    def _correct(self, step: NewtonStep, tried: Point, length: float) -> Point | None:
        """Tries second-order corrections: the rows' curvature along the step is taken out."""
        rows, violation, last = self.point.rows, self.point.violation, tried
        for _ in range(_CORRECTIONS):
            rows = length * rows + last.rows
            if not np.all(np.isfinite(rows)):
                return None
            dy = step.corrected(rows)
            length = self.problem.longest(self.point, dy, self.fraction)
            last = self.problem.point(self.point.y + length * dy)
            if self._take(last, length, step.slope):
                return last
            if not last.violation <= _KAPPA_SOC * violation:
                return None
            violation = last.violation
        return None

    def _take(self, tried: Point, length: float, slope: float) -> bool:
        """Returns whether a point is accepted; unless φ decided, the filter learns of the start."""
        violation, barrier = self.point.violation, self.point.barrier(self.mu)
        new_violation, new_barrier = tried.violation, tried.barrier(self.mu)
        if not self.filter.accepts(new_violation, new_barrier):
            return False
        fall = length * _raise(-slope, _S_PHI) if slope < 0 else 0.0
        descends = fall > _DELTA * _raise(violation, _S_THETA)
        change = new_barrier - barrier - self.rounding
        armijo = change <= _ETA_PHI * length * slope
        if descends and violation <= self.filter.least_violation:
            return armijo
        if not (
            new_violation <= (1 - _GAMMA_THETA) * violation or change <= -_GAMMA_PHI * violation
        ):
            return False
        if not (descends and armijo):
            self.filter.add(violation, barrier)
        return True

    def _least_length(self, slope: float) -> float:
        """Returns α_min: eq. (23) near c = 0; far off, where restoration is quick, much more."""
        violation = self.point.violation
        if violation > self.filter.least_violation:
            return _LEAST_FAR_LENGTH
        least = _GAMMA_THETA
        if slope < 0:
            least = min(least, _GAMMA_PHI * violation / -slope)
            least = min(least, _DELTA * _raise(violation, _S_THETA) * _raise(-slope, -_S_PHI))
        return max(_SHORTEST, _GAMMA_ALPHA * least)


def _raise(base: float, exponent: float) -> float:
    """Returns base^exponent, infinity where that overflows: far out, slopes are of any size."""
    try:
        return math.pow(base, exponent)
    except OverflowError:
        return math.inf


@dataclass
class Progress:
    """Counts idle steps.

    A step is idle where φ changes by no more than its rounding and is no lower than ever since such
    steps began, and neither the violation nor the optimality error falls. For bounds on rounding
    are generous, and near a degenerate solution the gradient shows the way for long after φ no
    longer does.
    """

    _idle_steps: int = 0
    _least_barrier: float = math.inf
    _least_error: float = math.inf

    @property
    def has_ended(self) -> bool:
        """Whether several steps in a row were idle."""
        return self._idle_steps >= _PATIENCE

    def restart(self) -> None:
        """Forgets all steps."""
        self._idle_steps, self._least_barrier, self._least_error = 0, math.inf, math.inf

    def add(self, violations: _Pair, barriers: _Pair, rounding: float, error: float) -> None:
        """Counts a step.

        Args:
            violations: θ before and after.
            barriers: φ before and after.
            rounding: Rounding of φ.
            error: Optimality error before.
        """
        if abs(barriers[1] - barriers[0]) > rounding or violations[1] < _LOWER * violations[0]:
            self.restart()
            return
        has_fallen = barriers[1] < self._least_barrier or error < _LOWER * self._least_error
        self._idle_steps = 0 if has_fallen else self._idle_steps + 1
        self._least_barrier = min(self._least_barrier, barriers[1])
        self._least_error = min(self._least_error, error)


def restore(
    search: NewtonSearch, point: Point, is_done: Callable[[Point], bool], max_steps: int
) -> tuple[Point | None, int]:
    """Minimizes ½‖c‖² by Levenberg-Marquardt steps, interior to the bounds.

        minimize over d   ½‖c + A d‖² + ν/2 Σ_i d_i² (1 + Σ 1/slack²)

    The metric keeps steps away from bounds that are near, as in affine scaling (Dikin 1967).
    Returns the first point that is done, None if none is found, and the number of steps.
    """
    damping = _FIRST_DAMPING
    for taken in range(1, max_steps + 1):
        moved = _step_to_rows(search, point, damping)
        if moved is None:
            return None, taken
        point, damping = moved
        if is_done(point):
            return point, taken
    return None, max_steps


def _step_to_rows(search: NewtonSearch, point: Point, damping: float) -> tuple[Point, float] | None:
    """Returns the next point and damping; None where c is stationary but for rounding."""
    problem = search.problem
    linearization = problem.linearize(point.y, point.rows)
    gradient = linearization.row_force  # Aᵀc
    metric = 1.0 + problem.bound_curvature(1.0 / point.slacks**2)
    steepness = np.linalg.norm(gradient / np.sqrt(metric))
    if not steepness > _STATIONARY * np.linalg.norm(point.rows):
        return None
    band = problem.structure.without_couplings(linearization.band)
    while damping <= _LARGEST_DAMPING:
        search.factorize(band, damping * metric, 1.0)
        step = search.solve(0.0, -point.rows)[0]
        length = problem.longest(point, step, _FRACTION)
        change = length * float(gradient @ step)
        if not change < -_NOISE * _half_square(point):
            break
        tried = problem.point(point.y + length * step)
        if _half_square(tried) <= _half_square(point) + _ARMIJO * change:
            return tried, max(_SOFTER * damping, _LEAST_DAMPING)
        damping *= _HARDER
    return None


def _half_square(point: Point) -> float:
    with np.errstate(over="ignore"):  # Infinite, which no step is taken to.
        return 0.5 * float(point.rows @ point.rows)
