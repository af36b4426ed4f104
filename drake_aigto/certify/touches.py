"""Lower bounds of motions between walls under a constant force, for any number of touches.

A motion is a path through its touches, each a point (time, speed before it) of its wall. These
planes are cut into cells, and an edge from one cell to another is the least cost of a flight
(`flights`) between any two of their points. Hence no motion costs less than the shortest path from
the start to the end: times, speeds and numbers of touches are bounded at once. Cells and edges that
no path below a known cost goes through are dropped, the others are halved. A cheap flight over Δ in
time h is nearly straight, 2Δ ≈ (v + v')h, which changes by some 2v for each unit of time, and by h
for each one of speed: a cell is cut along what changes it more.

So that a path gains little by leaving a cell elsewhere than it came, each cell has a slope p, near
that of the cost to go. Edges cost f + p'(z' − c') − p (z − c), with z, z'
the touches and c, c' the middles of their cells: along a motion these terms cancel.

Where touches accumulate, their speeds go to 0. Cells that 0 speed belongs to have p = 0, and a way
from one to a later one of the same wall, by whatever touches or at rest, costs γ² for each unit of
time if the wall has to be held on to, else nothing. Flights may go through walls, which costs less.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.certify.flights import FlightFamily, Line, direct_cost, flights_between

_FIRST_BINS = 16  # of times, and of speeds
_MOST = 500_000  # edges of one level, and cells
_LEVELS = 32
_BISECTIONS = 6
_ENOUGH = 1e-3  # of the largest cost of interest: a level that gains less is the last one
_ROUNDING = 1e-13


@dataclass(frozen=True, eq=False)
class _Cells:
    """Touches of walls by their times and speeds, after the start and the end, which are points.

    An array of E edges has shape (2, E): the cells that they come from, and those that they go to.
    """

    walls: Ints  # which wall each is of; behind the last one, start and end (N,)
    low: Floats  # least time and speed (N, 2)
    high: Floats  # largest
    slopes: Floats  # p (N, 2)

    @property
    def middles(self) -> Floats:
        """C (N, 2)."""
        return 0.5 * self.low + 0.5 * self.high

    @property
    def gains(self) -> Floats:
        """Upper bound of p (z − c) (N,)."""
        return np.sum(np.abs(self.slopes) * 0.5 * (self.high - self.low), axis=1) * (1.0 + 1e-9)

    @property
    def may_rest(self) -> Bools:
        """Whether a speed of 0 belongs to it (N,)."""
        return self.low[:, 1] == 0.0

    def boxes(self, edges: Ints) -> tuple[Floats, Floats]:
        """Returns how long flights take, and the speeds of their touches: both ends (E, 3)."""
        sources, targets = edges
        least = np.nextafter(self.low[targets, 0] - self.high[sources, 0], -np.inf)
        most = np.nextafter(self.high[targets, 0] - self.low[sources, 0], np.inf)
        return (
            np.column_stack([np.maximum(least, 0.0), self.low[sources, 1], self.low[targets, 1]]),
            np.column_stack([most, self.high[sources, 1], self.high[targets, 1]]),
        )


class _Paths(NamedTuple):
    """Shortest paths through cells."""

    least: float  # cost of the shortest one
    cells: Floats  # of the shortest one by way of each cell (N,)
    edges: Floats  # of the shortest one by way of each edge (E,)
    followers: Ints  # the next cell on the shortest path from each (N,)


class _LineFlights:
    """All flights on a line, and their costs between cells, up to the most that is of interest."""

    def __init__(self, line: Line, most: float) -> None:
        """Makes the formulas."""
        self.most, places = most, [*enumerate(line.walls)]
        self._pulls = np.array([-wall.side * line.drift for wall in line.walls] + [0.0] * 2)
        self._sticks = np.array([wall.restitution == 0.0 for wall in line.walls] + [False] * 2)
        start, self._end = len(places), len(places) + 1
        self._flights = {
            (i, j): flights_between(line, one, other)
            for i, one in (*places, (start, None))
            for j, other in (*places, (self._end, None))
            if one or other
        }

    def flat(self, cells: _Cells, edges: Ints) -> Floats:
        """Returns lower bounds of the costs of flights and rests (E,), without slopes."""
        costs = np.full(edges.shape[1], np.inf)
        for own, flights in self._flights_of(cells, edges):
            costs[own] = flights.bound(*cells.boxes(edges[:, own]), self.most)
        rests = self._rests(cells, edges)
        sources, targets = edges[:, rests]
        time = np.maximum(cells.low[targets, 0] - cells.high[sources, 0], 0.0)
        costs[rests] = np.minimum(self._pulls[cells.walls[sources]], 0.0) ** 2 * time
        return costs

    def sloped(self, cells: _Cells, edges: Ints, flat: Floats) -> Floats:
        """Returns costs with f + p'(z' − c') − p (z − c) in place of f."""
        gains, (sources, targets) = cells.gains, edges
        costs = flat - gains[sources] - gains[targets]
        for own, flights in self._flights_of(cells, edges):
            own = own[np.isfinite(costs[own])]
            costs[own] = np.fmax(costs[own], self._expand(flights, cells, edges[:, own]))
        return costs

    def _expand(self, flights: FlightFamily, cells: _Cells, edges: Ints) -> Floats:
        """Returns bounds of f + p'(z' − c') − p (z − c) of flights between cells (E,)."""
        (sources, targets), (p, q) = edges, cells.slopes[edges]
        q = np.where(cells.walls[targets, None] == self._end, p, q)  # There, z' is c'.
        low, high = cells.boxes(edges)
        found = flights.expand(low, high, np.column_stack([q[:, 0], -p[:, 1], q[:, 1]]))
        # With t' = t + h: q (t' − c') − p (t − c) = q (h − m) + q (m − c' + c) + (q − p) (t − c).
        middles, half = cells.middles[:, 0], 0.5 * (cells.high - cells.low)[sources, 0]
        moved = 0.5 * (low + high)[:, 0] - middles[targets] + middles[sources]
        return found + q[:, 0] * moved - np.abs(q[:, 0] - p[:, 0]) * half

    def _flights_of(self, cells: _Cells, edges: Ints) -> Iterator[tuple[Ints, FlightFamily]]:
        """Yields the edges from one place to another that are not rests."""
        (first, second), moves = cells.walls[edges], ~self._rests(cells, edges)
        for (i, j), flights in self._flights.items():
            yield np.flatnonzero(moves & (first == i) & (second == j)), flights

    def _rests(self, cells: _Cells, edges: Ints) -> Bools:
        """Returns which edges a mass may go along by resting (E,)."""
        (first, second), (before, after) = cells.walls[edges], cells.may_rest[edges]
        return (before | self._sticks[first]) & (first == second) & after

    def without_gain(self, cells: _Cells, edges: Ints, flat: Floats) -> _Cells:
        """Returns cells with slopes so small that no cycle lowers the cost of a path.

        Only what may take no time leads back. What leads to a cell that way costs no less then than
        its slope gains between two of its points.
        """
        sources, targets = edges
        back = cells.low[targets, 0] <= cells.high[sources, 0]
        costs = np.full(cells.walls.size, np.inf)
        np.minimum.at(costs, targets[back], flat[back])
        gains = cells.gains
        parts = np.divide(
            0.499 * costs, gains, out=np.ones_like(gains), where=gains > 0.499 * costs
        )
        return replace(cells, slopes=cells.slopes * parts[:, None])

    def with_slopes(self, cells: _Cells, walls: Ints, touches: Floats) -> _Cells:
        """Returns cells with p: the slope of the cost to go at a cell's middle.

        The next touches are of walls (N,), or the end, at times and speeds (N, 2).
        """
        found, own = np.zeros_like(cells.low), cells.middles
        time = touches[:, 0] - own[:, 0]
        for (i, j), flights in self._flights.items():
            at = np.flatnonzero((cells.walls == i) & (walls == j) & (time > 0.0))
            along = flights.slopes(np.column_stack([time, own[:, 1], touches[:, 1]])[at])
            found[at] = np.column_stack([-along[:, 0], along[:, 1]])
        found[cells.may_rest] = 0.0
        return replace(cells, slopes=found)


