"""Newton systems, solved as bands or as sparse matrices."""

from __future__ import annotations

from numba import objmode

from drake_aigto.arrays import Floats
from drake_aigto.jit import inner, njit
from drake_aigto.linear import Pattern, factorize


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


@inner
def solve_system(pattern: Pattern | None, matrix: Floats, x: Floats) -> bool:
    """Overwrites a right-hand side (size,) with the solution, and the matrix with its factors.

    Args:
        pattern: Of the matrix, None for a band.
        matrix: As a band (size, diagonals), or as entries (E, 1).
        x: The right-hand side.

    Returns:
        Whether the matrix is positive definite; if not, x stays.
    """
    if pattern is None:  # An argument of its own, for then Numba leaves out the other case.
        if not factorize_band(matrix):
            return False
        solve_band(matrix, x)
        return True
    return _solve_sparse(pattern, matrix, x)


# Not nogil: what runs in Python takes the interpreter's lock.
@njit(no_cpython_wrapper=True)
def _solve_sparse(pattern: Pattern, matrix: Floats, x: Floats) -> bool:
    with objmode(is_definite="boolean"):
        is_definite = _solve_in_python(pattern, matrix, x)
    return is_definite


def _solve_in_python(pattern: Pattern, matrix: Floats, x: Floats) -> bool:
    factors = factorize(pattern, matrix[:, 0])
    if factors is None or factors.num_negative:
        return False
    x[:] = factors.solve(x)
    return True
