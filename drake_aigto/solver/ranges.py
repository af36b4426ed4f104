"""Bounds of sums of products over a box, by interval arithmetic."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from drake_aigto.box import Factor, FunctionKind, Term

if TYPE_CHECKING:
    import numpy.typing as npt

# Exponentials of wide boxes overflow: their range ends here.
LARGEST = 1e15

_Range = tuple[float, float]


def sum_range(
    terms: Sequence[Term], low: npt.NDArray[np.float64], high: npt.NDArray[np.float64]
) -> _Range:
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
            ends = _product(ends, _factor_range(factor, interval))
        least, most = least + min(ends), most + max(ends)
    return max(least, -LARGEST), min(most, LARGEST)


def _product(a: _Range, b: _Range) -> _Range:
    products = [x * y for x in a for y in b]
    return max(min(products), -LARGEST), min(max(products), LARGEST)


def _factor_range(factor: Factor, x: _Range) -> _Range:
    y = sorted(factor.scale * end + factor.offset for end in x)
    if factor.kind == FunctionKind.POWER:
        return _power_range(factor.exponent, (y[0], y[1]))
    if factor.kind == FunctionKind.EXPONENTIAL:
        wave = _exponential(y[0]), _exponential(y[1])
    else:
        quarter = math.pi / 2 if factor.kind == FunctionKind.SINE else 0.0
        wave = _cosine_range(y[0] - quarter, y[1] - quarter)  # sin y = cos(y − π/2)
    return _product(_power_range(factor.exponent, x), wave)


def _power_range(exponent: int, y: _Range) -> _Range:
    powers = [min(max(float(np.float64(end) ** exponent), -LARGEST), LARGEST) for end in y]
    if exponent % 2 == 0 and exponent > 0 and y[0] < 0.0 < y[1]:
        powers.append(0.0)
    return min(powers), max(powers)


def _exponential(y: float) -> float:
    return math.exp(min(y, math.log(LARGEST)))


def _cosine_range(first: float, last: float) -> _Range:
    """Returns the least and largest cosine between two angles."""
    ends = math.cos(first), math.cos(last)
    has_top = math.floor(last / (2 * math.pi)) >= math.ceil(first / (2 * math.pi))
    has_bottom = math.floor(last / (2 * math.pi) - 0.5) >= math.ceil(first / (2 * math.pi) - 0.5)
    return (-1.0 if has_bottom else min(ends)), (1.0 if has_top else max(ends))
