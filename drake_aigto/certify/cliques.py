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

import numpy as np

from drake_aigto.arrays import Bools, Floats
from drake_aigto.certify.clique_cells import (
    MOST_VARIABLES,
    Bins,
    Group,
    bound_box,
    bound_cells,
    may_hold_minima,
    moved_slopes,
    slopes_of,
)
from drake_aigto.certify.enclosures import SumOfFormulas
from drake_aigto.certify.formulas import Formulas, formula_of, make_tape
from drake_aigto.certify.intervals import UNIT

_FIRST_BINS = 16
_SWEEPS = 2  # over all bins, before their cells are bounded


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
        self._groups = [
            Group(
                np.array(numbers),
                np.array([self._variables[k] for k in numbers]),
                bounds[:, np.array(numbers) - len(costs)] if is_row else None,
            )
            for (_, is_row), numbers in found.items()
        ]
        self._costs = [group for group in self._groups if group.rows is None]
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
        bins = self._bins()
        self._pass_up(self._fill(bins), bins)
        if not math.isfinite(self._total):
            self.is_empty = self._total == np.inf
            self.lower_bound = min(self.least, self._total)
            return self.best
        bound = self._total - self._margin
        self.lower_bound = max(self.lower_bound, min(bound, self.least))
        return self._pass_down(bins)

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
            keep = may_hold_minima(self._tape, self._costs, self._bins(), *self._outer)
            if np.all(keep):
                return
            is_any = np.logical_or.reduceat(keep, self._starts[:-1])
            self._narrow(keep | ~np.repeat(is_any, np.diff(self._starts)), 1)

    def _narrow(self, keep: Bools, times: int) -> None:
        """Leaves some bins, each as many times; they inherit the neighbors of their own."""
        bins = self._bins()
        for group, points in self._partners.items():
            self._partners[group] = np.repeat(points[keep[group.bins(bins)[-1]]], times, axis=0)
        kept = np.add.reduceat(keep, self._starts[:-1], dtype=np.int64)
        self._starts = np.concatenate([[0], np.cumsum(times * kept)])
        self._low, self._high = (np.repeat(ends[keep], times) for ends in (self._low, self._high))

    def _bins(self) -> Bins:
        best = np.repeat(self.best, np.diff(self._starts))
        points = 0.5 * self._low + 0.5 * self._high
        points = np.where((self._low <= best) & (best <= self._high), best, points)
        return Bins(self._starts, self._low, self._high, points)

    def _fill(self, bins: Bins) -> list[Floats]:
        """Returns a table of bounds for each formula, an axis for each variable."""
        slopes = {
            group: slopes_of(self._tape, group, bins, self._slope_points(group, bins))
            for group in self._coupled
        }
        moved = moved_slopes(slopes, bins)
        tables: list[Floats] = [np.empty(0)] * len(self._variables)
        for group in self._groups:
            found = bound_cells(self._tape, group, bins, slopes.get(group), moved)
            for formula, table in zip(group.formulas.tolist(), found, strict=True):
                tables[formula] = table
        return tables

    def _slope_points(self, group: Group, bins: Bins) -> Floats:
        """Returns where each slope is taken: of each bin, all variables of the formula (S, m)."""
        of, local, own = group.bins(bins)
        points = self._partners.get(group, self.best[group.variables[of]])
        points[np.arange(own.size), local] = bins.points[own]
        return points

    def _pass_up(self, tables: Sequence[Floats], bins: Bins) -> None:
        """Adds tables up along the elimination, and sets the total."""
        self.num_cells += sum(table.size for table in tables)
        counts, order = bins.counts, self._order
        self._sums = [np.zeros(counts[list(clique)]) for clique in order]
        size = 0.0
        for table, variables, home in zip(tables, self._variables, self._home, strict=True):
            self._sums[home] += _spread(table, variables, order[home])
            finite = np.abs(table[np.isfinite(table)])
            size += float(np.max(finite, initial=0.0))
        # Every addition is off by half a unit of what is never more than all tables' largest.
        self._margin = (len(tables) + 2 * len(order)) * UNIT * size
        self._messages: list[Floats] = []
        self._total = 0.0
        for sums, clique in zip(self._sums, order, strict=True):
            message = sums.min(axis=0)
            self._messages.append(message)
            if len(clique) > 1:
                parent = self._first(clique[1:])
                self._sums[parent] += _spread(message, clique[1:], order[parent])
            else:
                self._total += float(message)

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
                outside = self._total - self._messages[number]
            else:
                parent = self._first(clique[1:])
                above = self._sums[parent]
                own = _spread(self._messages[number], clique[1:], order[parent])
                with np.errstate(invalid="ignore"):
                    rest = np.where(np.isinf(above), np.inf, above - own)
                axes = [a for a, i in enumerate(order[parent]) if i not in clique[1:]]
                kept = [i for i in order[parent] if i in clique[1:]]
                outside = _spread(rest.min(axis=tuple(axes)), kept, clique[1:])
            sums = self._sums[number] = self._sums[number] + outside
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
        if np.any(self.best < low) or np.any(self.best > high):
            return
        bound = bound_box(self._tape, self._costs, low, high, self.best)
        self.lower_bound = max(self.lower_bound, min(bound, self.least))


def _spread(table: Floats, variables: Sequence[int], clique: Sequence[int]) -> Floats:
    """Returns a table over some variables with an axis for each of a clique's."""
    kept = [i for i in clique if i in variables]
    moved = np.transpose(table, [list(variables).index(i) for i in kept])
    return moved[tuple(slice(None) if i in variables else None for i in clique)]
