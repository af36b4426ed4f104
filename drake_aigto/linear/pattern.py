"""Where the entries of a sparse symmetric matrix are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_aigto.arrays import Floats, Ints
from drake_aigto.jit import kernel


class Pattern(NamedTuple):
    """The lower triangle of a symmetric matrix by columns, behind its diagonal.

    Shape letters: size unknowns, E entries stored. A matrix of the pattern is an array (E,): first
    its diagonal, so that entry k is (k, k) as in the first row of a band, then what is below.

    Attributes:
        rows: Row of each entry, ascending within a column (E,).
        columns: Its column (E,).
        starts: Entries below the diagonal in column j are starts[j]:starts[j + 1] (size + 1,).
        beside: Entries off the diagonal in the row or the column of unknown 0, of unknown 1, …
            (2 (E − size),).
        beside_starts: Those of unknown k are beside_starts[k]:beside_starts[k + 1] (size + 1,).
        whole: Which entry each one is of the matrix with both triangles, by columns (2 E − size,).
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
