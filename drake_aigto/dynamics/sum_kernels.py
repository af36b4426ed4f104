"""Compiled code that evaluates sums of products, and divides by mass matrices."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.kernels import kernel
from drake_aigto.linear import solve_factored
from drake_aigto.terms import FunctionKind

_COSINE, _SINE = int(FunctionKind.COSINE), int(FunctionKind.SINE)


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
    num_factors, num_sums = factors.shape[0], coefficients.shape[0]
    values, sums = np.empty(num_factors), np.zeros((x.shape[0], num_sums))
    for k in range(x.shape[0]):
        for i in range(num_factors):
            y, value = x[k, factors[i, 0]], 1.0
            for _ in range(factors[i, 1]):
                value *= y
            if factors[i, 2] == _COSINE:
                value *= np.cos(waves[i, 0] * y + waves[i, 1])
            elif factors[i, 2] == _SINE:
                value *= np.sin(waves[i, 0] * y + waves[i, 1])
            values[i] = value
        for p in range(members.shape[0]):
            value = 1.0
            for i in members[p]:
                if i < num_factors:
                    value *= values[i]
            for j in range(num_sums):
                sums[k, j] += coefficients[j, p] * value
    return sums


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
        for i in range(n):
            for j in range(i + 1):
                total = masses[k, i * n + j]
                for c in range(j):
                    total -= L[i, c] * L[j, c]
                L[i, j] = np.sqrt(total) if i == j else total / L[j, j]
        solve_factored(n, L, found[k])
    return found
