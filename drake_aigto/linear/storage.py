"""Order, storage and factorization of a problem's Newton systems, by predicted work.

SuperLU in its symmetric mode takes every pivot from the diagonal unless it is exactly 0. Then its
U = D Lᵀ, and the signs of D give the inertia. Matrices that are definite, or quasidefinite
(Vanderbei 1995, "Symmetric quasidefinite matrices", SIAM J. Optim. 5:100-113), have such factors in
any order of the unknowns; of another, small pivots may spoil them, which residuals show.
"""

from __future__ import annotations

import enum
import heapq
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array, csc_matrix
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import splu

from drake_aigto.arrays import Floats, Ints, locked
from drake_aigto.errors import OptionsError
from drake_aigto.kernels import kernel

# Unknowns coupled to more than this times √size others are eliminated last: an order that looks at
# them again after each of their neighbors takes a time that grows with the square of the size
# (Amestoy, Davis & Duff 1996, "An approximate minimum degree ordering algorithm", SIAM J. Matrix
# Anal. Appl. 17:886-905, sec. 5).
_DENSE = 10.0


class Pattern(NamedTuple):
    """The lower triangle of a symmetric matrix by columns, behind its diagonal.

    Shape letters: size unknowns, E entries stored. A matrix of the pattern is an array (E,): first
    its diagonal, so that entry k is (k, k) as in the first row of a band, then the entries below.

    Attributes:
        rows: Row of each entry, ascending within a column (E,).
        columns: Its column (E,).
        starts: Entries below the diagonal in column j are starts[j]:starts[j + 1] (size + 1,).
        beside: Entries off the diagonal in the row or the column of unknown 0, of unknown 1, …
            (2 (E − size),).
        beside_starts: Those of unknown k are beside_starts[k]:beside_starts[k + 1] (size + 1,).
        whole: Entries of the matrix with both triangles, by columns (2 E − size,).
        whole_rows: The rows of these.
        whole_starts: Where the columns start among these (size + 1,).
    """

    rows: Ints
    columns: Ints
    starts: Ints
    beside: Ints
    beside_starts: Ints
    whole: Ints
    whole_rows: NDArray[np.int32]
    whole_starts: NDArray[np.int32]

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.starts.size - 1


def make_pattern(size: int, edges: Ints) -> Pattern:
    """Returns the pattern with a full diagonal and an entry for each pair in edges (2, P)."""
    low, high = np.minimum(*edges), np.maximum(*edges)
    below_columns, below_rows = np.divmod(np.unique((low * size + high)[low != high]), size)
    diagonal = np.arange(size)
    rows = np.concatenate([diagonal, below_rows])
    columns = np.concatenate([diagonal, below_columns])
    below = np.arange(size, rows.size)
    in_whole, whole_rows, whole_starts = _by_columns(
        size, np.concatenate([rows, below_columns]), np.concatenate([columns, below_rows])
    )
    entries = np.concatenate([diagonal, below, below])
    in_both, _, beside_starts = _by_columns(
        size, np.concatenate([below, below]), np.concatenate([below_columns, below_rows])
    )
    return Pattern(
        rows,
        columns,
        size + np.searchsorted(below_columns, np.arange(size + 1)),
        np.concatenate([below, below])[in_both],
        beside_starts,
        entries[in_whole],
        whole_rows.astype(np.int32),
        whole_starts.astype(np.int32),
    )


def _by_columns(size: int, rows: Ints, columns: Ints) -> tuple[Ints, Ints, Ints]:
    """Returns an order of entries by columns and rows, their rows, and where columns start."""
    order = np.lexsort((rows, columns))
    return order, rows[order], np.searchsorted(columns[order], np.arange(size + 1))


@kernel
def find_entry(pattern: Pattern, i: int, j: int) -> int:
    """Returns the place of entry (i, j) of a matrix, which the pattern has to have."""
    column, row = min(i, j), max(i, j)
    if column == row:
        return column
    low, high = pattern.starts[column], pattern.starts[column + 1] - 1
    while low < high:
        middle = (low + high) // 2
        if pattern.rows[middle] < row:
            low = middle + 1
        else:
            high = middle
    return low


def multiply(pattern: Pattern, values: Floats, x: Floats) -> Floats:
    """Returns the product of a matrix (E,) with a vector (size,)."""
    size = pattern.size
    rows, columns, below = pattern.rows[size:], pattern.columns[size:], values[size:]
    return (
        values[:size] * x
        + np.bincount(rows, below * x[columns], minlength=size)
        + np.bincount(columns, below * x[rows], minlength=size)
    )


