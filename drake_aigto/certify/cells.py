"""Branch and bound over cells of all variables at once."""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.certify.contraction import bound_all, may_hold_minima, middles
from drake_aigto.certify.enclosures import HESSIAN, VALUE, SumOfFormulas, enclose_all
from drake_aigto.certify.formulas import Formulas, tape_of
from drake_aigto.certify.relaxation import Relaxation

_MOST_OPEN = 400_000  # cells
_BATCH = 4  # this part of the open cells is cut at once, and at least this number
_MOST_CELLS = 500  # between two reports of progress and looks at the clock
_MOST_AT_ONCE = 250
# Variables of programs without rows whose cells are bounded by Hessians, and by these alone.
_MOST_BENT, _FEW_BENT = 10, 2
_MOST_ROUNDS = 4  # over all sides of the whole
_SPENT = 0.1  # of a side: a round over all sides that cuts off less is the last one
# Such a round takes up to this number of cells, or this part of those that are left.
_MOST_OF_ROUND, _PART_OF_ROUND = 5000, 0.5
# Where cells that go on without an end begin, and how many groups of them are bounded at most,
# before any other cell.
_MOST_PROBES, _FAR = 10, (2.0**10, 2.0**40, 2.0**160, 2.0**640)
_MOST_PAIRED = 20  # sides without an end; of more, no two are looked at together


class OpenCells(NamedTuple):
    """Cells and what is known of them."""

    low: Floats  # lower ends (C, n)
    high: Floats  # upper ends
    bounds: Floats  # of f (C,)
    cuts: Ints  # variables to cut next; −1: none can be (C,)
    places: Floats  # where (C,)

    def some(self, kept: Bools | Ints) -> OpenCells:
        """Returns a part of them."""
        return OpenCells._make(each[kept] for each in self)

    def halves(self) -> OpenCells:
        """Returns both parts of each, one after the other."""
        parts = OpenCells._make(np.repeat(each, 2, axis=0) for each in self)
        first, last = np.arange(0, len(parts.cuts), 2), np.arange(1, len(parts.cuts), 2)
        parts.high[first, self.cuts] = parts.low[last, self.cuts] = self.places
        return parts


class BoundSearch(ABC):
    """Search for the least cost of a program, from below, which may be gone on with.

    Parts are settled once their bound is nearer to the best value than the margin, relative to it
    or to a scale.

    Attributes:
        cost: f.
        best: the best point that is known (n,).
        least: its value, rounded up.
        lowest_point: of the parts whose bounds were lowest last, if any (n,).
        num_cells: number of cells that were bounded; a linear program counts as some of them, and
            forty entries of a table as one.
    """

    def __init__(self, cost: SumOfFormulas, point: Floats, margin: float) -> None:
        """Knows of no value."""
        self.cost, self.best, self.least = cost, point, math.inf
        self.lowest_point: Floats | None = None
        self.num_cells, self._margin = 0, margin

    @abstractmethod
    def run(self, count: int, scale: float) -> bool:
        """Bounds some cells, and returns whether any is left that may hold something better.

        Args:
            count: number of cells at most.
            scale: the margin is relative to the best value, or to this where that is less in size.
        """

    def offer(self, x: Floats, value: float) -> None:
        """Takes a feasible point and its value, rounded up, if it is the best so far."""
        if value < self.least:
            self.least, self.best = value, x

    def enough(self, least: float, scale: float) -> float:
        """Returns the bound that is high enough for a least value, with a scale as in `run`."""
        return least - self._margin * max(abs(least), scale) if least < np.inf else np.inf

    def value(self, x: Floats) -> float:
        """Returns f at a point (n,), rounded up."""
        return self.cost.range(x, x)[1]


