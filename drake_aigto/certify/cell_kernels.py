"""Bounds over cells of all variables at once, in compiled code."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.certify.contraction import contract
from drake_aigto.certify.enclosures import (
    GRADIENT,
    HESSIAN,
    VALUE,
    at,
    enclose,
    make_scratch,
    put,
)
from drake_aigto.certify.expansions import (
    bend_place,
    expansion_bound,
    mean_value,
    middle_of,
    set_steps,
)
from drake_aigto.certify.formulas import JointTape, Tape
from drake_aigto.certify.intervals import plus, power, scaled, times, up
from drake_aigto.certify.pricing import Rows
from drake_aigto.kernels import inner, kernel

_COST = 0  # the formula's number; that of row j is 1 + j
_ABOUT, _OVER = 0, 1  # jets of f about a point, and over a cell
# A side is not cut that is this much shorter than the first box's, beside the longest one.
_LEAST_SIDE = 1e-3
_STEPS = 8  # of the descent within a cell where f is convex


class Problem(NamedTuple):
    """Minimize f over a box, subject to rows.

    Attributes:
        tape: f and the rows.
        joint: the same with entries that they share.
        rows: R of them.
        outer: the box (2, n).
        best: the best known point (n,).
        known: its value, and the least bound of parts that were left alone (2,).
    """

    tape: Tape
    joint: JointTape
    rows: Rows
    outer: Floats
    best: Floats
    known: Floats


class _Work(NamedTuple):
    """Room for the enclosures of one cell.

    Attributes:
        jets: of a formula's entries (E, J, 2).
        values: of a formula's entries (E, 1, 2).
        totals: of f with its rows, about a point and over the cell (2, J, 2).
        steps: from the point to the cell's ends (n, 2).
        bends: ρ of each row in this cell (R,).
        point: of the cell (n,).
        second_point: another one (n,).
        matrix: for Cholesky's factor (n, n).
        scales: of the variables (n,).
        shares: of the variables in variations of formulas (n,).
        sides: of the first box, 1 where it has no such side (n,).
        old: a box (2, n).
        ranges: of the joint tape's entries.
        lower: bounds of f and the rows (1 + R,).
        upper: shape (1 + R,).
    """

    jets: Floats
    values: Floats
    totals: Floats
    steps: Floats
    bends: Floats
    point: Floats
    second_point: Floats
    matrix: Floats
    scales: Floats
    shares: Floats
    sides: Floats
    old: Floats
    ranges: Floats
    lower: Floats
    upper: Floats


@inner
def _copy_jet(jets: Floats, end: int, totals: Floats, to: int) -> None:
    for place in range(totals.shape[1]):
        put(totals, to, place, at(jets, end, place))


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


@inner
def _expand_about(problem: Problem, point: Floats, work: _Work) -> float:
    """Fills the totals about a point of a cell, and returns f there, rounded up."""
    jets, totals, rows = work.jets, work.totals, problem.rows
    totals[_ABOUT, 0, 0] = -np.inf  # where f or a row has no value
    end = enclose(problem.tape, _COST, point, point, GRADIENT, jets)
    if end < 0:
        return np.inf
    _copy_jet(jets, end, totals, _ABOUT)
    value = totals[_ABOUT, 0, 1]
    for j in range(work.bends.size):
        if rows.slopes[j] == 0.0 and work.bends[j] == 0.0:
            continue
        end = enclose(problem.tape, 1 + j, point, point, GRADIENT, jets)
        if end < 0:
            totals[_ABOUT, 0, 0] = -np.inf
            return np.inf
        _add_row(rows.slopes[j], work.bends[j], rows.targets[j], end, GRADIENT, _ABOUT, work)
    return value


@inner
def _narrow(problem: Problem, low: Floats, high: Floats, work: _Work) -> bool:
    """Narrows a cell to where rows may hold, and f is no more than the best value, in place.

    Returns whether anything is left.
    """
    rows, known = problem.rows, problem.known
    work.lower[0], work.upper[0] = -np.inf, known[0]
    known[1] = min(known[1], known[0])
    for j in range(rows.lower.size):
        work.lower[1 + j], work.upper[1 + j] = rows.lower[j], rows.upper[j]
    return contract(problem.joint, work.lower, work.upper, low, high, work.ranges, work.old)


@inner
def _bound(
    problem: Problem, low: Floats, high: Floats, margins: tuple[float, float], work: _Work
) -> float:
    """Returns a bound of f over a cell, +∞ if it has no feasible minimizer.

    Narrows the cell, and takes a better point where there are no rows.

    Args:
        problem: f and the rows.
        low: the cell's lower ends.
        high: the cell's upper ends.
        margins: see `bound_cells`.
        work: room; its `shares` are filled.
    """
    (tape, _, rows, outer, best, known), jets, totals = problem, work.jets, work.totals
    work.shares[:] = 0.0
    if not _narrow(problem, low, high, work):
        return np.inf
    end = enclose(tape, _COST, low, high, HESSIAN, jets)
    if end < 0:
        return np.inf
    natural = jets[end, 0, 0]
    _copy_jet(jets, end, totals, _OVER)
    _add_shares(end, low, high, work)
    _choose_point(low, high, best, work.point)
    set_steps(work.point, low, high, work.steps)
    for j in range(rows.lower.size):
        if not _take_row(problem, j, low, high, work):
            return np.inf
    if natural > known[0] - margins[0] * max(abs(known[0]), margins[1]):
        return natural
    if rows.lower.size == 0 and _press(low, high, outer, work):
        return np.inf
    bound = natural
    for attempt in range(2):
        point = work.point if attempt == 0 else work.second_point
        set_steps(point, low, high, work.steps)
        value = _expand_about(problem, point, work)
        if rows.lower.size == 0 and value < known[0]:
            known[0], best[:] = value, point
        found, is_bowl = expansion_bound(
            totals[_ABOUT], totals[_OVER], work.steps, work.matrix, work.scales
        )
        bound = max(bound, found)
        if not is_bowl or bound > known[0] - margins[0] * max(abs(known[0]), margins[1]):
            break
        if attempt == 0:
            _descend(totals, work.point, low, high, work.second_point)
    return bound


@inner
def _take_row(problem: Problem, j: int, low: Floats, high: Floats, work: _Work) -> bool:
    """Adds a row's terms to the totals over a cell; returns whether the row may hold there."""
    tape, rows, jets = problem.tape, problem.rows, work.jets
    lower, upper, t = rows.lower[j], rows.upper[j], rows.targets[j]
    end = enclose(tape, 1 + j, work.point, work.point, VALUE, work.values)
    value = at(work.values, end, 0) if end >= 0 else (-np.inf, np.inf)
    end = enclose(tape, 1 + j, low, high, HESSIAN, jets)
    if end < 0:
        return False
    value = mean_value(value, jets, end, work.steps)
    if value[0] > upper or value[1] < lower:
        return False
    if value[0] < lower or value[1] > upper:
        _add_shares(end, low, high, work)
    slope, bend = rows.slopes[j], rows.bends[j]
    if bend < 0.0:
        reach = max(up(jets[end, 0, 1] - t), up(t - jets[end, 0, 0]))
        bend = min(-bend, 1.999 * abs(slope) / reach) if 0.0 < reach < np.inf else 0.0
    work.bends[j] = bend
    if slope != 0.0 or bend != 0.0:
        _add_row(slope, bend, t, end, HESSIAN, _OVER, work)
    return True


