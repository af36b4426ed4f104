"""Branch and bound over cells of all variables at once, for programs of few variables."""

from __future__ import annotations

import math

import numpy as np

from drake_aigto.arrays import Bools, Floats
from drake_aigto.certify.cell_kernels import Heap, Problem, Rows, explore
from drake_aigto.certify.enclosures import GRADIENT, SumOfFormulas, enclose_all
from drake_aigto.certify.formulas import Formulas, formula_of, make_tape

_MOST_OPEN = 400_000  # cells
# A row or a variable is at its bound where it is this near, relative to its size.
_NEAR = 1e-5
_BEND = 10.0  # relative to what makes up for the cost's slope in a unit's length


class CellSearch:
    """Branch and bound over cells of a program, which may be gone on with.

    Args:
        formulas: the program.
        margin: cells are settled once their bound is this near to the best value, relative to it
            or to a scale.

    Attributes:
        cost: f.
        best: the best point that is known (n,).
        least: its value.
        num_cells: number of cells that were cut.
    """

    def __init__(self, formulas: Formulas, margin: float) -> None:
        """Opens the whole box."""
        everything = range(formulas.lower.size)
        sums = [formulas.summands, *((row,) for row in formulas.rows)]
        self._tape = make_tape(formula_of(each, everything) for each in sums)
        self.cost = SumOfFormulas(self._tape, [everything])
        bounds = ([getattr(row, side) for row in formulas.rows] for side in ("lower", "upper"))
        unpriced = np.zeros((3, len(formulas.rows)))
        self._rows, self._margin = Rows(*map(np.array, bounds), *unpriced), margin
        self._outer = np.array([formulas.lower, formulas.upper])
        low, high = self._outer.copy()
        self._heap = Heap(np.array([1]), np.array([-np.inf]), np.array([0]), low[None], high[None])
        self._settled = np.inf
        self.num_cells = 0
        self.least = np.inf
        with np.errstate(invalid="ignore"):
            middle = 0.5 * (low + high)
        self.best = np.where(np.isfinite(middle), middle, np.clip(0.0, low, high))

    def offer(self, x: Floats, value: float) -> None:
        """Takes a feasible point and its value, rounded up, if it is the best so far."""
        if value < self.least:
            self.least, self.best[:] = value, x

    def run(self, count: int, scale: float) -> bool:
        """Cuts cells, and returns whether any is left that may hold something better.

        Args:
            count: number of cells at most.
            scale: the margin is relative to the best value, or to this where that is less in size.
        """
        self._make_room(count)
        problem = Problem(self._tape, self._priced_rows(), self._outer, self.best)
        settled, self.least, done = explore(
            problem, self._heap, self.least, self._margin, scale, count
        )
        self._settled = min(self._settled, settled)
        self.num_cells += done
        return done == count

    def _make_room(self, cells: int) -> None:
        """Makes the heap larger where this many cells more may not fit."""
        count, keys, places, *boxes = self._heap
        room = min(_MOST_OPEN, int(count[0]) + cells + 2)
        more = room - keys.size
        if more > 0:
            places = np.append(places, np.arange(keys.size, room))
            low, high = (np.pad(ends, ((0, more), (0, 0))) for ends in boxes)
            self._heap = Heap(count, np.pad(keys, (0, more)), places, low, high)

    def _priced_rows(self) -> Rows:
        """Returns rows with which the Lagrangian has next to no slope at the best point."""
        low, high, *_ = self._rows
        count, x = low.size + 1, self.best
        if count == 1 or not math.isfinite(self.least):
            return self._rows
        points = np.tile(x, (count, 1))
        jets = enclose_all(self._tape, np.arange(count), points, points, GRADIENT)
        if not np.all(np.isfinite(jets)):
            return self._rows
        values, gradients = np.mean(jets[:, 0], axis=-1), np.mean(jets[:, 1:], axis=-1)
        at_low, at_high = _is_at(values[1:], low), _is_at(values[1:], high)
        # Of the side that is active: λ ≥ 0 at the upper one, ≤ 0 at the lower one.
        signs = np.where(at_high, 1.0, -1.0)
        active = at_low | at_high
        free = ~np.any([_is_at(x, bound) for bound in self._outer], axis=0)
        slopes = np.zeros(count - 1)
        while np.any(active) and np.any(free):
            matrix = gradients[1:][np.ix_(active, free)].T
            slopes[:] = 0.0
            slopes[active] = np.linalg.lstsq(matrix, -gradients[0][free], rcond=None)[0]
            wrong = active & (low != high) & (slopes * signs <= 0.0)
            if not np.any(wrong):
                break
            active &= ~wrong
            slopes[~active] = 0.0
        sizes = np.sum(gradients[1:] ** 2, axis=1)
        largest = max(1.0, float(np.max(np.abs(gradients[0]), initial=0.0)))
        bends = np.zeros(count - 1)
        bent = active & (sizes > 0.0)
        bends[bent] = np.where(low == high, _BEND, -_BEND)[bent] * largest / sizes[bent]
        targets = np.where(at_high, high, np.where(at_low, low, 0.0))
        return Rows(low, high, targets, np.where(active, slopes, 0.0), bends)

    @property
    def is_empty(self) -> bool:
        """Whether no point of the box meets all rows."""
        return self._heap.used[0] == 0 and self._settled == np.inf

    @property
    def lower_bound(self) -> float:
        """Of f over all feasible points; at most the best value."""
        first = float(self._heap.keys[0]) if self._heap.used[0] else np.inf
        return min(first, self._settled, self.least)

    @property
    def lowest_cell(self) -> Floats | None:
        """Lower and upper ends (2, n) of the open cell of the lowest bound, if there is one."""
        heap, place = self._heap, self._heap.places[0]
        return np.array([heap.low[place], heap.high[place]]) if heap.used[0] else None

    @property
    def hull(self) -> Floats | None:
        """Ends (2, n) of the smallest box that holds all open cells below the best value.

        It holds the best point, too. None if there is no such cell.
        """
        count, keys, places, low, high = self._heap
        places = places[: count[0]][keys[: count[0]] <= self.least]
        if not places.size:
            return None
        ends = np.array([low[places].min(axis=0), high[places].max(axis=0)])
        if math.isfinite(self.least):
            ends = np.array([np.minimum(ends[0], self.best), np.maximum(ends[1], self.best)])
        return ends


def _is_at(values: Floats, bounds: Floats) -> Bools:
    """Returns which values are next to their bounds, which are finite then."""
    return np.abs(values - bounds) <= _NEAR * np.maximum(1.0, np.abs(values))
