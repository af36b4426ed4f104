"""Bounds of sums of products over a box, by interval arithmetic."""

from __future__ import annotations

import math
from collections.abc import Sequence

from drake_aigto.arrays import Floats
from drake_aigto.jit import kernel
from drake_aigto.terms import Factor, FunctionKind, Term

# Exponentials of wide boxes overflow: their range ends here.
LARGEST = 1e15

Range = tuple[float, float]


def sum_range(terms: Sequence[Term], low: Floats, high: Floats) -> Range:
    """Returns bounds of a sum over low ≤ x ≤ high, term by term; at most 1e15 in size.

    Args:
        terms: products of powers, sines, cosines and exponentials.
        low: lower end of each local variable (L,).
        high: upper end (L,).
    """
    least = most = 0.0
    for term in terms:
        ends = term.coefficient, term.coefficient
        for factor in term.factors:
            interval = float(low[factor.variable]), float(high[factor.variable])
            ends = _clamped(product(*ends, *_factor_range(factor, interval)))
        least, most = least + min(ends), most + max(ends)
    return max(least, -LARGEST), min(most, LARGEST)


@kernel
def affine(scale: float, offset: float, low: float, high: float) -> Range:
    """Returns the range of scale · x + offset over x in [low, high]."""
    a, b = scale * low + offset, scale * high + offset
    return min(a, b), max(a, b)


@kernel
def product(a: float, b: float, c: float, d: float) -> Range:
    """Returns the range of x y over x in [a, b], y in [c, d], with 0 · ∞ = 0."""
    products = _times(a, c), _times(a, d), _times(b, c), _times(b, d)
    return min(products), max(products)


@kernel
def _times(a: float, b: float) -> float:
    return 0.0 if a == 0.0 or b == 0.0 else a * b


@kernel
def power_range(low: float, high: float, exponent: int) -> Range:
    """Returns the range of y^p over y in [low, high]."""
    a, b = low**exponent, high**exponent
    if exponent % 2 == 1 or exponent == 0:
        return a, b
    return (0.0 if low <= 0.0 <= high else min(a, b)), max(a, b)


def _clamped(ends: Range) -> Range:
    return max(ends[0], -LARGEST), min(ends[1], LARGEST)


def _factor_range(factor: Factor, x: Range) -> Range:
    y = affine(factor.scale, factor.offset, *x)
    if factor.kind == FunctionKind.POWER:
        return _clamped(power_range(*y, factor.exponent))
    if factor.kind == FunctionKind.EXPONENTIAL:
        wave = _exponential(y[0]), _exponential(y[1])
    else:
        quarter = math.pi / 2 if factor.kind == FunctionKind.SINE else 0.0
        wave = cosine_range(y[0] - quarter, y[1] - quarter)  # sin y = cos(y − π/2)
    return _clamped(product(*_clamped(power_range(*x, factor.exponent)), *wave))


def _exponential(y: float) -> float:
    return math.exp(min(y, math.log(LARGEST)))


def cosine_range(first: float, last: float) -> Range:
    """Returns the least and largest cosine between two angles."""
    if not last - first < 2 * math.pi:
        return -1.0, 1.0
    ends = math.cos(first), math.cos(last)
    has_top = math.floor(last / (2 * math.pi)) >= math.ceil(first / (2 * math.pi))
    has_bottom = math.floor(last / (2 * math.pi) - 0.5) >= math.ceil(first / (2 * math.pi) - 0.5)
    return (-1.0 if has_bottom else min(ends)), (1.0 if has_top else max(ends))
