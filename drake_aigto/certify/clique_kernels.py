"""Bounds of all cells of small cliques, in compiled code."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.certify.cells import curvatures, expansion_bound, least_linear, least_quadratic
from drake_aigto.certify.enclosures import GRADIENT, HESSIAN, Scratch, enclose, make_scratch
from drake_aigto.certify.intervals import down, plus, times, up
from drake_aigto.certify.tape import Tape
from drake_aigto.jit import inner, kernel

MOST_VARIABLES = 3  # of a clique


class Layout(NamedTuple):
    """Where a formula's variables, slopes and table are, and its bounds if it is a row."""

    first_variable: Ints
    variables: Ints
    first_slope: Ints
    first_cell: Ints
    is_row: Ints
    lower_rows: Floats
    upper_rows: Floats


# Room for formulas of one, two and three variables.
Scratches = tuple[Scratch, Scratch, Scratch]


def make_scratches(tape: Tape) -> Scratches:
    """Returns room for the formulas of a tape."""
    return make_scratch(tape, 1), make_scratch(tape, 2), make_scratch(tape, MOST_VARIABLES)


class Bins(NamedTuple):
    """Bins of all variables, one variable after the other.

    Attributes:
        starts: first bin of each variable (n + 1,).
        low: lower ends (K,).
        high: upper ends (K,).
        points: c (K,).
    """

    starts: Ints
    low: Floats
    high: Floats
    points: Floats


@kernel
def fill_slopes(
    tape: Tape, layout: Layout, bins: Bins, points: Floats, slopes: Floats, scratches: Scratches
) -> None:
    """Fills s of every formula of several variables: its slope at a bin's point and neighbors."""
    for formula in range(layout.is_row.size):
        first, last = layout.first_variable[formula], layout.first_variable[formula + 1]
        if last - first == 1 or layout.is_row[formula]:
            continue
        scratch = scratches[last - first - 1]
        for local in range(last - first):
            for s in range(
                layout.first_slope[first + local], layout.first_slope[first + local + 1]
            ):
                point = points[s]
                end = enclose(tape, formula, point, point, GRADIENT, scratch)
                if end >= 0:
                    slope = 0.5 * scratch.gradients[end, local, 0]
                    slope += 0.5 * scratch.gradients[end, local, 1]
                    slopes[s] = slope if math.isfinite(slope) else 0.0


@kernel
def fill_tables(
    tape: Tape,
    layout: Layout,
    bins: Bins,
    slopes: Floats,
    num_variables: int,
    table: Floats,
    scratches: Scratches,
) -> None:
    """Fills bounds of all formulas over all cells of their variables' bins."""
    most = len(scratches)
    # What all formulas of several variables moved to those of one.
    moved = np.zeros((bins.low.size, 2))
    for formula in range(num_variables, layout.is_row.size):
        first, last = layout.first_variable[formula], layout.first_variable[formula + 1]
        for local in range(first, last):
            start = bins.starts[layout.variables[local]]
            count = layout.first_slope[local + 1] - layout.first_slope[local]
            for k in range(count):
                s = slopes[layout.first_slope[local] + k]
                moved[start + k, 0], moved[start + k, 1] = plus(
                    moved[start + k, 0], moved[start + k, 1], s, s
                )
    low, high, point = np.zeros(most), np.zeros(most), np.zeros(most)
    slope, work = np.zeros((most, 2)), np.empty((most, most + 2))
    counter = np.zeros(most, dtype=np.int64)
    for formula in range(layout.is_row.size):
        first = layout.first_variable[formula]
        size = layout.first_variable[formula + 1] - first
        scratch = scratches[size - 1]
        counter[:] = 0
        for cell in range(layout.first_cell[formula], layout.first_cell[formula + 1]):
            for local in range(size):
                bin_ = bins.starts[layout.variables[first + local]] + counter[local]
                low[local], high[local] = bins.low[bin_], bins.high[bin_]
                point[local] = bins.points[bin_]
                if formula < num_variables:
                    slope[local, 0], slope[local, 1] = moved[bin_, 0], moved[bin_, 1]
                else:
                    s = slopes[layout.first_slope[first + local] + counter[local]]
                    slope[local, 0] = slope[local, 1] = -s
            if layout.is_row[formula]:
                table[cell] = _row_cell(
                    tape,
                    formula,
                    layout.lower_rows[formula],
                    layout.upper_rows[formula],
                    low,
                    high,
                    point,
                    size,
                    scratch,
                )
            else:
                table[cell] = _cost_cell(
                    tape, formula, low, high, point, slope, size, scratch, work
                )
            for local in range(size - 1, -1, -1):
                counter[local] += 1
                variable = layout.variables[first + local]
                if counter[local] < bins.starts[variable + 1] - bins.starts[variable]:
                    break
                counter[local] = 0