@dataclass(frozen=True, eq=False)
class SparseFactors:
    """L D Lᵀ of one matrix.

    Attributes:
        num_negative: Number of negative entries of D, which is that of negative eigenvalues.
        num_entries: Number of entries of L below its diagonal.
    """

    num_negative: int
    num_entries: int
    _factors: Any

    def solve(self, right: Floats) -> Floats:
        """Returns the solution for a right-hand side (size,), without refinement."""
        return self._factors.solve(right)


def factorize(pattern: Pattern, values: Floats) -> SparseFactors | None:
    """Returns the factors of a matrix (E,), unknowns in the pattern's order; None if a pivot is 0.

    So are those of a matrix that is not finite.
    """
    if not np.isfinite(values).all():
        return None
    whole = values[pattern.whole], pattern.whole_rows, pattern.whole_starts
    try:
        factors = _factorize(csc_matrix(whole, shape=(pattern.size, pattern.size)), "NATURAL")
    except RuntimeError:  # A column of zeros is left.
        return None
    pivots = factors.U.diagonal()
    if not np.array_equal(factors.perm_r, factors.perm_c) or not np.isfinite(pivots).all():
        return None
    num_entries = (factors.nnz - pivots.size) // 2
    return SparseFactors(int(np.count_nonzero(pivots < 0.0)), num_entries, factors)


def minimum_degree(pattern: Pattern) -> Ints:
    """Returns the places of the unknowns in an order of little fill: multiple minimum degree.

    Liu 1985, "Modification of the minimum-degree algorithm by multiple elimination", ACM TOMS
    11:141-153, as SuperLU has it.
    """
    degrees = np.diff(pattern.beside_starts)
    is_last = degrees > _DENSE * np.sqrt(pattern.size)
    first, last = np.flatnonzero(~is_last), np.flatnonzero(is_last)
    if first.size:
        whole = _dominant(pattern)[pattern.whole], pattern.whole_rows, pattern.whole_starts
        part = csc_matrix(whole, shape=(pattern.size, pattern.size))[first][:, first].tocsc()
        first = first[np.argsort(_factorize(part, "MMD_AT_PLUS_A").perm_c)]
    last = last[np.argsort(degrees[last], kind="stable")]
    return np.argsort(np.concatenate([first, last]))


def eliminate(
    cliques: Iterable[Sequence[int]], variables: Iterable[int], width: int, luck: Sequence[float]
) -> Iterator[tuple[int, set[int], bool]]:
    """Yields variables by exact minimum degree, each with its neighbors then, and if it is held.

    Where all of them have more neighbors than the width, one with the most is held: it goes, and
    couples no others.

    Args:
        cliques: variables that are coupled with each other; those not asked for do not matter.
        variables: those to eliminate.
        width: the most neighbors.
        luck: of each variable; of as many neighbors, the one with the least is next.
    """
    near: dict[int, set[int]] = {i: set() for i in variables}
    for clique in cliques:
        own = [i for i in clique if i in near]
        for i in own:
            near[i].update(own)
    for i, others in near.items():
        others.discard(i)
    queue = [(len(others), luck[i], i) for i, others in near.items()]
    heapq.heapify(queue)
    while queue:
        count, _, i = heapq.heappop(queue)
        if i not in near or count != len(near[i]):
            continue
        is_held = count > width
        if is_held:
            heapq.heappush(queue, (count, luck[i], i))
            i = max(near, key=lambda j: (len(near[j]), luck[j]))
        others = near.pop(i)
        for j in others:
            near[j] |= set() if is_held else others - {j}
            near[j].discard(i)
            heapq.heappush(queue, (len(near[j]), luck[j], j))
        yield i, others, is_held


def count_fill(pattern: Pattern) -> int:
    """Returns the number of entries of L below its diagonal, unknowns in the pattern's order."""
    factors = factorize(pattern, _dominant(pattern))
    assert factors is not None, "a matrix whose diagonal dominates is positive definite"
    return factors.num_entries


def _dominant(pattern: Pattern) -> Floats:
    """Returns a matrix that is positive definite, as its diagonal dominates (E,)."""
    values = np.full(pattern.rows.size, -1.0)
    values[: pattern.size] = np.diff(pattern.beside_starts) + 1.0
    return values


def _factorize(matrix: csc_matrix, order: str) -> Any:
    """Returns SuperLU's factors, with pivots from the diagonal."""
    return splu(matrix, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})


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
