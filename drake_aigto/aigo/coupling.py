"""Coupling of variables: clusters of those that share a term, and the best mix of several points.

Mixes are found by dynamic programming over variables, some of which are held.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from scipy.sparse import coo_array

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.box import NO_SYSTEM, BoxPolynomial, Order, add_means, make_lanes
from drake_aigto.kernels import kernel
from drake_aigto.linear import eliminate
from drake_aigto.terms import TermBlock, copy_weights, stack_terms, with_own_numbers

_MOST_READ = 4  # variables of a term
_MOST_ENTRIES = 4096  # of a table
_MOST_COPIES = 200_000  # of terms, at all their variables' values
_USES = 4  # mixes that share a plan, as finding one takes as long as a mix

_known: WeakKeyDictionary[BoxPolynomial, CouplingGraph] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class CouplingGraph:
    """The variables, and an edge between any two that appear in one term.

    Attributes:
        starts: the neighbors of variable i are neighbors[starts[i]:starts[i + 1]], shape (n + 1,).
        neighbors: shape (2 · number of edges,).
    """

    starts: Ints
    neighbors: Ints

    @classmethod
    def of(cls, f: BoxPolynomial) -> CouplingGraph:
        """Returns the graph of a cost, kept for as long as the cost."""
        if f not in _known:
            _known[f] = cls._build(f)
        return _known[f]

    @classmethod
    def _build(cls, f: BoxPolynomial) -> CouplingGraph:
        rows, columns = f.couplings().T
        apart = rows != columns
        shape = (f.num_variables, f.num_variables)
        edges = (np.ones(np.count_nonzero(apart)), (rows[apart], columns[apart]))
        graph = coo_array(edges, shape=shape).tocsr()
        return cls(graph.indptr.astype(np.int64), graph.indices.astype(np.int64))

    def components(self, free: Bools) -> Ints:
        """Labels the variables that are coupled once the others are held: −1 where held."""
        seeds = np.flatnonzero(free)
        return _pack(self.starts, self.neighbors, seeds, np.zeros(free.size), free.size)

    def clusters(self, size: int, free: Bools, rng: np.random.Generator) -> Ints:
        """Packs random connected clusters of at most `size` variables, none beside another.

        Returns:
            The cluster of each variable, shape (n,); −1 for those that are not free, or keep two
            clusters apart.
        """
        seeds = rng.permutation(np.flatnonzero(free))
        return _pack(self.starts, self.neighbors, seeds, rng.random(free.size), size)


@kernel
def _pack(starts: Ints, neighbors: Ints, seeds: Ints, picks: Floats, size: int) -> Ints:
    """Grows one cluster from each seed that is still open, by open neighbors picked at random."""
    held, is_open = -1, -2
    n = starts.size - 1
    labels = np.full(n, held)
    labels[seeds] = is_open
    border = np.empty(n, dtype=np.int64)
    cluster = 0
    for seed in seeds:
        if labels[seed] != is_open:
            continue
        border[0] = seed
        length, taken = 1, 0
        labels[seed] = held
        while length > 0 and taken < size:
            k = int(picks[(seed + taken) % n] * length)
            i = border[k]
            length -= 1
            border[k] = border[length]
            labels[i] = cluster
            taken += 1
            for j in neighbors[starts[i] : starts[i + 1]]:
                if labels[j] == is_open:
                    labels[j] = held  # unless it is taken later: then by this cluster
                    border[length] = j
                    length += 1
        cluster += 1
    return labels


class _Scope(NamedTuple):
    """Variables that a summand reads, and where its values for all of theirs are."""

    variables: tuple[int, ...]
    values: slice


class _FusedProduct(NamedTuple):
    """A summand of a step: a table's number, and how its axes become those of the step."""

    table: int
    axes: tuple[int, ...]
    kept: tuple[Any, ...]


class _Step(NamedTuple):
    """A variable, those that its elimination depends on, and their tables."""

    variable: int
    given: tuple[int, ...]
    parts: tuple[_FusedProduct, ...]


