"""Coupling of variables: those that share a term, and sets of variables that do not."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from scipy.sparse import coo_array

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.box import BoxPolynomial
from drake_aigto.kernels import kernel

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
