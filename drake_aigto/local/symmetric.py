"""Symmetric indefinite matrices in lower band storage: what all their factorisations share."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsbmv

Floats = NDArray[np.float64]

_REFINEMENTS = 2
_RESIDUAL = 1e-13  # of the largest entry on the right, where refinement stops


class SymmetricFactors(ABC):
    """Factors of one symmetric matrix at a time, of fixed size and bandwidth."""

    _band: Floats
    _is_singular: bool

    def factorise(self, band: Floats) -> int:
        """Factorise a matrix in place of the one before.

        Args:
            band: Lower band storage (bandwidth + 1, size), in Fortran's order. It is kept, and must
                not change as long as `solve` is called.

        Returns:
            The number of negative eigenvalues, −1 if the matrix is singular or not finite.
        """
        negative = self._factorise(band) if np.isfinite(band).all() else -1
        self._band, self._is_singular = band, negative < 0
        return negative

    def solve(self, right: Floats) -> Floats:
        """The solution for a right-hand side (size,), refined; NaN where `factorise` gave −1."""
        if self._is_singular:
            return np.full(right.size, np.nan)
        solution = self._solve(right)
        goal = _RESIDUAL * max_norm(right)
        for _ in range(_REFINEMENTS):
            rest = right - multiply(self._band, solution)
            if not max_norm(rest) > goal:
                break
            solution += self._solve(rest)
        return solution

    @abstractmethod
    def _factorise(self, band: Floats) -> int:
        """As `factorise`, of finite entries; no `solve` follows where it is −1."""

    @abstractmethod
    def _solve(self, right: Floats) -> Floats:
        """The solution (size,) as the factors have it."""


def multiply(band: Floats, x: Floats) -> Floats:
    """The product of a symmetric matrix in lower band storage (b + 1, size) with a vector."""
    if x.size == 0:
        return x
    return dsbmv(band.shape[0] - 1, 1.0, band, x, lower=1)


def max_norm(values: Floats) -> float:
    """Largest absolute value, 0 of nothing."""
    return float(np.abs(values).max()) if values.size else 0.0
