"""Newton's method on a barrier function with penalized rows, compiled as a whole.

    Φ(x) = s f(x) + yᵀ r(x) + ρ/2 Σ w_i² r_i(x)² − μ Σ log (slacks of bounds),    r = c(x) − ε

Of rows that are to be at or below ε, r_i = max(c_i(x) − ε, −y_i/(ρ w_i²)), with y_i ≥ 0
(Rockafellar 1973): those that are well below it neither cost nor curve.

One call goes a rung of a ladder: to a minimizer for given (ε, ρ, μ), followed by y ← y + ρ w² r,
the method of multipliers (Hestenes 1969, Powell 1969). The Hessian is a band: far from feasible
points an iteration costs as much as near them, and no restoration is ever needed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.box import NO_SYSTEM, Lanes, Order, System, add_means, make_lanes
from drake_aigto.kernels import borrow, borrowing, inner, kernel
from drake_aigto.linear import factorize_band, narrow_band, solve_band
from drake_aigto.local.nlp import PolynomialNlp

_TAU = 0.995  # of any slack that a step may use
_KAPPA = 1e3  # largest factor between multipliers of bounds and μ/slack
_ARMIJO, _HALVINGS = 1e-4, 12
# Shifts of the Hessian, in units of the variables: they are tried one after the other.
_FIRST_SHIFT, _LEAST_SHIFT, _LARGEST_SHIFT = 1e-3, 1e-6, 1e6
_HARDER, _SOFTER, _AFTER_FAILURE = 5.0, 0.3, 1e-2
# Steps without the rows' curvature once it has made the Hessian indefinite.
_CONVEX_STEPS = 3


class PenaltyTables(NamedTuple):
    """Costs and, behind them, the m rows of a program, for kernels.

    Letters: C copies of its sums, n variables, nf of them free, half bandwidth b.

    Attributes:
        values: for values.
        derivatives: for derivatives.
        weights: factor of each copy (C,).
        places: place of each variable in the band, −1 where it is held (n,).
        size: nf.
        bandwidth: b.
    """

    values: Lanes
    derivatives: Lanes
    weights: Floats
    places: Ints
    size: int
    bandwidth: int


def make_penalty_tables(nlp: PolynomialNlp) -> PenaltyTables:
    """Returns the tables of a program, its free variables in an order of narrow band.

    Variables of a row are coupled, as rows are squared.
    """
    free = np.flatnonzero(nlp.lower != nlp.upper)
    position = np.full(nlp.num_variables, -1)
    position[free] = np.arange(free.size)
    copies, pairs = nlp.terms.couplings()
    found = position[pairs].T
    are_free = np.all(found >= 0, axis=0)
    is_read = are_free & (copies >= nlp.num_costs) & (found[0] == found[1])
    rows, columns = copies[is_read] - nlp.num_costs, found[0, is_read]
    shape = nlp.num_rows, free.size
    jacobian = coo_array((np.ones(rows.size), (rows, columns)), shape=shape).tocsr()
    coupled = (jacobian.T @ jacobian).tocoo()
    edges = np.hstack([np.vstack(coupled.coords), found[:, are_free]])
    order = narrow_band(free.size, edges)
    places = np.full(nlp.num_variables, -1)
    places[free] = order
    return PenaltyTables(
        values=make_lanes(nlp.terms, Order.MEAN),
        derivatives=make_lanes(nlp.terms, Order.CENTERS),
        weights=np.array(nlp.copy_weights),
        places=places,
        size=free.size,
        bandwidth=int(np.max(np.abs(order[edges[0]] - order[edges[1]]), initial=0)),
    )


class PenaltyProgram(NamedTuple):
    """A program as the kernel reads it."""

    places: Ints  # of the tables: place of each variable in the band, −1 where it is held (n,)
    bounds: Floats  # lower and upper ones, infinite where there is none (2, n)
    units: Floats  # a distance that matters, of each variable (n,)
    row_scales: Floats  # w, of each row (m,)
    is_upper: Bools  # rows that are to be at or below ε, all others at it (m,)
    cost_scale: float  # s


class PenaltyIterate(NamedTuple):
    """A point and its multipliers, which a rung moves."""

    x: Floats  # the point, within its bounds (n,)
    multipliers: Floats  # y (m,)
    of_bounds: Floats  # multipliers of lower and upper bounds (2, n)


class PenaltyRung(NamedTuple):
    """Penalty and barrier, and when to stop."""

    relaxation: float  # ε of the rows that are relaxed
    weight: float  # ρ
    barrier: float  # μ
    max_steps: int  # Newton steps
    tolerance: float  # of the decrease that a step promises, where the rung ends


@borrowing
def _inactive(program: PenaltyProgram, weight: float, multipliers: Floats, i: int) -> float:
    """Returns r below which a row neither costs nor curves; −∞ of one that is to be at ε."""
    if not program.is_upper[i]:
        return -np.inf
    scale = program.row_scales[i]
    return -multipliers[i] / (weight * scale * scale)


@inner
def _merit(
    tables: PenaltyTables,
    program: PenaltyProgram,
    targets: Floats,
    rung: PenaltyRung,
    multipliers: Floats,
    x: Floats,
    values: Floats,
    rows: Floats,
) -> tuple[float, float]:
    """Fills rows r(x) (m,), and weighted values of all copies (C,); returns Φ and f."""
    weight, num_costs = rung.weight, values.size - rows.size
    add_means(tables.values, tables.weights, x, np.zeros(x.size), values, NO_SYSTEM)
    cost = np.sum(values[:num_costs])
    total = program.cost_scale * cost
    for i in range(rows.size):
        inactive = _inactive(program, weight, multipliers, i)
        rows[i] = max(values[num_costs + i] - targets[i], inactive)
        scaled = program.row_scales[i] * rows[i]
        total += multipliers[i] * rows[i] + 0.5 * weight * scaled * scaled
    for i in range(x.size):
        for side in range(2):
            if program.places[i] >= 0 and math.isfinite(program.bounds[side, i]):
                total -= rung.barrier * math.log(_slack(program.bounds, side, i, x[i]))
    return total, cost


@borrowing
def _slack(bounds: Floats, side: int, i: int, x: float) -> float:
    """Returns the distance of a variable x from a bound, below 0 beyond it."""
    return x - bounds[side, i] if side == 0 else bounds[side, i] - x


@borrowing
def _add_bounds(
    program: PenaltyProgram, iterate: PenaltyIterate, barrier: float, system: System
) -> None:
    """Adds the barrier's gradient and primal-dual Hessian."""
    for i in range(iterate.x.size):
        place = program.places[i]
        for side in range(2):
            if place >= 0 and math.isfinite(program.bounds[side, i]):
                slack = _slack(program.bounds, side, i, iterate.x[i])
                system.gradient[place] -= (1 - 2 * side) * barrier / slack
                system.band[place, 0] += iterate.of_bounds[side, i] / slack


