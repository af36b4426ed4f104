"""LDLᵀ of symmetric indefinite matrices that are small or nearly full, by LAPACK."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dsytrf, dsytrs

from drake_aigto.arrays import Floats
from drake_aigto.local.symmetric import SymmetricFactors

_BLOCK = 64  # columns that dsytrf eliminates at a time


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