@inner
def _add_shares(end: int, low: Floats, high: Floats, work: _Work) -> None:
    """Adds the share of each variable in the variation of a formula over a cell."""
    total, changes = 0.0, work.scales
    for i in range(low.size):
        a, b = at(work.jets, end, 1 + i)
        change = max(-a, b) * (high[i] - low[i]) if high[i] > low[i] else 0.0
        changes[i] = min(change, 1e200) if change >= 0.0 else 1e200
        total += changes[i]
    for i in range(low.size):
        work.shares[i] += changes[i] / total if total > 0.0 else 0.0


@inner
def _press(low: Floats, high: Floats, outer: Floats, work: _Work) -> bool:
    """Makes a cell flat where f rises or falls over all of it, in place.

    Returns whether it holds no minimizer: where f falls towards a face that is not the first box's,
    what is beyond it is lower, if f has values there: a finite Hessian says so.
    """
    size = low.size
    for i in range(size):
        a, b = at(work.totals, _OVER, 1 + i)
        bend = at(work.totals, _OVER, bend_place(size, i, i))
        if low[i] == high[i] or not (a > 0.0 or b < 0.0):
            continue
        face = low[i] if a > 0.0 else high[i]
        if not (math.isfinite(bend[1] - bend[0]) and math.isfinite(b - a) and math.isfinite(face)):
            continue
        if face != (outer[0, i] if a > 0.0 else outer[1, i]):
            return True
        low[i] = high[i] = work.point[i] = face
    return False


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
            point[i] = middle_of(low[i], high[i])


