"""Sparse symmetric matrices: their patterns, LDLᵀ by SuperLU, and orders of little fill.

SuperLU in its symmetric mode takes every pivot from the diagonal unless it is exactly 0. Then its
U = D Lᵀ, and the signs of D give the inertia. Matrices that are definite, or quasidefinite
(Vanderbei 1995, "Symmetric quasidefinite matrices", SIAM J. Optim. 5:100-113), have such factors in
any order of the unknowns; of another, small pivots may spoil them, which residuals show.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from drake_aigto.arrays import Floats, Ints
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
