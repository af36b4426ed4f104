"""Cheapest flights between walls under a constant force, and bounds of their costs.

In unit time, and along y = side (x − wall), one from (0, v) to (Δ, v') in time h against the pull γ
costs (v' − v + γh)²/h + 3 (2Δ − (v + v')h)²/h³, and one to the end, with the goal at y = G,
3w/(3 + wh³) (G − vh + γh²/2)².
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pydrake.symbolic as sym

from drake_aigto.arrays import Floats
from drake_aigto.certify.contraction import bound_all
from drake_aigto.certify.enclosures import GRADIENT, VALUE, enclose_all
from drake_aigto.certify.tape import Formula, make_tape

# A flight that is this far beyond a wall, as a part of the line's length, goes through it.
_INSIDE = 1e-9


@dataclass(frozen=True)
class Wall:
    """A wall on a line: where, on which side there is room (±1), and its restitution."""

    position: float
    side: int
    restitution: float


@dataclass(frozen=True)
class Line:
    """The cost ∫₀¹ (ẍ − drift)² dt + weight (x(1) − goal)², in units of the price.

    One axis on its own: a mass on a line between walls, in unit time.
    """

    position: float
    velocity: float
    goal: float
    weight: float
    price: float
    walls: tuple[Wall, ...]
    drift: float

    @property
    def miss(self) -> float:
        """Distance to the goal of the uncontrolled motion without walls."""
        return self.goal - self.position - self.velocity - 0.5 * self.drift

    @property
    def slack(self) -> float:
        """Distance that is lost in rounding."""
        return _INSIDE * (abs(self.goal - self.position) + abs(self.velocity) + abs(self.drift))


class FlightFamily:
    """Flights of one kind, as functions of their parameters (m,)."""

    def __init__(self, cost: sym.Expression, *variables: sym.Variable) -> None:
        """Makes the formula."""
        formula = Formula()
        places = {variable.get_id(): i for i, variable in enumerate(variables)}
        self._tape = make_tape([formula.entries(formula.enter(places, cost))])

    def slopes(self, at: Floats) -> Floats:
        """Returns the gradient of the cost at points (E, m), 0 where it has none."""
        slopes = np.mean(self._enclose(at, at, GRADIENT)[:, 1:], axis=-1)
        return np.where(np.isfinite(slopes), slopes, 0.0)

    def bound(self, low: Floats, high: Floats, most: float) -> Floats:
        """Returns bounds over cells (E, m); ∞ where no flight costs up to the most."""
        found = self._enclose(low, high, VALUE)[:, 0, 0]
        return np.where(found <= most, found, np.inf)

    def _enclose(self, low: Floats, high: Floats, order: int) -> Floats:
        # In the order for which searches over cells have compiled it, too.
        ends = np.ascontiguousarray(low), np.ascontiguousarray(high)
        return enclose_all(self._tape, np.zeros(len(low), dtype=np.int64), *ends, order)

    def expand(self, low: Floats, high: Floats, slopes: Floats) -> Floats:
        """Returns bounds of cost + s (x − c) over cells (E, m), about their middles c."""
        sides = np.array([low, high, 0.5 * low + 0.5 * high, slopes, slopes]).reshape(5, -1)
        return bound_all(self._tape, 0, sides, np.arange(low.size).reshape(low.shape))


def _effort(h: Any, way: Any, before: Any, after: Any, pull: float) -> Any:
    miss = 2.0 * way - (before + after) * h
    return (after - before + pull * h) ** 2 / h + 3.0 * miss**2 / h**3


def flights_between(line: Line, one: Wall | None, other: Wall | None) -> FlightFamily:
    """Returns flights from a wall, or the start, to a wall, or the end, which is None.

    Their parameters are how long they take, and the speeds of touches before and after.
    """
    h, a, b = (sym.Variable(name) for name in "hab")
    wall = one or other
    assert wall is not None
    pull, v = -wall.side * line.drift, wall.restitution * a
    if one is None:
        y, v = wall.side * (line.position - wall.position), wall.side * line.velocity
        cost = _effort(h, -y, v, -b, pull)
    elif other is None:
        w, way = line.weight, wall.side * (line.goal - wall.position)
        cost = 3.0 * w / (3.0 + w * h**3) * (way - v * h + 0.5 * pull * h**2) ** 2
    elif other is wall:
        cost = (pull * h - v - b) ** 2 / h + 3.0 * (v - b) ** 2 / h
    else:
        cost = _effort(h, abs(other.position - wall.position), v, b, pull)
    return FlightFamily(cost, h, a, b)


def direct_cost(line: Line) -> float:
    """Returns the cost of the cheapest flight without walls; ∞ if it goes through one.

    Then the cheapest one that does not grazes a wall, and is bounded as one that touches it.
    """
    lift = line.weight / (3.0 + line.weight) * line.miss
    path = np.polynomial.Polynomial(
        [line.position, line.velocity, 0.5 * line.drift + 1.5 * lift, -0.5 * lift]
    )
    turns = [root.real for root in np.atleast_1d(path.deriv().roots()) if abs(root.imag) < 1e-9]
    times = np.array([1.0, *(time for time in turns if 0.0 < time < 1.0)])
    if any(np.min(w.side * (path(times) - w.position)) < -line.slack for w in line.walls):
        return math.inf
    return goal_price(line.weight) * line.miss**2


def goal_price(weight: float) -> float:
    """Returns the cost of a flight in unit time per squared unit of displacement."""
    return 3.0 * weight / (3.0 + weight)
