"""Branch and bound over cells of all variables at once."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.certify.contraction import contract
from drake_aigto.certify.enclosures import (
    GRADIENT,
    HESSIAN,
    VALUE,
    SumOfFormulas,
    enclose,
    make_scratch,
)
from drake_aigto.certify.expansions import (
    bend_place,
    expansion_bound,
    make_room,
    middle_of,
    middles,
    set_steps,
)
from drake_aigto.certify.formulas import Formulas, JointTape, Tape, formula_of, join, make_tape
from drake_aigto.certify.relaxation import Relaxation, sides_of
from drake_aigto.kernels import inner, kernel


@inner
def _press(over: Floats, outer: Floats, low: Floats, high: Floats) -> bool:
    """Makes a cell flat where f rises or falls over all of it, in place.

    Returns whether it holds no minimizer: where f falls towards a face that is not the whole box's,
    what is beyond it is lower, if f has values there: a finite Hessian says so.
    """
    size = low.size
    for i in range(size):
        a, b = over[1 + i]
        bend = over[bend_place(size, i, i)]
        if low[i] == high[i] or not (a > 0.0 or b < 0.0):
            continue
        face = low[i] if a > 0.0 else high[i]
        if not (math.isfinite(bend[1] - bend[0]) and math.isfinite(b - a) and math.isfinite(face)):
            continue
        if face != (outer[0, i] if a > 0.0 else outer[1, i]):
            return True
        low[i] = high[i] = face
    return False


@inner
def _choose_point(low: Floats, high: Floats, best: Floats, point: Floats) -> None:
    """Fills the point of a cell that is nearest to the best known one, if that is near; else c."""
    is_near = True
    for i in range(low.size):
        reach = high[i] - low[i]
        is_near &= low[i] - reach <= best[i] <= high[i] + reach
    for i in range(low.size):
        near = min(max(best[i], low[i]), high[i])
        point[i] = near if is_near else middle_of(low[i], high[i])


@kernel
def bound_cells(
    tape: Tape,
    joint: JointTape,
    outer: Floats,
    low: Floats,
    high: Floats,
    best: Floats,
    least: float,
    bounds: Floats,
) -> float:
    """Raises bounds of f over cells, +∞ of those without a minimizer, and narrows cells in place.

    Args:
        tape: f.
        joint: the same, with entries that are shared.
        outer: the whole box (2, n).
        low: lower ends of the cells (C, n).
        high: upper ends.
        best: the best known point (n,), replaced by better ones.
        least: f there, rounded up.
        bounds: shape (C,).

    Returns:
        The least value that is known, rounded up.
    """
    size, limits = best.size, np.empty((2, 1))
    jets, about, over, steps, matrix, scales = make_room(tape, size)
    ranges, old = make_scratch(joint.tape, size, VALUE), np.empty((2, size))
    point = np.empty(size)
    for c in range(bounds.size):
        limits[0, 0], limits[1, 0] = -np.inf, least
        end = -1
        if contract(joint, limits[0], limits[1], low[c], high[c], ranges, old):
            end = enclose(tape, 0, low[c], high[c], HESSIAN, jets)
        if end < 0:
            bounds[c] = np.inf
            continue
        over[:] = jets[end]
        if _press(over, outer, low[c], high[c]):
            bounds[c] = np.inf
            continue
        bounds[c] = max(bounds[c], over[0, 0])
        _choose_point(low[c], high[c], best, point)
        end = enclose(tape, 0, point, point, GRADIENT, jets)
        if end < 0:
            continue
        about[:] = jets[end]
        if about[0, 1] < least:
            least, best[:] = about[0, 1], point
        set_steps(point, low[c], high[c], steps)
        bounds[c] = max(bounds[c], expansion_bound(about, over, steps, matrix, scales))
    return least


_MOST_OPEN = 400_000  # cells
_BATCH = 4  # this part of the open cells is cut at once, and at least this number
_MOST_AT_ONCE = 250  # between two reports of progress and looks at the clock
_MOST_BENT = 10  # variables of programs without rows whose cells are bounded by Hessians


class OpenCells(NamedTuple):
    """Cells and what is known of them.

    Attributes:
        low: lower ends (C, n).
        high: upper ends.
        bounds: of f (C,).
        cuts: variables to cut next; −1: none can be (C,).
        places: where (C,).
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
        parts.high[first, self.cuts] = parts.low[last, self.cuts] = self.places
        return parts


