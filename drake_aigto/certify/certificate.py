"""`certify`: a lower bound of a program, beside the best known point."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from pydrake.solvers import MathematicalProgram

from drake_aigto.arrays import Floats
from drake_aigto.certify.cells import CellSearch
from drake_aigto.certify.cliques import MOST_VARIABLES, CliqueSearch
from drake_aigto.certify.contraction import contract_box
from drake_aigto.certify.enclosures import SumOfFormulas
from drake_aigto.certify.formulas import (
    Formulas,
    formula_of,
    make_tape,
    read_formulas,
)
from drake_aigto.certify.squares import SquaresBound, bound_by_squares, elimination
from drake_aigto.errors import UnsupportedTermError

# A point → a feasible one near it, if there is one.
Improve = Callable[[Floats], Floats | None]

# Cells of more variables are too many.
_MOST_VARIABLES = 10
# Of up to this many variables, cells of all of them converge faster than trees of cliques.
_FEW = 4
_FIRST_CHUNK = 500
_FIRST_CELLS = 2000  # before sums of squares
# Costs below it are lost in what rounding adds to numbers that may underflow.
_LEAST_SCALE = 1e-290
# Polynomials of more variables are too many to multiply out.
_MOST_OF_SQUARES = 1000
# Cells are settled at this part of the required gap.
_MARGIN = 0.5
# Dynamic programming bounds up to this many cells for each that branch and bound may use.
_CLIQUE_CELLS = 40


class Method(enum.Enum):
    """How a bound was found."""

    CELLS = "branch and bound over cells of all variables"
    CLIQUES = "dynamic programming over bins of a tree of small cliques"
    SQUARES = "sums of squares over cliques of variables"
    ROWS = "rows that leave nothing of the bounds"
    SUM = "the sum of what each summand is at least"
    NONE = "no bound"


@dataclass(frozen=True, eq=False)
class Certificate:
    """Bounds of the least cost of a program, from both sides.

    No feasible point costs less than `lower_bound`: intervals are rounded outward, so no rounding
    can make that untrue. It holds for the formulas that the program has.

    Attributes:
        lower_bound: of the cost; −∞ if none was found, ∞ if there is no feasible point.
        best_cost: the least cost of a feasible point that was given or found; ∞ if there is none.
        best: that point, shape (n,).
        scale: the gap is relative to the best cost, or to this where that is less in size.
        method: how it was found.
        cells: how many cells were bounded.
        reason: what stands in the way of a better bound, or an empty string.
        hull: lower and upper ends of a box that holds all minimizers, shape (2, n).
    """

    lower_bound: float
    best_cost: float
    scale: float
    method: Method
    cells: int
    reason: str = ""
    best: Floats = field(repr=False, default_factory=lambda: np.empty(0))
    hull: Floats = field(repr=False, default_factory=lambda: np.empty((2, 0)))

    @property
    def gap(self) -> float:
        """(best cost − lower bound) / max(|best cost|, scale)."""
        return relative_gap(self.best_cost, self.lower_bound, self.scale)

    @property
    def is_infeasible(self) -> bool:
        """Whether it is proven that no point within the bounds meets all rows."""
        return self.lower_bound == math.inf


def relative_gap(cost: float, bound: float, scale: float) -> float:
    """Returns (cost − bound) / max(|cost|, scale), 0 or more; ∞ where one is missing."""
    if not (math.isfinite(cost) and math.isfinite(bound)):
        return math.inf
    return max(0.0, cost - bound) / max(abs(cost), scale, _LEAST_SCALE)


def certify(
    prog: MathematicalProgram,
    point: Floats | None = None,
    *,
    gap: float = 1e-6,
    cells: int = 1_000_000,
) -> Certificate:
    """Returns a lower bound of a program's cost over all points that meet its constraints.

    Args:
        prog: costs and constraints linear, quadratic or symbolic; variables with bounds.
        point: a feasible point, the better the tighter, shape (n,).
        gap: relative; small enough.
        cells: the most cells that are bounded.

    Raises:
        UnsupportedTermError: a function without an enclosure, by name.
    """
    certifier = Certifier(prog, gap=gap)
    if point is not None:
        certifier.offer(point)
    return certifier.run(cells)


def is_infeasible(prog: MathematicalProgram) -> bool:
    """Returns whether ranges of rows prove that no point within the bounds meets them all."""
    try:
        return not _narrowed(read_formulas(prog))[1]
    except UnsupportedTermError:
        return False


class Certifier:
    """Bounds of one program, which may be gone on with.

    Args:
        prog: as in `certify`.
        gap: as in `certify`.

    Attributes:
        least_sum: the sum of the lower bounds of summands.

    Raises:
        UnsupportedTermError: as in `certify`.
    """

    def __init__(self, prog: MathematicalProgram, gap: float = 1e-6) -> None:
        """Chooses a method by the program's structure."""
        self._asked = read_formulas(prog)
        self._formulas, is_feasible = _narrowed(self._asked)
        formulas, self._gap = self._formulas, gap
        self._search: CellSearch | CliqueSearch | None = None
        self._squares: SquaresBound | None = None
        self._method, order = Method.SUM, self._order()
        if not is_feasible:
            self._method = Method.ROWS
        elif order is not None:
            self._method, self._search = Method.CLIQUES, CliqueSearch(formulas, order)
        elif 0 < formulas.lower.size <= _MOST_VARIABLES:
            self._method, self._search = Method.CELLS, CellSearch(formulas, _MARGIN * gap)
        self._cost = _sum_of(formulas) if self._search is None else self._search.cost
        least, most = self._cost.range(formulas.lower, formulas.upper)
        self.least_sum = least if is_feasible else math.inf
        # The variation of the cost over the bounds, if that is below 1 in its own unit.
        width = most - self.least_sum
        self._scale = max(min(1.0, width), _LEAST_SCALE) if math.isfinite(width) else 1.0
        self._best, self._best_cost = np.full(formulas.lower.size, np.nan), math.inf

    def _order(self) -> list[tuple[int, ...]] | None:
        """Returns in which order variables of small cliques are eliminated; None: of others."""
        formulas = self._formulas
        size, few = formulas.lower.size, _MOST_VARIABLES if formulas.rows else _FEW
        if size <= few or not np.all(np.isfinite(formulas.upper - formulas.lower)):
            return None
        read = [each.variables for each in (*formulas.summands, *formulas.rows)]
        if max(map(len, read), default=0) > MOST_VARIABLES:
            return None
        return elimination(size, read, MOST_VARIABLES)

    def offer(self, x: Floats) -> None:
        """Takes a point that meets all constraints, if it is the best so far."""
        x = np.clip(x, self._asked.lower, self._asked.upper)
        value = self._cost.range(x, x)[1]
        if value < self._best_cost:
            self._best, self._best_cost = x, value
        if self._search is not None:
            self._search.offer(x, value)

    def run(self, cells: int, improve: Improve = lambda _: None) -> Certificate:
        """Bounds more cells, and returns the bound so far.

        Args:
            cells: number of cells at most.
            improve: called with points of the lowest cells; returns a feasible one nearby, or None.
        """
        # Squares may prove at once what many cells would be spent on.
        first = min(cells, _FIRST_CELLS) if isinstance(self._search, CellSearch) else cells
        self._run_search(first, improve)
        if self._squares is None and self._gap_of(self._bound) > self._gap:
            self._run_squares(improve)
        if self._gap_of(self._bound) > self._gap:
            self._run_search(cells - first, improve)
        return self._certificate()

    def _run_search(self, cells: int, improve: Improve) -> None:
        if isinstance(self._search, CellSearch):
            self._run_cells(self._search, cells, improve)
        elif isinstance(self._search, CliqueSearch):
            self._run_cliques(self._search, cells, improve)

    @property
    def _cells_bound(self) -> float:
        """The lower bound without sums of squares."""
        if self._search is None:
            return self.least_sum
        return math.inf if self._search.is_empty else self._search.lower_bound

    @property
    def _bound(self) -> float:
        return max(self._cells_bound, self._squares.lower_bound if self._squares else -math.inf)

    def _gap_of(self, bound: float) -> float:
        """Returns how far the best cost is above a bound; 0 if there is no feasible point."""
        return 0.0 if bound == math.inf else relative_gap(self._best_cost, bound, self._scale)

    def _run_squares(self, improve: Improve) -> None:
        size = self._formulas.lower.size
        if size > _MOST_OF_SQUARES:
            self._squares = SquaresBound(-math.inf, reason=f"{size} variables are too many")
            return
        x = np.where(np.isfinite(self._best), self._best, 0.0)
        self._squares = bound_by_squares(self._formulas, x)
        better = None if self._squares.start is None else improve(self._squares.start)
        if better is not None:
            self.offer(better)

    def _run_cells(self, search: CellSearch, cells: int, improve: Improve) -> None:
        end, chunk, last = search.num_cells + cells, _FIRST_CHUNK, math.inf
        while search.num_cells < end:
            if not search.run(min(chunk, end - search.num_cells), self._scale):
                break
            chunk *= 2
            if self._formulas.rows:
                start = search.lowest_point
            else:
                start = search.best.copy() if search.least < last else None
            if start is not None and np.all(np.isfinite(start)):
                self._try(start, improve)
            last = search.least
        if not self._formulas.rows and search.least < self._best_cost:
            self._try(search.best.copy(), improve)

    def _try(self, x: Floats, improve: Improve) -> None:
        """Takes a point and its improvement; for a program with rows, only the latter."""
        if not self._formulas.rows:
            self.offer(x)
        better = improve(x)
        if better is not None:
            self.offer(better)

    def _run_cliques(self, search: CliqueSearch, cells: int, improve: Improve) -> None:
        end = search.num_cells + _CLIQUE_CELLS * cells
        while search.num_cells + search.next_size() <= end:
            self._try(search.step(), improve)
            if search.is_empty:
                return
            search.drop()
            if self._gap_of(search.lower_bound) <= self._gap:
                return

    def _certificate(self) -> Certificate:
        formulas, search = self._formulas, self._search
        bound = self._bound
        method = self._method if bound == self._cells_bound else Method.SQUARES
        hull = None if search is None else search.hull
        return Certificate(
            lower_bound=bound,
            best_cost=self._best_cost,
            scale=self._scale,
            method=method,
            cells=0 if search is None else search.num_cells,
            reason=self._reason(bound, method),
            best=self._best,
            hull=np.array([formulas.lower, formulas.upper]) if hull is None else hull,
        )

    def _reason(self, bound: float, method: Method) -> str:
        formulas = self._formulas
        if self._gap_of(bound) <= self._gap:
            return ""
        if bound == -math.inf:
            return _missing(formulas) or "the cost falls without end in some cell"
        if isinstance(self._search, CellSearch) and self._search.is_over:
            return "cells are as small as numbers allow, or their number is"
        if self._search is not None:
            return "the cells allowed were used up"
        coupled = (
            f"{formulas.lower.size} variables are coupled in more than trees of cliques of "
            f"{MOST_VARIABLES}, and cells of more than {_MOST_VARIABLES} are too many"
        )
        if method is Method.SQUARES:
            return f"{coupled}; sums of squares leave this gap"
        squares = self._squares.reason if self._squares else ""
        return f"{coupled}; no sums of squares: {squares}" if squares else coupled


