"""Box means in exact arithmetic: slow, and what the kernels are checked against.

They come from the primitives, (G(b) − G(a))/(b − a) over the interval [a, b] that x runs through,
or y = scale·x + offset, with the floats taken as the numbers that they are.
"""

from __future__ import annotations

import decimal
import math
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.box import D_C, D_CC, D_CZ, D_Z, D_ZZ, VALUE, BoxPolynomial
from drake_aigto.terms import WAVES, Factor, FunctionKind

# Enough for second differences of steps 1e-20, over intervals of 1e-15 of their center.
_DIGITS = 120


def exact_factor_mean(factor: Factor, center: Fraction, half_width: Fraction) -> Fraction:
    """Mean of a factor over |x − center| ≤ half_width.

    Those of logarithms, cosines, sines and exponentials are right to 100 digits or so.

    Raises:
        ValueError: The interval leaves the domain of a logarithm.
    """
    if factor.kind in WAVES:
        return _wave_mean(factor, center, half_width)
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
    with decimal.localcontext(decimal.Context(prec=_DIGITS)):
        return Fraction(_decimal(y).ln())


def _wave_mean(factor: Factor, center: Fraction, half_width: Fraction) -> Fraction:
    """Mean of x^p times a cosine, sine or exponential of y, in as many digits as cancel and more.

    A difference of primitives has lost (p + 1) log10 1/|scale·half_width| digits.
    """
    scale, offset = Fraction(factor.scale), Fraction(factor.offset)
    if not scale or not half_width:
        power = Factor(0, FunctionKind.POWER, factor.exponent)
        value = exact_factor_mean(power, center, half_width)
        with decimal.localcontext(decimal.Context(prec=2 * _DIGITS)):
            return value * Fraction(_wave(factor.kind, _decimal(scale * center + offset), 0))
    ratios = (1 / (scale * half_width), center / half_width, scale * center + offset)
    lost = max(_decades(ratio) for ratio in ratios)
    with decimal.localcontext(decimal.Context(prec=_DIGITS + (factor.exponent + 6) * lost)):
        rise = _wave_primitive(factor, center + half_width)
        rise -= _wave_primitive(factor, center - half_width)
        return Fraction(rise) / (2 * half_width)


def _decades(ratio: Fraction) -> int:
    """log10 |ratio|, rounded up and not below 0."""
    bits = ratio.numerator.bit_length() - ratio.denominator.bit_length() + 1
    return max(0, math.ceil(bits * math.log10(2.0)))


def _wave_primitive(factor: Factor, x: Fraction) -> decimal.Decimal:
    """∫ x^p g(y) dx = Σ_i (−1)^i p!/(p−i)! x^{p−i} g^{(−i−1)}(y) / scale^{i+1}, by parts."""
    y = _decimal(Fraction(factor.scale) * x + Fraction(factor.offset))
    scale, point = decimal.Decimal(factor.scale), _decimal(x)
    total, falling = decimal.Decimal(0), decimal.Decimal(1) / scale
    for i in range(factor.exponent + 1):
        rest = factor.exponent - i
        power = point**rest if rest else decimal.Decimal(1)  # Decimal has no 0⁰
        total += falling * power * _wave(factor.kind, y, i + 1)
        falling *= -rest / scale
    return total


def _wave(kind: FunctionKind, y: decimal.Decimal, primitives: int) -> decimal.Decimal:
    """The cosine, sine or exponential of y, integrated so many times."""
    if kind is FunctionKind.EXPONENTIAL:
        return y.exp()
    cosine, sine = _cosine_and_sine(y)
    quarters = primitives + (kind is FunctionKind.SINE)  # sin = ∫ cos
    return (cosine, sine, -cosine, -sine)[quarters % 4]


def _cosine_and_sine(y: decimal.Decimal) -> tuple[decimal.Decimal, decimal.Decimal]:
    """Taylor's series at y/2^n, and n doublings."""
    doublings = max(0, y.adjusted() + 1) * 4 + 10
    with decimal.localcontext() as context:
        context.prec += doublings
        part = y / 2**doublings
        cosine, sine = decimal.Decimal(0), decimal.Decimal(0)
        term, n = decimal.Decimal(1), 0
        while abs(term) > decimal.Decimal(10) ** -context.prec:
            cosine, sine = cosine + term, sine + term * part / (n + 1)
            term *= -part * part / ((n + 1) * (n + 2))
            n += 2
        for _ in range(doublings):
            cosine, sine = cosine * cosine - sine * sine, 2 * cosine * sine
    return +cosine, +sine


def _decimal(number: Fraction) -> decimal.Decimal:
    return decimal.Decimal(number.numerator) / decimal.Decimal(number.denominator)


def relative_error(computed: float, exact: Fraction, size: Fraction) -> float:
    """|computed − exact| / size; 0 where both are 0."""
    if not math.isfinite(computed):
        return math.inf
    error = abs(Fraction(computed) - exact)
    return float(error / size) if size else (math.inf if error else 0.0)


def exact_row(factor: Factor, center: float, half_width: float) -> dict[int, Fraction]:
    """Returns the mean, and derivatives as central differences, right to h² = 1e-40 of its size."""
    h = Fraction(1, 10**20)
    c, w = Fraction(center), Fraction(half_width)
    dc = h * (w or abs(c) or 1)

    def mean(i: int, j: int) -> Fraction:
        return exact_factor_mean(factor, c + i * dc, w + j * h * w)

    here, left, right, narrow, wide = mean(0, 0), mean(-1, 0), mean(1, 0), mean(0, -1), mean(0, 1)
    mixed = mean(1, 1) - mean(1, -1) - mean(-1, 1) + mean(-1, -1)
    d_z = (wide - narrow) / (2 * h)  # w ∂/∂w, over steps h w
    return {
        VALUE: here,
        D_C: (right - left) / (2 * dc),
        D_CC: (right - 2 * here + left) / dc**2,
        D_Z: d_z,
        D_CZ: mixed / (4 * dc * h),
        D_ZZ: (wide - 2 * here + narrow) / h**2 + d_z,  # w² ∂²/∂w² + w ∂/∂w
    }
