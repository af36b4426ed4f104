"""Branch and bound over cells of all variables, in compiled code."""

from __future__ import annotations

import math
from typing import NamedTuple, cast

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.certify.cells import expansion_bound
from drake_aigto.certify.enclosures import GRADIENT, HESSIAN, VALUE, Scratch, enclose
from drake_aigto.certify.heap import Heap, copy, copy_pairs, pop, push
from drake_aigto.certify.intervals import down, plus, power, times, up
from drake_aigto.certify.multipliers import Multipliers
from drake_aigto.certify.tape import Tape
from drake_aigto.jit import inner, kernel, pasted

COST = cast(int, np.int64(0))  # the formula's number, as for Numba a plain 0 is a type of its own
# A side is not cut that is so much shorter than the first box's, beside the longest one.
_LEAST_SIDE = 1e-3
_STEPS = 8  # of the descent within a cell where f is convex


class Rows(NamedTuple):
    """lower ≤ r_j(x) ≤ upper: formulas 1 … R of a tape, shapes (R,)."""

    lower: Floats
    upper: Floats


class Work(NamedTuple):
    """Room for the enclosures of one cell."""

    scratch: Scratch
    at_point: Floats
    over_cell: Floats
    hessian: Floats
    low_steps: Floats
    high_steps: Floats
    square: Floats
    value: Floats
    bends: Floats
    point: Floats
    second_point: Floats


@pasted
def _expand_about(
    tape: Tape,
    rows: Rows,
    multipliers: Multipliers,
    bends: Floats,
    point: Floats,
    work: Work,
) -> tuple[float, float]:
    """Fills the gradient at a point of f with its rows; returns bounds of f's own value there."""
    scratch = work.scratch
    end = enclose(tape, COST, point, point, GRADIENT, scratch)
    if end < 0:
        return -np.inf, np.inf
    value = scratch.values[end, 0], scratch.values[end, 1]
    copy_pairs(scratch.gradients[end], work.at_point)
    work.value[0], work.value[1] = value
    for j in range(rows.lower.size):
        if multipliers.slopes[j] == 0.0 and bends[j] == 0.0:
            continue
        end = enclose(tape, 1 + j, point, point, GRADIENT, scratch)
        if end < 0:
            return -np.inf, np.inf
        slope, t = multipliers.slopes[j], multipliers.targets[j]
        off = plus(scratch.values[end, 0], scratch.values[end, 1], -t, -t)
        factor = plus(slope, slope, *times(bends[j], bends[j], off[0], off[1]))
        added = times(off[0], off[1], slope, slope)
        half = 0.5 * bends[j]
        bent = times(half, half, *power(off[0], off[1], 2))
        total = plus(work.value[0], work.value[1], *plus(*added, *bent))
        work.value[0], work.value[1] = total
        for i in range(point.size):
            g = times(
                factor[0], factor[1], scratch.gradients[end, i, 0], scratch.gradients[end, i, 1]
            )
            work.at_point[i, 0], work.at_point[i, 1] = plus(
                work.at_point[i, 0], work.at_point[i, 1], g[0], g[1]
            )
    return value


@pasted
def _add_row(slope: float, bend: float, t: float, end: int, work: Work) -> None:
    """Adds λ (r − t) + ½ ρ (r − t)² to gradient and Hessian over the cell."""
    values, gradients, hessians = work.scratch
    off = plus(values[end, 0], values[end, 1], -t, -t)
    factor = plus(slope, slope, *times(bend, bend, off[0], off[1]))
    place = 0
    for i in range(gradients.shape[1]):
        own = gradients[end, i, 0], gradients[end, i, 1]
        g = times(factor[0], factor[1], own[0], own[1])
        work.over_cell[i, 0], work.over_cell[i, 1] = plus(
            work.over_cell[i, 0], work.over_cell[i, 1], g[0], g[1]
        )
        for j in range(i + 1):
            if i == j:
                both = power(own[0], own[1], 2)
            else:
                both = times(own[0], own[1], gradients[end, j, 0], gradients[end, j, 1])
            bent = plus(
                *times(bend, bend, both[0], both[1]),
                *times(factor[0], factor[1], hessians[end, place, 0], hessians[end, place, 1]),
            )
            work.hessian[place, 0], work.hessian[place, 1] = plus(
                work.hessian[place, 0], work.hessian[place, 1], bent[0], bent[1]
            )
            place += 1


@inner
def _choose_point(low: Floats, high: Floats, best: Floats, point: Floats) -> None:
    """Fills the point of a cell that is nearest to the best known one, if that is near; else c."""
    is_near = True
    for i in range(low.size):
        reach = high[i] - low[i]
        is_near &= low[i] - reach <= best[i] <= high[i] + reach
    for i in range(low.size):
        if is_near:
            point[i] = min(max(best[i], low[i]), high[i])
        else:
            point[i] = _middle(low[i], high[i])


