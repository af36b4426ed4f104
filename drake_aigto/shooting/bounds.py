"""Bounds at knots as an augmented Lagrangian, and how far they are off."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.jit import inner, kernel
from drake_aigto.shooting.cones import measure_modes
from drake_aigto.shooting.layout import triangle
from drake_aigto.shooting.mechanism import find_foremost
from drake_aigto.shooting.tables import FLOW, Bounds, Memory, Program
from drake_aigto.shooting.tape import run_tape


@inner
def _excess(value: float, lower: float, upper: float) -> float:
    """Returns how far a value is above its upper bound, negative below the lower one."""
    return max(value - upper, 0.0) + min(value - lower, 0.0)


@inner
def _unwind(bounds: Bounds, k: int, i: int, value: float) -> float:
    """Returns a state without the turns that are between it and where it has to end."""
    if bounds.does_turn[i] and k == bounds.lower.shape[0] - 1:
        return value - 2 * np.pi * np.round((value - bounds.lower[k, i]) / (2 * np.pi))
    return value


@inner
def add_bounds(
    program: Program,
    states: Floats,
    controls: Floats,
    penalty: float,
    has_slopes: bool,
    memory: Memory,
) -> float:
    """Returns what all bounds at knots add to the cost; adds to its derivatives if asked."""
    bounds, l1, l2 = program.bounds, memory.expansion.l1, memory.expansion.l2
    lower, upper, is_bounded = bounds.lower, bounds.upper, bounds.is_bounded
    weights, multipliers, cost = bounds.weights, bounds.multipliers, 0.0
    for k in range(states.shape[0]):
        if is_bounded[k]:
            for i in range(states.shape[1]):
                weight = penalty * weights[i]
                shifted = _unwind(bounds, k, i, states[k, i]) + multipliers[k, i] / weight
                off = _excess(shifted, lower[k, i], upper[k, i])
                cost += weight * off * off / 2
                if has_slopes and off != 0.0:
                    l1[k, i] += weight * off
                    l2[k, i, i] += weight
        if bounds.is_distance_bounded[k]:
            cost += _add_distances(program, k, states[k], penalty, has_slopes, memory)
        if k < program.kinds.size and program.kinds[k] >= 0:
            cost += _add_approach(program, k, states[k], penalty, has_slopes, memory)
        u = controls[min(k, controls.shape[0] - 1)]
        cost += _add_modes(program, k, states[k], u, penalty, has_slopes, memory)
    return cost


@inner
def _add_distances(
    program: Program, k: int, z: Floats, penalty: float, has_slopes: bool, memory: Memory
) -> float:
    """Returns what the bounds of φ at knot k add; adds to derivatives if asked."""
    bounds, cost, n = program.bounds, 0.0, program.mechanics.actuation.shape[0]
    l1, l2, sums = memory.expansion.l1, memory.expansion.l2, memory.flow.mechanics.sums
    weight = penalty * bounds.distance_weight
    phi, m = measure_distances(program, z, False, memory), bounds.lower_distance.shape[1]
    for i in range(m):
        if not _counts(program, k, i, phi, sums):
            continue
        shifted = sums[phi + i] + bounds.distance_multipliers[k, i] / weight
        off = _excess(shifted, bounds.lower_distance[k, i], bounds.upper_distance[k, i])
        cost += weight * off * off / 2
        if has_slopes and off != 0.0:
            row = phi + m + i * n
            for j in range(n):
                l1[k, j] += weight * off * sums[row + j]
                for c in range(n):
                    l2[k, j, c] += weight * sums[row + j] * sums[row + c]
    return cost


@inner
def _add_approach(
    program: Program, k: int, z: Floats, penalty: float, has_slopes: bool, memory: Memory
) -> float:
    """Returns what a bound of φ̇ adds before the impact at knot k; adds to derivatives if asked.

    Where φ̇ > 0 a motion would come out of a wall, and be pulled back by the impact.
    """
    bounds, nx = program.bounds, 2 * program.mechanics.actuation.shape[0]
    l1, l2, slope = memory.expansion.l1, memory.expansion.l2, memory.flow.points[0]
    weight = penalty * bounds.approach_weight
    rate = _measure_approach(program, program.kinds[k], z, has_slopes, memory)
    off = max(rate + bounds.slowest + bounds.approach_multipliers[k] / weight, 0.0)
    if has_slopes and off > 0.0:
        for j in range(nx):
            l1[k, j] += weight * off * slope[j]
            for c in range(nx):
                l2[k, j, c] += weight * slope[j] * slope[c]
    return weight * off * off / 2


@inner
def _add_modes(
    program: Program,
    k: int,
    z: Floats,
    u: Floats,
    penalty: float,
    has_slopes: bool,
    memory: Memory,
) -> float:
    """Returns what modes ask for at knot k adds; adds to derivatives by (q, v, u) if asked."""
    if not measure_modes(program, k, z, u, has_slopes, memory):
        return 0.0
    values, slopes, weights, _ = memory.modes
    l1, l2, multipliers = memory.expansion.l1, memory.expansion.l2, program.bounds.mode_multipliers
    nz, nx, cost = z.size, memory.flow.points.shape[1], 0.0
    columns = slopes.shape[2]
    if k == program.kinds.size or program.kinds[k] != FLOW:
        columns = nx  # What a phase's start chooses is its duration.
    for i in range(values.shape[0]):
        for side in range(values.shape[1]):
            weight = penalty * weights[i, side]
            if weight == 0.0:
                continue
            off = min(values[i, side] + multipliers[k, i, side] / weight, 0.0)
            cost += weight * off * off / 2
            if has_slopes and off < 0.0:
                slope = slopes[i, side]
                for c in range(columns):
                    row = c if c < nx else nz + c - nx
                    l1[k, row] += weight * off * slope[c]
                    for d in range(c, columns):
                        column = d if d < nx else nz + d - nx
                        l2[k, row, column] += weight * slope[c] * slope[d]
    return cost


@inner
def _measure_approach(
    program: Program, contact: int, z: Floats, has_slopes: bool, memory: Memory
) -> float:
    """Returns φ̇ = J v of a contact, and computes its derivative by (q, v) if asked."""
    n, m = program.mechanics.actuation.shape[0], program.bounds.lower_distance.shape[1]
    sums, slope, rate = memory.flow.mechanics.sums, memory.flow.points[0], 0.0
    phi = measure_distances(program, z, has_slopes, memory)
    row, half = phi + m + contact * n, n * (n + 1) // 2
    for j in range(n):
        rate += sums[row + j] * z[n + j]
    if has_slopes:
        bends = phi + m + m * n + half * n + 2 * n * n + contact * half
        for c in range(n):
            slope[c], slope[n + c] = 0.0, sums[row + c]
            for j in range(n):
                slope[c] += sums[bends + triangle(n, j, c)] * z[n + j]
    return rate


@inner
def measure_distances(program: Program, z: Floats, has_slopes: bool, memory: Memory) -> int:
    """Computes φ and J, with their derivatives if asked, and returns where φ starts in the sums."""
    n, room = program.mechanics.actuation.shape[0], memory.flow.mechanics
    mechanics = program.mechanics
    run_tape(mechanics.code, mechanics.numbers, z[: 2 * n], has_slopes, room.values, room.sums)
    return n * (n + 1) // 2 + n


@inner
def _counts(program: Program, k: int, i: int, phi: int, sums: Floats) -> bool:
    """Tells whether the bound of φ_i counts: a solid is left by one of its faces."""
    if program.bounds.upper_distance[k, i] < np.inf:
        return True
    solids = program.mechanics.solids
    s = np.searchsorted(solids, i, side="right") - 1
    return find_foremost(solids[s], solids[s + 1], phi, sums) == i


@kernel
def measure_bounds(
    program: Program,
    states: Floats,
    controls: Floats,
    penalty: float,
    updates: bool,
    memory: Memory,
) -> float:
    """Returns the largest violation √w dist(s, [a, b]), and updates the multipliers if asked.

    They become ρw (s + y/ρw − its projection on [a, b]), Hestenes' and Powell's rule.
    """
    bounds, worst, sums = program.bounds, 0.0, memory.flow.mechanics.sums
    for k in range(states.shape[0]):
        if bounds.is_bounded[k]:
            for i in range(states.shape[1]):
                weight = penalty * bounds.weights[i]
                low, high = bounds.lower[k, i], bounds.upper[k, i]
                value = _unwind(bounds, k, i, states[k, i])
                worst = max(worst, np.sqrt(bounds.weights[i]) * abs(_excess(value, low, high)))
                if updates:
                    value += bounds.multipliers[k, i] / weight
                    bounds.multipliers[k, i] = weight * _excess(value, low, high)
        if bounds.is_distance_bounded[k]:
            phi = measure_distances(program, states[k], False, memory)
            weight = penalty * bounds.distance_weight
            for i in range(bounds.lower_distance.shape[1]):
                if not _counts(program, k, i, phi, sums):
                    continue
                low, high = bounds.lower_distance[k, i], bounds.upper_distance[k, i]
                value = sums[phi + i]
                off = abs(_excess(value, low, high))
                worst = max(worst, np.sqrt(bounds.distance_weight) * off)
                if updates:
                    value += bounds.distance_multipliers[k, i] / weight
                    bounds.distance_multipliers[k, i] = weight * _excess(value, low, high)
        if k < program.kinds.size and program.kinds[k] >= 0:
            weight = penalty * bounds.approach_weight
            rate = _measure_approach(program, program.kinds[k], states[k], False, memory)
            off = rate + bounds.slowest
            worst = max(worst, np.sqrt(bounds.approach_weight) * off)
            if updates:
                multiplier = bounds.approach_multipliers[k] + weight * off
                bounds.approach_multipliers[k] = max(multiplier, 0.0)
        u = controls[min(k, controls.shape[0] - 1)]
        if not measure_modes(program, k, states[k], u, False, memory):
            continue
        values, _, weights, _ = memory.modes
        for i in range(values.shape[0]):
            for side in range(values.shape[1]):
                weight, value = penalty * weights[i, side], values[i, side]
                worst = max(worst, -np.sqrt(weights[i, side]) * value)
                if updates and weight > 0.0:
                    multiplier = bounds.mode_multipliers[k, i, side] + weight * value
                    bounds.mode_multipliers[k, i, side] = min(multiplier, 0.0)
    return worst