@inner
def _factorize(program: PenaltyProgram, hessian: Floats, factor: Floats, shift: float) -> float:
    """Fills the factor of a Hessian, shifted as little as makes it definite; returns the shift."""
    while shift <= _LARGEST_SHIFT:
        factor[:] = hessian
        if shift > 0.0:
            for i in range(program.units.size):
                place = program.places[i]
                if place >= 0:
                    factor[place, 0] += shift / (program.units[i] * program.units[i])
        if factorize_band(factor):
            return shift
        shift = max(_FIRST_SHIFT, _HARDER * shift)
    return shift


@borrowing
def _longest(program: PenaltyProgram, x: Floats, step: Floats) -> float:
    """Returns the part of a step, up to 1, that leaves slacks room."""
    length = 1.0
    for i in range(x.size):
        bound = program.bounds[int(step[i] > 0.0), i]
        if abs(step[i]) > 0.0 and math.isfinite(bound):
            length = min(length, _TAU * (bound - x[i]) / step[i])
    return length


@borrowing
def _moved(multiplier: float, slack: float, change: float, barrier: float) -> float:
    """Returns a bound's multiplier after a full Newton step that changes its slack."""
    step = barrier / slack - multiplier - multiplier / slack * change
    if step < 0.0:
        step *= min(1.0, _TAU * multiplier / -step)
    return multiplier + step


@borrowing
def _move(
    program: PenaltyProgram, iterate: PenaltyIterate, barrier: float, step: Floats, to: Floats
) -> None:
    """Moves the point, and the multipliers of bounds."""
    for i in range(step.size):
        if program.places[i] < 0:
            continue
        for side in range(2):
            if math.isfinite(program.bounds[side, i]):
                slack = _slack(program.bounds, side, i, iterate.x[i])
                change = (1 - 2 * side) * step[i]
                z = _moved(iterate.of_bounds[side, i], slack, change, barrier)
                middle = barrier / _slack(program.bounds, side, i, to[i])
                iterate.of_bounds[side, i] = min(max(z, middle / _KAPPA), middle * _KAPPA)
        iterate.x[i] = to[i]


