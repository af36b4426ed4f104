"""Small dense systems, and LDLᵀ of positive definite bands, for kernels to call."""

from __future__ import annotations

from drake_aigto.arrays import Floats
from drake_aigto.kernels import borrowing, njit


@borrowing
def solve_factored(size: int, L: Floats, y: Floats) -> None:
    """Overwrites the first entries of y by (L Lᵀ)⁻¹ y, L being of this size."""
    for i in range(size):
        for k in range(i):
            y[i] -= L[i, k] * y[k]
        y[i] /= L[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            y[i] -= L[k, i] * y[k]
        y[i] /= L[i, i]


@borrowing
def factor_in_place(size: int, least: float, A: Floats) -> None:
    """Overwrites the first rows of A by L and R with A = L R, of which L has ones on its diagonal.

    Rows keep their order: A is nearly symmetric and positive. Pivots are at least a part `least` of
    the diagonal in size.
    """
    for i in range(size):
        floor = least * abs(A[i, i])
        for j in range(size):
            for k in range(min(i, j)):
                A[i, j] -= A[i, k] * A[k, j]
            if j < i:
                A[i, j] /= A[j, j]
        if abs(A[i, i]) < floor:
            A[i, i] = floor


@borrowing
def solve_factors(size: int, A: Floats, y: Floats) -> None:
    """Overwrites the first entries of y by (L R)⁻¹ y, with both in A (`factor_in_place`)."""
    for i in range(size):
        for k in range(i):
            y[i] -= A[i, k] * y[k]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            y[i] -= A[i, k] * y[k]
        y[i] /= A[i, i]


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def factorize_band(band: Floats) -> bool:
    """Overwrites a matrix with its LDLᵀ factors, L and in place of its ones D⁻¹.

    For half bandwidths up to some 50 this is quicker than LAPACK's `dpbtrf`, which calls BLAS for
    every column, on a few numbers; beyond some 60 it is slower.

    Args:
        band: In LAPACK's lower band storage, transposed: entry (i, j), i ≥ j, at [j, i − j].

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
def solve_band(factors: Floats, x: Floats) -> None:
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
