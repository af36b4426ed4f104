"""Small dense systems whose factors are known, for kernels to call."""

from __future__ import annotations

from drake_aigto.arrays import Floats
from drake_aigto.kernels import inner


@inner
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


@inner
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


@inner
def solve_factors(size: int, A: Floats, y: Floats) -> None:
    """Overwrites the first entries of y by (L R)⁻¹ y, with both in A (`factor_in_place`)."""
    for i in range(size):
        for k in range(i):
            y[i] -= A[i, k] * y[k]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            y[i] -= A[i, k] * y[k]
        y[i] /= A[i, i]
