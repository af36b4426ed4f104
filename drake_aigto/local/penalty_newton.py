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

from drake_aigto.arrays import Bools, Floats
from drake_aigto.kernels import borrow, inner, kernel
from drake_aigto.local.points import (
    PointSystem,
    PointTables,
    differentiate,
    evaluate,
    factorize_band,
    solve_band,
)

_TAU = 0.995  # of any slack that a step may use
_KAPPA = 1e3  # largest factor between multipliers of bounds and μ/slack
_ARMIJO, _HALVINGS = 1e-4, 12
# Shifts of the Hessian, in units of the variables: they are tried one after the other.
_FIRST_SHIFT, _LEAST_SHIFT, _LARGEST_SHIFT = 1e-3, 1e-6, 1e6
_HARDER, _SOFTER, _AFTER_FAILURE = 5.0, 0.3, 1e-2
# Steps without the rows' curvature once it has made the Hessian indefinite.
_CONVEX_STEPS = 3


class PenaltyProgram(NamedTuple):
    """A program as the kernel reads it.

    Attributes:
        tables: of its costs and rows.
        bounds: lower and upper ones, infinite where there is none (2, n).
        units: a distance that matters, of each variable (n,).
        row_scales: w, of each row (m,).
        is_upper: rows that are to be at or below ε, all others at it (m,).
        cost_scale: s.
    """

    tables: PointTables
    bounds: Floats
    units: Floats
    row_scales: Floats
    is_upper: Bools
    cost_scale: float


class PenaltyIterate(NamedTuple):
    """A point and its multipliers, which a rung moves.

    Attributes:
        x: the point, within its bounds (n,).
        multipliers: y (m,).
        of_bounds: multipliers of lower and upper bounds (2, n).
    """

    x: Floats
    multipliers: Floats
    of_bounds: Floats


class PenaltyRung(NamedTuple):
    """Penalty and barrier, and when to stop.

    Attributes:
        relaxation: ε of the rows that are relaxed.
        weight: ρ.
        barrier: μ.
        max_steps: Newton steps.
        tolerance: of the decrease that a step promises, where the rung ends.
    """

    relaxation: float
    weight: float
    barrier: float
    max_steps: int
    tolerance: float


@inner
def _inactive(program: PenaltyProgram, weight: float, multipliers: Floats, i: int) -> float:
    """Returns r below which a row neither costs nor curves; −∞ of one that is to be at ε."""
    if not program.is_upper[i]:
        return -np.inf
    scale = program.row_scales[i]
    return -multipliers[i] / (weight * scale * scale)


@inner
def _merit(
    program: PenaltyProgram,
    targets: Floats,
    rung: PenaltyRung,
    multipliers: Floats,
    x: Floats,
    values: Floats,
    rows: Floats,
) -> tuple[float, float]:
    """Fills rows r(x) (m,), and the functions' values; returns Φ and f."""
    weight, cost = rung.weight, evaluate(program.tables, x, values, rows)
    total = program.cost_scale * cost
    for i in range(rows.size):
        rows[i] = max(rows[i] - targets[i], _inactive(program, weight, multipliers, i))
        scaled = program.row_scales[i] * rows[i]
        total += multipliers[i] * rows[i] + 0.5 * weight * scaled * scaled
    for i in range(x.size):
        for side in range(2):
            if program.tables.places[i] >= 0 and math.isfinite(program.bounds[side, i]):
                total -= rung.barrier * math.log(_slack(program.bounds, side, i, x[i]))
    return total, cost


@inner
def _slack(bounds: Floats, side: int, i: int, x: float) -> float:
    """Returns the distance of a variable x from a bound, below 0 beyond it."""
    return x - bounds[side, i] if side == 0 else bounds[side, i] - x


@inner
def _add_bounds(
    program: PenaltyProgram, iterate: PenaltyIterate, barrier: float, system: PointSystem
) -> None:
    """Adds the barrier's gradient and primal-dual Hessian."""
    for i in range(iterate.x.size):
        place = program.tables.places[i]
        for side in range(2):
            if place >= 0 and math.isfinite(program.bounds[side, i]):
                slack = _slack(program.bounds, side, i, iterate.x[i])
                system.gradient[place] -= (1 - 2 * side) * barrier / slack
                system.hessian[place, 0] += iterate.of_bounds[side, i] / slack


@inner
def _add_rows(
    program: PenaltyProgram, weight: float, multipliers: Floats, system: PointSystem
) -> None:
    """Adds the rows' gradient, and the convex part of their penalty's Hessian."""
    tables = program.tables
    for row in range(multipliers.size):
        if program.is_upper[row] and multipliers[row] == 0.0:
            continue
        scale = weight * program.row_scales[row] * program.row_scales[row]
        first, last = tables.first_entries[row], tables.first_entries[row + 1]
        for i in range(first, last):
            place, slope = tables.entry_places[i], system.jacobian[i]
            system.gradient[place] += multipliers[row] * slope
            for j in range(first, last):
                other = tables.entry_places[j]
                if other >= place:
                    product = scale * slope * system.jacobian[j]
                    system.hessian[place, other - place] += product


