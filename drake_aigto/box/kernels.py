"""The hot loops: means of stacked sums over boxes, with their derivatives in (c, z = log w).

Copies of sums run their common tape side by side, each in a lane of rows (rows, lanes): innermost
loops are over lanes, for the compiler to turn into vector instructions.

A copy of weight 0 is off: it adds nothing, also where its own mean is infinite. At a half width of
0 means are values.

Shape letters: C copies, n variables. A symmetric matrix is kept in LAPACK's lower band storage,
transposed to be of one type for Numba however few diagonals there are: entry (i, j), i ≥ j, at
[j, i − j].

Numba's cache of this file does not see edits of `functions`: delete `__pycache__` after one.
"""

from __future__ import annotations

import numpy as np

from drake_aigto.box.functions import factor_mean
from drake_aigto.box.lanes import Lanes
from drake_aigto.box.tables import Floats, Ints, Records
from drake_aigto.box.tapes import MEAN, ONES
from drake_aigto.jit import njit

_PARTS = 6  # of a factor's mean: value and derivatives


@njit(cache=True, nogil=True, error_model="numpy")
def _choose(
    lanes: Records, weights: Floats, at: int, last: int, chosen: Records
) -> tuple[int, int]:
    """Fill chosen with lanes from place `at` on, up to `last`, that are not off.

    Returns:
        How many they are, and the place to go on from.
    """
    count = 0
    while count < chosen.size and at < last:
        if weights[lanes[at].copy] != 0.0:
            chosen[count] = lanes[at]
            count += 1
        at += 1
    return count, at


@njit(cache=True, nogil=True, error_model="numpy")
def _load_boxes(
    lanes: Records,
    copy_variables: Ints,
    arguments: Records,
    functions: Records,
    center: Floats,
    half_width: Floats,
    rows: Floats,
) -> None:
    """Set the rows (rows, lanes) of a tape's arguments, and then of its functions."""
    single = np.empty(_PARTS)
    for k in range(lanes.size):
        for a in range(arguments.size):
            argument = arguments[a]
            i = copy_variables[lanes[k].first_variable + argument.variable]
            reach = argument.scale * half_width[i]
            rows[2 * a, k] = argument.scale * center[i] + argument.offset
            rows[2 * a + 1, k] = reach * reach
        for f in range(functions.size):
            it, row = functions[f], 2 * arguments.size + _PARTS * f
            i = copy_variables[lanes[k].first_variable + it.variable]
            box = center[i], half_width[i]
            factor_mean(it.kind, it.exponent, it.scale, it.offset, *box, single)
            for part in range(_PARTS):
                rows[row + part, k] = single[part]


@njit(cache=True, nogil=True, error_model="numpy")
def _load_coefficients(lanes: Records, weights: Floats, coefficients: Floats, rows: Floats) -> None:
    """Set the rows (terms, lanes) of a tape's coefficients, times their copies' weights."""
    first, last = lanes[0].first_coefficient, lanes[lanes.size - 1].first_coefficient
    factors = np.empty(lanes.size)
    for k in range(lanes.size):
        factors[k] = weights[lanes[k].copy]
    for m in range(rows.shape[0]):
        if first == last:  # Copies of one sum, as lanes are in the order of sums.
            for k in range(lanes.size):
                rows[m, k] = factors[k] * coefficients[first + m]
        else:
            for k in range(lanes.size):
                rows[m, k] = factors[k] * coefficients[lanes[k].first_coefficient + m]


@njit(cache=True, nogil=True, error_model="numpy")
def _run(operations: Records, count: int, rows: Floats) -> None:
    """Run a tape in the first lanes of rows (rows, lanes)."""
    for o in range(operations.size):
        operation = operations[o]
        to, a, b, factor = operation.to, operation.a, operation.b, operation.factor
        if operation.adds:
            for k in range(count):
                rows[to, k] += factor * rows[a, k] * rows[b, k]
        else:
            for k in range(count):
                rows[to, k] = factor * rows[a, k] * rows[b, k]


@njit(cache=True, nogil=True, error_model="numpy")
def _evaluate(
    tables: Lanes,
    t: int,
    chosen: Records,
    weights: Floats,
    center: Floats,
    half_width: Floats,
    rows: Floats,
) -> None:
    """Run tape t for chosen lanes, from their boxes to all that it computes in rows."""
    _, copy_variables, coefficients, tapes, operations, arguments, functions = tables[:7]
    tape, after, count = tapes[t], tapes[t + 1], chosen.size
    rows[ONES, :count] = 1.0
    first = MEAN + 1
    arguments = arguments[tape.first_argument : after.first_argument]
    functions = functions[tape.first_function : after.first_function]
    boxes = center, half_width
    _load_boxes(chosen, copy_variables, arguments, functions, *boxes, rows[first:])
    first += 2 * arguments.size + _PARTS * functions.size
    _load_coefficients(chosen, weights, coefficients, rows[first : first + tape.num_terms])
    _run(operations[tape.first_operation : after.first_operation], count, rows)


