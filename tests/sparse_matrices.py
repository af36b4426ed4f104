"""Programs and matrices whose bands are wide: arrows and grids."""

from __future__ import annotations

import numpy as np

from drake_aigto.linear import Pattern

Ints = np.ndarray


def arrow(size: int, beside: int = 2) -> Ints:
    """Returns the edges (2, P) of a chain of unknowns, the first of which is coupled to all."""
    i = np.arange(size)
    chain = [np.vstack([i[1:-k], i[1 + k :]]) for k in range(1, beside + 1)]
    return np.hstack([*chain, np.vstack([np.zeros(size - 1, dtype=np.int64), i[1:]])])


def grid(side: int) -> Ints:
    """Returns the edges (2, P) of a square grid of side² unknowns."""
    i = np.arange(side * side).reshape(side, side)
    along = np.vstack([i[:, :-1].ravel(), i[:, 1:].ravel()])
    return np.hstack([along, np.vstack([i[:-1].ravel(), i[1:].ravel()])])


def whole(pattern: Pattern, values: np.ndarray) -> np.ndarray:
    """Returns the dense matrix of a pattern's entries (E,)."""
    matrix = np.zeros((pattern.size, pattern.size))
    matrix[pattern.rows, pattern.columns] = matrix[pattern.columns, pattern.rows] = values
    return matrix
