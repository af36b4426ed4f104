"""Branch and bound over cells of all variables at once, for programs of few variables."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.certify.cell_kernels import Rows, Work, explore
from drake_aigto.certify.enclosures import make_scratch
from drake_aigto.certify.heap import Heap, push
from drake_aigto.certify.multipliers import Multipliers, multipliers_at, no_multipliers
from drake_aigto.certify.tape import Tape
from drake_aigto.certify.values import slopes_at

_FIRST_ROOM = 1024


@dataclass(frozen=True, eq=False)
class CellProgram:
    """Minimize f over a box, subject to rows.

    Attributes:
        tape: f, and the rows r_1 … r_R.
        rows: their bounds.
        lower: bounds of x (n,).
        upper: shape (n,).
    """

    tape: Tape
    rows: Rows
    lower: Floats
    upper: Floats


class CellSearch:
    """Branch and bound over cells of a program, which may be gone on with.

    Args:
        program: what is bounded.
        scale: the gap is relative to the best value, or to this where that is less in size.
        margin: cells are settled once their bound is so near to the best value.
        most: how many cells may be open.
    """

    def __init__(self, program: CellProgram, scale: float, margin: float, most: int) -> None:
        """Opens the whole box."""
        size = program.lower.size
        self._program, self._scale, self._margin = program, scale, margin
        self._outer = np.array([program.lower, program.upper])
        self._most = most
        self._heap = _make_heap(min(most, _FIRST_ROOM), size)
        pairs = size * (size + 1) // 2
        self._work = Work(
            make_scratch(program.tape, size),
            np.empty((size, 2)), np.empty((size, 2)), np.empty((pairs, 2)),
            np.empty(size), np.empty(size), np.empty((size, size + 2)),
            np.empty(2), np.empty(program.rows.lower.size), np.empty(size), np.empty(size),
        )  # fmt: skip
        self.settled = np.inf
        self.num_cells = 0
        self.least = np.inf
        self.best = np.array([_middle_of(*ends) for ends in self._outer.T.tolist()])
        push(self._heap, -np.inf, *self._outer)

    def offer(self, x: Floats, value: float) -> None:
        """Takes a feasible point and its value, rounded up, if it is the best so far."""
        if value < self.least:
            self.least, self.best[:] = value, x

    def run(self, count: int) -> bool:
        """Cuts so many cells; returns whether any is left that may hold something better."""
        program, multipliers = self._program, self._multipliers()
        self._make_room(count)
        settled, self.least, done = explore(
            program.tape, program.rows, multipliers, self._heap, self._outer, self.best,
            self.least, self._margin, self._scale, count, self._work,
        )  # fmt: skip
        self.settled = min(self.settled, settled)
        self.num_cells += done
        return done == count

    def _make_room(self, count: int) -> None:
        """Moves the open cells to a larger heap, where so many more may not fit."""
        old = self._heap
        used = int(old.counts[0])
        room = min(self._most, used + count + 2)
        if room <= old.keys.size:
            return
        heap = _make_heap(room, self.best.size)
        places = old.places[:used]
        heap.keys[:used], heap.places[:used] = old.keys[:used], np.arange(used)
        heap.low[:used], heap.high[:used] = old.low[places], old.high[places]
        heap.counts[:] = used, room - used
        heap.free[: room - used] = np.arange(used, room)
        self._heap = heap

    def _multipliers(self) -> Multipliers:
        program = self._program
        if not program.rows.lower.size or not math.isfinite(self.least):
            return no_multipliers(program.rows.lower.size)
        values, gradients = slopes_at(program.tape, self.best)
        bounds = program.lower, program.upper
        rows = program.rows.lower, program.rows.upper
        return multipliers_at(self.best, values, gradients, rows, bounds)

    @property
    def is_empty(self) -> bool:
        """Whether no point of the box meets all rows."""
        return self._heap.counts[0] == 0 and self.settled == np.inf

    @property
    def lower_bound(self) -> float:
        """Of f over all feasible points; at most the best value."""
        count = self._heap.counts[0]
        first = float(self._heap.keys[0]) if count else np.inf
        return min(first, self.settled, self.least)

    @property
    def lowest_cell(self) -> tuple[Floats, Floats] | None:
        """The open cell of the lowest bound, if there is one."""
        if not self._heap.counts[0]:
            return None
        place = self._heap.places[0]
        return self._heap.low[place].copy(), self._heap.high[place].copy()

    @property
    def hull(self) -> tuple[Floats, Floats] | None:
        """The smallest box that holds all open cells below the best value, and its point."""
        count = int(self._heap.counts[0])
        keys, places = self._heap.keys[:count], self._heap.places[:count]
        places = places[keys <= self.least]
        if not places.size:
            return None
        low, high = self._heap.low[places].min(axis=0), self._heap.high[places].max(axis=0)
        if math.isfinite(self.least):
            low, high = np.minimum(low, self.best), np.maximum(high, self.best)
        return low, high


def _make_heap(room: int, size: int) -> Heap:
    """Returns a heap without a cell."""
    places = np.arange(room)
    return Heap(
        np.empty(room), places.copy(), places, np.array([0, room]),
        np.empty((room, size)), np.empty((room, size)),
    )  # fmt: skip


def _middle_of(low: float, high: float) -> float:
    if math.isfinite(low) and math.isfinite(high):
        return 0.5 * (low + high)
    return min(max(0.0, low), high)
