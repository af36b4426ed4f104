"""Newton's method on banded or sparse systems, damped until it descends."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.aigo.algorithm import Box
from drake_aigto.aigo.descent import Problem, descend, descend_boldly
from drake_aigto.arrays import Bools, Floats
from drake_aigto.box import BoxPolynomial, Order

_NO_BOUNDS = np.empty(0), np.empty(0)


class Objective:
    """A function of unknowns y in elimination order, held ones included.

    Args:
        problem: what it is, for the hot loop.
        largest_residual: y is stationary where √(Σ g²/D) is no more than this, D being the
            diagonal that damping is measured in.
    """

    def __init__(self, problem: Problem, largest_residual: float) -> None:
        """Stores both."""
        self.problem, self.largest_residual = problem, largest_residual


def _make_problem(
    f: BoxPolynomial,
    order: Order,
    free: Bools,
    half_width: ArrayLike,
    bounds: tuple[Floats, Floats],
    temperature: float,
) -> Problem:
    """Returns the arrays of the hot loop, as `Problem` has them."""
    places = order.num_unknowns * f.position
    return Problem(
        *(f.lanes(order), f.copy_weights, np.ones_like(f.copy_weights)),
        *(np.full(f.copy_weights.size, -1), np.empty_like(f.copy_weights)),
        *(places, np.where(free, places, -1)),
        np.array(np.broadcast_to(half_width, free.shape), dtype=float),
        *bounds,
        temperature=temperature,
        shape=f.hessian_shape(order),
        pattern=f.pattern(order),
    )


def point_objective(
    f: BoxPolynomial,
    free: Bools,
    tolerance: float,
    bounds: tuple[Floats, Floats] | None = None,
    half_width: ArrayLike = 0.0,
) -> Objective:
    """Returns f̄(c, w) of boxes of given widths; by default f(c) itself: every box is its center.

    It is stationary once √(gᵀ diag(H)⁻¹ g) is no more than the tolerance.

    Args:
        f: the cost.
        free: which variables are not held.
        tolerance: of the residual.
        bounds: lower and upper bounds (n,) of the variables, where steps are cut off.
        half_width: w, shape (n,), or a scalar for all.
    """
    within = _NO_BOUNDS if bounds is None else (bounds[0][f.order], bounds[1][f.order])
    return Objective(_make_problem(f, Order.CENTERS, free, half_width, within, 0.0), tolerance)


class SmoothedObjective(Objective):
    """f̄(c, e^z) − μ Σ z over y = (c_i, z_i) side by side in elimination order.

    Args:
        f: the cost.
        free: which variables are not held.
        temperature: μ.
        tolerance: stationary at √(mean g²/(μD)) ≤ tolerance, μD = μ (3/w², 2).
        first: a box whose c ± w are bounds of c, and w those of the half width, if given.

    Attributes:
        f: as given.
    """

    def __init__(
        self,
        f: BoxPolynomial,
        free: Bools,
        temperature: float,
        tolerance: float,
        first: Box | None = None,
    ) -> None:
        """Prepares for one temperature."""
        self.f = f
        bounds = _NO_BOUNDS if first is None else self._bounds(first)
        self._unit = tolerance, 2 * np.count_nonzero(free)
        problem = _make_problem(f, Order.BOXES, free, 0.0, bounds, temperature)
        super().__init__(problem, self._calc_largest_residual(temperature))

    def _calc_largest_residual(self, temperature: float) -> float:
        tolerance, num_unknowns = self._unit
        return tolerance * math.sqrt(num_unknowns * temperature)

    def at(self, temperature: float) -> SmoothedObjective:
        """Returns the same objective at another temperature."""
        other = copy.copy(self)
        other.problem = self.problem._replace(temperature=temperature)
        other.largest_residual = self._calc_largest_residual(temperature)
        return other

    def _bounds(self, first: Box) -> tuple[Floats, Floats]:
        """Returns lower and upper bounds of y."""
        lower, upper = (np.full(2 * self.f.num_variables, end) for end in (-np.inf, np.inf))
        center, half_width = first.center[self.f.order], first.half_width[self.f.order]
        lower[0::2], upper[0::2] = center - half_width, center + half_width
        upper[1::2] = self.unknowns(first)[1::2]
        return lower, upper

    def unknowns(self, box: Box) -> Floats:
        """Returns y of a box; z = −∞ where a variable is held."""
        y = np.empty(2 * self.f.num_variables)
        y[0::2] = box.center[self.f.order]
        with np.errstate(divide="ignore"):
            y[1::2] = np.log(box.half_width[self.f.order])
        return y

    def box(self, y: Floats) -> Box:
        """Returns the box of y."""
        center, log_half_width = self.f.to_variables(y)
        return Box(center, np.exp(log_half_width))


@dataclass(frozen=True)
class NewtonResult:
    """Where Newton's method ended.

    Attributes:
        y: the unknowns.
        value: the objective there.
        mean: f̄ there.
        steps: iterations.
        residual: √(Σ g²/D) there.
        damping: λ to start the next, similar problem with.
    """

    y: Floats
    value: float
    mean: float
    steps: int
    residual: float
    damping: float


def newton(objective: Objective, y: Floats, max_steps: int, damping: float) -> NewtonResult:
    """Minimizes by damped steps, see `descent.descend`."""
    y = np.array(y, dtype=float)
    found = descend(objective.problem, y, objective.largest_residual, max_steps, damping)
    return NewtonResult(y, *found)


def bold_newton(objective: Objective, y: Floats, max_steps: int) -> tuple[Floats, int]:
    """Takes undamped steps, see `descent.descend_boldly`; returns the end and their number."""
    y = np.array(y, dtype=float)
    steps = descend_boldly(objective.problem, y, objective.largest_residual, max_steps)
    return y, steps
