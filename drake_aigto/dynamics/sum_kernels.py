"""Compiled code that evaluates sums of products, and divides by mass matrices."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.kernels import borrowing, kernel
from drake_aigto.linear import solve_factored
from drake_aigto.terms import FunctionKind

_COSINE, _SINE = int(FunctionKind.COSINE), int(FunctionKind.SINE)


@borrowing
def sum_products(
    x: Floats, tables: tuple[Ints, Floats, Ints, Floats], values: Floats, sums: Floats
) -> None:
    """Computes sums of products at a point, see `evaluate_sums`; values have room for all g."""
    factors, waves, members, coefficients = tables
    num_factors = factors.shape[0]
    for i in range(num_factors):
        y, value = x[factors[i, 0]], 1.0
        for _ in range(factors[i, 1]):
            value *= y
        if factors[i, 2] == _COSINE:
            value *= np.cos(waves[i, 0] * y + waves[i, 1])
        elif factors[i, 2] == _SINE:
            value *= np.sin(waves[i, 0] * y + waves[i, 1])
        values[i] = value
    for j in range(sums.size):
        sums[j] = 0.0
    for p in range(members.shape[0]):
        value = 1.0
        for k in range(members.shape[1]):
            if members[p, k] < num_factors:
                value *= values[members[p, k]]
        for j in range(sums.size):
            sums[j] += coefficients[j, p] * value


@kernel
def evaluate_sums(
    x: Floats, factors: Ints, waves: Floats, members: Ints, coefficients: Floats
) -> Floats:
    """Returns sums of products at points x, (K, n), shape (K, m).

    Args:
        x: the points.
        factors: variable, exponent and kind of each g, powers or waves, shape (G, 3).
        waves: scale and offset of each, shape (G, 2).
        members: which g each product has, shape (P, most); G: none.
        coefficients: of the products in each sum, shape (m, P).
    """
    values, sums = np.empty(factors.shape[0]), np.empty((x.shape[0], coefficients.shape[0]))
    for k in range(x.shape[0]):
        sum_products(x[k], (factors, waves, members, coefficients), values, sums[k])
    return sums


@borrowing
def factor_masses(n: int, masses: Floats, L: Floats) -> None:
    """Computes Cholesky's factor of M, which is in the first n n entries, row by row."""
    for i in range(n):
        for j in range(i + 1):
            total = masses[i * n + j]
            for c in range(j):
                total -= L[i, c] * L[j, c]
            L[i, j] = np.sqrt(total) if i == j else total / L[j, j]


@kernel
def divide_by_masses(masses: Floats, momenta: Floats) -> Floats:
    """Returns M⁻¹ y of each of K pairs by Cholesky's factors, shape (K, n).

    NumPy's solver takes ten times as long for the few coordinates that mechanisms have.

    Args:
        masses: M, positive definite, shape (K, n n).
        momenta: y, shape (K, n).
    """
    n = momenta.shape[1]
    L, found = np.empty((n, n)), momenta.copy()
    for k in range(found.shape[0]):
        factor_masses(n, masses[k], L)
        solve_factored(n, L, found[k])
    return found
