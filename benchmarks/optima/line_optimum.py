"""The least cost of one point mass on a line between walls, or on a floor, in unit time.

It shares no line and no idea with the planner: no knots, no boxes, no solver of the package.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from benchmarks.optima.least_effort import Coordinate, Flights, extremes
from drake_aigto.arrays import Floats

# Flights may leave the line by this much, for rounding; and one that is over sooner is none.
_TOLERANCE = 1e-9
# Where Newton's method starts: how much longer each flight lasts than the one before, what part of
# all time the first one lasts, and how much longer than by that rule the last one does.
_RATIOS, _FIRST, _LAST = (0.5, 0.8, 1.0, 1.25, 2.0), (0.1, 0.25, 0.6), (0.3, 1.0, 2.0)
_SLACKS = (0.1, 0.3, 0.6)  # how long a mass rests
# Sequences that come to rest have up to so many touches.
_MOST_WITH_REST = 3


class Wall(NamedTuple):
    """One end of the line."""

    place: float
    side: int  # 1 if the mass is above it, −1 if below
    restitution: float


class LineBounce(NamedTuple):
    """One touch."""

    time: float
    wall: int
    speed: float  # before it


class LineRest(NamedTuple):
    """A contact that lasts."""

    start: float
    end: float
    wall: int


@dataclass(frozen=True)
class LineMotion:
    """The best motion of one contact sequence.

    Attributes:
        cost: of it.
        bounces: its touches; those of a mass that settles are told up to the first of them.
        rest: where it rests, if it does.
    """

    cost: float
    bounces: tuple[LineBounce, ...]
    rest: LineRest | None


@dataclass(frozen=True)
class Line:
    """The problem: minimize ∫₀¹ (ẍ + g)² dt + w (x(1) − goal)², bouncing off the walls.

    Attributes:
        position: x(0).
        velocity: ẋ(0).
        goal: where x(1) should be.
        weight: w.
        gravity: g, along −x; may be negative.
        walls: one or two, the lower one first.
    """

    position: float
    velocity: float
    goal: float
    weight: float
    gravity: float
    walls: tuple[Wall, ...]

    def optimum(self, most_touches: int) -> LineMotion:
        """Returns the best motion of all sequences.

        Without gravity the number of touches is bounded by what they cost at least; with it, it
        goes up to `most_touches`.
        """
        best = min(self.solve(()), self._stay(), key=lambda motion: motion.cost)
        for number in range(1, most_touches + 1) if self.gravity else itertools.count(1):
            sequences = [
                sequence
                for sequence in self._sequences(number)
                if self._least_effort(sequence[0]) < best.cost
            ]
            if not sequences:
                break
            for walls, rests in sequences:
                best = min(best, self.solve(walls, rests), key=lambda motion: motion.cost)
        return best

    def _sequences(self, number: int) -> Iterator[tuple[tuple[int, ...], int | None]]:
        """Yields the walls of so many touches, and after which one the mass rests, if it does."""
        for walls in itertools.product(range(len(self.walls)), repeat=number):
            if self.gravity == 0:
                if all(one != other for one, other in itertools.pairwise(walls)):
                    yield walls, None
                continue
            yield walls, None
            if number <= _MOST_WITH_REST:
                for place, wall in enumerate(walls):
                    if self._settles(self.walls[wall]):
                        yield walls, place

    def _settles(self, wall: Wall) -> bool:
        """Returns whether a mass on this wall comes to rest by itself."""
        return wall.side * self.gravity > 0 and wall.restitution < 1

    def _stay(self) -> LineMotion:
        """Returns falling, settling and staying there without any effort, if time allows."""
        for number, wall in enumerate(self.walls):
            if len(self.walls) == 1 and self._settles(wall):
                g, height = abs(self.gravity), wall.side * (self.position - wall.place)
                rise = wall.side * self.velocity
                speed = math.sqrt(rise**2 + 2 * g * height)
                time = (rise + speed) / g
                settled = time + self.settling(wall) * speed
                if settled < 1:
                    cost = self.weight * (self.goal - wall.place) ** 2
                    return LineMotion(
                        cost, (LineBounce(time, number, speed),), LineRest(settled, 1.0, number)
                    )
        return LineMotion(math.inf, (), None)

    def settling(self, wall: Wall) -> float:
        """Returns how long a mass takes to settle, over the speed of the first touch."""
        e = wall.restitution
        return 2 * e / (abs(self.gravity) * (1 - e))

    def _least_effort(self, walls: tuple[int, ...]) -> float:
        """Returns a bound of the effort of these touches: 3 (way − velocity along it)²; or 0."""
        if self.gravity != 0:
            return 0.0
        places = [self.position, *(self.walls[wall].place for wall in walls)]
        way = float(np.sum(np.abs(np.diff(places))))
        along = -self.walls[walls[0]].side * self.velocity
        return 3 * max(0.0, way - along) ** 2

    def solve(self, walls: tuple[int, ...], rests: int | None = None) -> LineMotion:
        """Returns the best motion of one sequence; its cost is infinite if none is admissible.

        Args:
            walls: the number of the wall that each touch is on.
            rests: after which of them the mass settles; None if it doesn't.
        """
        best = LineMotion(math.inf, (), None)
        for slack in (False,) if rests is None else (False, True):
            sequence = LineSequence(self, walls, rests, slack)
            for cost, z in sequence.flights.minimize(sequence.starts()):
                if cost < best.cost and sequence.is_admissible(z):
                    best = sequence.motion(cost, z)
        return best


class LineSequence:
    """One contact sequence of a line, as flights.

    Free are the times of all flights but the last, the speeds before all touches, and, with slack,
    how long the mass rests. It settles by bounces of less and less height without any effort; that
    takes 2ey/(g(1 − e)) from the touch at speed y.
    """

    def __init__(self, line: Line, walls: tuple[int, ...], rests: int | None, slack: bool) -> None:
        """Lists the flights.

        Args:
            line: the problem.
            walls: the number of the wall that each touch is on.
            rests: after which of them the mass settles; None if it doesn't.
            slack: whether it rests after that.
        """
        self.line, self.walls, self.rests, self.slack = line, walls, rests, slack
        n = len(walls)
        self.flights = flights = Flights(2 * n + slack, line.gravity)
        self.mass = mass = Coordinate(flights, line.position, line.velocity)
        for i, number in enumerate(walls):
            wall, speed = line.walls[number], flights.variable(n + i)
            after = wall.side * wall.restitution * speed
            time, place = mass.time + flights.variable(i), flights.constant(wall.place)
            mass.fly(time, place, -wall.side * speed, after)
            if i == rests:
                mass.velocity = flights.constant(0.0)
                mass.time = mass.time + line.settling(wall) * speed
                if slack:
                    mass.time = mass.time + flights.variable(2 * n)
        mass.finish(line.goal, line.weight)
        flights.keep_positive(*map(flights.variable, range(n, flights.size)))

    def starts(self) -> Floats:
        """Returns where to start Newton's method, shape (k, n)."""
        line, n = self.line, len(self.walls)
        if n == 0:
            return np.empty((1, 0))
        places = [line.position, *(line.walls[number].place for number in self.walls), line.goal]
        ways = np.abs(np.diff(places))
        ways[ways == 0] = np.mean(ways)
        starts = []
        for times in self._times(ways):
            # As in flights that start at rest, or hop.
            speeds = ways[:n] / times + abs(line.gravity) * times / 2
            if self.rests is not None:
                settling = line.settling(line.walls[self.walls[self.rests]])
                speeds[self.rests] = min(speeds[self.rests], 0.2 / max(settling, 1e-9))
            # All flights, 0.2 at most to settle, and the rest's own time fill what there is.
            for slack in _SLACKS if self.slack else (0.0,):
                share = 1.0 if self.rests is None else 0.8 - slack
                starts.append([*share * times, *speeds, *([slack] if self.slack else [])])
        return np.array(starts)

    def _times(self, ways: Floats) -> Iterator[Floats]:
        """Yields how long each flight but the last may take, of these ways."""
        ratios = _RATIOS if ways.size > 2 else (1.0,)
        for ratio, first, last in itertools.product(ratios, self._first_times(ways[0]), _LAST):
            times = ways * ratio ** np.arange(ways.size)
            times[-1] *= last
            times[1:] *= (1 - first) / times[1:].sum()
            times[0] = first
            yield times[:-1]

    def _first_times(self, way: float) -> list[float]:
        """Returns how long the first flight may last: some parts of all time, and by itself."""
        times = [*_FIRST]
        along = -self.line.walls[self.walls[0]].side * self.line.velocity
        if along > way:
            times += [way / along, 0.7 * way / along]
        return times

    def is_admissible(self, z: Floats) -> bool:
        """Returns whether there are all flights, and stay on the line."""
        lower, upper = -math.inf, math.inf
        for wall in self.line.walls:
            lower, upper = (wall.place, upper) if wall.side > 0 else (lower, wall.place)
        spans = self.flights.values(z)[:, 3]
        # The first one may be as short as the way to the wall is.
        if spans[0] <= 0.0 or np.any(spans[1:] <= _TOLERANCE):
            return False
        for start, end, path in self.mass.paths(z):
            least, largest = extremes(path, end - start)
            if least < lower - _TOLERANCE or largest > upper + _TOLERANCE:
                return False
        return True

    def motion(self, cost: float, z: Floats) -> LineMotion:
        """Returns the motion of this z."""
        n, time, bounces, rest = len(self.walls), 0.0, [], None
        for i, number in enumerate(self.walls):
            time += float(z[i])
            bounces.append(LineBounce(time, number, float(z[n + i])))
            if i == self.rests:
                start = time + self.line.settling(self.line.walls[number]) * float(z[n + i])
                time = start + (float(z[2 * n]) if self.slack else 0.0)
                rest = LineRest(start, time, number)
        return LineMotion(float(cost), tuple(bounces), rest)
