"""Branch and bound over cells of all variables at once."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.certify.cell_kernels import Problem, bound_cells
from drake_aigto.certify.enclosures import SumOfFormulas
from drake_aigto.certify.expansions import middles
from drake_aigto.certify.formulas import Formulas, join
from drake_aigto.certify.pricing import cost_and_rows, priced_rows
from drake_aigto.certify.relaxation import Relaxation

_MOST_OPEN = 400_000  # cells
_BATCH = 4  # this part of the open cells is cut at once, and at least this number
_MOST_AT_ONCE = 4000  # between two reports of progress and looks at the clock
_MOST_BENT = 10  # variables of cells that are bounded by Hessians, too
_FEW = 4  # variables of programs without rows that need no linear relaxations
_PLAIN = 200  # cells that are bounded by Hessians alone, before relaxations
# A relaxation pays if it closes this part of the gap; where fewer than this part of them do, every
# sixteenth cell is relaxed only.
_LEAST_SHARE, _SELDOM = 0.1, 16


class OpenCells(NamedTuple):
    """Cells and what is known of them.

    Attributes:
        low: lower ends (C, n).
        high: upper ends.
        bounds: of f (C,).
        cuts: variables to cut next; −1: none can be (C,).
        places: where; NaN: in the middle (C,).
    """

    low: Floats
    high: Floats
    bounds: Floats
    cuts: Ints
    places: Floats

    def some(self, kept: Bools | Ints) -> OpenCells:
        """Returns a part of them."""
        return OpenCells._make(each[kept] for each in self)

    def halves(self) -> OpenCells:
        """Returns both parts of each, one after the other."""
        parts = OpenCells._make(np.repeat(each, 2, axis=0) for each in self)
        first, last = np.arange(0, len(parts.cuts), 2), np.arange(1, len(parts.cuts), 2)
        own = first, self.cuts
        middle = middles(parts.low[own], parts.high[own])
        places = np.where(np.isnan(self.places), middle, self.places)
        parts.high[first, self.cuts] = parts.low[last, self.cuts] = places
        return parts


class CellSearch:
    """Branch and bound over cells of a program, which may be gone on with.

    An interruption leaves what is known in order: cells that are taken away, and what became of
    them, are changed at once.

    Args:
        formulas: the program.
        margin: cells are settled once their bound is this near to the best value, relative to it
            or to a scale.

    Attributes:
        cost: f.
        num_cells: number of cells that were bounded; a linear program counts as some of them.
    """

    def __init__(self, formulas: Formulas, margin: float) -> None:
        """Opens the whole box."""
        size = formulas.lower.size
        tape, rows = cost_and_rows(formulas)
        self.cost = SumOfFormulas(tape, [range(size)])
        outer, known = np.array([formulas.lower, formulas.upper]), np.full(2, np.inf)
        joint = join([formulas.summands, *((row,) for row in formulas.rows)], size)
        self._problem = Problem(tape, joint, rows, outer, middles(*outer), known)
        self._margin, self._scale, self.num_cells = margin, 1.0, 0
        self._is_bent = size <= _MOST_BENT
        self._relaxation: Relaxation | None = None
        if rows.lower.size or size > _FEW:
            try:
                self._relaxation = Relaxation(formulas)
            except OverflowError:  # A coefficient is beyond the range of numbers.
                self._is_bent = True
        self._tries, self._gains, self._turn = _SELDOM, _SELDOM, 0
        self._start: Floats | None = None  # of the lowest relaxation that was solved last
        ends = outer[:, None].copy()
        self._open = OpenCells(
            ends[0], ends[1], np.array([-np.inf]), np.array([0]), np.array([np.nan])
        )

    @property
    def best(self) -> Floats:
        """The best point that is known (n,)."""
        return self._problem.best

    @property
    def least(self) -> float:
        """Its value."""
        return float(self._problem.known[0])

    def offer(self, x: Floats, value: float) -> None:
        """Takes a feasible point and its value, rounded up, if it is the best so far."""
        if value < self.least:
            self._problem.known[0], self._problem.best[:] = value, x

    def run(self, count: int, scale: float) -> bool:
        """Cuts cells, and returns whether any is left that may hold something better.

        Args:
            count: number of cells at most.
            scale: the margin is relative to the best value, or to this where that is less in size.
        """
        if math.isfinite(self.least):
            tape, _, rows, outer, x, _ = self._problem
            self._problem = self._problem._replace(rows=priced_rows(tape, rows, outer, x))
        end, self._scale = self.num_cells + count, scale
        if self.num_cells == 0:
            self.num_cells = 1
            self._open = self._bounded(self._whole())
        while self.num_cells < end:
            # What holds nothing better, or cannot be cut, is left alone.
            is_over = (self._open.bounds > self._enough) | (self._open.cuts < 0)
            self._settle(float(np.min(self._open.bounds[is_over], initial=np.inf)))
            self._open = self._open.some(~is_over)
            size = self._open.bounds.size
            if not size or size > _MOST_OPEN:
                return False
            most = min(_MOST_AT_ONCE, max(1, end - self.num_cells), size)
            self._cut(min(most, max(_BATCH, size // _BATCH)))
        return True

    def _settle(self, bound: float) -> None:
        """Takes note that what is left alone has this bound."""
        self._problem.known[1] = min(self._problem.known[1], bound)

    @property
    def _enough(self) -> float:
        """Bound that needs not be raised."""
        size = max(abs(self.least), self._scale)
        return self.least - self._margin * size if self.least < np.inf else np.inf

    def _whole(self) -> OpenCells:
        """Returns the whole box, narrowed by linear programs where cells are many-sided."""
        whole = self._open
        if self._relaxation is not None and not self._is_bent:
            self._settle(self.least)
            is_left = self._relaxation.tighten(whole.low[0], whole.high[0], self.least)
            return whole.some(np.array([is_left]))
        return whole

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
        low, high, bounds, cuts, places = cells
        places[:] = np.nan
        if self._is_bent:
            margins = self._margin, self._scale
            bound_cells(self._problem, low, high, margins, bounds, cuts)
        if self._relaxation is not None and (not self._is_bent or self.num_cells > _PLAIN):
            self._relax(self._relaxation, cells)
        return cells.some(bounds < np.inf)

    def _relax(self, relaxation: Relaxation, cells: OpenCells) -> None:
        """Raises bounds by linear relaxations, and narrows cells by them."""
        low, high, bounds, cuts, places = cells
        self._settle(self.least)
        lowest, enough = np.inf, self._enough
        for c in np.flatnonzero(bounds < enough):
            self._turn += 1
            is_seldom = self._is_bent and self._gains < _LEAST_SHARE * self._tries
            if is_seldom and self._turn % _SELDOM:
                continue
            found = relaxation.bound(low[c], high[c], self.least)
            self.num_cells += relaxation.effort
            self._tries += 1
            most = _LEAST_SHARE * (enough - bounds[c]) if np.isfinite(enough - bounds[c]) else 0.0
            self._gains += found.bound > min(enough, bounds[c] + most)
            bounds[c] = max(bounds[c], found.bound)
            if bounds[c] < lowest:
                lowest, self._start = bounds[c], found.x
            if not self._is_bent:  # Hessians know better where to cut.
                cuts[c], places[c] = found.cut

    @property
    def is_over(self) -> bool:
        """Whether no cell is left that can be cut."""
        return not self._open.bounds.size

    @property
    def is_empty(self) -> bool:
        """Whether no point of the box meets all rows."""
        return self.is_over and bool(self._problem.known[1] == np.inf)

    @property
    def lower_bound(self) -> float:
        """Of f over all feasible points; at most the best value."""
        return float(np.min(self._open.bounds, initial=np.min(self._problem.known)))

    @property
    def lowest_point(self) -> Floats | None:
        """A point (n,) near a minimizer, perhaps: of the last relaxation, or the lowest cell."""
        if self.is_over or self._start is not None:
            return self._start
        lowest = int(np.argmin(self._open.bounds))
        return middles(self._open.low[lowest], self._open.high[lowest])

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
