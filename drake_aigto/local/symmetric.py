"""Symmetric indefinite matrices: what all their factorizations share.

A matrix is kept in LAPACK's lower band storage (b + 1, size), in Fortran's order; or, where there
is a `Pattern`, as its entries (1, E). Its diagonal is the beginning of the first row either way.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from scipy.linalg.blas import dsbmv

from drake_aigto.arrays import Floats
from drake_aigto.linear import Pattern
from drake_aigto.linear import multiply as multiply_sparse

_RESIDUAL = 1e-13  # of the largest entry on the right, where refinement stops


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
