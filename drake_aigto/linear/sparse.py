"""LDLᵀ of sparse symmetric matrices, by SuperLU, and orders in which it fills little.

SuperLU in its symmetric mode takes every pivot from the diagonal unless it is exactly 0. Then its
U = D Lᵀ, and the signs of D tell the inertia. Matrices that are definite, or quasidefinite
(Vanderbei 1995, "Symmetric quasidefinite matrices", SIAM J. Optim. 5:100-113), have such factors in
any order of the unknowns; of another, small pivots may spoil them, which residuals show.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from drake_aigto.arrays import Floats, Ints
from drake_aigto.linear.pattern import Pattern

# Unknowns coupled to more than this times √size others are eliminated last: an order that looks at
# them again after each of their neighbors takes a time that grows with the square of the size
# (Amestoy, Davis & Duff 1996, "An approximate minimum degree ordering algorithm", SIAM J. Matrix
# Anal. Appl. 17:886-905, sec. 5).
_DENSE = 10.0


@dataclass(frozen=True, eq=False)
class SparseFactors:
    """L D Lᵀ of one matrix.

    Attributes:
        num_negative: Number of negative entries of D, which is that of negative eigenvalues.
        num_entries: Number of entries of L below its diagonal.
    """

    num_negative: int
    num_entries: int
    _factors: Any

    def solve(self, right: Floats) -> Floats:
        """Returns the solution for a right-hand side (size,), as the factors have it."""
        return self._factors.solve(right)


def factorize(pattern: Pattern, values: Floats) -> SparseFactors | None:
    """Returns the factors of a matrix (E,), unknowns in the pattern's order; None if a pivot is 0.

    So are those of a matrix that is not finite.
    """
    if not np.isfinite(values).all():
        return None
    whole = values[pattern.whole], pattern.whole_rows, pattern.whole_starts
    try:
        factors = _factorize(csc_matrix(whole, shape=(pattern.size, pattern.size)), "NATURAL")
    except RuntimeError:  # A column of zeros is left.
        return None
    pivots = factors.U.diagonal()
    if not np.array_equal(factors.perm_r, factors.perm_c) or not np.isfinite(pivots).all():
        return None
    num_entries = (factors.nnz - pivots.size) // 2
    return SparseFactors(int(np.count_nonzero(pivots < 0.0)), num_entries, factors)


def minimum_degree(pattern: Pattern) -> Ints:
    """Returns the places of the unknowns in an order of little fill: multiple minimum degree.

    Liu 1985, "Modification of the minimum-degree algorithm by multiple elimination", ACM TOMS
    11:141-153, as SuperLU has it.
    """
    degrees = np.diff(pattern.beside_starts)
    is_last = degrees > _DENSE * np.sqrt(pattern.size)
    first, last = np.flatnonzero(~is_last), np.flatnonzero(is_last)
    if first.size:
        whole = _dominant(pattern)[pattern.whole], pattern.whole_rows, pattern.whole_starts
        part = csc_matrix(whole, shape=(pattern.size, pattern.size))[first][:, first].tocsc()
        first = first[np.argsort(_factorize(part, "MMD_AT_PLUS_A").perm_c)]
    last = last[np.argsort(degrees[last], kind="stable")]
    return np.argsort(np.concatenate([first, last]))


def count_fill(pattern: Pattern) -> int:
    """Returns the number of entries of L below its diagonal, unknowns in the pattern's order."""
    factors = factorize(pattern, _dominant(pattern))
    assert factors is not None, "a matrix whose diagonal dominates is positive definite"
    return factors.num_entries


def _dominant(pattern: Pattern) -> Floats:
    """Returns a matrix that is positive definite, as its diagonal dominates (E,)."""
    values = np.full(pattern.rows.size, -1.0)
    values[: pattern.size] = np.diff(pattern.beside_starts) + 1.0
    return values


def _factorize(matrix: csc_matrix, order: str) -> Any:
    """Returns SuperLU's factors, with pivots from the diagonal."""
    return splu(matrix, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})
