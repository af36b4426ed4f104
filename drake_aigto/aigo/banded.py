"""LDLᵀ of positive definite band matrices.

For half bandwidths up to some 50 this is quicker than LAPACK's `dpbtrf`, which calls BLAS for every
column, on a few numbers; beyond some 60 it is slower.

Matrices are in LAPACK's lower band storage, transposed: entry (i, j), i ≥ j, at [j, i − j].
"""

from __future__ import annotations

from drake_aigto.arrays import Floats
from drake_aigto.jit import njit


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def factorize(band: Floats) -> bool:
    """Overwrites a matrix with its factors, L and in place of its ones D⁻¹.

    Returns:
        Whether it is positive definite; if not, it is spoilt.
    """
    size, width = band.shape
    for j in range(size):
        if not band[j, 0] > 0.0:
            return False
        inverse = 1.0 / band[j, 0]
        below = min(width, size - j)
        while below > 1 and band[j, below - 1] == 0.0:
            below -= 1
        for a in range(1, below):
            factor = inverse * band[j, a]
            for d in range(below - a):
                band[j + a, d] -= factor * band[j, a + d]
        for a in range(1, below):
            band[j, a] *= inverse
        band[j, 0] = inverse
    return True


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def solve(factors: Floats, x: Floats) -> None:
    """Overwrites a right-hand side (size,) with the solution."""
    size, width = factors.shape
    for j in range(size):
        for a in range(1, min(width, size - j)):
            x[j + a] -= factors[j, a] * x[j]
    for j in range(size - 1, -1, -1):
        value = factors[j, 0] * x[j]
        for a in range(1, min(width, size - j)):
            value -= factors[j, a] * x[j + a]
        x[j] = value
