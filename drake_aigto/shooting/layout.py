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


@inner
def find_tangent(n: int, size: int, count: int, rub: int) -> tuple[int, int]:
    """Returns where T of a friction, of so many, and ∂T/∂q begin in sums of so many."""
    return size - (count - rub) * n, size - count * n - (count - rub) * n * n


@inner
def find_row(n: int, m: int, size: int, count: int, k: int) -> int:
    """Returns where row k begins: J_k of a contact, or T of friction k − m."""
    return find_rows(n, m, k)[0] if k < m else find_tangent(n, size, count, k - m)[0]


@inner
def find_slope(n: int, m: int, size: int, count: int, k: int, i: int, c: int) -> int:
    """Returns where the derivative of entry i of row k by q_c is."""
    if k < m:
        return find_rows(n, m, k)[1] + triangle(n, i, c)
    return find_tangent(n, size, count, k - m)[1] + i * n + c