@inner
def _middle(low: float, high: float) -> float:
    """Returns where a side is cut, with or without ends."""
    if math.isinf(low) and math.isinf(high):
        return 0.0
    if math.isinf(high):
        return max(1.0, 2.0 * low) if low >= 0.0 else 0.0
    if math.isinf(low):
        return min(-1.0, 2.0 * high) if high <= 0.0 else 0.0
    return min(max(0.5 * low + 0.5 * high, low), high)


@inner
def _set_steps(low: Floats, high: Floats, point: Floats, work: Work) -> None:
    for i in range(low.size):
        work.low_steps[i] = min(down(low[i] - point[i]), 0.0)
        work.high_steps[i] = max(up(high[i] - point[i]), 0.0)


@inner
def _descend(low: Floats, high: Floats, work: Work) -> None:
    """Moves to where the model g d + ½ dᵀ H d is least, a coordinate at a time."""
    size = low.size
    start, point = work.point, work.second_point
    copy(start, point)
    for _ in range(_STEPS):
        for i in range(size):
            slope = 0.5 * (work.at_point[i, 0] + work.at_point[i, 1])
            curvature = 0.0
            for j in range(size):
                place = i * (i + 1) // 2 + j if j <= i else j * (j + 1) // 2 + i
                middle = 0.5 * (work.hessian[place, 0] + work.hessian[place, 1])
                slope += middle * (point[j] - start[j])
                curvature = middle if j == i else curvature
            if curvature > 0.0:
                point[i] = min(max(point[i] - slope / curvature, low[i]), high[i])


@pasted
def _bound(
    tape: Tape,
    rows: Rows,
    multipliers: Multipliers,
    low: Floats,
    high: Floats,
    outer: Floats,
    best: Floats,
    threshold: float,
    work: Work,
) -> tuple[float, float]:
    """Bounds f from below over a cell, which may be made flat at the first box's faces, in place.

    Args:
        tape: f, and the rows.
        rows: their bounds.
        multipliers: of the rows.
        low: the cell's lower ends.
        high: the cell's upper ends.
        outer: the first box (2, n).
        best: the best known point.
        threshold: a bound above it is good enough.
        work: room; its `point` is filled.

    Returns:
        The bound, +∞ of a cell that has no feasible minimizer, and f at the point, rounded up.
    """
    scratch = work.scratch
    end = enclose(tape, COST, low, high, HESSIAN, scratch)
    if end < 0:
        return np.inf, np.inf
    natural = scratch.values[end, 0]
    copy_pairs(scratch.gradients[end], work.over_cell)
    copy_pairs(scratch.hessians[end], work.hessian)
    _choose_point(low, high, best, work.point)
    bends = work.bends
    for j in range(rows.lower.size):
        end = enclose(tape, 1 + j, low, high, HESSIAN, scratch)
        if (
            end < 0
            or scratch.values[end, 0] > rows.upper[j]
            or scratch.values[end, 1] < rows.lower[j]
        ):
            return np.inf, np.inf
        slope, t, bend = multipliers.slopes[j], multipliers.targets[j], multipliers.bends[j]
        if bend < 0.0:
            reach = max(up(scratch.values[end, 1] - t), up(t - scratch.values[end, 0]))
            bend = min(-bend, 1.999 * abs(slope) / reach) if 0.0 < reach < np.inf else 0.0
        bends[j] = bend
        if slope != 0.0 or bend != 0.0:
            _add_row(slope, bend, t, end, work)
    if natural > threshold:
        return natural, np.inf
    if rows.lower.size:
        for j in range(rows.lower.size):
            if _row_excludes(tape, 1 + j, rows.lower[j], rows.upper[j], low, high, work):
                return np.inf, np.inf
    elif _press(low, high, outer, work):
        return np.inf, np.inf
    best_bound, at_point = natural, np.inf
    for attempt in range(2):
        point = work.point if attempt == 0 else work.second_point
        value = _expand_about(tape, rows, multipliers, bends, point, work)
        _set_steps(low, high, point, work)
        bound, is_bowl = expansion_bound(
            work.value[0],
            work.at_point,
            work.over_cell,
            work.hessian,
            work.low_steps,
            work.high_steps,
            work.square,
        )
        best_bound = max(best_bound, bound)
        if attempt == 0:
            at_point = value[1]
            if not is_bowl or best_bound > threshold:
                break
            _descend(low, high, work)
    return best_bound, at_point


@pasted
def _row_excludes(
    tape: Tape, formula: int, least: float, most: float, low: Floats, high: Floats, work: Work
) -> bool:
    """Returns whether the mean value theorem shows that a row holds nowhere in a cell."""
    scratch, point = work.scratch, work.point
    end = enclose(tape, formula, point, point, VALUE, scratch)
    if end < 0:
        return False
    a, b = scratch.values[end, 0], scratch.values[end, 1]
    end = enclose(tape, formula, low, high, GRADIENT, scratch)
    for i in range(low.size):
        step = min(down(low[i] - point[i]), 0.0), max(up(high[i] - point[i]), 0.0)
        a, b = plus(a, b, *times(scratch.gradients[end, i, 0], scratch.gradients[end, i, 1], *step))
    return a > most or b < least


