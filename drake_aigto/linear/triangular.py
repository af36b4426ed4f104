"""Small dense systems whose Cholesky factor is known, for kernels to call."""

from __future__ import annotations

from drake_aigto.arrays import Floats
from drake_aigto.jit import inner


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
