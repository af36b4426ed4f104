"""Interval arithmetic that is rounded outward, for compiled code.

IEEE arithmetic is within half a unit in the last place, ½ u |x| with u = 2⁻⁵²; so x (1 ∓ u) is
beyond what was rounded to x. Results that may have underflowed move by a number that is above every
subnormal one; a lower end that overflows is the largest number, as the exact one is beyond it. Of
exp, log, x log x, tan⁻¹, tanh, sin, cos and powers with a fraction, four units are taken (see
`LIBRARY`).
"""

from __future__ import annotations

import math

import numpy as np

from drake_aigto.kernels import inner

Interval = tuple[float, float]

UNIT = 2.0**-52
# Largest errors of the C library: GNU's manual lists one or two units for all of these functions
# ("Errors in Math Functions"), and searches for the worst arguments found as little elsewhere
# (Zimmermann 2021, hal-03141101). No library has them proven.
LIBRARY = 4.0 * UNIT
LARGEST = 1.7976931348623157e308
TINY = 1e-300
# Where a wave has its top is known to this many units of the number of turns.
_TURN_UNITS = 8.0 * UNIT


@inner
def down(x: float) -> float:
    """Returns a number below all that round to x; 0 is exact."""
    y = x * (1.0 - UNIT) if x > 0.0 else x * (1.0 + UNIT)
    return LARGEST if y > LARGEST else y


@inner
def up(x: float) -> float:
    """Returns a number above all that round to x; 0 is exact."""
    return -down(-x)


@inner
def up_product(a: float, b: float) -> float:
    """Returns a number above a b, whatever underflows."""
    return up(a * b) + TINY


@inner
def up_quotient(a: float, b: float) -> float:
    """Returns a number above a / b, whatever underflows."""
    return up(a / b) + TINY


@inner
def plus(x: Interval, y: Interval) -> Interval:
    """Returns x + y."""
    low, high = x[0] + y[0], x[1] + y[1]
    # ∞ − ∞ says nothing.
    return (-np.inf if math.isnan(low) else down(low)), (np.inf if math.isnan(high) else up(high))


@inner
def product(a: float, b: float) -> float:
    """Returns a b, rounded to nearest, with 0 · ∞ = 0."""
    return 0.0 if a == 0.0 or b == 0.0 else a * b


@inner
def times(x: Interval, y: Interval) -> Interval:
    """Returns x y, with 0 · ∞ = 0."""
    (a, b), (c, d) = x, y
    if (a == 0.0 and b == 0.0) or (c == 0.0 and d == 0.0):
        return 0.0, 0.0
    p, q, r, s = product(a, c), product(a, d), product(b, c), product(b, d)
    low, high = min(min(p, q), min(r, s)), max(max(p, q), max(r, s))
    low, high = down(low) - TINY, up(high) + TINY
    # A product that underflows is 0, whatever its sign: that of the factors tells it.
    if (a >= 0.0 and c >= 0.0) or (b <= 0.0 and d <= 0.0):
        low = max(low, 0.0)
    if (a >= 0.0 and d <= 0.0) or (b <= 0.0 and c >= 0.0):
        high = min(high, 0.0)
    return low, high


@inner
def scaled(factor: float, x: Interval) -> Interval:
    """Returns factor · x, exactly if that only changes signs."""
    if abs(factor) == 1.0:
        return x if factor > 0.0 else (-x[1], -x[0])
    return times((factor, factor), x)


@inner
def minus(x: Interval) -> Interval:
    """Returns −x, exactly."""
    return -x[1], -x[0]


@inner
def reciprocal(x: Interval) -> Interval:
    """Returns 1 / x; all numbers where 0 is inside."""
    a, b = x
    if not (a >= 0.0 or b <= 0.0) or (a == 0.0 and b == 0.0):
        return -np.inf, np.inf
    low = -np.inf if b == 0.0 else down(1.0 / b) - TINY
    return low, (np.inf if a == 0.0 else up(1.0 / a) + TINY)


@inner
def _whole_power(x: float, exponent: int) -> Interval:
    """Returns bounds of x^p of a number x ≥ 0: p/2 u x^p covers the errors of p − 1 products."""
    value, square, left = 1.0, x, exponent
    while left > 0:
        if left % 2 == 1:
            value *= square
        left //= 2
        if left > 0:
            square *= square
    relative = exponent * UNIT
    low, high = value * (1.0 - relative) - TINY, value * (1.0 + relative) + TINY
    return min(max(low, 0.0), LARGEST), (0.0 if x == 0.0 else high)