@inner
def _factorize(program: PenaltyProgram, hessian: Floats, factor: Floats, shift: float) -> float:
    """Fills the factor of a Hessian, shifted as little as makes it definite; returns the shift."""
    while shift <= _LARGEST_SHIFT:
        factor[:] = hessian
        if shift > 0.0:
            for i in range(program.units.size):
                place = program.tables.places[i]
                if place >= 0:
                    factor[place, 0] += shift / (program.units[i] * program.units[i])
        if factorize_band(factor):
            return shift
        shift = max(_FIRST_SHIFT, _HARDER * shift)
    return shift


@inner
def _longest(program: PenaltyProgram, x: Floats, step: Floats) -> float:
    """Returns the part of a step, up to 1, that leaves slacks room."""
    length = 1.0
    for i in range(x.size):
        bound = program.bounds[int(step[i] > 0.0), i]
        if abs(step[i]) > 0.0 and math.isfinite(bound):
            length = min(length, _TAU * (bound - x[i]) / step[i])
    return length


@inner
def _moved(multiplier: float, slack: float, change: float, barrier: float) -> float:
    """Returns a bound's multiplier after a full Newton step that changes its slack."""
    step = barrier / slack - multiplier - multiplier / slack * change
    if step < 0.0:
        step *= min(1.0, _TAU * multiplier / -step)
    return multiplier + step


@inner
def _move(
    program: PenaltyProgram, iterate: PenaltyIterate, barrier: float, step: Floats, to: Floats
) -> None:
    """Moves the point, and the multipliers of bounds."""
    for i in range(step.size):
        if program.tables.places[i] < 0:
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
    program: PenaltyProgram,
    iterate: PenaltyIterate,
    rung: PenaltyRung,
    rows: Floats,
    estimates: Floats,
    is_convex: bool,
    system: PointSystem,
) -> None:
    """Fills Φ's gradient and Hessian, the latter without the rows' curvature if it is convex."""
    weight = rung.weight
    for i in range(rows.size):
        estimates[i] = 0.0
        if rows[i] > _inactive(program, weight, iterate.multipliers, i):
            scale = program.row_scales[i]
            estimates[i] = iterate.multipliers[i] + weight * scale * scale * rows[i]
    curved = np.zeros(rows.size) if is_convex else estimates
    differentiate(program.tables, iterate.x, program.cost_scale, curved, system)
    _add_bounds(program, iterate, rung.barrier, system)
    _add_rows(program, weight, estimates, system)


@kernel
def differentiate_at(tables: PointTables, x: Floats, system: PointSystem) -> None:
    """Fills a system at a point (n,), without curvature of rows."""
    num_rows = tables.first_entries.size - 1
    differentiate(borrow(tables), x, 1.0, np.zeros(num_rows), borrow(system))


@kernel
def descend(
    program: PenaltyProgram,
    targets: Floats,
    rung: PenaltyRung,
    iterate: PenaltyIterate,
    system: PointSystem,
    rows: Floats,
) -> tuple[int, float]:
    """Minimizes Φ from an iterate, which is overwritten, and moves the multipliers of rows.

    Args:
        program: the program.
        targets: ε of each row (m,).
        rung: weights, and when to stop.
        iterate: the start, strictly within its bounds.
        system: room for derivatives.
        rows: filled with r (m,).

    Returns:
        The number of steps, and f.
    """
    program, iterate, system = borrow(program), borrow(iterate), borrow(system)
    x, size = iterate.x, system.gradient.size
    tried, step, right = np.empty(x.size), np.zeros(x.size), np.empty(size)
    new_rows, estimates = np.empty(rows.size), np.empty(rows.size)
    factor = np.empty_like(system.hessian)
    places, multipliers = program.tables.places, iterate.multipliers
    merit, cost = _merit(program, targets, rung, multipliers, x, system.values, rows)
    shift, convex_steps, steps = 0.0, 0, 0
    while steps < rung.max_steps and shift <= _LARGEST_SHIFT:
        is_convex = convex_steps > 0
        _differentiate(program, iterate, rung, rows, estimates, is_convex, system)
        if is_convex:
            convex_steps -= 1
            shift = _SOFTER * shift if shift > _LEAST_SHIFT else 0.0
            shift = _factorize(program, system.hessian, factor, shift)
        else:
            factor[:] = system.hessian
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
                program, targets, rung, multipliers, tried, system.values, new_rows
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
