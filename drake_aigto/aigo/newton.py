"""Newton's method over the centers of boxes, on banded or sparse systems."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.aigo.descent import NewtonProblem, descend, descend_boldly
from drake_aigto.arrays import Bools, Floats
from drake_aigto.box import BoxPolynomial, Order

_NO_BOUNDS = np.empty(0), np.empty(0)

# Of `raise_penalties`: a penalty W r² leaves a residual of (multiplier)/(2W), so that weights
# raised by R shrink it by 1/R, here to 1e-5 in all.
_RAISES, _RAISE = 5, 10.0
_RAISED_STEPS, _RAISED_TOLERANCE = 10, 1e-10


def make_ball_task(
    f: BoxPolynomial,
    order: Order,
    free: Bools,
    half_width: ArrayLike = 0.0,
    bounds: tuple[Floats, Floats] = _NO_BOUNDS,
    temperature: float = 0.0,
) -> NewtonProblem:
    """Returns the arrays of the hot loop, as `NewtonProblem` has them."""
    places = order.num_unknowns * f.position
    return NewtonProblem(
        *(f.lanes(order), f.copy_weights, np.ones_like(f.copy_weights)),
        *(np.full(f.copy_weights.size, -1), np.empty_like(f.copy_weights)),
        *(places, np.where(free, places, -1)),
        np.array(np.broadcast_to(half_width, free.shape), dtype=float),
        *bounds,
        temperature=temperature,
        shape=f.hessian_shape(order),
        pattern=f.pattern(order),
    )


class NewtonResult(NamedTuple):
    """The end of Newton's method.

    Attributes:
        x: the centers, shape (n,).
        value: f̄ there.
        steps: iterations.
        residual: √(gᵀ diag(H)⁻¹ g) there.
        damping: λ to start the next, similar problem with.
    """

    x: Floats
    value: float
    steps: int
    residual: float
    damping: float


class CenterObjective:
    """f̄(c, w) over centers c of boxes of given widths; by default f(c): every box is its center.

    Args:
        f: the cost.
        free: which variables are not held, shape (n,).
        tolerance: stationary once √(gᵀ diag(H)⁻¹ g) is no more than this.
        bounds: lower and upper bounds (n,) of the variables, where steps are cut off.
        half_width: w, shape (n,), or a scalar for all.
    """

    def __init__(
        self,
        f: BoxPolynomial,
        free: Bools,
        tolerance: float,
        bounds: tuple[Floats, Floats] | None = None,
        half_width: ArrayLike = 0.0,
    ) -> None:
        """Puts variables in elimination order."""
        within = _NO_BOUNDS if bounds is None else (bounds[0][f.order], bounds[1][f.order])
        self._f, self._tolerance = f, tolerance
        self._problem = make_ball_task(f, Order.CENTERS, free, half_width, within)

    def descend(self, x: Floats, max_steps: int, damping: float = 0.0) -> NewtonResult:
        """Minimizes from x (n,) by damped steps, see `descent.descend`."""
        y = np.array(x[self._f.order], dtype=float)
        value, _, steps, residual, damping = descend(
            self._problem, y, self._tolerance, max_steps, damping
        )
        (x,) = self._f.to_variables(y)
        return NewtonResult(x, value, steps, residual, damping)

    def descend_boldly(self, x: Floats, max_steps: int) -> tuple[Floats, int]:
        """Takes undamped steps, see `descent.descend_boldly`; returns the end and their number."""
        y = np.array(x[self._f.order], dtype=float)
        steps = descend_boldly(self._problem, y, self._tolerance, max_steps)
        (x,) = self._f.to_variables(y)
        return x, steps


def raise_penalties(f: BoxPolynomial, penalties: Collection[str], x: Floats, free: Bools) -> Floats:
    """Returns the minimizer of f with penalties raised in steps until constraints hold, nearly.

    Args:
        f: the penalized cost.
        penalties: names of the blocks that are penalties.
        x: where to start, shape (n,).
        free: which variables may move, shape (n,).
    """
    weights, damping = {name: f.weights[name] for name in penalties}, 0.0
    for k in range(1, _RAISES + 1):
        raised = f.with_weights({name: w * _RAISE**k for name, w in weights.items()})
        objective = CenterObjective(raised, free, _RAISED_TOLERANCE)
        x, _, _, _, damping = objective.descend(x, _RAISED_STEPS, damping)
    return x