class Fusion:
    """Mixes K points x¹ … x^K: each variable takes its value in one of them.

        minimize over k ∈ {1 … K}ⁿ   f(x₁^{k₁}, …, x_n^{k_n})

    Variables are eliminated one by one, those of few neighbors first. Where that would make a table
    of more than 4096 entries, a variable of most neighbors is held at its value in the first point
    instead: a cut set, conditioned on, opens the loops (Dechter 1990, "Enhancement schemes for
    constraint processing", Artif. Intell. 41:273-312). Given the variables that are held, the mix
    is the best of all, and no worse than the first point. Fusing proposals that way is known from
    images (Lempitsky, Rother, Roth & Blake 2010, "Fusion moves for Markov random field
    optimization", IEEE TPAMI 32:1392-1405).
    """

    def __init__(self, f: BoxPolynomial, num_points: int) -> None:
        """Makes one copy of every term for each combination of its variables' values."""
        self._num_points, self._num_variables = num_points, f.num_variables
        blocks = list(_split(f))
        scopes = [tuple(row) for block in blocks for row in block.variables.tolist()]
        sizes = [num_points ** len(scope) for scope in scopes]
        lasts = itertools.accumulate(sizes)
        self._scopes = [
            _Scope(scope, slice(last - size, last))
            for scope, size, last in zip(scopes, sizes, lasts, strict=True)
        ]
        self._steps: tuple[_Step, ...] = ()
        self._planned = np.zeros(0, dtype=bool)
        self._num_mixes = 0
        spread = [_spread(block, num_points, f.num_variables) for block in blocks]
        self._lanes = make_lanes(stack_terms(spread), Order.MEAN)
        self._weights = copy_weights(spread)
        self._width = int(np.log(_MOST_ENTRIES) / np.log(num_points) + 1e-9) - 1

    @staticmethod
    def of(f: BoxPolynomial, num_points: int) -> Fusion | None:
        """Returns the mixer of a number of points; None if terms read too many variables for it."""
        reads = [
            (len({factor.variable for factor in term.factors}), len(block.variables))
            for block in f.blocks
            for term in block.terms
        ]
        if max((read for read, _ in reads), default=0) > _MOST_READ:
            return None
        if sum(copies * num_points**read for read, copies in reads) > _MOST_COPIES:
            return None
        return Fusion(f, num_points)

    def mix(self, points: Sequence[Floats], free: Bools, rng: np.random.Generator) -> Floats:
        """Returns the best mix of K points (n,), some variables being those of the first one.

        Args:
            points: K of them.
            free: which variables may differ from the first point, shape (n,).
            rng: decides between variables of as many neighbors.
        """
        if self._num_mixes % _USES == 0 or not np.array_equal(free, self._planned):
            self._steps, self._planned = self._arrange(self._plan(free, rng)), free.copy()
        self._num_mixes += 1
        tables = self._tables(np.concatenate(points))
        choices, taken = [], np.zeros(self._num_variables, dtype=np.int64)
        for step in self._steps:
            total = np.zeros((self._num_points,) * (len(step.given) + 1))
            for part in step.parts:
                total = total + tables[part.table].transpose(part.axes)[part.kept]
            choices.append(np.argmin(total, axis=0))
            tables.append(np.min(total, axis=0))
        for step, choice in zip(reversed(self._steps), reversed(choices), strict=True):
            taken[step.variable] = choice[tuple(taken[list(step.given)])]
        return np.asarray(points)[taken, np.arange(taken.size)]

    def _tables(self, points: Floats) -> list[Floats]:
        """Returns the values of all summands, an axis for each variable."""
        values = np.empty_like(self._weights)
        add_means(self._lanes, self._weights, points, np.zeros_like(points), values, NO_SYSTEM)
        count = self._num_points
        return [
            values[each.values].reshape((count,) * len(each.variables)) for each in self._scopes
        ]

    def _arrange(self, order: Sequence[tuple[int, tuple[int, ...]]]) -> tuple[_Step, ...]:
        """Returns the steps of an elimination; each ends in a table over what it depends on."""
        place = {variable: number for number, (variable, _) in enumerate(order)}
        reading: dict[int, list[tuple[int, tuple[int, ...]]]] = {variable: [] for variable in place}
        every = [each.variables for each in self._scopes] + [given for _, given in order]
        for number, variables in enumerate(every):
            if free := [i for i in variables if i in place]:
                reading[min(free, key=place.__getitem__)].append((number, variables))
        return tuple(
            _Step(i, given, tuple(_part(number, read, (i, *given)) for number, read in reading[i]))
            for i, given in order
        )

    def _plan(self, free: Bools, rng: np.random.Generator) -> list[tuple[int, tuple[int, ...]]]:
        """Returns the variables in the order of their elimination, with their neighbors then."""
        scopes = {each.variables for each in self._scopes}
        luck = rng.random(free.size)
        found = eliminate(scopes, np.flatnonzero(free).tolist(), self._width, luck.tolist())
        order = [(i, others) for i, others, is_held in found if not is_held]
        kept = {i for i, _ in order}  # Some neighbors were held later.
        return [(i, tuple(sorted(others & kept))) for i, others in order]


def _split(f: BoxPolynomial) -> Iterator[TermBlock]:
    """Yields blocks of terms that read the same variables, all of them."""
    for block in f.blocks:
        by_scope: dict[tuple[int, ...], list[int]] = {}
        for number, term in enumerate(block.terms):
            scope = tuple(sorted({factor.variable for factor in term.factors}))
            by_scope.setdefault(scope, []).append(number)
        for scope, numbers in by_scope.items():
            if scope:
                terms, _ = with_own_numbers([block.terms[number] for number in numbers])
                variables = block.variables[:, list(scope)]
                yield TermBlock(f"{block.name} of {scope}", terms, variables, block.weight)


def _spread(block: TermBlock, num_points: int, num_variables: int) -> TermBlock:
    """Returns a block with copies for all combinations of values, the k-th ones after k·n."""
    combinations = list(itertools.product(range(num_points), repeat=block.variables.shape[1]))
    shift = num_variables * np.array(combinations)
    variables = (block.variables[:, None, :] + shift).reshape(-1, block.variables.shape[1])
    return TermBlock(block.name, block.terms, variables, block.weight)


def _part(table: int, read: tuple[int, ...], variables: tuple[int, ...]) -> _FusedProduct:
    """Returns how a table over `read` is one over `variables`; others have their first value."""
    others = [k for k, i in enumerate(read) if i not in variables]
    axes = sorted(set(range(len(read))) - set(others), key=lambda k: variables.index(read[k]))
    index = [slice(None) if i in read else None for i in variables]
    return _FusedProduct(table, (*others, *axes), (*[0] * len(others), *index))
