"""Interval arithmetic that is rounded outward, for compiled code.

IEEE arithmetic and square roots are within half a unit in the last place, ½ u |x| with u = 2⁻⁵²; so
x (1 ∓ u) is beyond what was rounded to x. Results that may have underflowed move by a number that
is above every subnormal one. Of exp, log, tan⁻¹, tanh, sin, cos and powers with a fraction, four
such units are taken: the C library's are within one (GNU libc manual, "Errors in Math Functions").
"""

from __future__ import annotations

import math

import numpy as np

from drake_aigto.kernels import inner

Interval = tuple[float, float]

UNIT = 2.0**-52
LIBRARY = 4.0 * UNIT
_UNDERFLOW = 1e-300
# Where a wave has its top is known to this many units of the number of turns.
_TURN_UNITS = 8.0 * UNIT


@inner
def down(x: float) -> float:
    """Returns a number below all that round to x; 0 is exact."""
    return x * (1.0 - UNIT) if x > 0.0 else x * (1.0 + UNIT)


@inner
def up(x: float) -> float:
    """Returns a number above all that round to x; 0 is exact."""
    return x * (1.0 + UNIT) if x > 0.0 else x * (1.0 - UNIT)


@inner
def plus(x: Interval, y: Interval) -> Interval:
    """Returns x + y."""
    low, high = x[0] + y[0], x[1] + y[1]
    # ∞ − ∞ says nothing.
    return (-np.inf if math.isnan(low) else down(low)), (np.inf if math.isnan(high) else up(high))


@inner
def _product(a: float, b: float) -> float:
    return 0.0 if a == 0.0 or b == 0.0 else a * b


@inner
def times(x: Interval, y: Interval) -> Interval:
    """Returns x y, with 0 · ∞ = 0."""
    (a, b), (c, d) = x, y
    if (a == 0.0 and b == 0.0) or (c == 0.0 and d == 0.0):
        return 0.0, 0.0
    p, q, r, s = _product(a, c), _product(a, d), _product(b, c), _product(b, d)
    low, high = min(min(p, q), min(r, s)), max(max(p, q), max(r, s))
    if low >= 0.0 and (a == 0.0 or b == 0.0 or c == 0.0 or d == 0.0):
        return 0.0, up(high) + _UNDERFLOW
    return down(low) - _UNDERFLOW, up(high) + _UNDERFLOW


@inner
def scaled(factor: float, x: Interval) -> Interval:
    """Returns factor · x."""
    return times((factor, factor), x)


@inner
def minus(x: Interval) -> Interval:
    """Returns −x, exactly."""
    return -x[1], -x[0]


@inner
def reciprocal(x: Interval) -> Interval:
    """Returns 1 / x; all numbers where 0 is inside."""
    a, b = x
    if a > 0.0 or b < 0.0:
        return down(1.0 / b) - _UNDERFLOW, up(1.0 / a) + _UNDERFLOW
    if a == 0.0 and b > 0.0:
        return down(1.0 / b), np.inf
    if b == 0.0 and a < 0.0:
        return -np.inf, up(1.0 / a)
    return -np.inf, np.inf


@inner
def _whole_power(x: float, exponent: int) -> Interval:
    """Returns bounds of x^p of a number x ≥ 0."""
    value = 1.0
    for _ in range(exponent):
        value *= x
    if value == 0.0:
        return 0.0, (0.0 if x == 0.0 else _UNDERFLOW)
    if math.isinf(value):
        return (np.inf if math.isinf(x) else 1e300), np.inf
    relative = exponent * UNIT
    return value * (1.0 - relative), value * (1.0 + relative) + _UNDERFLOW


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
    a = low - LIBRARY * abs(low) - _UNDERFLOW if math.isfinite(low) else low
    b = high + LIBRARY * abs(high) + _UNDERFLOW if math.isfinite(high) else high
    return a, b


@inner
def real_power(x: Interval, exponent: float) -> Interval:
    """Returns x^p over the part where the base is 0 or more; upside down if there is none."""
    base, b = max(x[0], 0.0), x[1]
    if b < 0.0:
        return np.inf, -np.inf
    if exponent > 0.0:
        low, high = base**exponent, b**exponent
    else:
        low = b**exponent if b > 0.0 else np.inf
        high = base**exponent if base > 0.0 else np.inf
    low, high = widened(low, high)
    return max(low, 0.0), high


@inner
def exponential(x: Interval) -> Interval:
    """Returns exp x."""
    low, high = widened(math.exp(x[0]), math.exp(x[1]) if x[1] < 709.0 else np.inf)
    return max(low, 0.0), high


@inner
def logarithm(x: Interval) -> Interval:
    """Returns log x over the part above 0; upside down if there is none."""
    if x[1] <= 0.0:
        return np.inf, -np.inf
    return widened(math.log(x[0]) if x[0] > 0.0 else -np.inf, math.log(x[1]))


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
