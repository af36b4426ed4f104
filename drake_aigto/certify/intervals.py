"""Interval arithmetic that is rounded outward, for compiled code.

IEEE arithmetic and square roots are within half a unit in the last place, ½ u |x| with u = 2⁻⁵²; so
x (1 ∓ u) is beyond what was rounded to x. Results that may have underflowed move by a number that
is above every subnormal one. Of exp, log, tan⁻¹, tanh, sin, cos and powers with a fraction, four
such units are taken: the C library's are within one (GNU libc manual, "Errors in Math Functions").
"""

from __future__ import annotations

import math

import numpy as np

from drake_aigto.jit import inner

Interval = tuple[float, float]

UNIT = 2.0**-52
_UNDERFLOW = 1e-300
_LIBRARY = 4.0 * UNIT
# Where a wave has its top is known to so many units of the number of turns.
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
def plus(a: float, b: float, c: float, d: float) -> Interval:
    """Returns [a, b] + [c, d]."""
    low, high = a + c, b + d
    # ∞ − ∞ says nothing.
    return (-np.inf if math.isnan(low) else down(low)), (np.inf if math.isnan(high) else up(high))


@inner
def _product(x: float, y: float) -> float:
    return 0.0 if x == 0.0 or y == 0.0 else x * y


@inner
def times(a: float, b: float, c: float, d: float) -> Interval:
    """Returns [a, b] · [c, d], with 0 · ∞ = 0."""
    if (a == 0.0 and b == 0.0) or (c == 0.0 and d == 0.0):
        return 0.0, 0.0
    p, q, r, s = _product(a, c), _product(a, d), _product(b, c), _product(b, d)
    low, high = min(min(p, q), min(r, s)), max(max(p, q), max(r, s))
    if low >= 0.0 and (a == 0.0 or b == 0.0 or c == 0.0 or d == 0.0):
        return 0.0, up(high) + _UNDERFLOW
    return down(low) - _UNDERFLOW, up(high) + _UNDERFLOW


@inner
def reciprocal(a: float, b: float) -> Interval:
    """Returns 1 / [a, b]; all numbers where 0 is inside."""
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
def power(a: float, b: float, exponent: int) -> Interval:
    """Returns [a, b]^p of a whole p ≥ 0."""
    if exponent == 0:
        return 1.0, 1.0
    if exponent == 1:
        return a, b
    first, last = _whole_power(abs(a), exponent), _whole_power(abs(b), exponent)
    if exponent % 2 == 0:
        if a >= 0.0:
            return first[0], last[1]
        if b <= 0.0:
            return last[0], first[1]
        return 0.0, max(first[1], last[1])
    return (first[0] if a >= 0.0 else -first[1]), (last[1] if b >= 0.0 else -last[0])


@inner
def _widened(low: float, high: float) -> Interval:
    a = low - _LIBRARY * abs(low) - _UNDERFLOW if math.isfinite(low) else low
    b = high + _LIBRARY * abs(high) + _UNDERFLOW if math.isfinite(high) else high
    return a, b


@inner
def real_power(a: float, b: float, exponent: float) -> Interval:
    """Returns [a, b]^p over the part where the base is 0 or more; upside down if there is none."""
    if b < 0.0:
        return np.inf, -np.inf
    base = max(a, 0.0)
    if exponent > 0.0:
        low, high = _widened(base**exponent, b**exponent)
        return max(low, 0.0), high
    low = b**exponent if b > 0.0 else np.inf
    high = base**exponent if base > 0.0 else np.inf
    low, high = _widened(low, high)
    return max(low, 0.0), high


@inner
def exponential(a: float, b: float) -> Interval:
    """Returns exp [a, b]."""
    low, high = _widened(math.exp(a), math.exp(b) if b < 709.0 else np.inf)
    return max(low, 0.0), high


@inner
def logarithm(a: float, b: float) -> Interval:
    """Returns log [a, b] over the part above 0; upside down if there is none."""
    if b <= 0.0:
        return np.inf, -np.inf
    return _widened(math.log(a) if a > 0.0 else -np.inf, math.log(b))


@inner
def arc_tangent(a: float, b: float) -> Interval:
    """Returns tan⁻¹ [a, b]."""
    return _widened(math.atan(a), math.atan(b))


@inner
def hyperbolic_tangent(a: float, b: float) -> Interval:
    """Returns tanh [a, b]."""
    return _widened(math.tanh(a), math.tanh(b))


@inner
def _has_turn(a: float, b: float, phase: float) -> bool:
    """Returns whether 2π (k + phase) may be in [a, b] for a whole k."""
    first, last = a / (2.0 * math.pi) - phase, b / (2.0 * math.pi) - phase
    slack = _TURN_UNITS * (1.0 + max(abs(first), abs(last)))
    return math.floor(last + slack) >= math.ceil(first - slack)


@inner
def cosine(a: float, b: float) -> Interval:
    """Returns cos [a, b]."""
    if not b - a < 6.0:
        return -1.0, 1.0
    first, last = math.cos(a), math.cos(b)
    low, high = _widened(min(first, last), max(first, last))
    low = -1.0 if _has_turn(a, b, 0.5) else max(low, -1.0)
    return low, (1.0 if _has_turn(a, b, 0.0) else min(high, 1.0))


@inner
def sine(a: float, b: float) -> Interval:
    """Returns sin [a, b]."""
    if not b - a < 6.0:
        return -1.0, 1.0
    first, last = math.sin(a), math.sin(b)
    low, high = _widened(min(first, last), max(first, last))
    low = -1.0 if _has_turn(a, b, 0.75) else max(low, -1.0)
    return low, (1.0 if _has_turn(a, b, 0.25) else min(high, 1.0))
