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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.certify.enclosures import (
    GRADIENT,
    HESSIAN,
    SumOfFormulas,
    enclose_all,
    sum_outward,
)
from drake_aigto.certify.expansions import bound_tables, curvatures, separable_bound
from drake_aigto.certify.formulas import Formulas, formula_of, make_tape
from drake_aigto.certify.intervals import UNIT

MOST_VARIABLES = 3  # of a clique
_FIRST_BINS = 16
_SWEEPS = 2  # over all bins, before their cells are bounded
_LARGE = 1e290  # Sums of what is larger would overflow.


def elimination(
    num_variables: int, cliques: Sequence[tuple[int, ...]], most: int
) -> list[tuple[int, ...]] | None:
    """Returns every variable, in the order of elimination, with its neighbors then.

    The next one is one of the fewest neighbors. None if these are more than the most, with it.
    """
    beside: list[set[int]] = [set() for _ in range(num_variables)]
    for clique in cliques:
        for i in clique:
            beside[i].update(clique)
    queue = []
    for i, others in enumerate(beside):
        others.discard(i)
        queue.append((len(others), i))
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


class Bins(NamedTuple):
    """Bins of all variables, one variable after the other.

    Attributes:
        starts: first bin of each variable (n + 1,).
        low: lower ends (K,).
        high: upper ends (K,).
        points: c (K,).
    """

    starts: Ints
    low: Floats
    high: Floats
    points: Floats


@dataclass(frozen=True, eq=False)
class Group:
    """Formulas of as many variables, all of them costs or all of them rows.

    Attributes:
        formulas: their numbers (G,).
        variables: those that each reads (G, m).
        rows: lower and upper bounds (2, G) of rows; (2, 0) of costs.
    """

    formulas: Ints
    variables: Ints
    rows: Floats

    def bins(self, starts: Ints) -> tuple[Ints, Ints, Ints]:
        """Returns all S bins of each variable of each formula, in the order formula, variable, bin.

        Their formulas, which of the formula's variables each is of, and the bins, all (S,).
        """
        read = self.variables.ravel()
        counts = np.diff(starts)[read]
        owners = np.repeat(np.arange(read.size), counts)
        own = np.arange(owners.size) - np.repeat(np.cumsum(counts) - counts, counts)
        return *np.divmod(owners, self.variables.shape[1]), starts[read][owners] + own


