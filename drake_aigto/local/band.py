"""Cholesky factors of positive definite bands, for kernels to call.

A matrix has entry (j + d, j) at [j, d], shape (size, b + 1): one row is a column from the diagonal
on. SciPy's have to be called from Python, which takes as long as the factors of a small band.
"""

from __future__ import annotations

import math

from drake_aigto.arrays import Floats
from drake_aigto.jit import inner

_LEAST_PIVOT = 1e-14


@inner
def factorize_band(band: Floats) -> bool:
    """Overwrites a matrix with its factor L, A = L Lᵀ; False if it is not positive definite."""
    size, width = band.shape
    for j in range(size):
        if not band[j, 0] > _LEAST_PIVOT:
            return False
        band[j, 0] = math.sqrt(band[j, 0])
        last = min(width, size - j)
        inverse = 1.0 / band[j, 0]
        for d in range(1, last):
            band[j, d] *= inverse
        for d in range(1, last):
            factor = band[j, d]
            if factor != 0.0:
                for e in range(d, last):
                    band[j + d, e - d] -= factor * band[j, e]
    return True


@inner
def solve_band(band: Floats, right: Floats) -> None:
    """Overwrites a right-hand side (size,) with the solution, given the factor L."""
    size, width = band.shape
    for j in range(size):
        right[j] /= band[j, 0]
        for d in range(1, min(width, size - j)):
            right[j + d] -= band[j, d] * right[j]
    for j in range(size - 1, -1, -1):
        total = right[j]
        for d in range(1, min(width, size - j)):
            total -= band[j, d] * right[j + d]
        right[j] = total / band[j, 0]