@inner
def power(x: Interval, exponent: int) -> Interval:
    """Returns x^p of a whole p ≥ 0."""
    a, b = x
    if exponent == 0:
        return 1.0, 1.0
    if exponent == 1:
        return x
    first, last = _whole_power(abs(a), exponent), _whole_power(abs(b), exponent)
    if exponent % 2 == 0:
        if a >= 0.0:
            return first[0], last[1]
        if b <= 0.0:
            return last[0], first[1]
        return 0.0, max(first[1], last[1])
    return (first[0] if a >= 0.0 else -first[1]), (last[1] if b >= 0.0 else -last[0])


@inner
def widened(low: float, high: float) -> Interval:
    """Returns an interval widened by the rounding of the C library's functions."""
    a = low - LIBRARY * abs(low) - TINY if low < np.inf else LARGEST
    b = high + LIBRARY * abs(high) + TINY if high > -np.inf else -LARGEST
    return a, b


@inner
def real_power(x: Interval, exponent: Interval) -> Interval:
    """Returns x^p over all p in an interval, and the part of x that is 0 or more.

    Upside down if there is none, nor any value.
    """
    base, b = max(x[0], 0.0), x[1]
    if b < 0.0 or (b == 0.0 and exponent[1] <= 0.0):
        return np.inf, -np.inf
    low, high = np.inf, 0.0
    # A power is monotone along both of its arguments.
    for p in exponent:
        for y in (base, b):
            value = y**p if y > 0.0 else (0.0 if p > 0.0 else np.inf)
            low, high = min(low, value), max(high, value)
    low, high = widened(low, high)
    return max(low, 0.0), high


@inner
def exponential(x: Interval) -> Interval:
    """Returns exp x."""
    low, high = widened(math.exp(x[0]), math.exp(x[1]) if x[1] < 709.0 else np.inf)
    return max(low, 0.0), high


@inner
def logarithm(x: Interval) -> Interval:
    """Returns log x over the part from 0 on, −∞ at 0; upside down if there is none.

    With 0 · ∞ = 0, x log x is 0 at 0, whatever else it is multiplied by.
    """
    if x[1] < 0.0:
        return np.inf, -np.inf
    low = math.log(x[0]) if x[0] > 0.0 else -np.inf
    return widened(low, math.log(x[1]) if x[1] > 0.0 else -np.inf)


@inner
def x_log(x: Interval) -> Interval:
    """Returns x log x, which is 0 at 0, over the part from 0 on; upside down if there is none."""
    if x[1] < 0.0:
        return np.inf, -np.inf
    a, turn = max(x[0], 0.0), math.exp(-1.0)
    first = a * math.log(a) if a > 0.0 else 0.0
    last = x[1] * math.log(x[1]) if x[1] > 0.0 else 0.0
    return widened(-turn if a < turn < x[1] else min(first, last), max(first, last))


@inner
def cosine(x: Interval) -> Interval:
    """Returns cos x."""
    return _wave(x, math.cos(x[0]), math.cos(x[1]), 0.0)


@inner
def sine(x: Interval) -> Interval:
    """Returns sin x."""
    return _wave(x, math.sin(x[0]), math.sin(x[1]), 0.25)


@inner
def _wave(x: Interval, first: float, last: float, top: float) -> Interval:
    """Returns the range of a wave between its values at both ends; its top is at 2π top."""
    if not x[1] - x[0] < 6.0:
        return -1.0, 1.0
    low, high = widened(min(first, last), max(first, last))
    low = -1.0 if _has_turn(x, top + 0.5) else max(low, -1.0)
    return low, (1.0 if _has_turn(x, top) else min(high, 1.0))


@inner
def _has_turn(x: Interval, phase: float) -> bool:
    """Returns whether 2π (k + phase) may be in x for a whole k."""
    first, last = x[0] / (2.0 * math.pi) - phase, x[1] / (2.0 * math.pi) - phase
    slack = _TURN_UNITS * (1.0 + max(abs(first), abs(last)))
    return math.floor(last + slack) >= math.ceil(first - slack)
