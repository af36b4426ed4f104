"""Cheapest flights between walls under a constant force, and bounds of their costs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pydrake.symbolic as sym

from drake_aigto.arrays import Floats
from drake_aigto.certify.enclosures import GRADIENT, VALUE, enclose_all
from drake_aigto.certify.expansions import bound_all
from drake_aigto.certify.tape import Formula, Tape, make_tape

# Places along a flight, as parts of its time, that have to be between the walls.
_PLACES = (0.25, 0.5, 0.75, 1.0)
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


@dataclass(frozen=True, eq=False)
class FlightFamily:
    """Flights of one kind, as functions of their parameters.

    Attributes:
        tape: their cost, and where they are at some times.
        low: least such place.
        high: largest.
        is_convex: whether the cost is known to be a convex function.
    """

    tape: Tape
    low: float
    high: float
    is_convex: bool = False

    def slopes(self, at: Floats) -> Floats:
        """Returns the gradient of the cost at points (E, m), 0 where it has none."""
        found = enclose_all(self.tape, np.zeros(len(at), dtype=np.int64), at, at, GRADIENT)
        slopes = np.mean(found[:, 1:], axis=-1)
        return np.where(np.isfinite(slopes), slopes, 0.0)

    def bound(self, low: Floats, high: Floats, most: float) -> Floats:
        """Returns bounds over cells (E, m); ∞ where no flight within walls costs up to the most."""
        found = self._values(0, low, high)[:, 0]
        keep = found <= most
        for place in range(1, self.tape.starts.size - 1):
            kept = np.flatnonzero(keep)
            inside = self._values(place, low[kept], high[kept])
            keep[kept] = (inside[:, 1] >= self.low) & (inside[:, 0] <= self.high)
        return np.where(keep, found, np.inf)

    def _values(self, formula: int, low: Floats, high: Floats) -> Floats:
        return enclose_all(self.tape, np.full(len(low), formula), low, high, VALUE)[:, 0]

    def expand(self, low: Floats, high: Floats, slopes: Floats) -> Floats:
        """Returns bounds of cost + s (x − c) over cells (E, m), about their middles c."""
        sides = np.array([low, high, 0.5 * low + 0.5 * high, slopes, slopes]).reshape(5, -1)
        cells = np.arange(low.size).reshape(low.shape)
        return bound_all(self.tape, 0, sides, cells, self.is_convex)


def _flights(
    line: Line,
    wall: Wall,
    variables: Sequence[sym.Variable],
    cost: sym.Expression,
    places: Sequence[sym.Expression],
    is_convex: bool = False,
) -> FlightFamily:
    """Returns flights from or to a wall, whose places are within the room beside it."""
    index = {variable.get_id(): i for i, variable in enumerate(variables)}
    formulas = []
    for each in (cost, *places):
        formula = Formula()
        formula.add(index, each)
        formulas.append(formula.finish())
    others = [abs(other.position - wall.position) for other in line.walls if other is not wall]
    most = min(others, default=math.inf) + line.slack
    return FlightFamily(make_tape(formulas), -line.slack, most, is_convex)


def _effort(h: Any, way: Any, before: Any, after: Any, pull: float) -> Any:
    """Returns ∫ (ÿ + γ)² dt of the cheapest flight."""
    return (after - before + pull * h) ** 2 / h + 3.0 * (
        2.0 * way - (before + after) * h
    ) ** 2 / h**3


def _cubic(h: Any, ends: tuple[Any, Any], speeds: tuple[Any, Any]) -> list[Any]:
    """Returns where a cubic is at some parts of its time."""
    return [
        (1.0 - s) ** 2 * (ends[0] * (1.0 + 2.0 * s) + speeds[0] * h * s)
        + s**2 * (ends[1] * (3.0 - 2.0 * s) - speeds[1] * h * (1.0 - s))
        for s in _PLACES
    ]


def first_flights(line: Line, wall: Wall) -> FlightFamily:
    """Returns flights from the start to a wall, by the time and speed of the touch."""
    h, a = sym.Variable("h"), sym.Variable("a")
    y, v = wall.side * (line.position - wall.position), wall.side * line.velocity
    cost = _effort(h, -y, v, -a, -wall.side * line.drift)
    return _flights(line, wall, (h, a), cost, _cubic(h, (y, 0.0), (v, -a)))


def hops(line: Line, wall: Wall, other: Wall) -> FlightFamily:
    """Returns flights from a wall to a wall, by how long they take and the speeds of touches."""
    h, a, b = sym.Variable("h"), sym.Variable("a"), sym.Variable("b")
    v, pull = wall.restitution * a, -wall.side * line.drift
    if other is wall:
        # Squares of linear functions over h are convex.
        cost = (pull * h - v - b) ** 2 / h + 3.0 * (v - b) ** 2 / h
        places = _cubic(h, (0.0, 0.0), (v, -b)) if len(line.walls) > 1 else []
        return _flights(line, wall, (h, a, b), cost, places, is_convex=True)
    way = abs(other.position - wall.position)
    places = _cubic(h, (0.0, way), (v, b))
    return _flights(line, wall, (h, a, b), _effort(h, way, v, b, pull), places)


def last_flights(line: Line, wall: Wall) -> FlightFamily:
    """Returns flights from a wall to the end, by the time and speed of the touch."""
    t, a = sym.Variable("t"), sym.Variable("a")
    pull, w, left = -wall.side * line.drift, line.weight, 1.0 - t
    v = wall.restitution * a
    miss = wall.side * (line.goal - wall.position) - v * left + 0.5 * pull * left**2
    lift = w * left**3 / (3.0 + w * left**3) * miss
    cost = 3.0 * w / (3.0 + w * left**3) * miss**2
    places = [
        s * left * v - 0.5 * pull * (s * left) ** 2 + 0.5 * (3.0 - s) * s**2 * lift for s in _PLACES
    ]
    return _flights(line, wall, (t, a), cost, places)


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