def _narrowed(formulas: Formulas) -> tuple[Formulas, bool]:
    """Returns formulas with bounds that rows leave something of, and whether they leave any."""
    everything, rows = range(formulas.lower.size), formulas.rows
    tape = make_tape(formula_of((row,), everything) for row in rows)
    lower, upper = formulas.lower.copy(), formulas.upper.copy()
    sides = np.array([[row.lower for row in rows], [row.upper for row in rows]])
    is_feasible = bool(np.all(lower <= upper)) and contract_box(
        tape, sides[0], sides[1], lower, upper
    )
    return (replace(formulas, lower=lower, upper=upper) if is_feasible else formulas), is_feasible


def _sum_of(formulas: Formulas) -> SumOfFormulas:
    """Returns the cost as a sum of formulas, one for each set of variables."""
    groups = formulas.groups()
    tape = make_tape(formula_of(parts, read) for read, parts in groups.items())
    return SumOfFormulas(tape, list(groups))


def _missing(formulas: Formulas) -> str:
    """Returns which bounds are missing, or an empty string."""
    sides = (("lower", formulas.lower), ("upper", formulas.upper))
    names = [
        f"{name} has no {side} bound"
        for side, bounds in sides
        for name, bound in zip(formulas.names, bounds.tolist(), strict=True)
        if math.isinf(bound)
    ]
    more = f", and {len(names) - 3} more are missing" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more
