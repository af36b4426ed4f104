"""Enclosures of formulas over boxes: values, gradients and Hessians, by interval arithmetic.

Derivatives go forward along the tape (Moore, Kearfott & Cloud 2009, "Introduction to Interval
Analysis", ch. 9). At a kink within the box, gradients are those of both sides, which makes the
mean value theorem hold there too (Clarke 1983, ch. 2), and Hessians are all numbers. These are so
too where the argument of a root or a logarithm comes down to 0, and all derivatives where there is
no value in a part of the box: a finite Hessian says that f has values around the box, too.

A jet of a function of L variables has J intervals (low, high), shape (J, 2): its value, the L of
its gradient, and its Hessian, of which row i ≥ column j is at 1 + L + i (i + 1)/2 + j. Of order 0
it ends after the value, of order 1 after the gradient.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.certify import intervals as iv
from drake_aigto.certify.intervals import Interval
from drake_aigto.certify.tape import Operation, Tape
from drake_aigto.kernels import inner, kernel

VALUE, GRADIENT, HESSIAN = range(3)


@inner
def jet_size(num_variables: int, order: int) -> int:
    """Returns J."""
    pairs = num_variables * (num_variables + 1) // 2
    return 1 + (num_variables if order > 0 else 0) + (pairs if order > 1 else 0)


@inner
def make_scratch(tape: Tape, num_variables: int, order: int) -> Floats:
    """Returns room for the jets of all entries of the longest formula of a tape (E, J, 2)."""
    longest = 1
    for formula in range(tape.starts.size - 1):
        longest = max(longest, tape.starts[formula + 1] - tape.starts[formula])
    return np.empty((longest, jet_size(num_variables, order), 2))


@inner
def at(jets: Floats, entry: int, place: int) -> Interval:
    """Returns an interval of jets (E, J, 2)."""
    return jets[entry, place, 0], jets[entry, place, 1]


@inner
def put(jets: Floats, entry: int, place: int, x: Interval) -> None:
    """Sets an interval of jets (E, J, 2)."""
    jets[entry, place, 0], jets[entry, place, 1] = x


@inner
def _slope_of_power(x: Interval, exponent: Interval) -> Interval:
    """Returns x^p as a part of a derivative: all numbers where it has no value."""
    low, high = iv.real_power(x, exponent)
    return (low, high) if low <= high else (-np.inf, np.inf)


@inner
def derivatives(
    operation: int, x: Interval, exponent: int, p: float, order: int
) -> tuple[Interval, Interval, Interval]:
    """Returns enclosures of a function of one argument, and of its two derivatives."""
    none = 0.0, 0.0
    if operation == Operation.POWER:
        first = second = none
        if order > 0 and exponent > 0:
            first = iv.scaled(float(exponent), iv.power(x, exponent - 1))
        if order > 1 and exponent > 1:
            second = iv.scaled(float(exponent * (exponent - 1)), iv.power(x, exponent - 2))
        return iv.power(x, exponent), first, second
    if operation == Operation.EXP:
        value = iv.exponential(x)
        return value, value, value
    if operation == Operation.SIN:
        s, c = iv.sine(x), iv.cosine(x)
        return s, c, iv.minus(s)
    if operation == Operation.COS:
        s, c = iv.sine(x), iv.cosine(x)
        return c, iv.minus(s), iv.minus(c)
    if operation == Operation.RECIPROCAL:
        value = iv.reciprocal(x)
        if x[0] < 0.0 < x[1]:  # It jumps from −∞ to ∞, whatever its slopes are.
            return value, value, value
        return value, iv.minus(iv.power(value, 2)), iv.scaled(2.0, iv.power(value, 3))
    if operation == Operation.REAL_POWER:
        less, least = iv.plus((p, p), (-1.0, -1.0)), iv.plus((p, p), (-2.0, -2.0))
        first, second = _slope_of_power(x, less), _slope_of_power(x, least)
        return iv.real_power(x, (p, p)), iv.scaled(p, first), iv.times(iv.scaled(p, less), second)
    if operation == Operation.LOG:
        first = iv.reciprocal((max(x[0], 0.0), x[1]))
        return iv.logarithm(x), first, iv.minus(iv.power(first, 2))
    if operation == Operation.X_LOG:
        first = iv.plus(iv.logarithm((x[0], max(x[1], iv.TINY))), (1.0, 1.0))
        return iv.x_log(x), first, iv.reciprocal((max(x[0], 0.0), x[1]))
    if operation == Operation.ABS:
        if x[0] > 0.0:
            return x, (1.0, 1.0), none
        if x[1] < 0.0:
            return iv.minus(x), (-1.0, -1.0), none
        return (0.0, max(-x[0], x[1])), (-1.0, 1.0), (-np.inf, np.inf)
    if operation == Operation.TANH:
        value = iv.widened(math.tanh(x[0]), math.tanh(x[1]))
        first = iv.plus((1.0, 1.0), iv.minus(iv.power(value, 2)))
        return value, first, iv.times((-2.0 * value[1], -2.0 * value[0]), first)
    first = iv.reciprocal(iv.plus((1.0, 1.0), iv.power(x, 2)))  # of tan⁻¹
    second = iv.times((-2.0 * x[1], -2.0 * x[0]), iv.power(first, 2))
    return iv.widened(math.atan(x[0]), math.atan(x[1])), first, second


@inner
def function_value(operation: int, a: int, b: int, p: float, jets: Floats) -> Interval:
    """Returns the range of a function, but for sums, from those of its arguments in jets."""
    x = at(jets, a, 0)
    if operation == Operation.MULTIPLY:
        return iv.times(x, at(jets, b, 0))
    if operation == Operation.MAX:
        return max(x[0], at(jets, b, 0)[0]), max(x[1], at(jets, b, 0)[1])
    return derivatives(operation, x, b, p, VALUE)[0]


@inner
def _apply(
    jets: Floats,
    to: int,
    of: int,
    values: tuple[Interval, Interval, Interval],
    size: int,
    order: int,
) -> None:
    """Fills an entry with a function of another, by the chain rule."""
    value, first, second = values
    put(jets, to, 0, value)
    place = 1 + size
    for i in range(size if order > 0 else 0):
        slope = at(jets, of, 1 + i)
        put(jets, to, 1 + i, iv.times(first, slope))
        for j in range(i + 1 if order > 1 else 0):
            both = iv.power(slope, 2) if i == j else iv.times(slope, at(jets, of, 1 + j))
            bent = iv.plus(iv.times(second, both), iv.times(first, at(jets, of, place)))
            put(jets, to, place, bent)
            place += 1


@inner
def _multiply(jets: Floats, to: int, a: int, b: int, size: int, order: int) -> None:
    u, v = at(jets, a, 0), at(jets, b, 0)
    put(jets, to, 0, iv.times(u, v))
    place = 1 + size
    for i in range(size if order > 0 else 0):
        du, dv = at(jets, a, 1 + i), at(jets, b, 1 + i)
        put(jets, to, 1 + i, iv.plus(iv.times(u, dv), iv.times(v, du)))
        for j in range(i + 1 if order > 1 else 0):
            mixed = iv.plus(iv.times(du, at(jets, b, 1 + j)), iv.times(at(jets, a, 1 + j), dv))
            passed = iv.plus(iv.times(u, at(jets, b, place)), iv.times(v, at(jets, a, place)))
            put(jets, to, place, iv.plus(mixed, passed))
            place += 1


@inner
def _copy(jets: Floats, to: int, of: int, count: int) -> None:
    for place in range(count):
        put(jets, to, place, at(jets, of, place))


@inner
def _take_larger(jets: Floats, to: int, a: int, b: int, size: int, count: int) -> None:
    """Fills an entry with the larger of two."""
    first, second = at(jets, a, 0), at(jets, b, 0)
    if first[0] > second[1] or second[0] > first[1]:
        _copy(jets, to, a if first[0] > second[1] else b, count)
        return
    put(jets, to, 0, (max(first[0], second[0]), max(first[1], second[1])))
    for place in range(1, count):
        both, other = at(jets, a, place), at(jets, b, place)
        slope = min(both[0], other[0]), max(both[1], other[1])
        put(jets, to, place, slope if place <= size else (-np.inf, np.inf))


@inner
def enclose(tape: Tape, formula: int, low: Floats, high: Floats, order: int, jets: Floats) -> int:
    """Fills jets with the enclosures of a formula's entries over low ≤ x ≤ high (L,).

    Jets are as `make_scratch` returns them, of this order or a higher one. Returns the entry of the
    formula itself; −1 if it has no value anywhere in the box.
    """
    operations, first, second, numbers, starts = tape
    start, last = starts[formula], starts[formula + 1] - starts[formula] - 1
    size, count, is_partial, is_open = low.size, jet_size(low.size, order), False, True
    for k in range(last + 1):
        operation, a, b = operations[start + k], first[start + k], second[start + k]
        p = numbers[start + k]
        if operation == Operation.NUMBER or operation == Operation.VARIABLE:
            for place in range(1, count):
                put(jets, k, place, (0.0, 0.0))
            if operation == Operation.NUMBER:
                put(jets, k, 0, (p, p))
                continue
            put(jets, k, 0, (low[a], high[a]))
            if order > 0:
                put(jets, k, 1 + a, (1.0, 1.0))
        elif operation == Operation.SHIFT:
            _copy(jets, k, a, count)
            put(jets, k, 0, iv.plus(at(jets, a, 0), (p, p)))
        elif operation == Operation.SCALE:
            values = iv.scaled(p, at(jets, a, 0)), (p, p), (0.0, 0.0)
            _apply(jets, k, a, values, size, order)
        elif operation == Operation.ADD:
            for place in range(count):
                put(jets, k, place, iv.plus(at(jets, a, place), at(jets, b, place)))
        elif operation == Operation.MULTIPLY:
            _multiply(jets, k, a, b, size, order)
        elif operation == Operation.MAX:
            _take_larger(jets, k, a, b, size, count)
        else:
            x = at(jets, a, 0)
            if (
                operation == Operation.LOG
                or operation == Operation.X_LOG
                or operation == Operation.REAL_POWER
            ):
                is_partial |= x[0] < 0.0
                is_open &= x[0] > 0.0
            values = derivatives(operation, x, b, p, order)
            if values[0][0] > values[0][1]:
                return -1
            _apply(jets, k, a, values, size, order)
    if not is_open:
        for place in range(1 if is_partial else 1 + size, count):
            put(jets, last, place, (-np.inf, np.inf))
    return last


@kernel
def enclose_all(tape: Tape, formulas: Ints, low: Floats, high: Floats, order: int) -> Floats:
    """Returns jets (C, J, 2) of formulas, each over a cell of its own.

    Where a formula has no value anywhere in its cell, its value is ∞, and its derivatives are 0.

    Args:
        tape: holds them.
        formulas: their numbers (C,).
        low: lower ends of the cells (C, L), contiguous.
        high: upper ends.
        order: 0 for values, 1 for gradients too, 2 for Hessians too.
    """
    jets = make_scratch(tape, low.shape[1], order)
    found = np.zeros((formulas.size, jets.shape[1], 2))
    for c in range(formulas.size):
        end = enclose(tape, formulas[c], low[c], high[c], order, jets)
        if end < 0:
            put(found, c, 0, (np.inf, np.inf))
            continue
        for place in range(jets.shape[1]):
            put(found, c, place, at(jets, end, place))
    return found


def sum_outward(intervals: Floats, owners: Ints, count: int) -> Floats:
    """Returns the sums (count, 2) of intervals (C, 2) by their owners (C,), rounded outward."""
    # Each addition is off by half a unit of what is no more than the sum of sizes.
    terms = np.bincount(owners, minlength=count)
    found = np.empty((count, 2))
    for side, sign in enumerate((-1.0, 1.0)):
        own = np.ascontiguousarray(intervals[:, side])
        sizes = np.bincount(owners, np.abs(own), count)
        found[:, side] = np.bincount(owners, own, count) + sign * (terms + 2) * iv.UNIT * sizes
    return found


class SumOfFormulas:
    """Σ f_p over the program's variables, of the first formulas of a tape, by those each reads."""

    def __init__(self, tape: Tape, variables: Sequence[Sequence[int]]) -> None:
        """Takes the formulas."""
        self._tape = tape
        self._read = np.zeros((len(variables), max(map(len, variables), default=0)), dtype=np.int64)
        for row, read in zip(self._read, variables, strict=True):
            row[: len(read)] = read

    def range(self, low: Floats, high: Floats) -> Interval:
        """Returns bounds over low ≤ x ≤ high (n,), rounded outward."""
        formulas = np.arange(self._read.shape[0])
        found = enclose_all(self._tape, formulas, low[self._read], high[self._read], VALUE)[:, 0]
        if np.any(found[:, 0] == np.inf):
            return math.inf, math.inf
        ((least, most),) = sum_outward(found, np.zeros_like(formulas), 1).tolist()
        return least, most
