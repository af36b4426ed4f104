"""`certify`: a lower bound of a program, beside the best known point."""

from __future__ import annotations

import enum
import functools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from pydrake.solvers import MathematicalProgram

from drake_aigto.arrays import Floats
from drake_aigto.certify.cells import CellSearch
from drake_aigto.certify.cliques import MOST_VARIABLES, CliqueSearch
from drake_aigto.certify.contraction import narrowed
from drake_aigto.certify.enclosures import SumOfFormulas
from drake_aigto.certify.formulas import Formulas, read_formulas, tape_of, values_at, with_prices
from drake_aigto.certify.scip import bound_by_scip
from drake_aigto.certify.tape import Tape
from drake_aigto.errors import OptionsError
from drake_aigto.linear import eliminate

# A point → a feasible one near it, if there is one.
Improve = Callable[[Floats], Floats | None]
Progress = Callable[[str], None]
Search = CellSearch | CliqueSearch
Prover = Literal["own", "scip"]

# Of up to this many variables, cells of all of them converge faster than trees of cliques; with
# rows, of up to the second number.
_FEW, _FEW_WITH_ROWS = 4, 10
_SOON = 2.0  # seconds from one line of progress to the next
# Costs below it are lost in what rounding adds to numbers that may underflow.
_LEAST_SCALE = 1e-290
# Cells are settled at this part of the required gap.
_MARGIN = 0.5
_TOLERANCE = 1e-6  # of rows, at points that are found
_INTERRUPTED = "interrupted: this is the bound so far"

# What overflows is infinite, and ∞ − ∞ says nothing: no claim rests on either.
_quiet = np.errstate(over="ignore", invalid="ignore")


class Method(enum.Enum):
    """How a bound was found."""

    CELLS = "branch and bound over cells of all variables"
    CLIQUES = "dynamic programming over bins of a tree of small cliques"
    ROWS = "rows that leave nothing of the bounds"
    SCIP = "SCIP, by floating point with tolerances: not rigorous"
    SUM = "the sum of what each summand is at least"


