"""Branch and bound over cells of all variables at once, for programs of few variables."""

from __future__ import annotations

import math

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.certify.cell_kernels import Problem, Rows, bound_cells
from drake_aigto.certify.enclosures import GRADIENT, SumOfFormulas, enclose_all
from drake_aigto.certify.expansions import middles
from drake_aigto.certify.formulas import Formulas, formula_of, make_tape

_MOST_OPEN = 400_000  # cells
_BATCH = 4  # this part of the open cells is cut at once, and at least this number
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
        num_cells: number of cells that were cut.
    """

    def __init__(self, formulas: Formulas, margin: float) -> None:
        """Opens the whole box."""
        everything = range(formulas.lower.size)
        sums = [formulas.summands, *((row,) for row in formulas.rows)]
        tape = make_tape(formula_of(each, everything) for each in sums)
        self.cost = SumOfFormulas(tape, [everything])
        bounds = ([getattr(row, side) for row in formulas.rows] for side in ("lower", "upper"))
        rows = Rows(*map(np.array, bounds), *np.zeros((3, len(formulas.rows))))
        outer = np.array([formulas.lower, formulas.upper])
        self._margin, self.num_cells = margin, 0
        self._problem = Problem(tape, rows, outer, middles(*outer), np.full(2, np.inf))
        # Open cells: their ends, bounds, and which variables are to be cut.
        self._low, self._high = outer[:, None].copy()
        self._bounds, self._cuts = np.array([-np.inf]), np.array([0])

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
        self._problem = self._problem._replace(rows=self._priced_rows())
        end, margins = self.num_cells + count, (self._margin, scale)
        if self.num_cells == 0:
            self.num_cells, whole = 1, (self._low, self._high, self._bounds, self._cuts)
            self._keep(np.zeros(1, dtype=bool))
            self._add(*whole, margins)
        while self.num_cells < end:
            enough = self.least - self._margin * max(abs(self.least), scale)
            # What holds nothing better, or cannot be cut, is left alone.
            is_over = (self._bounds > enough) | (self._cuts < 0)
            settled = np.min(self._bounds[is_over], initial=self._problem.known[1])
            self._problem.known[1] = settled
            self._keep(~is_over)
            size = self._bounds.size
            if not size or size > _MOST_OPEN:
                return False
            self._cut(min(end - self.num_cells, size, max(_BATCH, size // _BATCH)), margins)
        return True

    def _keep(self, kept: Bools) -> None:
        self._low, self._high = self._low[kept], self._high[kept]
        self._bounds, self._cuts = self._bounds[kept], self._cuts[kept]

    def _cut(self, count: int, margins: tuple[float, float]) -> None:
        """Cuts the lowest cells in two."""
        lowest = np.argpartition(self._bounds, count - 1)[:count]
        low, high, bounds, cuts = (
            np.repeat(each[lowest], 2, axis=0)
            for each in (self._low, self._high, self._bounds, self._cuts)
        )
        first, last = np.arange(0, 2 * count, 2), np.arange(1, 2 * count, 2)
        middle = middles(low[first, cuts[first]], high[first, cuts[first]])
        high[first, cuts[first]] = low[last, cuts[last]] = middle
        self.num_cells += count
        kept = np.ones(self._bounds.size, dtype=bool)
        kept[lowest] = False
        self._keep(kept)
        self._add(low, high, bounds, cuts, margins)

    def _add(
        self, low: Floats, high: Floats, bounds: Floats, cuts: Ints, margins: tuple[float, float]
    ) -> None:
        """Bounds cells, and opens those that may hold a minimizer."""
        bound_cells(self._problem, low, high, margins, bounds, cuts)
        left = bounds < np.inf
        self._low = np.concatenate([self._low, low[left]])
        self._high = np.concatenate([self._high, high[left]])
        self._bounds = np.append(self._bounds, bounds[left])
        self._cuts = np.append(self._cuts, cuts[left])

    def _priced_rows(self) -> Rows:
        """Returns rows with which the Lagrangian has next to no slope at the best point."""
        tape, rows, outer, x, _ = self._problem
        low, high, *_ = rows
        count = low.size + 1
        if count == 1 or not math.isfinite(self.least):
            return rows
        points = np.tile(x, (count, 1))
        jets = enclose_all(tape, np.arange(count), points, points, GRADIENT)
        if not np.all(np.isfinite(jets)):
            return rows
        values, gradients = np.mean(jets[:, 0], axis=-1), np.mean(jets[:, 1:], axis=-1)
        at_low, at_high = _is_at(values[1:], low), _is_at(values[1:], high)
        # Of the side that is active: λ ≥ 0 at the upper one, ≤ 0 at the lower one.
        signs = np.where(at_high, 1.0, -1.0)
        active = at_low | at_high
        free = ~np.any([_is_at(x, bound) for bound in outer], axis=0)
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
    def is_over(self) -> bool:
        """Whether no cell is left that can be cut."""
        return not self._bounds.size

    @property
    def is_empty(self) -> bool:
        """Whether no point of the box meets all rows."""
        return self.is_over and bool(self._problem.known[1] == np.inf)

    @property
    def lower_bound(self) -> float:
        """Of f over all feasible points; at most the best value."""
        return float(np.min(self._bounds, initial=np.min(self._problem.known)))

    @property
    def lowest_point(self) -> Floats | None:
        """The middle (n,) of the open cell of the lowest bound, if there is one."""
        if self.is_over:
            return None
        lowest = int(np.argmin(self._bounds))
        return middles(self._low[lowest], self._high[lowest])

    @property
    def hull(self) -> Floats | None:
        """Ends (2, n) of the smallest box that holds all open cells below the best value.

        It holds the best point, too. None if there is no such cell.
        """
        below = self._bounds <= self.least
        if not np.any(below):
            return None
        low, high = self._low[below].min(axis=0), self._high[below].max(axis=0)
        if math.isfinite(self.least):
            low, high = np.minimum(low, self.best), np.maximum(high, self.best)
        return np.array([low, high])


def _is_at(values: Floats, bounds: Floats) -> Bools:
    """Returns which values are next to their bounds, which are finite then."""
    return np.abs(values - bounds) <= _NEAR * np.maximum(1.0, np.abs(values))
