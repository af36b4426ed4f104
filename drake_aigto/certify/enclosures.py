"""Enclosures of a formula over a box: value, gradient and Hessian, by interval arithmetic.

Derivatives go forward along the tape (Moore, Kearfott & Cloud 2009, "Introduction to Interval
Analysis", ch. 9). At a kink within the box, gradients are those of both sides, which makes the
mean value theorem hold there too (Clarke 1983, ch. 2), and Hessians are all numbers.
"""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.certify.intervals import (
    Interval,
    arc_tangent,
    cosine,
    exponential,
    hyperbolic_tangent,
    logarithm,
    plus,
    power,
    real_power,
    reciprocal,
    sine,
    times,
)
from drake_aigto.certify.tape import Operation, Tape
from drake_aigto.jit import inner

_NUMBER = int(Operation.NUMBER)
_SHIFT, _SCALE = int(Operation.SHIFT), int(Operation.SCALE)
_ADD, _MULTIPLY = int(Operation.ADD), int(Operation.MULTIPLY)
_MAX, _MIN, _ABS = int(Operation.MAX), int(Operation.MIN), int(Operation.ABS)
_POWER, _REAL_POWER = int(Operation.POWER), int(Operation.REAL_POWER)
_RECIPROCAL, _EXP, _LOG = int(Operation.RECIPROCAL), int(Operation.EXP), int(Operation.LOG)
_SIN, _COS = int(Operation.SIN), int(Operation.COS)
_TANH = int(Operation.TANH)

# No plain integers: Numba would compile `enclose` once for each.
VALUE, GRADIENT, HESSIAN = (cast(int, np.int64(order)) for order in range(3))


class Scratch(NamedTuple):
    """Enclosures of all entries of a formula over L variables; the last axis is (low, high).

    Attributes:
        values: shape (E, 2).
        gradients: shape (E, L, 2).
        hessians: shape (E, L (L + 1)/2, 2), row i ≥ column j at i (i + 1)/2 + j.
    """

    values: Floats
    gradients: Floats
    hessians: Floats


def make_scratch(tape: Tape, num_variables: int) -> Scratch:
    """Returns room for the longest formula of a tape."""
    longest = int(np.max(np.diff(tape.starts), initial=1))
    pairs = num_variables * (num_variables + 1) // 2
    return Scratch(
        np.empty((longest, 2)),
        np.empty((longest, num_variables, 2)),
        np.empty((longest, pairs, 2)),
    )


@inner
def _derivatives(
    operation: int, a: float, b: float, exponent: int, p: float, order: int
) -> tuple[Interval, Interval, Interval]:
    """Returns enclosures of a function of one argument in [a, b], and of its two derivatives."""
    all_, none = (-np.inf, np.inf), (0.0, 0.0)
    if operation == _POWER:
        value = power(a, b, exponent)
        first = second = none
        if order > 0 and exponent > 0:
            degree = float(exponent)
            first = times(degree, degree, *power(a, b, exponent - 1))
        if order > 1 and exponent > 1:
            factor = float(exponent * (exponent - 1))
            second = times(factor, factor, *power(a, b, exponent - 2))
        return value, first, second
    if operation == _EXP:
        value = exponential(a, b)
        return value, value, value
    if operation in (_SIN, _COS):
        s, c = sine(a, b), cosine(a, b)
        if operation == _SIN:
            return s, c, (-s[1], -s[0])
        return c, (-s[1], -s[0]), (-c[1], -c[0])
    if operation == _RECIPROCAL:
        value = reciprocal(a, b)
        square, cube = power(value[0], value[1], 2), power(value[0], value[1], 3)
        return value, (-square[1], -square[0]), (2.0 * cube[0], 2.0 * cube[1])
    if operation == _REAL_POWER:
        first = times(p, p, *real_power(a, b, p - 1.0))
        both = times(p, p, *plus(p, p, -1.0, -1.0))
        second = times(both[0], both[1], *real_power(a, b, p - 2.0))
        return real_power(a, b, p), first, second
    if operation == _LOG:
        first = reciprocal(max(a, 0.0), b)
        square = power(first[0], first[1], 2)
        return logarithm(a, b), first, (-square[1], -square[0])
    if operation == _ABS:
        if a > 0.0:
            return (a, b), (1.0, 1.0), none
        if b < 0.0:
            return (-b, -a), (-1.0, -1.0), none
        return (0.0, max(-a, b)), (-1.0, 1.0), all_
    if operation == _TANH:
        value = hyperbolic_tangent(a, b)
        square = power(value[0], value[1], 2)
        first = plus(1.0, 1.0, -square[1], -square[0])
        second = times(-2.0 * value[1], -2.0 * value[0], *first)
        return value, first, second
    below = plus(1.0, 1.0, *power(a, b, 2))  # tan⁻¹
    first = reciprocal(*below)
    second = times(-2.0 * b, -2.0 * a, *power(first[0], first[1], 2))
    return arc_tangent(a, b), first, second


