"""The hot loops: means of stacked sums over boxes, with their derivatives in (c, z = log w).

Copies of sums run their common tape side by side, each in a lane of rows (rows, lanes): innermost
loops are over lanes, for the compiler to turn into vector instructions.

A copy of weight 0 is off: it adds nothing, also where its own mean is infinite. At a half width of
0 means are values.

Shape letters: C copies, n variables. A symmetric matrix is kept in LAPACK's lower band storage,
transposed to be of one type for Numba however few diagonals there are: entry (i, j), i ≥ j, at
[j, i − j]; or, where there is a `Pattern`, as its entries (E, 1).

Innermost functions take no slices and no more arrays than they read: that is most of what there is
to compile.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from drake_aigto.arrays import Floats, Ints, Records
from drake_aigto.box.lanes import (
    PARTS,
    Lanes,
    load_arguments,
    load_coefficients,
    load_functions,
    make_waves,
)
from drake_aigto.box.tapes import MEAN
from drake_aigto.kernels import borrowing, kernel
from drake_aigto.linear import Pattern, find_entry


class System(NamedTuple):
    """Sums that derivatives of means are added to: the KKT matrix [W Aᵀ; A 0] and the gradient.

        W = Σ multiplier · weight · ∇²mean,      A's row of a copy: weight · ∇mean

    Copies with penalties λ r + ρ/2 r², r = weight · mean, have no rows: W gets ρ ∇r ∇rᵀ as well,
    and the gradient λ ∇r.

    Attributes:
        multipliers: Factor of each copy's Hessian (C,).
        variable_places: Place of each variable's first unknown, −1 for a variable that is held
            (n,).
        copy_places: Place of each copy that is one of A's rows, −1 for one that is not (C,).
        gradient: weight · ∇mean of the copies of place −1 is added (size,).
        band: The matrix is added (size, number of diagonals), or (E, 1).
        pattern: Of the matrix, if it is no band.
        penalties: λ and ρ of each copy (2, C), if they have penalties.
    """

    multipliers: Floats
    variable_places: Ints
    copy_places: Ints
    gradient: Floats
    band: Floats
    pattern: Pattern | None
    penalties: Floats | None


# For tables of order MEAN. Not read-only, for which Numba would compile once more.
NO_SYSTEM = System(
    multipliers=np.empty(0),
    variable_places=np.empty(0, np.int64),
    copy_places=np.empty(0, np.int64),
    gradient=np.empty(0),
    band=np.empty((0, 0)),
    pattern=None,
    penalties=None,
)


@borrowing
def _choose(lanes: Records, weights: Floats, at: int, last: int, chosen: Ints) -> tuple[int, int]:
    """Fills chosen with the lanes from `at` on, up to `last`, that are not off.

    Returns:
        How many they are, and the lane to go on from.
    """
    count = 0
    while count < chosen.size and at < last:
        if weights[lanes[at].copy] != 0.0:
            chosen[count] = at
            count += 1
        at += 1
    return count, at


@borrowing
def _run(operations: Records, tape: Any, after: Any, count: int, rows: Floats) -> None:
    """Runs operations in the first lanes of rows (rows, lanes)."""
    for o in range(tape.first_operation, after.first_operation):
        operation = operations[o]
        to, a, b, factor = operation.to, operation.a, operation.b, operation.factor
        if operation.adds:
            for k in range(count):
                rows[to, k] += factor * rows[a, k] * rows[b, k]
        else:
            for k in range(count):
                rows[to, k] = factor * rows[a, k] * rows[b, k]


@borrowing
def _add_entry(pattern: Pattern | None, band: Floats, i: int, j: int, value: float) -> None:
    """Adds to entry (i, j) of a matrix, a band if it has no pattern."""
    if pattern is None:  # An argument of its own, for then Numba leaves out the other case.
        band[min(i, j), abs(i - j)] += value
    else:
        band[find_entry(pattern, i, j), 0] += value


@borrowing
def _add_slopes(
    slopes: Records,
    tape: Any,
    after: Any,
    count: int,
    rows: Floats,
    places: Ints,
    ends: Ints,
    gradient: Floats,
    band: Floats,
    pattern: Pattern | None,
) -> None:
    """Adds the lanes' first derivatives, in rows (rows, lanes), to the gradient or to A.

    Places are `System.variable_places` of the tape's local variables (variables, lanes), ends
    `System.copy_places` of its copies (lanes,). Entries of a tape end where those of the next one
    start.
    """
    for s in range(tape.first_slope, after.first_slope):
        slope = slopes[s]
        variable, unknown, row = slope.variable, slope.unknown, slope.row
        for k in range(count):
            i, j = places[variable, k] + unknown, ends[k]
            if places[variable, k] < 0:
                continue
            if j < 0:
                gradient[i] += rows[row, k]
            else:
                _add_entry(pattern, band, i, j, rows[row, k])


@borrowing
def _add_penalties(
    penalties: Floats | None,
    slopes: Records,
    tape: Any,
    after: Any,
    lanes: Records,
    chosen: Ints,
    count: int,
    rows: Floats,
    places: Ints,
    own: Floats,
    gradient: Floats,
    band: Floats,
    pattern: Pattern | None,
) -> None:
    """Adds first derivatives of the lanes' penalties to the gradient, and their squares to W.

    Nothing where there are none; otherwise as `_add_slopes`, which adds nothing then. λ, ρ and one
    slope times ρ of the lanes are written to `own` (3, lanes).
    """
    if penalties is None:
        return
    is_curved = False
    for k in range(count):
        copy = lanes[chosen[k]].copy
        own[0, k], own[1, k] = penalties[0, copy], penalties[1, copy]
        is_curved |= own[1, k] != 0.0
    for s in range(tape.first_slope, after.first_slope):
        slope = slopes[s]
        row, variable, unknown = slope.row, slope.variable, slope.unknown
        for k in range(count):
            if places[variable, k] >= 0:
                gradient[places[variable, k] + unknown] += own[0, k] * rows[row, k]
        if not is_curved:
            continue
        for k in range(count):
            own[2, k] = own[1, k] * rows[row, k]
        for t in range(tape.first_slope, s + 1):
            other = slopes[t]
            other_row, other_variable, other_unknown = other.row, other.variable, other.unknown
            for k in range(count):
                place, other_place = places[variable, k], places[other_variable, k]
                if min(place, other_place) >= 0:
                    i, j = place + unknown, other_place + other_unknown
                    value = own[2, k] * rows[other_row, k]
                    _add_entry(pattern, band, i, j, 2.0 * value if i == j and t < s else value)


@borrowing
def _add_curvatures(
    curvatures: Records,
    tape: Any,
    after: Any,
    count: int,
    rows: Floats,
    places: Ints,
    factors: Floats,
    band: Floats,
    pattern: Pattern | None,
) -> None:
    """Adds the lanes' second derivatives, times their factors, to W; otherwise as `_add_slopes`."""
    for c in range(tape.first_curvature, after.first_curvature):
        it = curvatures[c]
        row, variable, unknown = it.row, it.variable, it.unknown
        other_variable, other_unknown = it.other_variable, it.other_unknown
        for k in range(count):
            place, other = places[variable, k], places[other_variable, k]
            if min(place, other) >= 0:
                value = factors[k] * rows[row, k]
                _add_entry(pattern, band, place + unknown, other + other_unknown, value)