@inner
def _descend(jets: Floats, start: Floats, low: Floats, high: Floats, point: Floats) -> None:
    """Fills where the model g d + ½ dᵀ H d is nearly least in a cell, a coordinate at a time."""
    size = point.size
    point[:] = start
    for _ in range(_STEPS):
        for i in range(size):
            slope = 0.5 * (jets[_ABOUT, 1 + i, 0] + jets[_ABOUT, 1 + i, 1])
            curvature = 0.0
            for j in range(size):
                place = bend_place(size, i, j)
                middle = 0.5 * (jets[_OVER, place, 0] + jets[_OVER, place, 1])
                slope += middle * (point[j] - start[j])
                curvature = middle if j == i else curvature
            if curvature > 0.0:
                point[i] = min(max(point[i] - slope / curvature, low[i]), high[i])


@inner
def _choose_cut(low: Floats, high: Floats, work: _Work) -> int:
    """Returns the variable with the largest share, among those that can be cut; −1: none can.

    One that is much shorter than others is not cut.
    """
    longest, best, most = 0.0, -1, -1.0
    for i in range(low.size):
        if low[i] < middle_of(low[i], high[i]) < high[i]:
            longest = max(longest, (high[i] - low[i]) / work.sides[i])
    for i in range(low.size):
        length = high[i] - low[i]
        is_long = length / work.sides[i] >= _LEAST_SIDE * longest
        if is_long and low[i] < middle_of(low[i], high[i]) < high[i]:
            share = np.inf if math.isinf(length) else work.shares[i]
            if share > most:
                best, most = i, share
    return best


@kernel
def bound_cells(
    problem: Problem,
    low: Floats,
    high: Floats,
    margins: tuple[float, float],
    bounds: Floats,
    cuts: Ints,
) -> None:
    """Raises bounds of f over cells, +∞ of those that have no feasible minimizer.

    Narrows cells in place. Bounds are good enough that are above the best value by more than a
    margin, relative to it or to a scale. Fills where cells are to be cut in two.

    Args:
        problem: f and the rows; takes better points, where there are no rows.
        low: lower ends of the cells (C, n).
        high: upper ends.
        margins: the margin, and the scale.
        bounds: shape (C,).
        cuts: variables to cut; −1: none can be (C,).
    """
    size, num_rows = problem.best.size, problem.rows.lower.size
    jets = make_scratch(problem.tape, size, HESSIAN)
    work = _Work(
        jets,
        make_scratch(problem.tape, size, VALUE),
        np.empty((2, jets.shape[1], 2)),
        np.empty((size, 2)),
        np.empty(num_rows),
        np.empty(size),
        np.empty(size),
        np.empty((size, size)),
        np.empty(size),
        np.empty(size),
        problem.outer[1] - problem.outer[0],
        np.empty((2, size)),
        make_scratch(problem.joint.tape, size, VALUE),
        np.empty(1 + num_rows),
        np.empty(1 + num_rows),
    )
    for i in range(size):
        if not 0.0 < work.sides[i] < np.inf:
            work.sides[i] = 1.0
    for c in range(len(low)):
        bounds[c] = max(bounds[c], _bound(problem, low[c], high[c], margins, work))
        cuts[c] = _choose_cut(low[c], high[c], work)