@inner
def _press(low: Floats, high: Floats, outer: Floats, work: Work) -> bool:
    """Makes a cell flat where f rises or falls over all of it, in place.

    Returns whether it holds no minimizer: where f falls towards a face that is not the first box's,
    what is beyond it is lower.
    """
    for i in range(low.size):
        a, b = work.over_cell[i, 0], work.over_cell[i, 1]
        if low[i] == high[i] or not (a > 0.0 or b < 0.0):
            continue
        if not (math.isfinite(a) and math.isfinite(b)):
            continue
        face = low[i] if a > 0.0 else high[i]
        if face != (outer[0, i] if a > 0.0 else outer[1, i]):
            return True
        low[i] = high[i] = work.point[i] = face
    return False


@inner
def _widest(low: Floats, high: Floats, sides: Floats, work: Work) -> int:
    """Returns the variable with the largest part in what formulas vary by, of those not too short.

    Its parts are in `work.low_steps`.
    """
    longest = 0.0
    for i in range(low.size):
        longest = max(longest, (high[i] - low[i]) / sides[i])
    best, most = -1, -1.0
    for i in range(low.size):
        length = high[i] - low[i]
        if length / sides[i] < _LEAST_SIDE * longest or length == 0.0:
            continue
        change = np.inf if math.isinf(length) else work.low_steps[i]
        if change > most:
            best, most = i, change
    return best


@pasted
def _add_parts(
    tape: Tape, formula: int, least: float, most: float, low: Floats, high: Floats, work: Work
) -> None:
    """Adds each variable's part in what a formula varies by, unless it is within bounds anyway."""
    scratch, changes = work.scratch, work.high_steps
    end = enclose(tape, formula, low, high, GRADIENT, scratch)
    if end < 0 or (scratch.values[end, 0] >= least and scratch.values[end, 1] <= most):
        return
    total = 0.0
    for i in range(low.size):
        a, b = scratch.gradients[end, i, 0], scratch.gradients[end, i, 1]
        changes[i] = max(-a, b) * (high[i] - low[i]) if high[i] > low[i] else 0.0
        changes[i] = min(changes[i], 1e200) if changes[i] >= 0.0 else 1e200
        total += changes[i]
    for i in range(low.size):
        work.low_steps[i] += changes[i] / total if total > 0.0 else 0.0


@kernel
def explore(
    tape: Tape,
    rows: Rows,
    multipliers: Multipliers,
    heap: Heap,
    outer: Floats,
    best: Floats,
    least: float,
    margin: float,
    scale: float,
    count: int,
    work: Work,
) -> tuple[float, float, int]:
    """Cuts the lowest open cells in two, until none is below the best value less a margin.

    Returns the least bound of those that were left alone, the least value, and how many were cut.
    """
    low, high = np.empty(best.size), np.empty(best.size)
    a, b = np.empty(best.size), np.empty(best.size)
    sides = np.empty(best.size)
    for i in range(best.size):
        side = outer[1, i] - outer[0, i]
        sides[i] = side if 0.0 < side < np.inf else 1.0
    settled = np.inf
    for number in range(count):
        threshold = least - margin * max(abs(least), scale)
        if heap.counts[0] == 0 or heap.keys[0] > threshold or heap.counts[1] < 2:
            return settled, least, number
        key = heap.keys[0]
        place = pop(heap)
        copy(heap.low[place], low)
        copy(heap.high[place], high)
        # What its gradients were is not kept.
        for i in range(low.size):
            work.low_steps[i] = 0.0
        _add_parts(tape, COST, np.inf, -np.inf, low, high, work)
        for j in range(rows.lower.size):
            _add_parts(tape, 1 + j, rows.lower[j], rows.upper[j], low, high, work)
        i = _widest(low, high, sides, work)
        middle = _middle(low[i], high[i]) if i >= 0 else 0.0
        if i < 0 or not low[i] < middle < high[i]:
            settled = min(settled, key)
            continue
        for half in range(2):
            copy(low, a)
            copy(high, b)
            if half == 0:
                b[i] = middle
            else:
                a[i] = middle
            threshold = least - margin * max(abs(least), scale)
            bound, value = _bound(tape, rows, multipliers, a, b, outer, best, threshold, work)
            bound = max(bound, key)
            if rows.lower.size == 0 and value < least:
                least = value
                copy(work.point, best)
            if bound == np.inf:
                continue
            if bound > threshold:
                settled = min(settled, bound)
            else:
                push(heap, bound, a, b)
    return settled, least, count