def bound_line(line: Line, most: float) -> float:
    """Returns a bound of the cost on a line, if it is no more than the most that is of interest.

    Fewest cells are left where the most is near the least cost, which is bisected for.
    """
    best, high = _search(line, most), most
    for _ in range(_BISECTIONS):
        if high - best <= 2.0 * _ENOUGH * high:
            break
        middle = 0.5 * (best + high)
        found = _search(line, middle)
        best, high = max(best, found), high if found >= middle else middle
    return best


def _search(line: Line, most: float) -> float:
    """Returns a bound of the cost on a line, or the most if no motion costs less."""
    walls, cells = _LineFlights(line, most), _first_cells(line, most)
    best, before, last, enough = 0.0, -math.inf, -math.inf, min(most, direct_cost(line))
    edges = np.indices((cells.walls.size,) * 2).reshape(2, -1)
    for _ in range(_LEVELS):
        edges = edges[:, cells.high[edges[1], 0] > cells.low[edges[0], 0]]
        if max(edges.shape[1], cells.walls.size) > _MOST:
            break
        flat = walls.flat(cells, edges)
        first = _find_paths(edges, flat, cells.walls.size)
        left = np.flatnonzero(first.edges <= most)
        edges, flat = edges[:, left], flat[left]
        cells = walls.without_gain(cells, edges, flat)
        sloped = walls.sloped(cells, edges, flat)
        paths = _find_paths(edges, sloped, cells.walls.size)
        if first.least > paths.least:
            paths = paths._replace(least=first.least, followers=first.followers)
        least = min(enough, paths.least)
        # Changes of two cuts fall fourfold: all that are to come add up to less than the last.
        best, change, before, last = max(best, least), abs(least - before), last, least
        if least >= enough or change < _ENOUGH * least:
            break
        cells, edges = _cut(walls, cells, edges, paths)
    return best