class CliqueSearch:
    """Dynamic programming over ever smaller bins.

    Args:
        formulas: the program; its cost and rows read up to three variables each.
        order: variables with their neighbors, as `elimination` returns them.

    Attributes:
        cost: Σ_p f_p.
        best: the best point that is known (n,).
        least: its value.
        lower_bound: of f over all feasible points; at most the best value.
        is_empty: whether no point of the box meets all rows.
        num_cells: number of cells that were bounded.
    """

    def __init__(self, formulas: Formulas, order: Sequence[tuple[int, ...]]) -> None:
        """Cuts every range into bins."""
        self._order = order
        self._rank = {clique[0]: number for number, clique in enumerate(order)}
        self._outer = lower, upper = formulas.lower, formulas.upper
        self._make_groups(formulas)
        self._home = [self._first(each) for each in self._variables]
        edges = np.linspace(lower, upper, _FIRST_BINS + 1, axis=-1)
        edges[:, 0], edges[:, -1] = lower, upper
        self._starts = _FIRST_BINS * np.arange(lower.size + 1)
        self._low, self._high = edges[:, :-1].ravel(), edges[:, 1:].ravel()
        # Of each group's bins, where its formula's variables are best, as far as is known.
        self._partners: dict[Group, Floats] = {}
        self.num_cells = 0
        self.lower_bound = -np.inf
        self.is_empty = False
        self.best = np.array(0.5 * lower + 0.5 * upper)
        self.least = np.inf

    def _make_groups(self, formulas: Formulas) -> None:
        """Makes a formula for every set of variables, those of one variable first, and every row.

        Formulas of as many variables are a group, rows and costs apart.
        """
        summands = formulas.groups()
        summands[(0,)] = summands.get((0,), []) + summands.pop((), [])
        costs: list[tuple[int, ...]] = [(i,) for i in range(formulas.lower.size)]
        costs += [variables for variables in summands if len(variables) > 1]
        rows = [row for row in formulas.rows if row.variables]
        sums = [formula_of(summands.get(each, []), each) for each in costs]
        sums += [formula_of((row,), row.variables) for row in rows]
        self._tape = make_tape(sums)
        self._variables = [*costs, *(row.variables for row in rows)]
        self.cost = SumOfFormulas(self._tape, costs)
        found: dict[tuple[int, bool], list[int]] = {}
        for formula, variables in enumerate(self._variables):
            found.setdefault((len(variables), formula >= len(costs)), []).append(formula)
        bounds = np.array([[row.lower for row in rows], [row.upper for row in rows]])
        groups = [
            Group(
                np.array(numbers),
                np.array([self._variables[k] for k in numbers]),
                np.ascontiguousarray(bounds[:, [k - len(costs) for k in numbers if is_row]]),
            )
            for (_, is_row), numbers in found.items()
        ]
        self._groups = groups
        self._costs = [group for group in groups if not group.rows.size]
        self._coupled = [group for group in self._costs if group.variables.shape[1] > 1]

    def offer(self, x: Floats, value: float) -> None:
        """Takes a feasible point and its value, rounded up, if it is the best so far."""
        if value < self.least:
            self.least, self.best = value, x

    @property
    def hull(self) -> Floats:
        """Lower and upper ends (2, n) of the smallest box that holds all bins that are left."""
        return np.array([self._low[self._starts[:-1]], self._high[self._starts[1:] - 1]])

    def next_size(self) -> int:
        """Returns how many cells the next step bounds."""
        counts = np.diff(self._starts).tolist()
        return sum(math.prod(counts[i] for i in each) for each in self._variables)

    def step(self) -> Floats:
        """Bounds all cells, and returns a point of the lowest ones; see `drop`."""
        self._drop_by_slopes()
        best = np.repeat(self.best, np.diff(self._starts))
        points = 0.5 * self._low + 0.5 * self._high
        points = np.where((self._low <= best) & (best <= self._high), best, points)
        bins = Bins(self._starts, self._low, self._high, points)
        with np.errstate(invalid="ignore"):
            self._pass_up(self._fill(bins), bins)
            if math.isfinite(self._total):
                bound = self._total - self._margin
                self.lower_bound = max(self.lower_bound, min(bound, self.least))
                return self._pass_down(bins)
        # Nothing is known of any bin where a cell has no bound.
        self._marginals = np.full(bins.low.size, self._total)
        self.is_empty = self._total == np.inf
        return self.best

    def drop(self) -> None:
        """Drops the bins that hold nothing below the best value, and halves the others."""
        keep = self._marginals - self._margin <= self.least
        is_any = np.logical_or.reduceat(keep, self._starts[:-1])
        self._close(keep, bool(np.all(is_any)))
        counts = np.diff(self._starts)
        lowest = np.repeat(np.minimum.reduceat(self._marginals, self._starts[:-1]), counts)
        keep |= ~np.repeat(is_any, counts) & (self._marginals == lowest)
        self._narrow(keep, 2)
        middle = 0.5 * self._low + 0.5 * self._high
        self._low[1::2], self._high[::2] = middle[1::2], middle[::2]

    def _drop_by_slopes(self) -> None:
        """Drops bins where f has no minimum along their own variable, for any values of others.

        It rises or falls all over the bin, which is none of the ends; or it is concave. That holds
        however many other variables there are, and however far from the best value the bound is.
        """
        if len(self._costs) < len(self._groups):
            return
        for _ in range(_SWEEPS):
            keep = self._may_hold_minima()
            if np.all(keep):
                return
            is_any = np.logical_or.reduceat(keep, self._starts[:-1])
            self._narrow(keep | ~np.repeat(is_any, np.diff(self._starts)), 1)

    def _may_hold_minima(self) -> Bools:
        """Returns for each bin whether f may have a minimum in it along its own variable (K,)."""
        slopes, bends, owners = [], [], []
        for group in self._costs:
            of, local, own = group.bins(self._starts)
            ends, rows = self.hull[:, group.variables[of]], np.arange(own.size)
            ends[0, rows, local], ends[1, rows, local] = self._low[own], self._high[own]
            over = enclose_all(self._tape, group.formulas[of], ends[0], ends[1], HESSIAN)
            slopes.append(over[rows, 1 + local])
            bends.append(over[rows, 1 + ends.shape[2] + local * (local + 1) // 2 + local])
            owners.append(own)
        whose, count = np.concatenate(owners), self._low.size
        with np.errstate(invalid="ignore"):
            rise = sum_outward(np.concatenate(slopes), whose, count)
            bend = sum_outward(np.concatenate(bends), whose, count)
        lower, upper = (np.repeat(side, np.diff(self._starts)) for side in self._outer)
        at_lower, at_upper = self._low == lower, self._high == upper
        is_bent = (bend[:, 1] < 0.0) & ~at_lower & ~at_upper
        falls, rises = (rise[:, 1] < 0.0) & ~at_upper, (rise[:, 0] > 0.0) & ~at_lower
        # Where a Hessian is finite, f has values around the bin, too.
        is_smooth = np.all(np.isfinite(np.hstack([rise, bend])), axis=1)
        return ~(is_smooth & (rises | falls | is_bent))

    def _narrow(self, keep: Bools, times: int) -> None:
        """Leaves some bins, each as many times; they inherit the neighbors of their own."""
        for group, points in self._partners.items():
            kept_points = points[keep[group.bins(self._starts)[-1]]]
            self._partners[group] = np.repeat(kept_points, times, axis=0)
        kept = np.add.reduceat(keep, self._starts[:-1], dtype=np.int64)
        self._starts = np.concatenate([[0], np.cumsum(times * kept)])
        self._low, self._high = (np.repeat(ends[keep], times) for ends in (self._low, self._high))

    def _fill(self, bins: Bins) -> list[Floats]:
        """Returns a table of bounds for each formula, an axis for each variable."""
        slopes = {group: self._slopes(group, bins) for group in self._coupled}
        values = np.concatenate([np.empty(0), *slopes.values()])
        owners = [np.empty(0, dtype=np.int64), *(g.bins(bins.starts)[-1] for g in slopes)]
        ends, counts = np.column_stack([values, values]), np.diff(bins.starts)
        # The slopes that are moved to functions of one variable, for each bin.
        moved = sum_outward(ends, np.concatenate(owners), bins.low.size)
        tables: list[Floats] = [np.empty(0)] * len(self._variables)
        for group in self._groups:
            own = -np.repeat(slopes[group][:, None], 2, axis=1) if group in slopes else moved
            found = bound_tables(self._tape, group.formulas, group.variables, bins, own, group.rows)
            shapes = counts[group.variables]
            parts = np.split(found, np.cumsum(np.prod(shapes, axis=1))[:-1])
            for formula, table, shape in zip(group.formulas, parts, shapes, strict=True):
                tables[formula] = table.reshape(shape)
        return tables

    def _slopes(self, group: Group, bins: Bins) -> Floats:
        """Returns s: a formula's slope along a variable, at each bin and its neighbors (S,)."""
        of, local, own = group.bins(bins.starts)
        points, rows = (
            self._partners.get(group, self.best[group.variables[of]]),
            np.arange(own.size),
        )
        points[rows, local] = bins.points[own]
        found = enclose_all(self._tape, group.formulas[of], points, points, GRADIENT)
        slopes = np.mean(found[rows, 1 + local], axis=-1)
        return np.where(np.isfinite(slopes), slopes, 0.0)

    def _pass_up(self, tables: Sequence[Floats], bins: Bins) -> None:
        """Adds tables up along the elimination, and sets the total."""
        self.num_cells += sum(table.size for table in tables)
        counts, order = np.diff(bins.starts), self._order
        self._sums = [np.zeros(counts[list(clique)]) for clique in order]
        # No sum with a larger entry is as low as the best value.
        lowest = sum(abs(float(np.min(table))) for table in tables)
        most = min(_LARGE, 2.0 * (abs(self.least) + lowest))
        size = 0.0
        for table, variables, home in zip(tables, self._variables, self._home, strict=True):
            table[np.isfinite(table) & (table > most)] = most
            self._sums[home] = _sum(self._sums[home], _spread(table, variables, order[home]))
            size += float(np.max(np.abs(table[np.isfinite(table)]), initial=0.0))
        # Every addition is off by half a unit of what is never more than all tables' largest.
        self._margin = (len(tables) + 2 * len(order)) * UNIT * size
        self._messages: list[Floats] = []
        self._total = 0.0
        for sums, clique in zip(self._sums, order, strict=True):
            message = sums.min(axis=0)
            self._messages.append(message)
            if len(clique) > 1:
                parent = self._first(clique[1:])
                own = _spread(message, clique[1:], order[parent])
                self._sums[parent] = _sum(self._sums[parent], own)
            else:
                self._total = float(_sum(np.array(self._total), message))

    def _first(self, variables: Sequence[int]) -> int:
        """Returns the number of the clique with which the first of some variables is eliminated."""
        return min(map(self._rank.__getitem__, variables))

    def _pass_down(self, bins: Bins) -> Floats:
        """Fills min-marginals and the best neighbors, and returns the points of the best bins."""
        order = self._order
        marginals: list[Floats] = [np.empty(0)] * len(order)
        chosen = np.zeros(len(order), dtype=np.int64)
        for number in range(len(order) - 1, -1, -1):
            clique = order[number]
            if len(clique) == 1:
                outside = np.array(self._total - self._messages[number])
            else:
                parent = self._first(clique[1:])
                above = self._sums[parent]
                own = _spread(self._messages[number], clique[1:], order[parent])
                rest = np.where(np.isinf(above), np.inf, above - own)
                axes = [a for a, i in enumerate(order[parent]) if i not in clique[1:]]
                kept = [i for i in order[parent] if i in clique[1:]]
                outside = _spread(rest.min(axis=tuple(axes)), kept, clique[1:])
            sums = self._sums[number] = _sum(self._sums[number], outside)
            marginals[clique[0]] = sums.min(axis=tuple(range(1, sums.ndim)))
            at = tuple(chosen[list(clique[1:])])
            chosen[clique[0]] = np.argmin(sums[(slice(None), *at)])
        self._marginals = np.concatenate(marginals)
        for group in self._coupled:
            found = (points for k in group.formulas for points in self._best_points(k, bins))
            self._partners[group] = np.concatenate(list(found))
        return bins.points[bins.starts[:-1] + chosen]

    def _best_points(self, formula: int, bins: Bins) -> Iterator[Floats]:
        """Yields for each variable of a formula the points of its bins' best neighbors.

        All variables of the formula (·, m); values in the variable's own column do not matter.
        """
        variables, home = self._variables[formula], self._home[formula]
        clique, sums = self._order[home], self._sums[home]
        for i in variables:
            flat = np.moveaxis(sums, clique.index(i), 0)
            best = np.argmin(flat.reshape(len(flat), -1), axis=1)
            others = [j for j in clique if j != i]
            places = dict(zip(others, np.unravel_index(best, flat.shape[1:]), strict=True))
            yield np.column_stack(
                [bins.points[bins.starts[j] + places.get(j, 0 * best)] for j in variables]
            )

    def _close(self, keep: Bools, is_any: bool) -> None:
        """Raises the bound to the best value where all bins that are left prove to be convex."""
        if not math.isfinite(self.least):
            return
        if not is_any:
            self.lower_bound = self.least
            return
        low = np.minimum.reduceat(np.where(keep, self._low, np.inf), self._starts[:-1])
        high = np.maximum.reduceat(np.where(keep, self._high, -np.inf), self._starts[:-1])
        if np.all((low <= self.best) & (self.best <= high)):
            bound = min(self._box_bound(low, high), self.least)
            self.lower_bound = max(self.lower_bound, bound)

    def _box_bound(self, low: Floats, high: Floats) -> float:
        """Returns a bound over a box about the best point: tight if all f is convex there."""
        values, slopes, bends, owners, point = [], [], [], [], self.best
        for group in self._costs:
            read, formulas = group.variables, group.formulas
            about = enclose_all(self._tape, formulas, point[read], point[read], GRADIENT)
            over = enclose_all(self._tape, formulas, low[read], high[read], HESSIAN)
            values += list(about[:, 0])
            slopes.append(about[:, 1:].reshape(-1, 2))
            bends.append(curvatures(over, read.shape[1]).ravel())
            owners.append(read.ravel())
        whose, bend = np.concatenate(owners), np.concatenate(bends)
        with np.errstate(invalid="ignore"):
            total = sum_outward(np.array(values), np.zeros(len(values), dtype=np.int64), 1)[0, 0]
            slope = sum_outward(np.concatenate(slopes), whose, low.size)
            bend = sum_outward(np.column_stack([bend, bend]), whose, low.size)[:, 0]
        bound = separable_bound(total, slope, bend, point, (low, high))
        return bound if math.isfinite(bound) else -math.inf


def _sum(a: Floats, b: Floats) -> Floats:
    """Returns a + b; ∞ where either is, as there is no feasible point."""
    total = a + b
    return np.where(np.isnan(total), np.inf, total)


def _spread(table: Floats, variables: Sequence[int], clique: Sequence[int]) -> Floats:
    """Returns a table over some variables with an axis for each of a clique's."""
    kept = [i for i in clique if i in variables]
    moved = np.transpose(table, [list(variables).index(i) for i in kept])
    return moved[tuple(slice(None) if i in variables else None for i in clique)]