@dataclass(frozen=True, eq=False)
class Certificate:
    """Bounds of the least cost of a program, from both sides.

    No feasible point costs less than `lower_bound`: intervals are rounded outward, so no rounding
    can make that untrue. It holds for the formulas that the program has.

    Attributes:
        lower_bound: of the cost; −∞ if none was found, ∞ if there is no feasible point.
        best_cost: the least cost of a point that was given, or found to meet rows to 1e-6; ∞ if
            there is none.
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
    point: ArrayLike | None = None,
    *,
    gap: float = 1e-6,
    cells: int = 1_000_000,
    seconds: float | None = None,
    prover: Prover = "own",
    progress: Progress | None = None,
) -> Certificate:
    """Returns a lower bound of a program's cost over all points that meet its constraints.

    Ctrl-C ends the search; the bound so far is returned, and `Certificate.reason` says so. What is
    proven is the formula that Drake holds, which may not be what was written: it makes
    `pow(pow(x, 2), 0.5)` to `x`, which is wrong where x < 0.

    Args:
        prog: costs and constraints linear, quadratic or symbolic; variables with bounds.
        point: a feasible point, the better the tighter, shape (n,); its rows are not checked.
        gap: relative; small enough.
        cells: the most cells that are bounded; a linear program counts as some of them.
        seconds: the most that it takes, if any; the bound depends on the clock then.
        prover: "own", or "scip" where SCIP is installed (extra `scip`), which is not rigorous.
        progress: called with a line of text every two seconds.

    Raises:
        OptionsError: a limit that is not above 0, a point of another size or with NaN, or a prover
            that is unknown or not installed.
        UnsupportedTermError: a function without an enclosure, or an integer variable, by name.
    """
    if prover not in (provers := get_args(Prover)):
        raise OptionsError("prover", got=repr(prover), expected=f"one of {', '.join(provers)}")
    for name, limit in (("gap", gap), ("cells", cells), ("seconds", seconds)):
        if limit is not None and not limit > 0:
            raise OptionsError(name, got=limit, expected="a number above 0")
    point = () if point is None and not prog.num_vars() else point
    known = None if point is None else np.asarray(point, dtype=float)
    if known is not None and (known.shape != (prog.num_vars(),) or np.any(np.isnan(known))):
        expected = f"shape ({prog.num_vars()},), no NaN"
        raise OptionsError("point", got=repr(known.tolist()), expected=expected)
    if prover == "scip":
        return _certify_with_scip(prog, gap, seconds)
    certifier = Certifier(prog, gap=gap, seconds=seconds, progress=progress)
    if known is not None:
        certifier.offer(known)
    try:
        return certifier.run(cells, certifier.check)
    except KeyboardInterrupt:
        return certifier.certificate(is_interrupted=True)


def _certify_with_scip(prog: MathematicalProgram, gap: float, seconds: float | None) -> Certificate:
    formulas = read_formulas(prog)
    bound, point = bound_by_scip(formulas, gap, seconds)
    cost = math.inf
    if point is not None:
        cost = float(sum(prog.EvalBinding(each, point)[0] for each in prog.GetAllCosts()))
    return Certificate(
        lower_bound=bound,
        best_cost=cost,
        scale=1.0,
        method=Method.SCIP,
        cells=0,
        best=np.full(formulas.lower.size, np.nan) if point is None else point,
        hull=np.array([formulas.lower, formulas.upper]),
    )


class Certifier:
    """Bounds of one program, which may be gone on with.

    Args:
        prog: as in `certify`, or its formulas.
        gap: as in `certify`.
        seconds: as in `certify`, of all runs.
        progress: as in `certify`.

    Attributes:
        least_sum: the sum of the lower bounds of summands.

    Raises:
        UnsupportedTermError: as in `certify`.
    """

    @_quiet
    def __init__(
        self,
        prog: MathematicalProgram | Formulas,
        gap: float = 1e-6,
        seconds: float | None = None,
        progress: Progress | None = None,
    ) -> None:
        """Chooses a method by the program's structure."""
        self._clock = _Clock(seconds, progress)
        self._asked = prog if isinstance(prog, Formulas) else read_formulas(prog)
        self._formulas, is_feasible = narrowed(self._asked)
        formulas, self._gap = self._formulas, gap
        self._search: Search | None = None
        self._method = Method.SUM if is_feasible else Method.ROWS
        order, size = _find_order(formulas), formulas.lower.size
        # Of programs with rows, whose prices are those of the last point with this cost.
        self._order, self._priced_cost = order if formulas.rows else None, math.inf
        self._floor, self._num_cells = -math.inf, 0
        if is_feasible and order is not None and not formulas.rows:
            self._method = Method.CLIQUES
            self._search = CliqueSearch(formulas, _MARGIN * gap, order)
        elif is_feasible and size:
            self._method, self._search = Method.CELLS, CellSearch(formulas, _MARGIN * gap)
        # With rows, two of simpler programs are added before it, once a point is known.
        self._searches = [self._search] if self._search else []
        self._cost = (
            self._search.cost
            if self._search
            else SumOfFormulas(tape_of([formulas.summands], size), [range(size)])
        )
        least, most = self._cost.range(formulas.lower, formulas.upper)
        self.least_sum = least if is_feasible else math.inf
        # The variation of the cost over the bounds, if that is below 1 in its own unit.
        width = most - self.least_sum
        self._scale = max(min(1.0, width), _LEAST_SCALE) if math.isfinite(width) else 1.0
        self._best, self._best_cost = np.full(size, np.nan), math.inf

    @_quiet
    def offer(self, x: Floats) -> None:
        """Takes a point that meets all constraints, if it is the best so far."""
        x = np.clip(x, self._asked.lower, self._asked.upper)
        value = self._cost.range(x, x)[1]
        if value < self._best_cost:
            self._best, self._best_cost = x, value
        for search in self._searches:
            search.offer(x, value)

    @functools.cached_property
    def _row_tape(self) -> Tape:
        return tape_of(((row,) for row in self._asked.rows), self._asked.lower.size)

    def check(self, x: Floats) -> Floats | None:
        """Returns a point if it meets all rows to 1e-6, else None."""
        found = values_at(self._row_tape, x)[:, 0]
        low, high = self._asked.row_bounds
        is_met = (found[:, 0] >= low - _TOLERANCE) & (found[:, 1] <= high + _TOLERANCE)
        return x if np.all(is_met & np.isfinite(found[:, 1])) else None

    @_quiet
    def run(self, cells: int, improve: Improve = lambda _: None) -> Certificate:
        """Bounds more cells, and returns the bound so far.

        Args:
            cells: number of cells at most.
            improve: called with points of the lowest cells; returns a feasible one nearby, or None.
        """
        end, over = self._num_cells + cells, set[Search]()
        while (left := [e for e in self._searches if e not in over]) and not self._is_over(end):
            if self._order is not None and self._best_cost < self._priced_cost:
                self._price_rows(self._order)
                continue
            # All have their share, as nobody knows which of them gets there.
            search = min(left, key=lambda each: each.num_cells)
            if not self._step(search, end, improve):
                over.add(search)
            if search is not self._search:
                self._floor = max(self._floor, search.lower_bound)
        return self.certificate()

    def _is_over(self, end: int) -> bool:
        """Whether no cells or seconds are left, or the gap is closed."""
        is_spent = self._num_cells >= end or self._clock.is_over
        return is_spent or self._gap_of(self._bound) <= self._gap

    def _step(self, search: Search, end: int, improve: Improve) -> bool:
        """Bounds some cells, and returns whether others are left; see `run`."""
        before = search.num_cells
        is_open = search.run(end - self._num_cells, self._scale)
        self._num_cells += search.num_cells - before
        self._clock.tell(search.lower_bound, search.least, self._num_cells)
        point, search.lowest_point = search.lowest_point, None
        if not self._formulas.rows and search.least < self._best_cost:
            point = search.best
        if point is not None and np.all(np.isfinite(point)):
            if not self._formulas.rows:
                self.offer(point)
            better = improve(point)
            if better is not None:
                self.offer(better)
        return is_open

    def _price_rows(self, order: Sequence[tuple[int, ...]]) -> None:
        """Searches by cliques, too: the cost with rows at prices that the best point says.

        And the cost without rows, as prices may be those of another valley.
        """
        priced = with_prices(self._formulas, self._best)
        programs = [priced]
        if self._priced_cost == math.inf:
            programs.append(replace(priced, summands=self._formulas.summands))
        own = [CliqueSearch(each, _MARGIN * self._gap, order) for each in programs]
        for search in own:
            search.offer(self._best, self._best_cost)
        self._searches, self._priced_cost = [*own, *self._searches[-2:]], self._best_cost

    @property
    def _bound(self) -> float:
        if self._search is None:
            return self.least_sum
        found = max(self.least_sum, self._floor, self._search.lower_bound)
        return math.inf if self._search.is_empty else found

    def _gap_of(self, bound: float) -> float:
        """Returns how far the best cost is above a bound; 0 if there is no feasible point."""
        return 0.0 if bound == math.inf else relative_gap(self._best_cost, bound, self._scale)

    def certificate(self, is_interrupted: bool = False) -> Certificate:
        """Returns the bound so far, which an interruption may have ended."""
        formulas, search, bound = self._formulas, self._search, self._bound
        hull = None if search is None else search.hull
        return Certificate(
            lower_bound=bound,
            best_cost=self._best_cost,
            scale=self._scale,
            method=Method.CLIQUES if -math.inf < bound == self._floor else self._method,
            cells=self._num_cells,
            reason=_INTERRUPTED if is_interrupted else self._reason(bound),
            best=self._best,
            hull=np.array([formulas.lower, formulas.upper]) if hull is None else hull,
        )

    def _reason(self, bound: float) -> str:
        if self._gap_of(bound) <= self._gap:
            return ""
        if self._clock.is_over:
            return "the seconds allowed were used up: the bound depends on the clock"
        if bound == -math.inf:
            far = self._search.hopeless if isinstance(self._search, CellSearch) else ()
            return _missing(self._formulas, far) or "no lower end of the cost is known in some cell"
        if isinstance(self._search, CellSearch) and self._search.is_over:
            return "cells are as small as numbers allow, or their number is"
        told = "the cells allowed were used up"
        if math.isfinite(self._best_cost):
            told += f"; those with bounds from {bound:.6g} on may hold a point that is better"
            told += f" than the one of cost {self._best_cost:.6g}"
        return told


