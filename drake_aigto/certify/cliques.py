"""Bounds of sums over trees of small cliques: bins of every variable, and dynamic programming.

Let f = Σ_p f_p, each f_p of up to three variables. Every variable's range is cut into bins k about
points c_k. A function of x_i alone may be moved from one summand to another, so

    f(x) = Σ_p [f_p(x) − Σ_i s_pik (x_i − c_k)] + Σ_i Σ_p s_pik (x_i − c_k),     x_i in bin k,

whatever numbers s are. With s_pik = ∂f_p/∂x_i at c_k and the best neighbors of bin k, no summand
has a slope where it matters, so that the sum of their minima over a cell is off by what falls with
its width squared. Dynamic programming along a junction tree adds these minima up: exactly, and for
every bin the least of all sums with it, its min-marginal (Wainwright & Jordan 2008, "Graphical
Models, Exponential Families, and Variational Inference", ch. 8). Bins whose min-marginal is above a
known value of f hold no minimizer, and go; the others are halved.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.certify.clique_cells import (
    MOST_VARIABLES,
    Bins,
    Group,
    bins_of,
    bound_box,
    bound_cells,
    may_hold_minima,
    moved_slopes,
    slopes_of,
)
from drake_aigto.certify.intervals import UNIT
from drake_aigto.certify.tape import Tape

_FIRST_BINS = 16
_SWEEPS = 2  # over all bins, before their cells are bounded


@dataclass(frozen=True, eq=False)
class CliqueProgram:
    """Minimize Σ_p f_p over a box, subject to rows.

    Attributes:
        tape: formulas of costs and rows. The first n are functions of one variable, x_0 … x_(n−1).
        variables: those of each formula, at most three.
        lower_rows: lower bounds of the rows among them; −∞ of costs (F,).
        upper_rows: upper bounds (F,).
        is_row: 1 of rows, 0 of costs (F,).
        lower: bounds of x (n,), finite.
        upper: shape (n,).
    """

    tape: Tape
    variables: tuple[tuple[int, ...], ...]
    lower_rows: Floats
    upper_rows: Floats
    is_row: Ints
    lower: Floats
    upper: Floats


def elimination(
    num_variables: int, cliques: Sequence[tuple[int, ...]], most: int = MOST_VARIABLES
) -> list[tuple[int, ...]] | None:
    """Returns every variable, in the order of elimination, with its neighbors then.

    The next one is one of the fewest neighbors. None if these are more than the most, with it.
    """
    beside: list[set[int]] = [set() for _ in range(num_variables)]
    for clique in cliques:
        for i in clique:
            beside[i].update(clique)
    for i, others in enumerate(beside):
        others.discard(i)
    queue = [(len(others), i) for i, others in enumerate(beside)]
    heapq.heapify(queue)
    order, is_gone = [], [False] * num_variables
    while queue:
        degree, i = heapq.heappop(queue)
        if is_gone[i] or degree != len(beside[i]):
            continue
        if degree >= most:
            return None
        is_gone[i] = True
        order.append((i, *sorted(beside[i])))
        for j in beside[i]:
            beside[j] |= beside[i]
            beside[j] -= {i, j}
            heapq.heappush(queue, (len(beside[j]), j))
    return order


class CliqueSearch:
    """Dynamic programming over ever smaller bins.

    Args:
        program: what is bounded.
        order: variables with their neighbors, as `elimination` returns them.
    """

    def __init__(self, program: CliqueProgram, order: Sequence[tuple[int, ...]]) -> None:
        """Cuts every range into bins."""
        self._program, self._order = program, order
        self._rank = {clique[0]: number for number, clique in enumerate(order)}
        edges = np.linspace(program.lower, program.upper, _FIRST_BINS + 1, axis=-1)
        edges[:, 0], edges[:, -1] = program.lower, program.upper
        self._low, self._high = list(edges[:, :-1]), list(edges[:, 1:])
        self._tables: list[Floats] = []
        self._partners: list[list[Floats]] | None = None
        self._home = [min(map(self._rank.__getitem__, each)) for each in program.variables]
        self._groups = _make_groups(program)
        self._costs = [group for group in self._groups if group.rows is None]
        self.num_cells = 0
        self.lower_bound = -np.inf
        self.is_empty = False
        self.best = np.array(0.5 * program.lower + 0.5 * program.upper)
        self.least = np.inf

    def offer(self, x: Floats, value: float) -> None:
        """Takes a feasible point and its value, rounded up, if it is the best so far."""
        if value < self.least:
            self.least, self.best = value, np.clip(x, self._program.lower, self._program.upper)

    @property
    def hull(self) -> tuple[Floats, Floats]:
        """The smallest box that holds all bins that are left."""
        low, high = zip(
            *((a[0], b[-1]) for a, b in zip(self._low, self._high, strict=True)), strict=True
        )
        return np.array(low), np.array(high)

    def next_size(self) -> int:
        """Returns how many cells the next step bounds."""
        counts = [bins.size for bins in self._low]
        return sum(math.prod(counts[i] for i in each) for each in self._program.variables)

    def step(self) -> Floats:
        """Bounds all cells, and returns a point of the lowest ones; see `drop`."""
        self._drop_by_slopes()
        bins = self._bins()
        self._tables = self._fill(bins)
        self.num_cells += sum(table.size for table in self._tables)
        self._pass_up()
        if not math.isfinite(self._total):
            self.is_empty = self._total == np.inf
            self.lower_bound = min(self.least, self._total)
            return self.best
        bound = self._total - self._margin
        self.lower_bound = max(self.lower_bound, min(bound, self.least))
        point = self._pass_down(bins)
        return point

    def drop(self) -> None:
        """Drops the bins that hold nothing below the best value, and halves the others."""
        self._close()
        for i, marginal in enumerate(self._marginals):
            keep = marginal - self._margin <= self.least
            if not np.any(keep):
                keep = marginal == np.min(marginal)
            low, high = self._low[i][keep], self._high[i][keep]
            middle = 0.5 * low + 0.5 * high
            self._low[i] = np.column_stack([low, middle]).ravel()
            self._high[i] = np.column_stack([middle, high]).ravel()
            self._inherit(i, np.repeat(np.flatnonzero(keep), 2))

    def _drop_by_slopes(self) -> None:
        """Drops bins where f has no minimum along their own variable, whatever the others are.

        It rises or falls all over the bin, which is none of the ends; or it is concave. That holds
        however many other variables there are, and however far from the best value the bound is.
        """
        program = self._program
        if np.any(program.is_row):
            return
        for _ in range(_SWEEPS):
            bins = self._bins()
            keep = may_hold_minima(program.tape, self._costs, bins, program.lower, program.upper)
            if np.all(keep):
                return
            for i, kept in enumerate(np.split(keep, bins.starts[1:-1])):
                if np.all(kept) or not np.any(kept):
                    continue
                self._low[i], self._high[i] = self._low[i][kept], self._high[i][kept]
                self._inherit(i, np.flatnonzero(kept))

    def _inherit(self, i: int, parents: Ints) -> None:
        """Gives bins the neighbors of those that they came from."""
        if self._partners is None:
            return
        for formula, local in self._readers[i]:
            self._partners[formula][local] = self._partners[formula][local][parents]

    @property
    def _readers(self) -> list[list[tuple[int, int]]]:
        if not hasattr(self, "_read_by"):
            found: list[list[tuple[int, int]]] = [[] for _ in self._low]
            for formula, variables in enumerate(self._program.variables):
                if len(variables) > 1:
                    for local, i in enumerate(variables):
                        found[i].append((formula, local))
            self._read_by = found
        return self._read_by

    def _bins(self) -> Bins:
        starts = np.cumsum([0, *(low.size for low in self._low)])
        low, high = np.concatenate(self._low), np.concatenate(self._high)
        points = 0.5 * low + 0.5 * high
        best = np.repeat(self.best, np.diff(starts))
        points = np.where((low <= best) & (best <= high), best, points)
        return Bins(starts, low, high, points)

    def _fill(self, bins: Bins) -> list[Floats]:
        """Returns a table of bounds for each formula, an axis for each variable."""
        tape = self._program.tape
        slopes = {
            group: slopes_of(tape, group, bins, self._partner_points(group, bins))
            for group in self._costs
            if group.variables.shape[1] > 1
        }
        moved = moved_slopes(list(slopes.values()), bins.low.size)
        tables: list[Floats] = [np.empty(0)] * len(self._program.variables)
        for group in self._groups:
            found = bound_cells(tape, group, bins, slopes.get(group), moved)
            for formula, table in zip(group.formulas.tolist(), found, strict=True):
                tables[formula] = table
        return tables

    def _partner_points(self, group: Group, bins: Bins) -> Floats:
        """Returns where each slope is taken: of each bin, all variables of the formula (S, m)."""
        owners, own = bins_of(group, bins)
        of, local = np.divmod(owners, group.variables.shape[1])
        if self._partners is None:
            points = self.best[group.variables[of]]
        else:
            known = (each for k in group.formulas.tolist() for each in self._partners[k])
            points = np.concatenate(list(known))
        points[np.arange(own.size), local] = bins.points[own]
        return points

    def _pass_up(self) -> None:
        """Adds tables up along the elimination, and sets the total."""
        counts = [low.size for low in self._low]
        order = self._order
        self._sums = [np.zeros([counts[i] for i in clique]) for clique in order]
        size = 0.0
        for table, variables, home in zip(
            self._tables, self._program.variables, self._home, strict=True
        ):
            self._sums[home] += _spread(table, variables, order[home])
            finite = np.abs(table[np.isfinite(table)])
            size += float(np.max(finite, initial=0.0))
        # Every addition is off by half a unit of what is never more than all tables' largest.
        self._margin = (len(self._tables) + 2 * len(order)) * UNIT * size
        self._messages: list[Floats] = []
        self._total = 0.0
        for number, clique in enumerate(order):
            message = self._sums[number].min(axis=0)
            self._messages.append(message)
            if len(clique) > 1:
                parent = min(map(self._rank.__getitem__, clique[1:]))
                self._sums[parent] += _spread(message, clique[1:], order[parent])
            else:
                self._total += float(message)

    def _pass_down(self, bins: Bins) -> Floats:
        """Fills min-marginals and the best neighbors, and returns the points of the best bins."""
        order, counts = self._order, [low.size for low in self._low]
        outside: list[Floats] = [np.zeros(())] * len(order)
        marginals: list[Floats] = [np.empty(0)] * len(order)
        chosen = np.zeros(len(order), dtype=np.int64)
        for number in range(len(order) - 1, -1, -1):
            clique = order[number]
            if len(clique) > 1:
                parent = min(map(self._rank.__getitem__, clique[1:]))
                above = self._sums[parent]
                own = _spread(self._messages[number], clique[1:], order[parent])
                with np.errstate(invalid="ignore"):
                    rest = np.where(np.isinf(above), np.inf, above - own)
                axes = [a for a, i in enumerate(order[parent]) if i not in clique[1:]]
                kept = [i for i in order[parent] if i in clique[1:]]
                message = rest.min(axis=tuple(axes)) if axes else rest
                outside[number] = _spread(message, kept, clique[1:])
                self._sums[number] = self._sums[number] + outside[number]
            else:
                self._sums[number] = self._sums[number] + (self._total - self._messages[number])
            sums = self._sums[number]
            i = clique[0]
            marginals[i] = sums.min(axis=tuple(range(1, sums.ndim)))
            at = tuple(chosen[list(clique[1:])])
            chosen[i] = np.argmin(sums[(slice(None), *at)])
        self._marginals = marginals
        self._find_partners(bins, counts)
        return bins.points[bins.starts[:-1] + chosen]

    def _find_partners(self, bins: Bins, counts: Sequence[int]) -> None:
        """Sets for each formula, variable and bin of it the points of its neighbors' best bins."""
        self._partners = []
        for variables, home in zip(self._program.variables, self._home, strict=True):
            if len(variables) == 1:
                self._partners.append([])
                continue
            clique, sums = self._order[home], self._sums[home]
            places = [clique.index(i) for i in variables]
            found = []
            for i, place in zip(variables, places, strict=True):
                flat = np.moveaxis(sums, place, 0)
                shape = flat.shape[1:]
                best = np.unravel_index(np.argmin(flat.reshape(counts[i], -1), axis=1), shape)
                others = [j for j in clique if j != i]
                columns = [
                    np.zeros(counts[i])
                    if j == i
                    else bins.points[bins.starts[j] + best[others.index(j)]]
                    for j in variables
                ]
                found.append(np.column_stack(columns))
            self._partners.append(found)

    def _close(self) -> None:
        """Raises the bound to the best value where all bins that are left prove to be convex."""
        if not math.isfinite(self.least):
            return
        keep = [marginal - self._margin <= self.least for marginal in self._marginals]
        if not all(map(np.any, keep)):
            self.lower_bound = self.least
            return
        low = np.array([a[k][0] for a, k in zip(self._low, keep, strict=True)])
        high = np.array([b[k][-1] for b, k in zip(self._high, keep, strict=True)])
        if np.any(self.best < low) or np.any(self.best > high):
            return
        bound = bound_box(self._program.tape, self._costs, low, high, self.best)
        self.lower_bound = max(self.lower_bound, min(bound, self.least))


def _make_groups(program: CliqueProgram) -> list[Group]:
    """Returns the formulas by how many variables they read, rows and costs apart."""
    found: dict[tuple[int, int], list[int]] = {}
    for formula, variables in enumerate(program.variables):
        found.setdefault((len(variables), int(program.is_row[formula])), []).append(formula)
    rows = np.array([program.lower_rows, program.upper_rows])
    return [
        Group(
            np.array(formulas),
            np.array([program.variables[k] for k in formulas]),
            rows[:, formulas] if is_row else None,
        )
        for (_, is_row), formulas in found.items()
    ]


def _spread(table: Floats, variables: Sequence[int], clique: Sequence[int]) -> Floats:
    """Returns a table over some variables with an axis for each of a clique's."""
    kept = [i for i in clique if i in variables]
    moved = np.transpose(table, [list(variables).index(i) for i in kept])
    return moved[tuple(slice(None) if i in variables else None for i in clique)]
