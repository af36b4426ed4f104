"""Bounds at knots as an augmented Lagrangian, and how far they are off."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.jit import inner, kernel
from drake_aigto.shooting.hold import press
from drake_aigto.shooting.layout import triangle
from drake_aigto.shooting.mechanism import factor_mass, find_foremost
from drake_aigto.shooting.strike import find_rub, strike
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
            cost += _add_cone(program, k, states[k], penalty, has_slopes, memory)
        if k < program.kinds.size and program.kinds[k] == FLOW and program.held[k].any():
            cost += _add_forces(program, k, states[k], controls[k], penalty, has_slopes, memory)
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
def _measure_cone(program: Program, k: int, z: Floats, has_slopes: bool, memory: Memory) -> bool:
    """Computes what the impact at knot k asks for in its mode; returns whether anything."""
    mechanics, contact, room = program.mechanics, program.kinds[k], memory.flow.mechanics
    rub = find_rub(mechanics.rubs, contact)
    if rub < 0:
        return False
    measure_distances(program, z, has_slopes, memory)
    factor_mass(mechanics.actuation.shape[0], room.sums, room.factor)
    strike(
        contact,
        mechanics.contacts.shape[0],
        mechanics.rubs,
        rub,
        program.modes[k],
        program.restitutions[k],
        z,
        has_slopes,
        room.sums,
        room.factor,
        memory.strike,
    )
    return True


@inner
def _add_cone(
    program: Program, k: int, z: Floats, penalty: float, has_slopes: bool, memory: Memory
) -> float:
    """Returns what Coulomb's cone adds at the impact at knot k; adds to derivatives if asked."""
    bounds, cone, cost = program.bounds, memory.strike.cone, 0.0
    weight, l1, l2 = penalty * bounds.approach_weight, memory.expansion.l1, memory.expansion.l2
    if not _measure_cone(program, k, z, has_slopes, memory):
        return cost
    for side in range(2):
        off = min(cone[side, 0] + bounds.cone_multipliers[k, side] / weight, 0.0)
        cost += weight * off * off / 2
        if has_slopes and off < 0.0:
            for j in range(cone.shape[1] - 1):
                l1[k, j] += weight * off * cone[side, 1 + j]
                for c in range(cone.shape[1] - 1):
                    l2[k, j, c] += weight * cone[side, 1 + j] * cone[side, 1 + c]
    return cost


@inner
def _add_forces(
    program: Program,
    k: int,
    z: Floats,
    u: Floats,
    penalty: float,
    has_slopes: bool,
    memory: Memory,
) -> float:
    """Returns what λ ≥ 0 adds where stage k starts; adds to derivatives by (z, u) if asked."""
    bounds, nz, nx, held = program.bounds, z.size, memory.flow.points.shape[1], program.held[k]
    l1, l2, by_force = memory.expansion.l1, memory.expansion.l2, memory.flow.mechanics.by_force
    weight, cost = penalty * bounds.force_weight, 0.0
    press(program.mechanics, held, z[:nx], u, has_slopes, memory.flow.mechanics)
    for i in range(held.size):
        force = memory.flow.mechanics.grip[held.size, i]
        off = min(force + bounds.force_multipliers[k, i] / weight, 0.0)
        cost += weight * off * off / 2
        if has_slopes and off < 0.0:
            for c in range(by_force.shape[0]):
                row = c if c < nx else nz + c - nx
                l1[k, row] += weight * off * by_force[c, i]
                for d in range(c, by_force.shape[0]):
                    column = d if d < nx else nz + d - nx
                    l2[k, row, column] += weight * by_force[c, i] * by_force[d, i]
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
            if _measure_cone(program, k, states[k], False, memory):
                for side in range(2):
                    speed = memory.strike.cone[side, 0]
                    worst = max(worst, -np.sqrt(bounds.approach_weight) * speed)
                    if updates:
                        multiplier = bounds.cone_multipliers[k, side] + weight * speed
                        bounds.cone_multipliers[k, side] = min(multiplier, 0.0)
        if k < program.kinds.size and program.kinds[k] == FLOW and program.held[k].any():
            weight, nx = penalty * bounds.force_weight, memory.flow.points.shape[1]
            mechanics, room = program.mechanics, memory.flow.mechanics
            press(mechanics, program.held[k], states[k, :nx], controls[k], False, room)
            for i in range(program.held.shape[1]):
                force = room.grip[program.held.shape[1], i]
                worst = max(worst, -np.sqrt(bounds.force_weight) * force)
                if updates:
                    multiplier = bounds.force_multipliers[k, i] + weight * force
                    bounds.force_multipliers[k, i] = min(multiplier, 0.0)
    return worst