@inner
def _cost_cell(
    tape: Tape,
    formula: int,
    low: Floats,
    high: Floats,
    point: Floats,
    slope: Floats,
    size: int,
    scratch: Scratch,
    work: Floats,
) -> float:
    """Returns a bound of f_p + s (x − c) over a cell."""
    end = enclose(tape, formula, point, point, GRADIENT, scratch)
    at_point, value = np.empty((size, 2)), -np.inf
    if end >= 0:
        value = scratch.values[end, 0]
        for i in range(size):
            at_point[i, 0] = scratch.gradients[end, i, 0]
            at_point[i, 1] = scratch.gradients[end, i, 1]
    end = enclose(tape, formula, low, high, HESSIAN, scratch)
    if end < 0:
        return np.inf
    natural = scratch.values[end, 0]
    over_cell = np.empty((size, 2))
    low_steps, high_steps = np.empty(size), np.empty(size)
    for i in range(size):
        low_steps[i] = min(down(low[i] - point[i]), 0.0)
        high_steps[i] = max(up(high[i] - point[i]), 0.0)
        natural = down(
            natural + least_linear(slope[i, 0], slope[i, 1], low_steps[i], high_steps[i])
        )
        over_cell[i, 0], over_cell[i, 1] = plus(
            scratch.gradients[end, i, 0], scratch.gradients[end, i, 1], slope[i, 0], slope[i, 1]
        )
        at_point[i, 0], at_point[i, 1] = plus(
            at_point[i, 0], at_point[i, 1], slope[i, 0], slope[i, 1]
        )
    if not math.isfinite(value):
        return natural
    bound, _ = expansion_bound(
        value,
        at_point,
        over_cell,
        scratch.hessians[end, : size * (size + 1) // 2],
        low_steps,
        high_steps,
        work[:size, : size + 2],
    )
    return max(natural, bound)


@inner
def _row_cell(
    tape: Tape,
    formula: int,
    least: float,
    most: float,
    low: Floats,
    high: Floats,
    point: Floats,
    size: int,
    scratch: Scratch,
) -> float:
    """Returns 0 where a row may hold in a cell, else +∞."""
    end = enclose(tape, formula, point, point, GRADIENT, scratch)
    a, b = (scratch.values[end, 0], scratch.values[end, 1]) if end >= 0 else (-np.inf, np.inf)
    end = enclose(tape, formula, low, high, GRADIENT, scratch)
    if end < 0 or scratch.values[end, 0] > most or scratch.values[end, 1] < least:
        return np.inf
    for i in range(size):
        step = min(down(low[i] - point[i]), 0.0), max(up(high[i] - point[i]), 0.0)
        a, b = plus(a, b, *times(scratch.gradients[end, i, 0], scratch.gradients[end, i, 1], *step))
    return np.inf if a > most or b < least else 0.0


@kernel
def may_hold_minima(
    tape: Tape, layout: Layout, bins: Bins, lower: Floats, upper: Floats, scratches: Scratches
) -> Bools:
    """Returns for each bin whether f may have a minimum in it along the bin's variable."""
    most = len(scratches)
    slopes, bends = np.zeros((bins.low.size, 2)), np.zeros((bins.low.size, 2))
    low, high = np.zeros(most), np.zeros(most)
    for formula in range(layout.is_row.size):
        first = layout.first_variable[formula]
        size = layout.first_variable[formula + 1] - first
        scratch = scratches[size - 1]
        for own in range(size):
            for local in range(size):
                i = layout.variables[first + local]
                low[local], high[local] = (
                    bins.low[bins.starts[i]],
                    bins.high[bins.starts[i + 1] - 1],
                )
            variable = layout.variables[first + own]
            diagonal = own * (own + 1) // 2 + own
            for k in range(bins.starts[variable], bins.starts[variable + 1]):
                low[own], high[own] = bins.low[k], bins.high[k]
                end = enclose(tape, formula, low, high, HESSIAN, scratch)
                if end < 0:
                    continue
                g, h = scratch.gradients[end, own], scratch.hessians[end, diagonal]
                slopes[k, 0], slopes[k, 1] = plus(slopes[k, 0], slopes[k, 1], g[0], g[1])
                bends[k, 0], bends[k, 1] = plus(bends[k, 0], bends[k, 1], h[0], h[1])
    keep = np.ones(bins.low.size, dtype=np.bool_)
    for i in range(lower.size):
        for k in range(bins.starts[i], bins.starts[i + 1]):
            if not (math.isfinite(slopes[k, 0]) and math.isfinite(slopes[k, 1])):
                continue
            at_lower, at_upper = bins.low[k] == lower[i], bins.high[k] == upper[i]
            rises, falls = slopes[k, 0] > 0.0, slopes[k, 1] < 0.0
            is_bent = bends[k, 1] < 0.0 and not (at_lower or at_upper)
            keep[k] = not ((rises and not at_lower) or (falls and not at_upper) or is_bent)
    return keep


@kernel
def bound_hull(
    tape: Tape, layout: Layout, low: Floats, high: Floats, best: Floats, scratches: Scratches
) -> float:
    """Returns a bound of Σ f_p over a box, about a point of it: tight if all f is convex there."""
    size, most = low.size, len(scratches)
    slopes, kappa = np.zeros((size, 2)), np.zeros(size)
    local_low, local_high, point = np.zeros(most), np.zeros(most), np.zeros(most)
    ones, own = np.ones(most), np.empty(most)
    total = 0.0
    for formula in range(layout.is_row.size):
        if layout.is_row[formula]:
            continue
        first = layout.first_variable[formula]
        count = layout.first_variable[formula + 1] - first
        scratch = scratches[count - 1]
        for k in range(count):
            i = layout.variables[first + k]
            local_low[k], local_high[k], point[k] = low[i], high[i], best[i]
        end = enclose(tape, formula, point, point, GRADIENT, scratch)
        if end < 0:
            return -np.inf
        total = down(total + scratch.values[end, 0])
        for k in range(count):
            i = layout.variables[first + k]
            slopes[i, 0], slopes[i, 1] = plus(
                slopes[i, 0],
                slopes[i, 1],
                scratch.gradients[end, k, 0],
                scratch.gradients[end, k, 1],
            )
        end = enclose(tape, formula, local_low, local_high, HESSIAN, scratch)
        if end < 0:
            return -np.inf
        curvatures(scratch.hessians[end, : count * (count + 1) // 2], ones[:count], own[:count])
        for k in range(count):
            i = layout.variables[first + k]
            kappa[i] = down(kappa[i] + own[k])
    for i in range(size):
        a, b = min(down(low[i] - best[i]), 0.0), max(up(high[i] - best[i]), 0.0)
        total = down(total + least_quadratic(slopes[i, 0], slopes[i, 1], kappa[i], a, b))
    return total if math.isfinite(total) else -np.inf