def _first_cells(line: Line, most: float) -> _Cells:
    """Returns cells of all touches that cost no more than the most."""
    # Touches take speed away, so that none is faster than this.
    fastest = abs(line.velocity) + abs(line.drift) + math.sqrt(most)
    times = np.linspace(0.0, 1.0, _FIRST_BINS + 1)
    speeds = times * fastest * (1.0 + 1e-9)
    low = np.array([(t, a) for t in times[:-1] for a in speeds[:-1]])
    high = np.array([(t, a) for t in times[1:] for a in speeds[1:]])
    count, ends = len(line.walls), np.array([(0.0, 0.0), (1.0, 0.0)])
    walls = np.array([count, count + 1, *np.repeat(np.arange(count), len(low))])
    low, high = (np.vstack([ends, np.tile(each, (count, 1))]) for each in (low, high))
    return _Cells(walls, low, high, np.zeros_like(low))


def _find_paths(edges: Ints, costs: Floats, count: int) -> _Paths:
    """Returns the shortest paths from the first one of N cells to the second, by way of edges."""
    kept = np.flatnonzero(np.isfinite(costs))
    (sources, targets), weights = edges[:, kept], costs[kept]
    before, after = (np.where(np.arange(count) == end, 0.0, np.inf) for end in range(2))
    before = _relax(before, sources, targets, weights)
    after = _relax(after, targets, sources, weights)
    followers = np.ones(count, dtype=np.int64)
    onward = weights + after[targets] <= after[sources] + _ROUNDING * np.abs(after[sources])
    followers[sources[onward]] = targets[onward]
    through = np.full(edges.shape[1], np.inf)
    through[kept] = before[sources] + weights + after[targets]
    return _Paths(float(after[0]), before + after, through, followers)


def _relax(values: Floats, sources: Ints, targets: Ints, weights: Floats) -> Floats:
    """Returns values (N,) that no edge lowers by more than rounding does."""
    while True:
        lower = values.copy()
        np.minimum.at(lower, targets, values[sources] + weights)
        known = np.isfinite(values)
        if np.array_equal(known, np.isfinite(lower)) and np.all(
            lower[known] >= values[known] - _ROUNDING * np.abs(values[known])
        ):
            return lower
        values = lower


def _cut(walls: _LineFlights, cells: _Cells, edges: Ints, paths: _Paths) -> tuple[_Cells, Ints]:
    """Returns both halves of the cells that are left, and the edges between them."""
    most, counts = walls.most * (1.0 + 1e-12), np.where(cells.high[:, 1] > 0.0, 2, 1)
    is_left, left = paths.cells <= most, np.flatnonzero(paths.edges <= most)
    counts[~is_left] = 0
    alive, place = np.repeat(np.arange(counts.size), counts), np.cumsum(counts) - counts
    low, high, middles, nexts = cells.low[alive], cells.high[alive], cells.middles, paths.followers
    (times, speeds), widths = middles.T, cells.high - cells.low
    flights = middles[nexts, 0] - times
    axes = (2.0 * speeds * widths[:, 0] < flights * widths[:, 1]).astype(np.int64)
    whole = np.flatnonzero(counts == 2)
    first, own = place[whole], axes[whole]
    high[first, own] = low[first + 1, own] = middles[whole, own]
    parts = _Cells(cells.walls[alive], low, high, np.zeros_like(low))
    parts = walls.with_slopes(parts, cells.walls[nexts[alive]], middles[nexts[alive]])
    pairs = np.indices((2, 2)).reshape(2, 1, -1)
    is_pair = np.all(pairs < counts[edges[:, left]][..., None], axis=0)
    return parts, (place[edges[:, left]][..., None] + pairs)[:, is_pair]
