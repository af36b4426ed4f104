"""Symmetric indefinite matrices of one sparsity, one after the other: solutions and inertia.

A matrix is kept in LAPACK's lower band storage (b + 1, size), in Fortran's order; or, where there
is a `Pattern`, as its entries (1, E). Its diagonal is the beginning of the first row either way.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from scipy.linalg.blas import dsbmv
from scipy.linalg.lapack import dsytrf, dsytrs

from drake_aigto.arrays import Bools, Floats
from drake_aigto.linear import Factorization, Pattern, SparseFactors, Storage, factorize
from drake_aigto.linear import multiply as multiply_sparse
from drake_aigto.local import multifrontal

_RESIDUAL = 1e-13  # of the largest entry on the right, where refinement stops
_BLOCK = 64  # columns that dsytrf eliminates at a time

# Added to the diagonal of W, and the least that is taken off the zeros below A: a matrix with a
# positive semidefinite W is quasidefinite then (Vanderbei 1995), and no pivot is 0 in any order.
# Refinement takes both out. Less for rows, as those that depend on each other would hinder it.
_SHIFT, _ROW_SHIFT = 1e-9, 1e-10
_LARGEST_ERROR = 1e-6  # of a refined solution's product, for a right-hand side of ones and −1


def make_factors(storage: Storage, is_row: Bools) -> SymmetricFactors:
    """Returns room for factors of KKT matrices, of whose unknowns (size,) some belong to rows."""
    if storage.pattern is not None:
        return SparseKktFactors(storage.pattern, is_row)
    kind = DenseFactors if storage.factorization is Factorization.DENSE else BandFactors
    return kind(storage.size, storage.bandwidth)


class SymmetricFactors(ABC):
    """Factors of one symmetric matrix at a time, all of the same sparsity."""

    _pattern: Pattern | None = None
    _refinements = 2
    _matrix: Floats
    _is_singular: bool

    def factorize(self, matrix: Floats) -> int:
        """Factorizes a matrix in place of the one before.

        Args:
            matrix: It is kept, and must not change as long as `solve` is called.

        Returns:
            The number of negative eigenvalues, −1 if the matrix is singular or not finite.
        """
        self._matrix = matrix
        negative = self._factorize(matrix) if np.isfinite(matrix).all() else -1
        self._is_singular = negative < 0
        return negative

    def solve(self, right: Floats) -> Floats:
        """Returns the refined solution for a right-hand side (size,); NaN after a −1."""
        if self._is_singular:
            return np.full(right.size, np.nan)
        solution = self._solve(right)
        goal = _RESIDUAL * max_norm(right)
        for _ in range(self._refinements):
            rest = right - self._multiply(solution)
            if not max_norm(rest) > goal:
                break
            solution += self._solve(rest)
        return solution

    def _multiply(self, x: Floats) -> Floats:
        return multiply(self._matrix, x, self._pattern)

    @abstractmethod
    def _factorize(self, matrix: Floats) -> int:
        """As `factorize`, of finite entries; no `solve` follows where it is −1."""

    @abstractmethod
    def _solve(self, right: Floats) -> Floats:
        """Returns the solution (size,) as the factors have it."""


class BandFactors(SymmetricFactors):
    """LDLᵀ that keeps the band: O(n b²) work, O(n b) memory (`multifrontal`)."""

    def __init__(self, size: int, bandwidth: int) -> None:
        """Allocates, which costs as much as filling the arrays."""
        capacity = 4 * (bandwidth + 2)
        self._work = np.empty((capacity, capacity)), np.empty(capacity, dtype=np.int64)
        self._columns = (
            np.empty(size, dtype=np.int64),
            np.empty((size, 2)),
            np.empty(size + 1, dtype=np.int64),
            np.empty(size * capacity, dtype=np.int64),
            np.empty(size * capacity),
        )

    def _factorize(self, matrix: Floats) -> int:
        front, active = self._work
        return multifrontal.factorize(matrix, front, active, *self._columns)

    def _solve(self, right: Floats) -> Floats:
        solution = right.copy()
        multifrontal.solve(*self._columns, solution)
        return solution


class DenseFactors(SymmetricFactors):
    """P A Pᵀ = L D Lᵀ with 1×1 and 2×2 pivots (Bunch & Kaufman 1977): n³/3 work, n² memory."""

    def __init__(self, size: int, bandwidth: int) -> None:
        """Allocates."""
        # Below and on the diagonal, entry (i, j) of a matrix in Fortran's order is i + j size =
        # (i − j) + j (size + 1) away from its start: the rows of the second view are its columns
        # from the diagonal on. What they have too many ends up above it, where nobody reads.
        entries = np.zeros(size * (size + 1))
        self._whole = entries[: size * size].reshape((size, size), order="F")
        self._columns = entries.reshape(size, size + 1)[:, : bandwidth + 1]
        self._lower, self._pivots = self._whole, np.zeros(size, dtype=np.int32)

    def _factorize(self, matrix: Floats) -> int:
        size = matrix.shape[1]
        if size == 0:
            return 0
        self._columns[:] = matrix.T
        self._lower, self._pivots, info = dsytrf(self._whole, lower=1, lwork=_BLOCK * size)
        if info != 0:
            return -1
        # Both rows of a 2×2 pivot are marked by a minus; its determinant is negative by choice.
        is_single = self._pivots > 0
        singles = np.count_nonzero(is_single)
        negative = np.count_nonzero(is_single & (self._lower.diagonal() < 0.0))
        return int(negative + (size - singles) // 2)

    def _solve(self, right: Floats) -> Floats:
        if right.size == 0:
            return right
        return dsytrs(self._lower, self._pivots, right, lower=1)[0]


class SparseKktFactors(SymmetricFactors):
    """L D Lᵀ with a diagonal D, in an order of little fill.

    Factors are those of a matrix whose diagonal is shifted a little, and solutions are refined.
    Where refinement does not converge, as pivots were too small, the matrix counts as singular: its
    owner then shifts it further.
    """

    _refinements = 10
    _factors: SparseFactors

    def __init__(self, pattern: Pattern, is_row: Bools) -> None:
        """Takes the pattern, and which unknowns are multipliers of rows (size,)."""
        self._pattern = self._sparsity = pattern
        self._is_row = is_row
        self._probe = np.where(np.arange(is_row.size) % 2, -1.0, 1.0)

    def _factorize(self, matrix: Floats) -> int:
        values = matrix[0].copy()
        diagonal = values[: self._is_row.size]
        shifted = np.where(self._is_row, np.minimum(diagonal, -_ROW_SHIFT), diagonal + _SHIFT)
        values[: shifted.size] = shifted
        factors = factorize(self._sparsity, values)
        if factors is None:
            return -1
        self._factors, self._is_singular = factors, False
        error = max_norm(self._multiply(self.solve(self._probe)) - self._probe)
        return factors.num_negative if error <= _LARGEST_ERROR else -1

    def _solve(self, right: Floats) -> Floats:
        return self._factors.solve(right)


def multiply(matrix: Floats, x: Floats, pattern: Pattern | None = None) -> Floats:
    """Returns the product of a symmetric matrix with a vector (size,)."""
    if x.size == 0:
        return x
    if pattern is not None:
        return multiply_sparse(pattern, matrix[0], x)
    return dsbmv(matrix.shape[0] - 1, 1.0, matrix, x, lower=1)


def max_norm(values: Floats) -> float:
    """Returns the largest absolute value, 0 of nothing."""
    return float(np.abs(values).max()) if values.size else 0.0