class _Clock:
    """Seconds that are left, and lines of progress, as `certify` has them."""

    def __init__(self, seconds: float | None, progress: Progress | None) -> None:
        self._end = math.inf if seconds is None else time.monotonic() + seconds
        self._progress, self._next = progress, time.monotonic() + _SOON

    @property
    def is_over(self) -> bool:
        """Whether no seconds are left."""
        return time.monotonic() >= self._end

    def tell(self, bound: float, cost: float, cells: int) -> None:
        """Reports the bound, if it is time to."""
        if self._progress is not None and time.monotonic() >= self._next:
            self._next = time.monotonic() + _SOON
            self._progress(f"bound {bound:.9g}, best known {cost:.9g}, {cells} cells")


def _find_order(formulas: Formulas) -> list[tuple[int, ...]] | None:
    """Returns in which order variables of small cliques are eliminated; None: of other programs."""
    size, few = formulas.lower.size, _FEW_WITH_ROWS if formulas.rows else _FEW
    if size <= few or not np.all(np.isfinite(formulas.upper - formulas.lower)):
        return None
    parts = (*formulas.summands, *(part for row in formulas.rows for part in row.parts()))
    read = [each.variables for each in parts]
    if max(map(len, read), default=0) > MOST_VARIABLES:
        return None
    order = []
    for i, others, is_held in eliminate(read, range(size), MOST_VARIABLES - 1, range(size)):
        if is_held:
            return None
        order.append((i, *sorted(others)))
    return order


def _missing(formulas: Formulas, sides: Sequence[tuple[int, int]]) -> str:
    """Returns which bounds are missing: at these sides of variables, else all; may be empty."""
    bounds = formulas.lower, formulas.upper
    every = [(i, k) for k in range(2) for i in np.flatnonzero(np.isinf(bounds[k])).tolist()]
    names = [f"{formulas.names[i]} has no {('lower', 'upper')[k]} bound" for i, k in sides or every]
    more = f", and {len(names) - 3} more are missing" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more
