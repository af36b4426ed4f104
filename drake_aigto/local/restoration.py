"""Back to the rows c = 0 within bounds, where the line search finds no step."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drake_aigto.local.newton import NewtonSearch
from drake_aigto.local.scaled import Point, ScaledProblem

_FRACTION = 0.99  # of any slack that a step may use
_ARMIJO = 1e-4
_FIRST_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING = 1e-4, 1e-12, 1e12
_HARDER, _SOFTER = 8.0, 0.25
_STATIONARY = 1e-9  # ‖Aᵀc‖ / ‖c‖ at which no direction helps
_NOISE = 1e-15  # relative rounding of ‖c‖²


class Restoration:
    """Minimizes ½‖c‖² by Levenberg-Marquardt steps, interior to the bounds.

        minimize over d   ½‖c + A d‖² + ν/2 Σ_i d_i² (1 + Σ 1/slack²)

    The metric keeps steps away from bounds that are near, as in affine scaling (Dikin 1967).
    """

    def __init__(self, problem: ScaledProblem, search: NewtonSearch) -> None:
        """Shares the search's factors."""
        self._problem = problem
        self._structure = problem.structure
        self._search = search

    def run(
        self, point: Point, is_done: Callable[[Point], bool], max_steps: int
    ) -> tuple[Point | None, int]:
        """Returns the first point that is done, None if none is found, and the number of steps."""
        damping = _FIRST_DAMPING
        for taken in range(1, max_steps + 1):
            moved = self._step(point, damping)
            if moved is None:
                return None, taken
            point, damping = moved
            if is_done(point):
                return point, taken
        return None, max_steps

    def _step(self, point: Point, damping: float) -> tuple[Point, float] | None:
        """Returns the next point and damping; None where c is stationary but for rounding."""
        linearization = self._problem.linearize(point.y, point.rows)
        gradient = linearization.row_force  # Aᵀc
        metric = 1.0 + self._problem.bound_curvature(1.0 / point.slacks**2)
        steepness = np.linalg.norm(gradient / np.sqrt(metric))
        if not steepness > _STATIONARY * np.linalg.norm(point.rows):
            return None
        band = self._structure.without_couplings(linearization.band)
        while damping <= _LARGEST_DAMPING:
            self._search.factorize(band, damping * metric, 1.0)
            step = self._search.solve(0.0, -point.rows)[0]
            length = self._problem.longest(point, step, _FRACTION)
            change = length * float(gradient @ step)
            if not change < -_NOISE * _half_square(point):
                break
            tried = self._problem.point(point.y + length * step)
            if _half_square(tried) <= _half_square(point) + _ARMIJO * change:
                return tried, max(_SOFTER * damping, _LEAST_DAMPING)
            damping *= _HARDER
        return None


def _half_square(point: Point) -> float:
    with np.errstate(over="ignore"):  # Infinite, which no step is taken to.
        return 0.5 * float(point.rows @ point.rows)
