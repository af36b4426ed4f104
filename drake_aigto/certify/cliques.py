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

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.certify.cells import BoundSearch
from drake_aigto.certify.contraction import bound_all, may_hold_minima
from drake_aigto.certify.enclosures import (
    GRADIENT,
    HESSIAN,
    SumOfFormulas,
    enclose_all,
    sum_outward,
)
from drake_aigto.certify.formulas import Formulas, formula_of
from drake_aigto.certify.intervals import UNIT
from drake_aigto.certify.tape import make_tape

MOST_VARIABLES = 3  # of a clique
_FIRST_BINS = 16
_SWEEPS = 2  # over all bins, before their cells are bounded
_ENTRIES = 40  # of tables, which take as long as a cell of all variables
_LARGE = 1e290  # Sums of what is larger would overflow.


@dataclass(frozen=True, eq=False)
class Group:
    """Formulas of as many variables."""

    formulas: Ints  # their numbers (G,)
    variables: Ints  # those that each reads (G, m)

    def bins(self, starts: Ints) -> tuple[Ints, Ints, Ints]:
        """Returns all S bins of each variable of each formula, in the order formula, variable, bin.

        Their formulas, which of the formula's variables each is of, and the bins, all (S,).
        """
        read = self.variables.ravel()
        counts = np.diff(starts)[read]
        owners = np.repeat(np.arange(read.size), counts)
        own = np.arange(owners.size) - np.repeat(np.cumsum(counts) - counts, counts)
        return *np.divmod(owners, self.variables.shape[1]), starts[read][owners] + own


