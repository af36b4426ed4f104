"""Where the sums of a mechanism's tape stand."""

from __future__ import annotations

from drake_aigto.jit import inner


@inner
def triangle(n: int, i: int, j: int) -> int:
    """Returns where entry (i, j) of a symmetric matrix stands in its upper triangle, by rows."""
    low, high = min(i, j), max(i, j)
    return low * n - low * (low - 1) // 2 + high - low


@inner
def find_rows(n: int, m: int, i: int) -> tuple[int, int]:
    """Returns where J_i, and the second derivatives of φ_i, begin in the sums of all slopes."""
    half = n * (n + 1) // 2
    return half + n + m + i * n, half + n + m + m * n + half * n + 2 * n * n + i * half
