"""Newton systems, solved as bands or as sparse matrices."""

from __future__ import annotations

from numba import objmode

from drake_aigto.aigo import banded
from drake_aigto.arrays import Floats
from drake_aigto.jit import inner, njit
from drake_aigto.linear import Pattern, factorize


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
        if not banded.factorize(matrix):
            return False
        banded.solve(matrix, x)
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