class CliqueSearch(BoundSearch):
    """Dynamic programming over ever smaller bins.

    The program has no rows, and its summands read up to three variables each. The order has every
    variable, as it is eliminated, with its neighbors then.

    Attributes:
        lower_bound: of f; at most the best value.
        is_empty: whether f has no value anywhere in the box.
    """

    def __init__(self, formulas: Formulas, margin: float, order: Sequence[tuple[int, ...]]) -> None:
        """Cuts every range into bins."""
        cost = self._make_groups(formulas)
        super().__init__(cost, np.array(0.5 * formulas.lower + 0.5 * formulas.upper), margin)
        self._order = order
        self._rank = {clique[0]: number for number, clique in enumerate(order)}
        self._outer = lower, upper = formulas.lower, formulas.upper
        self._home = [self._first(each) for each in self._variables]
        edges = np.linspace(lower, upper, _FIRST_BINS + 1, axis=-1)
        edges[:, 0], edges[:, -1] = lower, upper
        self._starts = _FIRST_BINS * np.arange(lower.size + 1)
        self._low, self._high = edges[:, :-1].ravel(), edges[:, 1:].ravel()
        self._points = 0.5 * self._low + 0.5 * self._high  # c
        # Of each group's bins, where its formula's variables are best, as far as is known.
        self._partners: dict[Group, Floats] = {}
        # Of bins that were bounded, the least sum with each, until they are halved.
        self._marginals: Floats | None = None
        self.lower_bound, self._lowest = -np.inf, np.inf  # of f, feasible or not
        self.is_empty = False
        self._drop_by_slopes()

    def _make_groups(self, formulas: Formulas) -> SumOfFormulas:
        """Makes a formula for every set of variables, those of one variable first; returns f."""
        summands = formulas.groups()
        summands[(0,)] = summands.get((0,), []) + summands.pop((), [])
        self._variables: list[tuple[int, ...]] = [(i,) for i in range(formulas.lower.size)]
        self._variables += [variables for variables in summands if len(variables) > 1]
        read = self._variables
        self._tape = make_tape(formula_of(summands.get(each, []), each) for each in read)
        found: dict[int, list[int]] = {}
        for formula, variables in enumerate(read):
            found.setdefault(len(variables), []).append(formula)
        self._groups = [
            Group(np.array(numbers), np.array([read[k] for k in numbers]))
            for numbers in found.values()
        ]
        self._coupled = [group for group in self._groups if group.variables.shape[1] > 1]
        return SumOfFormulas(self._tape, read)

    @property
    def hull(self) -> Floats:
        """Lower and upper ends (2, n) of the smallest box that holds all bins that are left."""
        return np.array([self._low[self._starts[:-1]], self._high[self._starts[1:] - 1]])

    def run(self, count: int, scale: float) -> bool:
        """Bounds the cells of all bins, once those with nothing better are gone, others halved."""
        if self._marginals is not None:
            self._drop(self._marginals)
            self._marginals = None
        counts = np.diff(self._starts).tolist()
        size = sum(math.prod(counts[i] for i in each) for each in self._variables)
        enough = self.enough(min(self.least, self._lowest), scale)
        if self.is_empty or self.lower_bound >= enough or size > count * _ENTRIES:
            return False
        self.num_cells += 1 + size // _ENTRIES
        best = np.repeat(self.best, np.diff(self._starts))
        points = 0.5 * self._low + 0.5 * self._high
        self._points = np.where((self._low <= best) & (best <= self._high), best, points)
        self._pass_up(self._fill())
        if math.isfinite(self._total):
            bound = self._total - self._rounding
            self.lower_bound = max(self.lower_bound, min(bound, self.least))
            self.lowest_point = self._pass_down()
            self._lowest = min(self._lowest, self.value(self.lowest_point))
            return True
        # Nothing is known of any bin where a cell has no bound.
        self._marginals = np.full(self._low.size, self._total)
        self.is_empty = self._total == np.inf
        return True

    def _drop(self, marginals: Floats) -> None:
        """Drops the bins that hold nothing below the best value, and halves the others."""
        keep = marginals - self._rounding <= self.least
        is_any = np.logical_or.reduceat(keep, self._starts[:-1])
        counts = np.diff(self._starts)
        lowest = np.repeat(np.minimum.reduceat(marginals, self._starts[:-1]), counts)
        keep |= ~np.repeat(is_any, counts) & (marginals == lowest)
        self._narrow(keep, 2)
        middle = 0.5 * self._low + 0.5 * self._high
        self._low[1::2], self._high[::2] = middle[1::2], middle[::2]
        self._drop_by_slopes()

    def _drop_by_slopes(self) -> None:
        """Drops bins where f has no minimum along their own variable, for any values of others.

        It rises or falls all over the bin, which is none of the ends; or it is concave. That holds
        however many other variables there are, and however far from the best value the bound is.
        """
        for _ in range(_SWEEPS):
            keep = self._may_hold_minima()
            if np.all(keep):
                return
            is_any = np.logical_or.reduceat(keep, self._starts[:-1])
            self._narrow(keep | ~np.repeat(is_any, np.diff(self._starts)), 1)

    def _may_hold_minima(self) -> Bools:
        """Returns for each bin whether f may have a minimum in it along its own variable (K,)."""
        slopes, bends, owners = [], [], []
        for group in self._groups:
            of, local, own = group.bins(self._starts)
            ends, at = np.take(self.hull, group.variables[of], axis=1), np.arange(own.size)
            ends[0, at, local], ends[1, at, local] = self._low[own], self._high[own]
            over = enclose_all(self._tape, group.formulas[of], ends[0], ends[1], HESSIAN)
            slopes.append(over[at, 1 + local])
            bends.append(over[at, 1 + ends.shape[2] + local * (local + 1) // 2 + local])
            owners.append(own)
        whose, count = np.concatenate(owners), self._low.size
        rise = sum_outward(np.concatenate(slopes), whose, count)
        bend = sum_outward(np.concatenate(bends), whose, count)
        outer = np.repeat(np.array(self._outer), np.diff(self._starts), axis=1)
        return may_hold_minima(rise, bend, np.array([self._low, self._high]), outer)

    def _narrow(self, keep: Bools, times: int) -> None:
        """Leaves some bins, each as many times; they inherit the neighbors of their own."""
        for group, points in self._partners.items():
            kept_points = points[keep[group.bins(self._starts)[-1]]]
            self._partners[group] = np.repeat(kept_points, times, axis=0)
        kept = np.add.reduceat(keep, self._starts[:-1], dtype=np.int64)
        self._starts = np.concatenate([[0], np.cumsum(times * kept)])
        self._low, self._high = (np.repeat(ends[keep], times) for ends in (self._low, self._high))

    def _fill(self) -> list[Floats]:
        """Returns a table of bounds for each formula, an axis for each variable."""
        slopes = {group: self._slopes(group) for group in self._coupled}
        values = np.concatenate([np.empty(0), *slopes.values()])
        owners = [np.empty(0, dtype=np.int64), *(g.bins(self._starts)[-1] for g in slopes)]
        ends, counts = np.column_stack([values, values]), np.diff(self._starts)
        # The slopes that are moved to functions of one variable, for each bin.
        moved = sum_outward(ends, np.concatenate(owners), self._low.size)
        tables: list[Floats] = [np.empty(0)] * len(self._variables)
        for group in self._groups:
            own = group.bins(self._starts)[-1]
            low, high = moved.T if group not in slopes else (-slopes[group], -slopes[group])
            sides = np.array([self._low[own], self._high[own], self._points[own], low, high])
            first = 0
            for formula, shape in zip(group.formulas, counts[group.variables], strict=True):
                starts = first + np.cumsum(shape) - shape
                cells = starts + np.moveaxis(np.indices(shape), 0, -1).reshape(-1, shape.size)
                # In this order, for which searches over cells have compiled it, too.
                cells = np.ascontiguousarray(cells)
                found = bound_all(self._tape, formula, sides, cells)
                tables[formula], first = found.reshape(shape), first + np.sum(shape)
        return tables

    def _slopes(self, group: Group) -> Floats:
        """Returns s: a formula's slope along a variable, at each bin and its neighbors (S,)."""
        of, local, own = group.bins(self._starts)
        points, rows = (
            self._partners.get(group, self.best[group.variables[of]]),
            np.arange(own.size),
        )
        points[rows, local] = self._points[own]
        found = enclose_all(self._tape, group.formulas[of], points, points, GRADIENT)
        slopes = np.mean(found[rows, 1 + local], axis=-1)
        return np.where(np.isfinite(slopes), slopes, 0.0)

    def _pass_up(self, tables: Sequence[Floats]) -> None:
        """Adds tables up along the elimination, and sets the total."""
        counts, order = np.diff(self._starts), self._order
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
        self._rounding = (len(tables) + 2 * len(order)) * UNIT * size
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

    def _pass_down(self) -> Floats:
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
            found = (points for k in group.formulas for points in self._best_points(k))
            self._partners[group] = np.concatenate(list(found))
        return self._points[self._starts[:-1] + chosen]

    def _best_points(self, formula: int) -> Iterator[Floats]:
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
                [self._points[self._starts[j] + places.get(j, 0 * best)] for j in variables]
            )


def _sum(a: Floats, b: Floats) -> Floats:
    """Returns a + b; ∞ where either is, as there is no feasible point."""
    total = a + b
    return np.where(np.isnan(total), np.inf, total)


def _spread(table: Floats, variables: Sequence[int], clique: Sequence[int]) -> Floats:
    """Returns a table over some variables with an axis for each of a clique's."""
    kept = [i for i in clique if i in variables]
    moved = np.transpose(table, [list(variables).index(i) for i in kept])
    return moved[tuple(slice(None) if i in variables else None for i in clique)]