class CellSearch:
    """Branch and bound over cells of a program, which may be gone on with.

    A cell is narrowed by its rows and the best value, and bounded by a linear relaxation; without
    rows, and of few variables, by an expansion about the best point.

    An interruption leaves what is known in order: cells that are taken away, and what became of
    them, are changed at once.

    Args:
        formulas: the program.
        margin: cells are settled once their bound is this near to the best value, relative to it
            or to a scale.

    Attributes:
        cost: f.
        best: the best point that is known (n,).
        least: its value.
        num_cells: number of cells that were bounded; a linear program counts as some of them.
    """

    def __init__(self, formulas: Formulas, margin: float) -> None:
        """Opens the whole box."""
        size, self._outer = formulas.lower.size, np.array([formulas.lower, formulas.upper])
        self._tape = make_tape([formula_of(formulas.summands, range(size))])
        self._joint = join([formulas.summands], size)
        self.cost = SumOfFormulas(self._tape, [range(size)])
        self.best, self.least = middles(*self._outer), math.inf
        self._margin, self._scale, self.num_cells = margin, 1.0, 0
        self._is_free = not formulas.rows
        is_smooth = self._is_free and size <= _MOST_BENT
        self._relaxation = None if is_smooth else Relaxation(formulas)
        self._settled = math.inf  # least bound of parts that were left alone
        self.lowest_point: Floats | None = None  # of the relaxations that were solved last
        self._sides = sides_of(formulas)
        low, high = self._outer[:, None].copy()
        self._open = OpenCells(low, high, np.array([-np.inf]), np.array([-1]), np.zeros(1))

    def offer(self, x: Floats, value: float) -> None:
        """Takes a feasible point and its value, rounded up, if it is the best so far."""
        if value < self.least:
            self.least, self.best = value, x

    def run(self, count: int, scale: float) -> bool:
        """Cuts cells, and returns whether any is left that may hold something better.

        Args:
            count: number of cells at most.
            scale: the margin is relative to the best value, or to this where that is less in size.
        """
        end, self._scale = self.num_cells + count, scale
        if self.num_cells == 0:
            self.num_cells = 1
            self._open = self._whole()
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
        self._settled = min(self._settled, bound)

    @property
    def _enough(self) -> float:
        """Bound that needs not be raised."""
        size = max(abs(self.least), self._scale)
        return self.least - self._margin * size if self.least < np.inf else np.inf

    def _whole(self) -> OpenCells:
        """Returns the whole box, narrowed by linear programs where cells are."""
        whole = self._open
        if self._relaxation is not None:
            self._settle(self.least)
            if not self._relaxation.tighten(whole.low[0], whole.high[0], self.least):
                return whole.some(np.zeros(1, dtype=bool))
        return self._bounded(whole)

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
        if self._relaxation is None:
            self._expand(cells)
        else:
            self._relax(self._relaxation, cells)
        return cells.some(cells.bounds < np.inf)

    def _expand(self, cells: OpenCells) -> None:
        """Raises bounds by expansions about the best point, or the middle; cuts longest sides."""
        low, high, bounds, cuts, places = cells
        best = self.best.copy()
        least = bound_cells(
            self._tape, self._joint, self._outer, low, high, best, self.least, bounds
        )
        self.offer(best, least)
        self._settle(self.least)
        sides = (high - low) / self._sides
        cuts[:] = np.argmax(sides, axis=1)
        own = np.arange(cuts.size), cuts
        places[:] = middles(low[own], high[own])
        cuts[(places <= low[own]) | (places >= high[own])] = -1

    def _relax(self, relaxation: Relaxation, cells: OpenCells) -> None:
        """Raises bounds by linear relaxations, and narrows cells by them."""
        low, high, bounds, cuts, places = cells
        self._settle(self.least)
        lowest, enough = np.inf, self._enough
        for c in np.flatnonzero(bounds <= enough):
            found = relaxation.bound(low[c], high[c], self.least)
            self.num_cells += relaxation.effort
            bounds[c] = max(bounds[c], found.bound)
            if bounds[c] < lowest:
                lowest, self.lowest_point = bounds[c], found.x
            cuts[c], places[c] = found.cut
            if self._is_free:
                self.offer(found.x, self.cost.range(found.x, found.x)[1])

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