@kernel
def add_means(
    tables: Lanes,
    weights: Floats,
    center: Floats,
    half_width: Floats,
    values: Floats,
    system: System,
) -> float:
    """Adds the derivatives of copies' means, as far as the tables have them, to a system.

    Args:
        tables: The sums, for order MEAN; for CENTERS, with unknowns c_i; or for GRADIENT or BOXES,
            with unknowns (c_i, z_i) next to each other.
        weights: Factor of each copy (C,).
        center: Box center of every variable (n,).
        half_width: Box half width of every variable (n,), ≥ 0.
        values: Filled with weight · mean of every copy (C,).
        system: Sums that derivatives are added to.

    Returns:
        The sum of weight · mean over all copies.
    """
    lanes, tapes, most_lanes = tables.lanes, tables.tapes, tables.most_lanes
    rows, factors = np.empty((tables.most_rows, most_lanes)), np.empty(most_lanes)
    parts, own = np.empty(PARTS), np.empty((3, most_lanes))
    waves = make_waves(center.size, tables.transcendental)
    chosen, ends = np.empty(most_lanes, np.int64), np.empty(most_lanes, np.int64)
    variables = np.empty((tables.most_variables, most_lanes), np.int64)
    values[:] = 0.0
    total = 0.0
    for t in range(tapes.size - 1):
        tape, after = tapes[t], tapes[t + 1]
        at = tape.first_lane
        while at < after.first_lane:
            count, at = _choose(lanes, weights, at, after.first_lane, chosen)
            if count == 0:
                continue
            for k in range(count):
                lane = lanes[chosen[k]]
                factors[k] = weights[lane.copy]
                for v in range(tape.num_variables):
                    variables[v, k] = tables.copy_variables[lane.first_variable + v]
            row = load_arguments(
                tables.arguments, tape, after, variables, count, center, half_width, rows
            )
            row = load_functions(
                *(tables.functions, tape, after, tables.transcendental, variables, count),
                *(center, half_width, parts, waves, rows, row),
            )
            row = load_coefficients(
                tables.coefficients, tape.num_terms, lanes, chosen, count, factors, rows, row
            )
            if tables.are_magnitudes:
                for r in range(row):
                    for k in range(count):
                        rows[r, k] = abs(rows[r, k])
            _run(tables.operations, tape, after, count, rows)
            for k in range(count):
                values[lanes[chosen[k]].copy] = rows[MEAN, k]
                total += rows[MEAN, k]
            if tape.first_slope == after.first_slope:
                continue
            for k in range(count):
                copy = lanes[chosen[k]].copy
                factors[k], ends[k] = system.multipliers[copy], system.copy_places[copy]
                for v in range(tape.num_variables):
                    variables[v, k] = system.variable_places[variables[v, k]]
            band, pattern = system.band, system.pattern
            if system.penalties is None:
                _add_slopes(
                    *(tables.slopes, tape, after, count, rows, variables, ends),
                    *(system.gradient, band, pattern),
                )
            _add_penalties(
                *(system.penalties, tables.slopes, tape, after, lanes, chosen, count, rows),
                *(variables, own, system.gradient, band, pattern),
            )
            _add_curvatures(
                tables.curvatures, tape, after, count, rows, variables, factors, band, pattern
            )
    return total
