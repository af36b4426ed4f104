"""LDLᵀ of sparse KKT matrices, whose pivots can't be chosen for stability."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drake_aigto.arrays import Floats
from drake_aigto.linear import Pattern, SparseFactors, factorize
from drake_aigto.local.symmetric import SymmetricFactors, max_norm

# Added to the diagonal of W, and the least that is taken off the zeros below A: a matrix with a
# positive semidefinite W is quasidefinite then (Vanderbei 1995), and no pivot is 0 in any order.
# Refinement takes both out. Less for rows, as those that depend on each other would hinder it.
_SHIFT, _ROW_SHIFT = 1e-9, 1e-10
_LARGEST_ERROR = 1e-6  # of a refined solution's product, for a right-hand side of ones and −1


class SparseKktFactors(SymmetricFactors):
    """L D Lᵀ with a diagonal D, in an order of little fill.

    Factors are those of a matrix whose diagonal is shifted a little, and solutions are refined.
    Where refinement does not converge, as pivots were too small, the matrix counts as singular: its
    owner then shifts it further.
    """

    _refinements = 10
    _factors: SparseFactors

    def __init__(self, pattern: Pattern, is_row: NDArray[np.bool_]) -> None:
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
