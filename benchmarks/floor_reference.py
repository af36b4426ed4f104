"""The least cost of a point mass on a floor under gravity, where it may also settle, rest and jump.

Globally, on a grid of times and impact speeds: dynamic programming over touches, from the last one
back, by the number of those to come. Then exactly: Newton's method on times and speeds
(`LineSequence`), from the best motion of the grid for each number of touches and each local optimum
of the first one's time. It knows no knots, no boxes, and no planner.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.optima.line_optimum import Line, LineSequence, Wall
from drake_aigto.arrays import Floats, Ints
from drake_aigto.kernels import kernel
from drake_aigto.world import Scenario

# The grid: times of touches, speeds before them, and the fastest, of what falling freely reaches.
_TIMES, _SPEEDS, _FASTEST = 100, 90, 1.6
# So many touches are tried, or so many beyond the best number of them, at which costs only rise.
_MOST_TOUCHES, _BEYOND = 16, 4
# Below the floor by this much is on it.
_TOLERANCE = 1e-9


@dataclass(frozen=True)
class FloorMotion:
    """The best motion of some kind.

    Attributes:
        cost: of it.
        touches: how many have a speed; of settling the first one only.
        rests: whether it settles.
        leaves: whether it jumps off, after that.
    """

    cost: float
    touches: int
    rests: bool = False
    leaves: bool = False


def floor_optimum(scenario: Scenario, gravity: float, mass: float) -> FloorMotion:
    """Returns the best motion that is found of a point mass on the floor q ≥ 0.

    Args:
        scenario: start, goal, duration, weights and restitution.
        gravity: towards the floor [m/s²].
        mass: [kg].
    """
    T = scenario.duration
    price = mass**2 * scenario.control_weight / T**3
    line = Line(
        position=float(scenario.initial_position[0]),
        velocity=float(scenario.initial_velocity[0] * T),
        goal=float(scenario.goal_position[0]),
        weight=scenario.goal_weight / price,
        gravity=gravity * T**2,
        walls=(Wall(0.0, 1, scenario.restitution),),
    )
    best = min(_list_motions(line), key=lambda motion: motion.cost)
    return FloorMotion(price * best.cost, best.touches, best.rests, best.leaves)


def _list_motions(line: Line) -> Iterator[FloorMotion]:
    """Yields what may be the best motion, in unit time."""
    simple = line.optimum(most_touches=0)  # It flies, or falls and stays.
    yield FloorMotion(simple.cost, len(simple.bounces), simple.rest is not None)
    grid, least, last = _Grid(line), math.inf, 0
    for number in range(1, _MOST_TOUCHES + 1):
        grid.add_touch()
        for cost, legs in grid.best_motions():
            if cost < least:
                least, last = cost, number
            yield from _polish(line, cost, legs)
        if number - last >= _BEYOND:
            return


@dataclass(frozen=True)
class _Leg:
    """A flight of a motion on the grid to a touch, and how long it rests after that, if it does."""

    time: float
    speed: float
    rest: float | None


def _polish(line: Line, cost: float, legs: list[_Leg]) -> Iterator[FloorMotion]:
    """Yields a motion of the grid, and the local optima next to it that have its touches."""
    number, rests = len(legs), [i for i, leg in enumerate(legs) if leg.rest is not None]
    stays = bool(rests) and math.isinf(legs[-1].rest or 0.0)
    yield FloorMotion(cost, number, bool(rests), bool(rests) and not stays)
    if stays or len(rests) > 1:
        return
    place = rests[0] if rests else None
    z = [*(leg.time for leg in legs), *(leg.speed for leg in legs)]
    for slack in (False, True) if rests else (False,):
        sequence = LineSequence(line, (0,) * number, place, slack)
        start = [*z, *(max(legs[i].rest or 0.0, 1e-3) for i in rests if slack)]
        for exact, found in sequence.flights.minimize(np.array([start])):
            if sequence.is_admissible(found):
                yield FloorMotion(exact, number, bool(rests), bool(rests))


class _Grid:
    """Motions of a line in unit time whose touches are on a grid.

    Tables are over the time i/n of a touch and the speed y_j before it, from which on the ball
    flies with e y_j, or settles, at no cost, in 2 e y_j/(g (1 − e)), and jumps when it likes. Lists
    have a table for each number of touches to come.
    """

    def __init__(self, line: Line) -> None:
        self.line = line
        g, (wall,) = line.gravity, line.walls
        self.times = np.arange(_TIMES) / _TIMES
        fall = math.sqrt(line.velocity**2 + 2 * g * max(line.position, line.goal))
        self.speeds = _FASTEST * fall * (np.arange(_SPEEDS) + 0.5) / _SPEEDS
        self.after = np.append(wall.restitution * self.speeds, 0.0)  # At last, from rest.
        self.durations = np.arange(1, _TIMES) / _TIMES
        v, y, t = self.after[:, None], self.speeds, self.durations[:, None, None]
        self.hops = (g * t - y - v) ** 2 / t + 3 * (y - v) ** 2 / t
        self.first = self._first_flights()
        self.settled = np.full((_TIMES, _SPEEDS), _TIMES)  # When; never, with e = 1.
        if wall.restitution < 1:
            ends = self.times[:, None] + line.settling(wall) * self.speeds
            self.settled = np.minimum(np.ceil(ends * _TIMES - 1e-9), _TIMES).astype(np.int64)
        self.flights = [
            np.array([[self._finish(v, 1 - t) for v in self.after] for t in self.times])
        ]
        self.hopped: list[Ints] = [np.empty((0, 0), dtype=np.int64)]  # To which state, k n + l.
        self.jumps: list[Ints] = []  # When, from rest at each time.
        self.touched: list[Floats] = []
        self.settles: list[Ints] = []

    def _finish(self, v: float, left: float) -> float:
        """Returns what the last flight from the floor costs; infinity if it would go below."""
        w, g, goal = self.line.weight, self.line.gravity, self.line.goal
        missed = goal - v * left + g * left**2 / 2
        lift = w / (3 + w * left**3) * missed
        # x(s) = s (v + slope s/2 − lift s²/2), s up to what is left: lowest at an end or between.
        slope = 3 * lift * left - g
        lows = [v, v + slope * left / 2 - lift * left**2 / 2]
        if lift < 0 and 0 < (at := slope / (2 * lift)) < left:
            lows.append(v + slope * at / 2 - lift * at**2 / 2)
        if min(lows) < -_TOLERANCE:
            return math.inf
        return 3 * w / (3 + w * left**3) * missed**2

    def _first_flights(self) -> Floats:
        """Returns what it costs to be at the floor at a time, with a speed."""
        p, v, g = self.line.position, self.line.velocity, self.line.gravity
        t, end = self.durations[:, None], -self.speeds
        cost = (end - v + g * t) ** 2 / t + 12 * (p + (v + end) * t / 2) ** 2 / t**3
        # In parts s of the time: (1 − s)(p + (p + vt) s + bend s²), with p > 0.
        slope, bend = p + v * t, -(2 * p + (v + end) * t)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = -slope / (2 * bend)
            dips = (bend > 0) & (at > 0) & (at < 1) & (p < slope**2 / (4 * bend))
        return np.where(dips, math.inf, cost)

    def add_touch(self) -> None:
        """Adds the tables of one touch more."""
        number = len(self.touched)
        if number:
            costs, states = _hop(self.hops, self.touched[-1])
            self.flights.append(costs)
            self.hopped.append(states)
        rest = np.append(self.flights[-1][:, -1], math.inf)
        if number == 0:
            rest[-1] = self.line.weight * self.line.goal**2  # It stays.
        later = np.minimum.accumulate(rest[::-1])[::-1]
        when = np.array([i + int(np.argmin(rest[i:])) for i in range(_TIMES + 1)])
        settled = later[self.settled]
        settled[self.settled == _TIMES] = math.inf
        flying = self.flights[-1][:, :-1]
        self.jumps.append(when)
        self.settles.append((settled < flying).astype(np.int64))
        self.touched.append(np.minimum(settled, flying))

    def best_motions(self) -> Iterator[tuple[float, list[_Leg]]]:
        """Yields cost and legs of the best motions with as many touches as there are tables.

        There is one for each local optimum of the first touch's time.
        """
        total = self.first + self.touched[-1][1:]
        costs = np.append(np.append(math.inf, np.min(total, axis=1)), math.inf)
        for i in range(1, _TIMES):
            if costs[i] < math.inf and costs[i] <= min(costs[i - 1], costs[i + 1]):
                yield float(costs[i]), self._trace(i, int(np.argmin(total[i - 1])))

    def _trace(self, time: int, speed: int) -> list[_Leg]:
        """Returns the legs of the best motion whose first touch is this."""
        legs, left = [], 0
        for number in range(len(self.touched) - 1, -1, -1):
            duration, state, rest = (time - left) / _TIMES, speed, None
            left = time
            if self.settles[number][time, speed]:
                settled = int(self.settled[time, speed])
                left, state = int(self.jumps[number][settled]), _SPEEDS
                slack = left / _TIMES - self.times[time] - self._settling(speed)
                rest = math.inf if left == _TIMES else slack
            legs.append(_Leg(duration, float(self.speeds[speed]), rest))
            if number:
                time, speed = divmod(int(self.hopped[number][left, state]), _SPEEDS)
        return legs

    def _settling(self, speed: int) -> float:
        return self.line.settling(self.line.walls[0]) * float(self.speeds[speed])


@kernel
def _hop(hops: Floats, touched: Floats) -> tuple[Floats, Ints]:
    """Returns the least cost from each time and state on over a hop, and which touch that ends in.

    Args:
        hops: the effort by duration, state before and speed after it.
        touched: what is left from each touch on.
    """
    n, m = touched.shape
    costs, states = np.full((n, m + 1), np.inf), np.zeros((n, m + 1), np.int64)
    for i in range(n):
        for s in range(m + 1):
            for k in range(i + 1, n):
                for j in range(m):
                    cost = hops[k - i - 1, s, j] + touched[k, j]
                    if cost < costs[i, s]:
                        costs[i, s] = cost
                        states[i, s] = k * m + j
    return costs, states
