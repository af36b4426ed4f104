"""Box means in exact arithmetic: slow, and what the kernels are checked against.

They come from the primitives, (G(b) − G(a))/(b − a) over the interval [a, b] that
y = scale·x + offset runs through, with the floats taken as the numbers that they are.
"""

from __future__ import annotations

import decimal
import math
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.box.functions import FunctionKind
from drake_aigto.box.polynomial import BoxPolynomial, Factor

# Enough for second differences of steps 1e-20, over intervals of 1e-15 of their center.
_LOG_DIGITS = 120


def exact_factor_mean(factor: Factor, center: Fraction, half_width: Fraction) -> Fraction:
    """Mean of a factor over |x − center| ≤ half_width; a logarithm's is right to 100 digits or so.

    Raises:
        ValueError: The interval leaves the domain of a logarithm.
    """
    middle = Fraction(factor.scale) * center + Fraction(factor.offset)
    reach = abs(Fraction(factor.scale)) * half_width
    if not reach:
        return _value(factor, middle)
    rise = _primitive(factor, middle + reach) - _primitive(factor, middle - reach)
    return rise / (2 * reach)


def exact_mean(
    polynomial: BoxPolynomial, center: ArrayLike, half_width: ArrayLike
) -> tuple[Fraction, Fraction]:
    """The mean f̄ = Σ a_m ∏ μ, and Σ |a_m| ∏ |μ|, which its rounding error is measured by.

    Args:
        polynomial: What is integrated; its logarithms must stay on their domain.
        center: Box center (n,).
        half_width: Box half width (n,).
    """
    c = [Fraction(x) for x in np.asarray(center, dtype=float).tolist()]
    w = [Fraction(x) for x in np.asarray(half_width, dtype=float).tolist()]
    total, size = Fraction(0), Fraction(0)
    for block in polynomial.blocks:
        for variables in block.variables.tolist():
            for term in block.terms:
                product = Fraction(block.weight) * Fraction(term.coefficient)
                for factor in term.factors:
                    i = variables[factor.variable]
                    product *= exact_factor_mean(factor, c[i], w[i])
                total += product
                size += abs(product)
    return total, size


def _value(factor: Factor, y: Fraction) -> Fraction:
    if factor.kind is FunctionKind.POWER:
        return y**factor.exponent
    if factor.kind is FunctionKind.SQUARED_HINGE:
        return min(y, Fraction(0)) ** 2
    return -_log(y)


def _primitive(factor: Factor, y: Fraction) -> Fraction:
    if factor.kind is FunctionKind.POWER:
        return y ** (factor.exponent + 1) / (factor.exponent + 1)
    if factor.kind is FunctionKind.SQUARED_HINGE:
        return min(y, Fraction(0)) ** 3 / 3
    return y - y * _log(y) if y else Fraction(0)


def _log(y: Fraction) -> Fraction:
    if y <= 0:
        raise ValueError(f"log of {float(y):g}")
    with decimal.localcontext(decimal.Context(prec=_LOG_DIGITS)):
        logarithm = (decimal.Decimal(y.numerator) / decimal.Decimal(y.denominator)).ln()
    return Fraction(logarithm)


def relative_error(computed: float, exact: Fraction, size: Fraction) -> float:
    """|computed − exact| / size; 0 where both are 0."""
    if not math.isfinite(computed):
        return math.inf
    error = abs(Fraction(computed) - exact)
    return float(error / size) if size else (math.inf if error else 0.0)
