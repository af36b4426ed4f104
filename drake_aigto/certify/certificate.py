"""`certify`: a lower bound of a program, beside the best known point."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from pydrake.solvers import MathematicalProgram

from drake_aigto.arrays import Floats
from drake_aigto.certify.clique_cells import MOST_VARIABLES
from drake_aigto.certify.cliques import CliqueProgram, CliqueSearch, elimination
from drake_aigto.certify.few_variables import CellProgram, CellSearch
from drake_aigto.certify.parts import cell_program, clique_program
from drake_aigto.certify.program import Formulas, formula_of, read_formulas
from drake_aigto.certify.squares import SquaresBound, bound_by_squares
from drake_aigto.certify.tape import make_tape
from drake_aigto.certify.values import SumOfFormulas, group

# A point → a feasible one near it, if there is one.
Improve = Callable[[Floats], Floats | None]

# Cells of more variables are too many.
_MOST_VARIABLES = 10
# Of up to so many variables, cells of all of them are smaller than trees of cliques are good.
_FEW = 4
_MOST_OPEN = 400_000
_FIRST_CHUNK = 500
# Polynomials of more variables are too many to multiply out.
_MOST_OF_SQUARES = 1000
# Cells are settled at this part of the gap that is asked for.
_MARGIN = 0.5
# Dynamic programming bounds so many cells at most in one step for each that may be used in all.
_CLIQUE_CELLS = 40


class Method(enum.Enum):
    """How a bound was found."""

    CELLS = "branch and bound over cells of all variables"
    CLIQUES = "dynamic programming over bins of a tree of small cliques"
    SQUARES = "sums of squares over cliques of variables"
    SUM = "the sum of what each summand is at least"
    NONE = "no bound"


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is known of the least cost of a program.

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
    return max(0.0, cost - bound) / max(abs(cost), scale, 1e-300)


def certify(
    prog: MathematicalProgram,
    point: Floats | None = None,
    *,
    gap: float = 1e-6,
    cells: int = 1_000_000,
    improve: Improve = lambda _: None,
) -> Certificate:
    """Returns a lower bound of a program's cost over all points that meet its constraints.

    Args:
        prog: costs and constraints linear, quadratic or symbolic; variables with bounds.
        point: a feasible point, the better the tighter, shape (n,).
        gap: relative; what is enough.
        cells: the most cells that are bounded.
        improve: called with points of the lowest cells; returns a feasible one nearby, or None.

    Raises:
        UnsupportedTermError: a function without an enclosure, by name.
    """
    certifier = Certifier(prog, gap=gap)
    if point is not None:
        certifier.offer(point)
    return certifier.run(cells, improve)


class Certifier:
    """Bounds of one program, which may be gone on with.

    Args:
        prog: as in `certify`.
        gap: as in `certify`.

    Attributes:
        method: of the cells, or the sum.
        least_sum: the sum of what each summand is at least.
        scale: the gap is relative to the best cost, or to this where that is less in size.
        best: the best point (n,), nan before there is one.
        best_cost: its cost; ∞ before.

    Raises:
        UnsupportedTermError: as in `certify`.
    """

    def __init__(self, prog: MathematicalProgram, gap: float = 1e-6) -> None:
        """Chooses a method by the program's structure."""
        self._formulas = read_formulas(prog)
        self._gap = gap
        order = self._order()
        self.method, program = self._choose(order)
        self._cost = _sum_of(self._formulas, program)
        least, most = self._cost.range(self._formulas.lower, self._formulas.upper)
        self.least_sum = least
        # What the cost varies by over the bounds, if that is below 1 in its own unit.
        self.scale = min(1.0, most - least) if math.isfinite(most - least) else 1.0
        self.best, self.best_cost = np.full(self._formulas.lower.size, np.nan), math.inf
        self._squares: SquaresBound | None = None
        self._search: CellSearch | CliqueSearch | None = None
        if isinstance(program, CellProgram):
            self._search = CellSearch(program, self.scale, _MARGIN * gap, _MOST_OPEN)
        elif program is not None and order is not None:
            self._search = CliqueSearch(program, order)

    def _order(self) -> list[tuple[int, ...]] | None:
        """Returns in which order variables of small cliques are eliminated; None: of others."""
        formulas = self._formulas
        size = formulas.lower.size
        if size <= _FEW or not np.all(np.isfinite(formulas.upper - formulas.lower)):
            return None
        read = [each.variables for each in formulas.summands]
        read += [row.formula.variables for row in formulas.rows]
        if max(map(len, read), default=0) > MOST_VARIABLES:
            return None
        return elimination(size, read)

    def _choose(
        self, order: list[tuple[int, ...]] | None
    ) -> tuple[Method, CellProgram | CliqueProgram | None]:
        formulas = self._formulas
        if order is not None:
            return Method.CLIQUES, clique_program(formulas)
        if 0 < formulas.lower.size <= _MOST_VARIABLES:
            return Method.CELLS, cell_program(formulas)
        return Method.SUM, None

    def offer(self, x: Floats) -> None:
        """Takes a point that meets all constraints, if it is the best so far."""
        x = np.clip(x, self._formulas.lower, self._formulas.upper)
        value = self._cost.range(x, x)[1]
        if value < self.best_cost:
            self.best, self.best_cost = x, value
        if self._search is not None:
            self._search.offer(x, value)

    def run(self, cells: int, improve: Improve) -> Certificate:
        """Bounds so many cells more at most, and returns what is known then.

        Args:
            cells: how many.
            improve: as in `certify`.
        """
        if isinstance(self._search, CellSearch):
            self._run_cells(self._search, cells, improve)
        elif isinstance(self._search, CliqueSearch):
            self._run_cliques(self._search, cells, improve)
        if self._squares is None and self._gap_of(self._cells_bound) > self._gap:
            self._run_squares(improve)
        return self._certificate()

    @property
    def _cells_bound(self) -> float:
        """What is known without sums of squares."""
        if self._search is None:
            return self.least_sum
        return math.inf if self._search.is_empty else self._search.lower_bound

    def _gap_of(self, bound: float) -> float:
        """Returns how far the best cost is above a bound; 0 if there is no feasible point."""
        return 0.0 if bound == math.inf else relative_gap(self.best_cost, bound, self.scale)

    def _run_squares(self, improve: Improve) -> None:
        size = self._formulas.lower.size
        if size > _MOST_OF_SQUARES:
            self._squares = SquaresBound(-math.inf, reason=f"{size} variables are too many")
            return
        x = np.where(np.isfinite(self.best), self.best, 0.0)
        self._squares = bound_by_squares(self._formulas, x)
        better = None if self._squares.start is None else improve(self._squares.start)
        if better is not None:
            self.offer(better)

    def _run_cells(self, search: CellSearch, cells: int, improve: Improve) -> None:
        end, chunk, last = search.num_cells + cells, _FIRST_CHUNK, math.inf
        while search.num_cells < end and search.run(min(chunk, end - search.num_cells)):
            chunk *= 2
            if self._formulas.rows:
                cell = search.lowest_cell
                start = None if cell is None else np.clip(np.mean(cell, axis=0), *cell)
            else:
                start = search.best.copy() if search.least < last else None
            if start is not None and np.all(np.isfinite(start)):
                self._try(start, improve)
            last = search.least
        if not self._formulas.rows and search.least < self.best_cost:
            self._try(search.best.copy(), improve)

    def _try(self, x: Floats, improve: Improve) -> None:
        """Takes a point, and what it is improved to; of a program with rows, only the latter."""
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
        search, bound, method = self._search, self._cells_bound, self.method
        if self._squares is not None and self._squares.lower_bound > bound:
            bound, method = self._squares.lower_bound, Method.SQUARES
        hull = getattr(search, "hull", None)
        return Certificate(
            lower_bound=bound,
            best_cost=self.best_cost,
            scale=self.scale,
            method=method,
            cells=0 if search is None else search.num_cells,
            reason=self._reason(bound, method),
            best=self.best,
            hull=np.array([self._formulas.lower, self._formulas.upper] if hull is None else hull),
        )

    def _reason(self, bound: float, method: Method) -> str:
        formulas = self._formulas
        if self._gap_of(bound) <= self._gap:
            return ""
        if bound == -math.inf:
            return _missing(formulas) or "the cost falls without end in some cell"
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


def _sum_of(formulas: Formulas, program: CellProgram | CliqueProgram | None) -> SumOfFormulas:
    """Returns the cost as a sum of the formulas that a program has of it, or of its summands."""
    if isinstance(program, CellProgram):
        return SumOfFormulas(program.tape, [range(formulas.lower.size)])
    if program is not None:
        costs = np.flatnonzero(program.is_row == 0)
        return SumOfFormulas(program.tape, [program.variables[k] for k in costs])
    groups = group(formulas.summands)
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
