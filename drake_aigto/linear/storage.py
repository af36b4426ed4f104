"""Order, storage and factorization of a problem's Newton systems, by predicted work."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from drake_aigto.arrays import Ints, locked
from drake_aigto.errors import OptionsError
from drake_aigto.linear.sparse import Pattern, count_fill, make_pattern, minimum_degree

# Microseconds of factorizations, measured on one core, from which others are predicted.
_BAND_UNIT = 1.4e-4  # times Σ min(b, size − j)²
_DENSE_UNIT = 2e-5  # times size³: LAPACK's blocks are quicker per entry
_SPARSE_UNIT = 0.12  # times entries of L
_SPARSE_CALL = 300.0  # for calling SuperLU at all
# The sparse one is taken where it is predicted to be this many times as quick as the best other.
_HYSTERESIS = 2.0
# Small systems are dense where they may be: LAPACK takes some 40 µs for them however wide the band,
# and spares a plan, whose polish has ten to sixty unknowns, the seconds for compiling the other.
_SMALL = 100
_MOST_DENSITY = 0.25  # of the matrix, beyond which no order that keeps L sparse is tried


class Factorization(enum.Enum):
    """Storage and factorization of a symmetric matrix."""

    BAND = "banded LDLᵀ"
    DENSE = "dense LDLᵀ (LAPACK)"
    SPARSE = "sparse LDLᵀ (SuperLU)"


@dataclass(frozen=True, eq=False)
class Storage:
    """Storage of all matrices of one sparsity, and the reasons for it.

    Attributes:
        factorization: The choice.
        size: Number of unknowns.
        bandwidth: Half bandwidth b of the narrowest band that was found.
        fill: Entries of a sparse L below the diagonal; None where bands were so cheap that no order
            was tried.
        places: Place of each group of unknowns in the order that was chosen (num_groups,).
        pattern: Of a matrix with one unknown in each group, in that order, if it is to be sparse.
    """

    factorization: Factorization
    size: int
    bandwidth: int
    fill: int | None
    places: Ints = field(repr=False)
    pattern: Pattern | None = field(repr=False)

    @property
    def is_large(self) -> bool:
        """Whether systems are so large that it matters how they are solved."""
        return self.size > _SMALL

    def __str__(self) -> str:
        """Returns the choice and its reasons in a line."""
        text = f"{self.factorization.value}, {self.size:,} unknowns, half bandwidth "
        text += f"{self.bandwidth:,}"
        return text if self.fill is None else f"{text}, sparse L of {self.fill:,} entries"


def choose_storage(
    num_groups: int,
    edges: Ints,
    orders: Sequence[Ints],
    group_size: int = 1,
    may_be_dense: bool = False,
) -> Storage:
    """Chooses an order of the unknowns and, by predicted work, a storage of their matrices.

    A band takes O(size · b²), a dense matrix O(size³), a sparse one as many operations as its
    order's L asks for. Bands are preferred: the others have to be several times as quick.

    Args:
        num_groups: Number of groups of unknowns that stay next to each other.
        edges: Pairs of groups that meet in the matrix (2, P).
        orders: Places of the groups (num_groups,) in one or more orders that bands are tried in;
            the first of the narrowest is taken.
        group_size: Unknowns in each group.
        may_be_dense: Whether there is a dense factorization.
    """
    size = group_size * num_groups
    places = min(orders, key=lambda order: _bandwidth(order, edges))
    bandwidth = group_size * (_bandwidth(places, edges) + 1) - 1
    best, cost = Factorization.BAND, _BAND_UNIT * (size - 2 / 3 * bandwidth) * bandwidth**2.0
    dense = _DENSE_UNIT * float(size) ** 3
    if may_be_dense and (size <= _SMALL or dense < cost):
        best, cost = Factorization.DENSE, dense
    storage = Storage(best, size, bandwidth, None, places, None)
    if size <= _SMALL or cost <= _HYSTERESIS * _SPARSE_CALL:
        return storage
    if np.unique(edges[0] * num_groups + edges[1]).size > _MOST_DENSITY * num_groups**2:
        return storage
    return _try_sparse(storage, cost, make_pattern(num_groups, edges), group_size)


def _try_sparse(storage: Storage, cost: float, groups: Pattern, group_size: int) -> Storage:
    """Returns a sparse storage if that pays, else the given one of a cost, with its fill."""
    places = minimum_degree(groups)
    pattern = make_pattern(groups.size, places[np.vstack([groups.rows, groups.columns])])
    within = storage.size * (group_size - 1) // 2
    fill = group_size**2 * count_fill(pattern) + within
    if _HYSTERESIS * (_SPARSE_CALL + _SPARSE_UNIT * fill) >= cost:
        return replace(storage, fill=fill)
    best = Factorization.SPARSE
    return replace(storage, factorization=best, fill=fill, places=places, pattern=pattern)


def spread(pattern: Pattern, group_size: int) -> Pattern:
    """Returns the pattern where each unknown is replaced by a group of them, side by side."""
    entries = group_size * np.vstack([pattern.rows, pattern.columns])
    within = np.indices((group_size, group_size)).reshape(2, -1)
    pairs = entries[:, :, np.newaxis] + within[:, np.newaxis]
    return make_pattern(group_size * pattern.size, pairs.reshape(2, -1))


def narrow_band(num_unknowns: int, edges: Ints) -> Ints:
    """Returns the places of unknowns in an order of narrow band: reverse Cuthill-McKee."""
    shape = num_unknowns, num_unknowns
    graph = coo_array((np.ones(edges.shape[1]), tuple(edges)), shape=shape)
    order = reverse_cuthill_mckee((graph + graph.T).tocsr(), symmetric_mode=True)
    return np.argsort(order)


def _bandwidth(places: Ints, edges: Ints) -> int:
    return int(np.max(np.abs(places[edges[0]] - places[edges[1]]), initial=0))


def as_order(order: ArrayLike, num_variables: int) -> Ints:
    """Returns an elimination order as a read-only array (n,).

    Raises:
        OptionsError: It is no permutation of the variables.
    """
    places = locked(np.array(order, dtype=np.int64))
    if not np.array_equal(np.sort(places), np.arange(num_variables)):
        raise OptionsError(
            "the elimination order",
            got=f"{places.size} entries {np.array2string(places, threshold=8)}",
            expected=f"each of 0 … {num_variables - 1} once",
        )
    return places