@inner
def _apply(
    to: int,
    of: int,
    value: Interval,
    first: Interval,
    second: Interval,
    order: int,
    scratch: Scratch,
) -> None:
    """Fills an entry with a function of another, by the chain rule."""
    values, gradients, hessians = scratch
    values[to, 0], values[to, 1] = value
    size = gradients.shape[1]
    if order == 0:
        return
    place = 0
    for i in range(size):
        slope = gradients[of, i, 0], gradients[of, i, 1]
        gradients[to, i, 0], gradients[to, i, 1] = times(first[0], first[1], slope[0], slope[1])
        if order < 2:
            continue
        for j in range(i + 1):
            other = gradients[of, j, 0], gradients[of, j, 1]
            if i == j:
                both = power(slope[0], slope[1], 2)
            else:
                both = times(slope[0], slope[1], other[0], other[1])
            bent = times(second[0], second[1], both[0], both[1])
            passed = times(first[0], first[1], hessians[of, place, 0], hessians[of, place, 1])
            hessians[to, place, 0], hessians[to, place, 1] = plus(
                bent[0], bent[1], passed[0], passed[1]
            )
            place += 1


@inner
def _multiply(to: int, a: int, b: int, order: int, scratch: Scratch) -> None:
    values, gradients, hessians = scratch
    u, v = (values[a, 0], values[a, 1]), (values[b, 0], values[b, 1])
    values[to, 0], values[to, 1] = times(u[0], u[1], v[0], v[1])
    if order == 0:
        return
    place = 0
    for i in range(gradients.shape[1]):
        ui, vi = (
            (gradients[a, i, 0], gradients[a, i, 1]),
            (gradients[b, i, 0], gradients[b, i, 1]),
        )
        gradients[to, i, 0], gradients[to, i, 1] = plus(
            *times(u[0], u[1], vi[0], vi[1]), *times(v[0], v[1], ui[0], ui[1])
        )
        if order < 2:
            continue
        for j in range(i + 1):
            uj, vj = (
                (gradients[a, j, 0], gradients[a, j, 1]),
                (gradients[b, j, 0], gradients[b, j, 1]),
            )
            mixed = plus(*times(ui[0], ui[1], vj[0], vj[1]), *times(uj[0], uj[1], vi[0], vi[1]))
            passed = plus(
                *times(u[0], u[1], hessians[b, place, 0], hessians[b, place, 1]),
                *times(v[0], v[1], hessians[a, place, 0], hessians[a, place, 1]),
            )
            hessians[to, place, 0], hessians[to, place, 1] = plus(*mixed, *passed)
            place += 1


@inner
def _copy(to: int, of: int, order: int, scratch: Scratch) -> None:
    """Fills an entry's derivatives with those of another."""
    _, gradients, hessians = scratch
    for end in range(2):
        for i in range(gradients.shape[1] if order > 0 else 0):
            gradients[to, i, end] = gradients[of, i, end]
        for i in range(hessians.shape[1] if order > 1 else 0):
            hessians[to, i, end] = hessians[of, i, end]


