"""Rows of tapes before they run: arguments, functions and coefficients of copies, lane by lane.

Functions take no slices and no more arrays than they read (`box.kernels`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from drake_aigto.arrays import Floats, Ints, Records
from drake_aigto.box.functions import factor_mean, trigonometric_means
from drake_aigto.box.tapes import MEAN, ONES
from drake_aigto.kernels import borrowing, inner
from drake_aigto.terms import FunctionKind

PARTS = 6  # of a factor's mean: value and derivatives
_COSINE = int(FunctionKind.COSINE)


@borrowing
def load_arguments(
    arguments: Records,
    tape: Any,
    after: Any,
    variables: Ints,
    count: int,
    center: Floats,
    half_width: Floats,
    rows: Floats,
) -> int:
    """Sets the rows of ones and of a tape's arguments; returns the next row."""
    row = MEAN + 1
    for k in range(count):
        rows[ONES, k] = 1.0
    for a in range(tape.first_argument, after.first_argument):
        argument = arguments[a]
        variable, scale, offset = argument.variable, argument.scale, argument.offset
        for k in range(count):
            i = variables[variable, k]
            reach = scale * half_width[i]
            rows[row, k] = scale * center[i] + offset
            rows[row + 1, k] = reach * reach
        row += 2
    return row


@borrowing
def load_functions(
    functions: Records,
    tape: Any,
    after: Any,
    transcendental: bool | None,
    variables: Ints,
    count: int,
    center: Floats,
    half_width: Floats,
    parts: Floats,
    waves: Floats,
    rows: Floats,
    row: int,
) -> int:
    """Sets the rows of a tape's functions, from `row` on; returns the next row.

    Without derivatives of the tape, those of functions are left out. The last cosine and sine of
    each variable are kept, with scale, offset and exponent behind them (n, 15): copies of a chain
    read those of one stage many times.
    """
    num_needed = PARTS if tape.first_slope < after.first_slope else 1
    for f in range(tape.first_function, after.first_function):
        it = functions[f]
        is_pair = it.kind == _COSINE
        for k in range(count):
            i = variables[it.variable, k]
            if is_pair:
                _keep_waves(it, i, center[i], half_width[i], waves, transcendental)
                for part in range(num_needed):
                    rows[row + part, k] = waves[i, part]
                    rows[row + PARTS + part, k] = waves[i, PARTS + part]
                continue
            box = center[i], half_width[i]
            factor_mean(it.kind, it.exponent, it.scale, it.offset, *box, parts, transcendental)
            for part in range(num_needed):
                rows[row + part, k] = parts[part]
        row += 2 * PARTS if is_pair else PARTS
    return row


@inner
def make_waves(num_variables: int, transcendental: bool | None) -> Floats:
    """Returns room for `_keep_waves`, if that is called, with nothing kept: no scale is 0."""
    if transcendental is None:
        return np.empty((0, 2 * PARTS + 3))
    waves = np.empty((num_variables, 2 * PARTS + 3))
    waves[:, 2 * PARTS] = 0.0
    return waves


@borrowing
def _keep_waves(
    it: Any, i: int, center: float, half_width: float, waves: Floats, transcendental: bool | None
) -> None:
    """Has the means of a variable's cosine and sine in row i of `waves`, with what they are of."""
    end, scale, offset, exponent = 2 * PARTS, it.scale, it.offset, it.exponent
    if waves[i, end] == scale and waves[i, end + 1] == offset and waves[i, end + 2] == exponent:
        return
    if transcendental is not None:  # Else Numba compiles without them.
        trigonometric_means(exponent, scale, offset, center, half_width, waves[i])
    waves[i, end], waves[i, end + 1], waves[i, end + 2] = scale, offset, exponent


@borrowing
def load_coefficients(
    coefficients: Floats,
    num_terms: int,
    lanes: Records,
    chosen: Ints,
    count: int,
    factors: Floats,
    rows: Floats,
    row: int,
) -> int:
    """Sets the rows of a tape's coefficients times factors, from `row` on; returns the next row."""
    first = lanes[chosen[0]].first_coefficient
    last = lanes[chosen[count - 1]].first_coefficient
    for m in range(num_terms):
        if first == last:  # Copies of one sum, as lanes are in the order of sums.
            for k in range(count):
                rows[row + m, k] = factors[k] * coefficients[first + m]
        else:
            for k in range(count):
                own = lanes[chosen[k]].first_coefficient
                rows[row + m, k] = factors[k] * coefficients[own + m]
    return row + num_terms
