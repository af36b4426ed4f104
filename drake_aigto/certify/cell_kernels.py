"""Branch and bound over cells of all variables, in compiled code."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.certify.enclosures import (
    GRADIENT,
    HESSIAN,
    VALUE,
    at,
    enclose,
    jet_size,
    make_scratch,
    put,
)
from drake_aigto.certify.expansions import (
    ABOUT,
    OVER,
    choose_point,
    descend,
    expansion_bound,
    mean_value,
    middle_of,
    set_steps,
)
from drake_aigto.certify.formulas import Tape
from drake_aigto.certify.intervals import plus, power, scaled, times, up
from drake_aigto.kernels import inner, kernel, pasted

_COST = 0  # the formula's number; that of row j is 1 + j
# A side is not cut that is this much shorter than the first box's, beside the longest one.
_LEAST_SIDE = 1e-3


class Rows(NamedTuple):
    """Rows lower ≤ r_j(x) ≤ upper, and their terms in the cost where they hold.

    On all feasible x, f ≥ f + λ_j (r_j − t_j) + ½ ρ_j (r_j − t_j)²: of an equality with any λ and
    ρ; of an inequality at its bound t with λ (r − t) ≤ 0 and ρ ≤ 2 |λ| / max |r − t|.

    Attributes:
        lower: bounds of r (R,).
        upper: shape (R,).
        targets: t (R,).
        slopes: λ (R,); 0 leaves a row out.
        bends: ρ (R,) of equalities, −ρ of inequalities, of which a cell may allow less.
    """

    lower: Floats
    upper: Floats
    targets: Floats
    slopes: Floats
    bends: Floats


class Problem(NamedTuple):
    """Minimize f over a box, subject to rows.

    Attributes:
        tape: f and the rows.
        rows: R of them.
        outer: the box (2, n).
        best: the best known point (n,).
    """

    tape: Tape
    rows: Rows
    outer: Floats
    best: Floats


class Heap(NamedTuple):
    """Open cells of a branch and bound, the lowest bound first.

    Attributes:
        used: number of open cells (1,).
        keys: their bounds, in a heap (C,).
        places: where each is in `low` and `high`; then places that hold no cell (C,).
        low: lower ends (C, n).
        high: upper ends (C, n).
    """

    used: Ints
    keys: Floats
    places: Ints
    low: Floats
    high: Floats


class _Work(NamedTuple):
    """Room for the enclosures of one cell.

    Attributes:
        jets: of a formula's entries (E, J, 2).
        totals: of f with its rows, over the cell and about a point (2, J, 2).
        steps: from the point to the cell's ends (n, 2).
        bends: ρ of each row in this cell (R,).
        point: of the cell (n,).
        second_point: another one (n,).
        matrix: for Cholesky's factor (n, n).
        scales: of the variables (n,).
        sides: of the first box, 1 where it has no such side (n,).
    """

    jets: Floats
    totals: Floats
    steps: Floats
    bends: Floats
    point: Floats
    second_point: Floats
    matrix: Floats
    scales: Floats
    sides: Floats


@inner
def _copy(of: Floats, to: Floats) -> None:
    """Copies numbers, which takes Numba less time to compile than a slice."""
    for i in range(to.size):
        to[i] = of[i]


@inner
def _copy_jet(jets: Floats, end: int, totals: Floats, to: int) -> None:
    for place in range(totals.shape[1]):
        put(totals, to, place, at(jets, end, place))


@inner
def _swap(heap: Heap, k: int, m: int) -> None:
    keys, places = heap.keys, heap.places
    keys[k], keys[m] = keys[m], keys[k]
    places[k], places[m] = places[m], places[k]


@inner
def _push(heap: Heap, key: float, low: Floats, high: Floats) -> None:
    """Opens a cell."""
    k = heap.used[0]
    heap.used[0], heap.keys[k] = k + 1, key
    _copy(low, heap.low[heap.places[k]])
    _copy(high, heap.high[heap.places[k]])
    while k > 0 and heap.keys[(k - 1) // 2] > heap.keys[k]:
        _swap(heap, k, (k - 1) // 2)
        k = (k - 1) // 2


@inner
def _pop(heap: Heap, low: Floats, high: Floats) -> None:
    """Takes the cell of the lowest bound out."""
    keys, last, k = heap.keys, heap.used[0] - 1, 0
    _copy(heap.low[heap.places[0]], low)
    _copy(heap.high[heap.places[0]], high)
    _swap(heap, 0, last)
    heap.used[0] = last
    while 2 * k + 1 < last:
        child = 2 * k + 1
        if child + 1 < last and keys[child + 1] < keys[child]:
            child += 1
        if keys[k] <= keys[child]:
            return
        _swap(heap, k, child)
        k = child


@inner
def _add_row(
    slope: float, bend: float, t: float, end: int, order: int, to: int, work: _Work
) -> None:
    """Adds λ (r − t) + ½ ρ (r − t)² to the totals."""
    jets, totals, size = work.jets, work.totals, work.point.size
    off = plus(at(jets, end, 0), (-t, -t))
    factor = plus((slope, slope), scaled(bend, off))
    own = plus(scaled(slope, off), scaled(0.5 * bend, power(off, 2)))
    put(totals, to, 0, plus(at(totals, to, 0), own))
    place = 1 + size
    for i in range(size):
        own = at(jets, end, 1 + i)
        put(totals, to, 1 + i, plus(at(totals, to, 1 + i), times(factor, own)))
        for j in range(i + 1 if order > 1 else 0):
            both = power(own, 2) if i == j else times(own, at(jets, end, 1 + j))
            bent = plus(scaled(bend, both), times(factor, at(jets, end, place)))
            put(totals, to, place, plus(at(totals, to, place), bent))
            place += 1


@pasted
def _expand_about(problem: Problem, point: Floats, work: _Work) -> float:
    """Fills the totals about a point of a cell, and returns f there, rounded up."""
    jets, totals, rows = work.jets, work.totals, problem.rows
    totals[ABOUT, 0, 0] = -np.inf  # where f or a row has no value
    end = enclose(problem.tape, _COST, point, point, GRADIENT, jets)
    if end < 0:
        return np.inf
    _copy_jet(jets, end, totals, ABOUT)
    value = totals[ABOUT, 0, 1]
    for j in range(work.bends.size):
        if rows.slopes[j] == 0.0 and work.bends[j] == 0.0:
            continue
        end = enclose(problem.tape, 1 + j, point, point, GRADIENT, jets)
        if end < 0:
            totals[ABOUT, 0, 0] = -np.inf
            return np.inf
        _add_row(rows.slopes[j], work.bends[j], rows.targets[j], end, GRADIENT, ABOUT, work)
    return value


@pasted
def _bound(
    problem: Problem, low: Floats, high: Floats, threshold: float, work: _Work
) -> tuple[float, float]:
    """Bounds f from below over a cell, which may be made flat at the first box's faces, in place.

    Args:
        problem: f and the rows.
        low: the cell's lower ends.
        high: the cell's upper ends.
        threshold: a bound above it is good enough.
        work: room; its `point` is filled.

    Returns:
        The bound, +∞ of a cell that has no feasible minimizer, and f at the point, rounded up.
    """
    (tape, rows, outer, best), jets, totals = problem, work.jets, work.totals
    end = enclose(tape, _COST, low, high, HESSIAN, jets)
    if end < 0:
        return np.inf, np.inf
    natural = jets[end, 0, 0]
    _copy_jet(jets, end, totals, OVER)
    choose_point(low, high, best, work.point)
    for j in range(rows.lower.size):
        end = enclose(tape, 1 + j, low, high, HESSIAN, jets)
        if end < 0 or jets[end, 0, 0] > rows.upper[j] or jets[end, 0, 1] < rows.lower[j]:
            return np.inf, np.inf
        slope, t, bend = rows.slopes[j], rows.targets[j], rows.bends[j]
        if bend < 0.0:
            reach = max(up(jets[end, 0, 1] - t), up(t - jets[end, 0, 0]))
            bend = min(-bend, 1.999 * abs(slope) / reach) if 0.0 < reach < np.inf else 0.0
        work.bends[j] = bend
        if slope != 0.0 or bend != 0.0:
            _add_row(slope, bend, t, end, HESSIAN, OVER, work)
    if natural > threshold:
        return natural, np.inf
    if rows.lower.size:
        if _rows_exclude(problem, low, high, work):
            return np.inf, np.inf
    elif _press(low, high, outer, work):
        return np.inf, np.inf
    best_bound, at_point = natural, np.inf
    for attempt in range(2):
        point = work.point if attempt == 0 else work.second_point
        set_steps(point, low, high, work.steps)
        value = _expand_about(problem, point, work)
        bound, is_bowl = expansion_bound(
            totals[ABOUT], totals[OVER], work.steps, work.matrix, work.scales
        )
        best_bound = max(best_bound, bound)
        if attempt == 0:
            at_point = value
            if not is_bowl or best_bound > threshold:
                break
            descend(totals, work.point, low, high, work.second_point)
    return best_bound, at_point


@pasted
def _rows_exclude(problem: Problem, low: Floats, high: Floats, work: _Work) -> bool:
    """Returns whether the mean value theorem shows that a row holds nowhere in a cell."""
    jets, point, rows = work.jets, work.point, problem.rows
    set_steps(point, low, high, work.steps)
    for j in range(rows.lower.size):
        end = enclose(problem.tape, 1 + j, point, point, VALUE, jets)
        if end < 0:
            continue
        value = at(jets, end, 0)
        end = enclose(problem.tape, 1 + j, low, high, GRADIENT, jets)
        value = mean_value(value, jets, end, work.steps)
        if value[0] > rows.upper[j] or value[1] < rows.lower[j]:
            return True
    return False


@inner
def _press(low: Floats, high: Floats, outer: Floats, work: _Work) -> bool:
    """Makes a cell flat where f rises or falls over all of it, in place.

    Returns whether it holds no minimizer: where f falls towards a face that is not the first box's,
    what is beyond it is lower.
    """
    for i in range(low.size):
        a, b = at(work.totals, OVER, 1 + i)
        if low[i] == high[i] or not (a > 0.0 or b < 0.0):
            continue
        if not (math.isfinite(a) and math.isfinite(b)):
            continue
        face = low[i] if a > 0.0 else high[i]
        if face != (outer[0, i] if a > 0.0 else outer[1, i]):
            return True
        low[i] = high[i] = work.point[i] = face
    return False


@pasted
def _widest(problem: Problem, low: Floats, high: Floats, work: _Work) -> int:
    """Returns the variable with the largest share in variations of formulas, if not too short.

    Rows that are within their bounds anyway do not count. −1 if there is none.
    """
    jets, changes, parts, size = work.jets, work.scales, work.second_point, low.size
    for i in range(size):
        parts[i] = 0.0
    for j in range(-1, problem.rows.lower.size):
        end = enclose(problem.tape, 1 + j, low, high, GRADIENT, jets)
        least = problem.rows.lower[j] if j >= 0 else np.inf
        most = problem.rows.upper[j] if j >= 0 else -np.inf
        if end < 0 or (jets[end, 0, 0] >= least and jets[end, 0, 1] <= most):
            continue
        total = 0.0
        for i in range(size):
            a, b = at(jets, end, 1 + i)
            changes[i] = max(-a, b) * (high[i] - low[i]) if high[i] > low[i] else 0.0
            changes[i] = min(changes[i], 1e200) if changes[i] >= 0.0 else 1e200
            total += changes[i]
        for i in range(size):
            parts[i] += changes[i] / total if total > 0.0 else 0.0
    longest, best, most = 0.0, -1, -1.0
    for i in range(size):
        longest = max(longest, (high[i] - low[i]) / work.sides[i])
    for i in range(size):
        length = high[i] - low[i]
        if length / work.sides[i] < _LEAST_SIDE * longest or length == 0.0:
            continue
        change = np.inf if math.isinf(length) else parts[i]
        if change > most:
            best, most = i, change
    return best


@kernel
def explore(
    problem: Problem, heap: Heap, least: float, margin: float, scale: float, count: int
) -> tuple[float, float, int]:
    """Cuts the lowest open cells in two, until none is below the best value less a margin.

    Returns the least bound of those that were left alone, the least value, and how many were cut.
    """
    size, num_rows = problem.best.size, problem.rows.lower.size
    work = _Work(
        make_scratch(problem.tape, size, HESSIAN),
        np.empty((2, jet_size(size, HESSIAN), 2)),
        np.empty((size, 2)),
        np.empty(num_rows),
        np.empty(size),
        np.empty(size),
        np.empty((size, size)),
        np.empty(size),
        problem.outer[1] - problem.outer[0],
    )
    for i in range(size):
        if not 0.0 < work.sides[i] < np.inf:
            work.sides[i] = 1.0
    low, high, a, b = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    settled = np.inf
    for number in range(count):
        threshold, key = least - margin * max(abs(least), scale), heap.keys[0]
        is_full = heap.used[0] + 2 > heap.keys.size
        if heap.used[0] == 0 or key > threshold or is_full:
            return settled, least, number
        _pop(heap, low, high)
        i = _widest(problem, low, high, work)  # Its gradients were not kept.
        middle = middle_of(low[i], high[i]) if i >= 0 else 0.0
        if i < 0 or not low[i] < middle < high[i]:
            settled = min(settled, key)
            continue
        for half in range(2):
            _copy(low, a)
            _copy(high, b)
            if half == 0:
                b[i] = middle
            else:
                a[i] = middle
            threshold = least - margin * max(abs(least), scale)
            bound, value = _bound(problem, a, b, threshold, work)
            bound = max(bound, key)
            if num_rows == 0 and value < least:
                least = value
                _copy(work.point, problem.best)
            if bound == np.inf:
                continue
            if bound > threshold:
                settled = min(settled, bound)
            else:
                _push(heap, bound, a, b)
    return settled, least, count