@inner
def _start(to: int, variable: int, order: int, scratch: Scratch) -> None:
    """Fills an entry's derivatives with those of a variable, or of a number, which is −1."""
    _, gradients, hessians = scratch
    for end in range(2):
        for i in range(gradients.shape[1] if order > 0 else 0):
            gradients[to, i, end] = 1.0 if i == variable else 0.0
        for i in range(hessians.shape[1] if order > 1 else 0):
            hessians[to, i, end] = 0.0


@inner
def _take_larger(to: int, a: int, b: int, sign: float, order: int, scratch: Scratch) -> None:
    """Fills an entry with the larger of two, or with sign −1 the smaller one."""
    values, gradients, hessians = scratch
    for end in range(2):
        values[to, end] = sign * max(sign * values[a, end], sign * values[b, end])
    is_a = values[a, 0] > values[b, 1] if sign > 0.0 else values[a, 1] < values[b, 0]
    is_b = values[b, 0] > values[a, 1] if sign > 0.0 else values[b, 1] < values[a, 0]
    if is_a or is_b:
        _copy(to, a if is_a else b, order, scratch)
        return
    for i in range(gradients.shape[1]):
        gradients[to, i, 0] = min(gradients[a, i, 0], gradients[b, i, 0])
        gradients[to, i, 1] = max(gradients[a, i, 1], gradients[b, i, 1])
    for i in range(hessians.shape[1]):
        hessians[to, i, 0], hessians[to, i, 1] = -np.inf, np.inf


@inner
def _add(to: int, a: int, b: int, order: int, scratch: Scratch) -> None:
    values, gradients, hessians = scratch
    values[to, 0], values[to, 1] = plus(values[a, 0], values[a, 1], values[b, 0], values[b, 1])
    if order > 0:
        for i in range(gradients.shape[1]):
            gradients[to, i, 0], gradients[to, i, 1] = plus(
                gradients[a, i, 0], gradients[a, i, 1], gradients[b, i, 0], gradients[b, i, 1]
            )
    if order > 1:
        for i in range(hessians.shape[1]):
            hessians[to, i, 0], hessians[to, i, 1] = plus(
                hessians[a, i, 0], hessians[a, i, 1], hessians[b, i, 0], hessians[b, i, 1]
            )


@inner
def enclose(
    tape: Tape, formula: int, low: Floats, high: Floats, order: int, scratch: Scratch
) -> int:
    """Fills a scratch with the enclosures of a formula over low ≤ x ≤ high (L,).

    Args:
        tape: holds the formula.
        formula: its number.
        low: lower ends.
        high: upper ends.
        order: 0 for values, 1 for gradients too, 2 for Hessians too.
        scratch: at least as long as the formula.

    Returns:
        Where its own enclosures are; −1 if it has no value anywhere in the box.
    """
    operations, first, second, numbers, starts = tape
    values = scratch.values
    start, count = starts[formula], starts[formula + 1] - starts[formula]
    for k in range(count):
        operation, a, b = operations[start + k], first[start + k], second[start + k]
        p = numbers[start + k]
        if operation <= _SHIFT:
            if operation == _SHIFT:
                values[k, 0], values[k, 1] = plus(values[a, 0], values[a, 1], p, p)
                _copy(k, a, order, scratch)
            elif operation == _NUMBER:
                values[k, 0], values[k, 1] = p, p
                _start(k, -1, order, scratch)
            else:
                values[k, 0], values[k, 1] = low[a], high[a]
                _start(k, a, order, scratch)
        elif operation == _SCALE:
            _apply(
                k, a, times(p, p, values[a, 0], values[a, 1]), (p, p), (0.0, 0.0), order, scratch
            )
        elif operation == _ADD:
            _add(k, a, b, order, scratch)
        elif operation == _MULTIPLY:
            _multiply(k, a, b, order, scratch)
        elif operation in (_MAX, _MIN):
            _take_larger(k, a, b, 1.0 if operation == _MAX else -1.0, order, scratch)
        else:
            value, slope, curvature = _derivatives(
                operation, values[a, 0], values[a, 1], b, p, order
            )
            if value[0] > value[1]:
                return -1
            _apply(k, a, value, slope, curvature, order, scratch)
    return count - 1