class CellSearch(BoundSearch):
    """Branch and bound over cells of a program, which may be gone on with.

    A cell is narrowed by its rows and the best value, and bounded by a linear relaxation; without
    rows, and of few variables, first by an expansion about the best point, or by that alone.

    An interruption leaves what is known in order: cells that are taken away, and what became of
    them, are changed at once.

    Attributes:
        hopeless: variables and their sides, 0 or 1, far out on which no cell has a bound.
    """

    def __init__(self, formulas: Formulas, margin: float) -> None:
        """Opens the whole box."""
        size, self._outer = formulas.lower.size, np.array([formulas.lower, formulas.upper])
        self._tape = tape_of([formulas.summands], size)
        cost = SumOfFormulas(self._tape, [range(size)])
        super().__init__(cost, middles(*self._outer), margin)
        self._is_free = not formulas.rows
        self._is_bent = self._is_free and size <= _MOST_BENT
        is_small = self._is_free and size <= _FEW_BENT
        self._relaxation = None if is_small else Relaxation(formulas)
        sides = formulas.upper - formulas.lower
        self._sides = np.where((sides > 0.0) & np.isfinite(sides), sides, 1.0)
        self._rounds = _MOST_ROUNDS if formulas.rows else 0
        # Variables that a round has not come to yet, and the sides that it found.
        self._left: list[int] = []
        self._found = self._sides
        self._settled = math.inf  # least bound of parts that were left alone
        self.hopeless: tuple[tuple[int, int], ...] = ()
        low, high = self._outer[:, None].copy()
        self._open = OpenCells(low, high, np.array([-np.inf]), np.array([-1]), np.zeros(1))

    def run(self, count: int, scale: float) -> bool:
        """Cuts cells."""
        end, self._scale = self.num_cells + min(count, _MOST_CELLS), scale
        if not self.num_cells:
            self.num_cells += 1
            self._probe()
            self._open = self._bounded(self._open)
            return True
        if self._relaxation and self._rounds and self._open.bounds.size:
            self._tighten(self._relaxation, count, end)
            return True
        while self.num_cells < end:
            # What holds nothing better, or cannot be cut, is left alone.
            is_over = (self._open.bounds > self.enough(self.least, scale)) | (self._open.cuts < 0)
            self._settle(float(np.min(self._open.bounds[is_over], initial=np.inf)))
            self._open = self._open.some(~is_over)
            size = self._open.bounds.size
            if not size or size > _MOST_OPEN or self._settled == -math.inf:
                return False
            most = min(_MOST_AT_ONCE, max(1, end - self.num_cells), size)
            self._cut(min(most, max(_BATCH, size // _BATCH)))
        return True

    def _probe(self) -> None:
        """Settles the bound as −∞ if it is that far out in one or two variables.

        Where no cell that goes on without an end has a bound, however far out it begins, none that
        is cut out of it has. All other variables are in their middles.
        """
        sides = [tuple(side) for side in np.argwhere(np.isinf(self._outer.T)).tolist()]
        pairs = itertools.combinations(sides if len(sides) <= _MOST_PAIRED else (), 2)
        probes = [((i, s),) for i, s in sides] + [(a, b) for a, b in pairs if a[0] != b[0]]
        ends = np.tile(middles(*self._outer), (len(_FAR), 2, len(probes), 1))
        for k, probe in enumerate(probes):
            for i, side in probe:
                sign = 2 * side - 1
                ends[:, side, k, i], ends[:, 1 - side, k, i] = sign * np.inf, sign * np.array(_FAR)
        formulas = np.zeros(len(probes), dtype=np.int64)
        ranges = enclose_all(self._tape, formulas, ends[0, 0], ends[0, 1], VALUE)[:, 0, 0]
        for k in np.flatnonzero(ranges == -np.inf)[:_MOST_PROBES].tolist():
            low, high = ends[:, 0, k], ends[:, 1, k]
            nothing = np.full(len(_FAR), -np.inf)
            cells = OpenCells(low, high, nothing, np.full(len(_FAR), -1), np.zeros(len(_FAR)))
            if np.count_nonzero(self._bounded(cells).bounds == -np.inf) == len(_FAR):
                self.hopeless = probes[k]
                self._settle(-math.inf)
                break
        self.lowest_point = None

    def _settle(self, bound: float) -> None:
        """Takes note that what is left alone has this bound."""
        self._settled = min(self._settled, bound)

    def _tighten(self, relaxation: Relaxation, count: int, end: int) -> None:
        """Narrows sides of the whole box by linear programs; bounds it after the last round."""
        whole, effort = self._open, 2 * relaxation.effort
        low, high = whole.low[0], whole.high[0]
        if not self._left:
            self._found, self._left = high - low, np.flatnonzero(low < high).tolist()
            if effort * len(self._left) > max(_MOST_OF_ROUND, _PART_OF_ROUND * count):
                self._rounds = 0
                return
        while self._left and self.num_cells < end:
            self.num_cells += effort
            self._settle(self.least)
            if not relaxation.tighten(self._left.pop(0), low, high, self.least):
                self._rounds, self._open = 0, whole.some(np.zeros(1, dtype=bool))
                return
        if not self._left:
            is_shorter = bool(np.any(self._found - (high - low) > _SPENT * self._found))
            self._rounds = self._rounds - 1 if is_shorter else 0
            if not self._rounds:
                self._open = self._bounded(whole)

    def _cut(self, count: int) -> None:
        """Cuts the lowest cells in two."""
        cells = self._open
        lowest = np.argpartition(cells.bounds, count - 1)[:count]
        kept = np.ones(cells.bounds.size, dtype=bool)
        kept[lowest] = False
        self.num_cells += count
        parts = zip(cells.some(kept), self._bounded(cells.some(lowest).halves()), strict=True)
        self._open = OpenCells._make(map(np.concatenate, parts))

    def _bounded(self, cells: OpenCells) -> OpenCells:
        """Returns the cells that may hold a minimizer, narrowed, with bounds and cuts."""
        cells.cuts[:] = -1
        self._settle(self.least)
        if self._is_bent:
            self._expand(cells)
        if self._relaxation is not None:
            self._relax(self._relaxation, cells)
        self._cut_widest(cells)
        return cells.some(cells.bounds < np.inf)

    def _relax(self, relaxation: Relaxation, cells: OpenCells) -> None:
        """Raises bounds by linear relaxations, and narrows cells by them."""
        low, high, bounds, cuts, places = cells
        lowest, enough = np.inf, self.enough(self.least, self._scale)
        for c in np.flatnonzero(bounds <= enough):
            bound, x, cut = relaxation.bound(low[c], high[c], self.least)
            self.num_cells += relaxation.effort
            bounds[c] = max(bounds[c], bound)
            if bounds[c] < lowest:
                lowest, self.lowest_point = bounds[c], x
            if not self._is_bent:
                cuts[c], places[c] = cut
            if self._is_free:
                self.offer(x, self.value(x))

    def _cut_widest(self, cells: OpenCells) -> None:
        """Has cells without a cut be cut in the middle of their longest side, if it has one."""
        alone = np.flatnonzero(cells.cuts < 0)
        low, high = cells.low[alone], cells.high[alone]
        own = np.arange(alone.size), np.argmax((high - low) / self._sides, axis=1)
        places = cells.places[alone] = middles(low[own], high[own])
        cells.cuts[alone] = np.where((low[own] < places) & (places < high[own]), own[1], -1)

    def _expand(self, cells: OpenCells) -> None:
        """Raises bounds by expansions about the best point where that is near, else the middle.

        Cells that hold no minimizer have the bound ∞.
        """
        low, high, bounds, *_ = cells
        (count, size), formulas = low.shape, np.zeros(len(low), dtype=np.int64)
        over = enclose_all(self._tape, formulas, low, high, HESSIAN)
        slopes, bends = over[:, 1 : 1 + size], over[:, size + np.cumsum(1 + np.arange(size))]
        ends, outer = np.array([low.ravel(), high.ravel()]), np.tile(self._outer, count)
        keep = may_hold_minima(slopes.reshape(-1, 2), bends.reshape(-1, 2), ends, outer)
        bounds[~np.all(keep.reshape(low.shape), axis=1)] = np.inf
        reach = high - low
        is_near = np.all((low - reach <= self.best) & (self.best <= high + reach), axis=1)
        centers = middles(low.ravel(), high.ravel()).reshape(low.shape)
        points = np.where(is_near[:, None], np.clip(self.best, low, high), centers)
        sides = np.zeros((5, low.size))
        sides[:3] = low.ravel(), high.ravel(), points.ravel()
        places = np.arange(low.size).reshape(low.shape)
        np.maximum(bounds, bound_all(self._tape, 0, sides, places), out=bounds)
        values = enclose_all(self._tape, formulas, points, points, VALUE)[:, 0, 1]
        self.offer(points[(best := np.argmin(values))], float(values[best]))

    @property
    def is_over(self) -> bool:
        """Whether no cell is left that can be cut."""
        return not self._open.bounds.size

    @property
    def is_empty(self) -> bool:
        """Whether no point of the box meets all rows."""
        return self.is_over and self._settled == math.inf

    @property
    def lower_bound(self) -> float:
        """Of f over all feasible points; at most the best value."""
        return float(np.min(self._open.bounds, initial=min(self.least, self._settled)))

    @property
    def hull(self) -> Floats | None:
        """Ends (2, n) of the smallest box that holds all open cells below the best value.

        It holds the best point, too. None if there is no such cell.
        """
        below = self._open.bounds <= self.least
        if not np.any(below):
            return None
        low, high = self._open.low[below].min(axis=0), self._open.high[below].max(axis=0)
        if math.isfinite(self.least):
            low, high = np.minimum(low, self.best), np.maximum(high, self.best)
        return np.array([low, high])