@njit(cache=True, nogil=True, error_model="numpy")
def add_means(
    tables: Lanes,
    weights: Floats,
    center: Floats,
    half_width: Floats,
    values: Floats,
    gradient: Floats,
) -> float:
    """Weighted means of the copies; returns their sum, and adds its gradient.

    Args:
        tables: The sums, for order MEAN or GRADIENT.
        weights: Factor of each copy (C,).
        center: Box center of every variable (n,).
        half_width: Box half width of every variable (n,), ≥ 0.
        values: Filled with weight · mean of every copy (C,).
        gradient: By c, and by z, added to (2, n); not used for order MEAN.
    """
    lanes, copy_variables, _, tapes, _, _, _, slopes = tables[:8]
    rows = np.empty((tables.most_rows, tables.most_lanes))
    chosen = np.empty(tables.most_lanes, lanes.dtype)
    values[:] = 0.0
    total = 0.0
    for t in range(tapes.size - 1):
        at, last = tapes[t].first_lane, tapes[t + 1].first_lane
        while at < last:
            count, at = _choose(lanes, weights, at, last, chosen)
            if count == 0:
                continue
            _evaluate(tables, t, chosen[:count], weights, center, half_width, rows)
            for k in range(count):
                values[chosen[k].copy] = rows[MEAN, k]
                total += rows[MEAN, k]
            for s in range(tapes[t].first_slope, tapes[t + 1].first_slope):
                slope = slopes[s]
                for k in range(count):
                    i = copy_variables[chosen[k].first_variable + slope.variable]
                    gradient[slope.unknown, i] += rows[slope.row, k]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _add_slopes(
    places: Ints, unknown: int, values: Floats, rows: Ints, gradient: Floats, band: Floats
) -> None:
    """Add each lane's derivative by an unknown to the gradient, or to A.

    Args:
        places: Place of the variable's first unknown, −1 where it is held (lanes,).
        unknown: Which of its unknowns.
        values: The derivatives (lanes,).
        rows: Place of each lane's row of A, −1 where it has none (lanes,).
        gradient: Added to (size,).
        band: Added to (size, number of diagonals).
    """
    for k in range(places.size):
        if places[k] < 0:
            continue
        i, row = places[k] + unknown, rows[k]
        if row < 0:
            gradient[i] += values[k]
        else:
            band[min(i, row), abs(i - row)] += values[k]


@njit(cache=True, nogil=True, error_model="numpy")
def _find_entries(
    places: Ints, unknown: int, others: Ints, other_unknown: int, width: int, entries: Ints
) -> None:
    """Set entries to where in a flat band of this width each lane's two unknowns meet.

    They are −1 where one of the variables, whose first unknowns have these places, is held.
    """
    for k in range(places.size):
        i, j = places[k] + unknown, others[k] + other_unknown
        is_free = min(places[k], others[k]) >= 0
        entries[k] = min(i, j) * (width - 1) + max(i, j) if is_free else -1


@njit(cache=True, nogil=True, error_model="numpy")
def add_newton_system(
    tables: Lanes,
    weights: Floats,
    multipliers: Floats,
    center: Floats,
    half_width: Floats,
    variable_places: Ints,
    copy_places: Ints,
    gradient: Floats,
    band: Floats,
) -> float:
    """Add the KKT matrix [W Aᵀ; A 0] of the copies' means, and the gradient of what has no row.

        W = Σ multiplier · weight · ∇²mean,      A's row of a copy: weight · ∇mean

    Args:
        tables: The sums, for order CENTERS, with unknowns c_i, or for order BOXES, with unknowns
            (c_i, z_i) next to each other.
        weights: Factor of each copy (C,).
        multipliers: Factor of each copy's Hessian (C,).
        center: Box center of every variable (n,).
        half_width: Box half width of every variable (n,), ≥ 0.
        variable_places: Place of each variable's first unknown in the matrix, −1 for a variable
            that is held (n,).
        copy_places: Place of each copy that is one of A's rows, −1 for one that is not (C,).
        gradient: weight · ∇mean of the copies of place −1 is added (size,).
        band: Added to (size, number of diagonals).

    Returns:
        The sum of weight · mean over all copies.
    """
    lanes, copy_variables, _, tapes, _, _, _, slopes, curvatures = tables[:9]
    rows = np.empty((tables.most_rows, tables.most_lanes))
    chosen = np.empty(tables.most_lanes, lanes.dtype)
    places = np.empty((tables.most_variables, tables.most_lanes), np.int64)
    factors, copy_rows = np.empty(tables.most_lanes), np.empty(tables.most_lanes, np.int64)
    entries, flat = np.empty(tables.most_lanes, np.int64), band.reshape(-1)
    total = 0.0
    for t in range(tapes.size - 1):
        at, last = tapes[t].first_lane, tapes[t + 1].first_lane
        while at < last:
            count, at = _choose(lanes, weights, at, last, chosen)
            if count == 0:
                continue
            _evaluate(tables, t, chosen[:count], weights, center, half_width, rows)
            for k in range(count):
                total += rows[MEAN, k]
                copy, first_variable = chosen[k].copy, chosen[k].first_variable
                factors[k], copy_rows[k] = multipliers[copy], copy_places[copy]
                for v in range(tapes[t].num_variables):
                    places[v, k] = variable_places[copy_variables[first_variable + v]]
            for slope in slopes[tapes[t].first_slope : tapes[t + 1].first_slope]:
                at_c, values = places[slope.variable], rows[slope.row]
                _add_slopes(at_c[:count], slope.unknown, values, copy_rows, gradient, band)
            for it in curvatures[tapes[t].first_curvature : tapes[t + 1].first_curvature]:
                at_c, other_c = places[it.variable], places[it.other_variable]
                _find_entries(
                    *(at_c[:count], it.unknown, other_c, it.other_unknown),
                    *(band.shape[1], entries),
                )
                values = rows[it.row]
                for k in range(count):
                    if entries[k] >= 0:
                        flat[entries[k]] += factors[k] * values[k]
    return total
