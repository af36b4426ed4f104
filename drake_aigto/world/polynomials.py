"""Expressions read off a plant, as polynomials: tidied once, and compiled to arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.symbolic import Expression, Polynomial, Variables

from drake_aigto.arrays import Floats

# Coefficients below this, relative to the largest, are rounding left by rotations such as
# cos(π/2) = 6e-17, not physics. They would make constants look like functions.
_ROUNDING = 1e-14


def find_nonpolynomial_variable(expression: Expression) -> Any | None:
    """Returns a variable in which the expression is no polynomial, or None if it is one in all."""
    if expression.is_polynomial():
        return None
    for variable in expression.GetVariables():
        try:
            Polynomial(expression, Variables(np.array([variable])))
        except RuntimeError:
            return variable
    return None


def tidy(expressions: NDArray[Any]) -> NDArray[Any]:
    """Returns polynomials of any shape expanded and rid of rounding, as a read-only array."""
    polynomials = [Polynomial(expression) for expression in expressions.flat]
    largest = max((abs(c) for p in polynomials for c in _coefficients(p).values()), default=0.0)
    tolerance = max(_ROUNDING * largest, np.finfo(float).tiny)  # Drake wants more than zero.
    result = np.empty(expressions.size, dtype=object)
    for i, polynomial in enumerate(polynomials):
        kept = polynomial.RemoveTermsWithSmallCoefficients(tolerance)
        result[i] = kept.ToExpression().Expand()
    result.flags.writeable = False
    return result.reshape(expressions.shape)


def is_constant(expressions: Any) -> bool:
    """Returns whether expressions, one or an array of them, have no variable."""
    return all(expression.GetVariables().empty() for expression in np.ravel(expressions))


def evaluate(expressions: NDArray[Any], at: dict[Any, float] | None = None) -> Floats:
    """Returns the values of expressions of any shape, given those of their variables."""
    values = [expression.Evaluate(at or {}) for expression in expressions.flat]
    return np.array(values, dtype=float).reshape(expressions.shape)


def _coefficients(polynomial: Polynomial) -> dict[Any, float]:
    """Returns monomial → coefficient of a polynomial in all of its variables."""
    return {
        monomial: coefficient.Evaluate()
        for monomial, coefficient in polynomial.monomial_to_coefficient_map().items()
    }


class PolynomialMap:
    """Polynomials f: ℝⁿ → ℝᵐ compiled to arrays, f(x)ⱼ = Σₖ Cⱼₖ ∏ᵢ xᵢ^Eₖᵢ.

    A simulator calls this in every derivative; it takes a few microseconds, one where f is affine.

    Attributes:
        exponents: E, shape (monomials, n).
        coefficients: C, shape (m, monomials).
    """

    def __init__(self, expressions: NDArray[Any], variables: NDArray[Any]) -> None:
        """Compiles polynomials (m,) in variables (n,)."""
        tables = [_coefficients(Polynomial(e)) for e in expressions]
        monomials = list(dict.fromkeys(monomial for table in tables for monomial in table))
        self.exponents = np.array(
            [[monomial.degree(variable) for variable in variables] for monomial in monomials],
            dtype=float,
        ).reshape(len(monomials), len(variables))
        self.coefficients = np.array(
            [[table.get(monomial, 0.0) for monomial in monomials] for table in tables]
        ).reshape(len(tables), len(monomials))
        degrees = self.exponents.sum(axis=1)
        self._is_affine = bool(np.all(degrees <= 1))
        self._constant = self.coefficients @ (degrees == 0).astype(float)
        self._slope = self.coefficients @ (self.exponents * (degrees == 1)[:, np.newaxis])

    def __call__(self, x: Floats) -> Floats:
        """Returns f(x), shape (…, m), for x of shape (…, n)."""
        if self._is_affine:
            return x @ self._slope.T + self._constant
        return (x[..., np.newaxis, :] ** self.exponents).prod(axis=-1) @ self.coefficients.T