@inner
def _differentiate(
    tables: PenaltyTables,
    program: PenaltyProgram,
    iterate: PenaltyIterate,
    rung: PenaltyRung,
    rows: Floats,
    is_convex: bool,
    values: Floats,
    system: System,
) -> None:
    """Fills Φ's gradient and Hessian, the latter without the rows' curvature if it is convex."""
    weight, num_costs = rung.weight, values.size - rows.size
    multipliers, penalties = system.multipliers, system.penalties
    assert penalties is not None
    for i in range(rows.size):
        copy, scale = num_costs + i, program.row_scales[i]
        is_active = rows[i] > _inactive(program, weight, iterate.multipliers, i)
        estimate = iterate.multipliers[i] + weight * scale * scale * rows[i] if is_active else 0.0
        penalties[0, copy] = estimate
        multipliers[copy] = 0.0 if is_convex else estimate
        counts = not program.is_upper[i] or estimate != 0.0
        penalties[1, copy] = weight * scale * scale if counts else 0.0
    multipliers[:num_costs] = penalties[0, :num_costs] = program.cost_scale
    system.gradient[:] = 0.0
    system.band[:] = 0.0
    x = iterate.x
    add_means(tables.derivatives, tables.weights, x, np.zeros(x.size), values, system)
    _add_bounds(program, iterate, rung.barrier, system)


@kernel
def descend(
    tables: PenaltyTables,
    program: PenaltyProgram,
    targets: Floats,
    rung: PenaltyRung,
    iterate: PenaltyIterate,
    rows: Floats,
) -> tuple[int, float]:
    """Minimizes Φ from an iterate, which is overwritten, and moves the multipliers of rows.

    It starts strictly within its bounds; targets are ε of each row, rows filled with r, both (m,).
    Returns the number of steps, and f.
    """
    # Two tuples, as functions that take one count references of all its arrays.
    tables, program, iterate = borrow(tables), borrow(program), borrow(iterate)
    x, places, size = iterate.x, program.places, tables.size
    tried, step, right = np.empty(x.size), np.zeros(x.size), np.empty(size)
    values, new_rows = np.empty(tables.weights.size), np.empty(rows.size)
    band = np.empty((size, tables.bandwidth + 1))
    factor = np.empty_like(band)
    system = System(
        *(np.empty(values.size), places, np.full(values.size, -1), np.empty(size), band, None),
        penalties=np.zeros((2, values.size)),
    )
    multipliers = iterate.multipliers
    merit, cost = _merit(tables, program, targets, rung, multipliers, x, values, rows)
    shift, convex_steps, steps = 0.0, 0, 0
    while steps < rung.max_steps and shift <= _LARGEST_SHIFT:
        is_convex = convex_steps > 0
        _differentiate(tables, program, iterate, rung, rows, is_convex, values, system)
        if is_convex:
            convex_steps -= 1
            shift = _SOFTER * shift if shift > _LEAST_SHIFT else 0.0
            shift = _factorize(program, band, factor, shift)
        else:
            factor[:] = band
            if not factorize_band(factor):
                convex_steps = _CONVEX_STEPS
                continue
        steps += 1
        right[:] = -system.gradient
        solve_band(factor, right)
        slope = np.dot(system.gradient, right)
        if not -slope >= rung.tolerance:
            break
        for i in range(x.size):
            step[i] = right[places[i]] if places[i] >= 0 else 0.0
        length, is_lower = _longest(program, x, step), False
        for _ in range(_HALVINGS):
            tried[:] = x + length * step
            new_merit, new_cost = _merit(
                tables, program, targets, rung, multipliers, tried, values, new_rows
            )
            is_lower = new_merit <= merit + _ARMIJO * length * slope
            if is_lower:
                break
            length *= 0.5
        if is_lower:
            _move(program, iterate, rung.barrier, step, tried)
            merit, cost = new_merit, new_cost
            rows[:] = new_rows
        else:
            shift, convex_steps = max(_AFTER_FAILURE, 20.0 * shift), _CONVEX_STEPS
    for i in range(rows.size):
        scale = program.row_scales[i]
        multipliers[i] += rung.weight * scale * scale * rows[i]
        if program.is_upper[i]:
            multipliers[i] = max(0.0, multipliers[i])
    return steps, cost
