"""Bounds of modes of rigid contacts: they push, they stick inside a cone, or slip one way."""

from __future__ import annotations

from drake_aigto.arrays import Floats
from drake_aigto.contact import (
    COEFFICIENT,
    accelerate,
    factor_mass,
    find_friction,
    find_row,
    find_slope,
    run_tape,
)
from drake_aigto.kernels import borrowing
from drake_aigto.shooting.hold import hold_contacts, strike
from drake_aigto.shooting.tables import FLOW, Memory, Program

# Columns of `ModeMemory.values`: both sides of a cone or an equation, or slips before and after an
# impact; and a contact's push.
_ONE, _OTHER, _PUSH = range(3)


@borrowing
def measure_modes(
    program: Program, k: int, z: Floats, u: Floats, has_slopes: bool, memory: Memory
) -> bool:
    """Computes inequalities (≥ 0) at knot k, and their derivatives by (q, v, u) if asked.

        λ_n,  μ λ_n ± λ_t if sticking,  σ s if slipping            where a flight starts
        c (μ p_n ± p_t) if sticking,  σ s and σ s⁺ if slipping     at impacts
        σ s if slipping before,  ±s if sticking from then on       elsewhere

    with c = T M⁻¹ Tᵀ at the start. They are written to the memory, with weights 0 for those that do
    not count. Knot K is the end. Returns whether there is anything.
    """
    weights, K = memory.modes.weights, program.kinds.size
    for i in range(weights.shape[0]):
        for side in range(3):
            weights[i, side] = 0.0
    is_held = k < K and program.held[k].any()
    if k < K and program.kinds[k] == FLOW:
        if is_held:
            _measure_hold(program, k, z, u, has_slopes, memory)
        return is_held
    if program.mechanics.frictions.shape[0] == 0:
        return False
    if k < K and program.kinds[k] >= 0:
        _measure_impact(program, k, z, has_slopes, memory)
    elif is_held or (k > 0 and program.held[k - 1].any()):
        _measure_change(program, k, z, has_slopes, memory)
    else:
        return False
    return True


@borrowing
def _measure_hold(
    program: Program, k: int, z: Floats, u: Floats, has_slopes: bool, memory: Memory
) -> None:
    """Measures forces and slips where a flight starts."""
    mechanics, bounds, room = program.mechanics, program.bounds, memory.flow.mechanics
    values, slopes, weights = memory.modes.values, memory.modes.slopes, memory.modes.weights
    nx, m = memory.flow.points.shape[1], values.shape[0]
    accelerate(mechanics, z[:nx], u, 0.0, True, room)
    hold_contacts(program.closed[k], program.leans[k], z[:nx], has_slopes, mechanics, room)
    pushes = room.grip[room.grip.shape[1]]
    for i in range(m):
        if not program.held[k, i]:
            continue
        weights[i, _PUSH], values[i, _PUSH] = bounds.force_weight, pushes[i]
        for c in range(slopes.shape[2] if has_slopes else 0):
            slopes[i, _PUSH, c] = room.by_force[c, i]
        if find_friction(mechanics.frictions, i) < 0:
            continue
        if program.modes[k, i] == 0:
            columns = slopes.shape[2] if has_slopes else 0
            _measure_cone(program, i, 1.0, bounds.force_weight, columns, memory)
        else:
            _measure_slip(program, i, _ONE, program.modes[k, i], z, has_slopes, memory)


@borrowing
def _measure_impact(program: Program, k: int, z: Floats, has_slopes: bool, memory: Memory) -> None:
    """Measures impulses and slips at an impact."""
    mechanics, bounds, room = program.mechanics, program.bounds, memory.flow.mechanics
    values, slopes, after = memory.modes.values, memory.modes.slopes, memory.modes.after
    nx, m, frictions = memory.flow.points.shape[1], values.shape[0], mechanics.frictions
    run_tape(mechanics.code, mechanics.numbers, z[:nx], has_slopes, room.values, room.sums)
    factor_mass(nx // 2, room.sums, room.factor)
    closed, leans, e = program.closed[k], program.leans[k], program.restitutions[k]
    strike(closed, leans, e, z, has_slopes, mechanics, room, after)
    for i in range(m):
        index = find_friction(frictions, i)
        if index < 0 or not program.closed[k, i]:
            continue
        if program.modes[k, i] == 0:
            columns, unit = nx if has_slopes else 0, bounds.mobilities[i]
            _measure_cone(program, i, unit, bounds.approach_weight, columns, memory)
            continue
        before = program.modes[k, i] if program.kinds[k] == i else 0
        if program.held[k - 1, i]:
            before = program.modes[k - 1, i]
        if before != 0:
            _measure_slip(program, i, _ONE, before, z, has_slopes, memory)
        _measure_slip(program, i, _OTHER, program.modes[k, i], after, has_slopes, memory)
        row = find_row(nx // 2, m, m + index)
        for c in range(nx if has_slopes else 0):
            for j in range(nx // 2):
                gain = program.modes[k, i] * room.sums[row + j]
                slopes[i, _OTHER, c] += gain * room.slopes[c, j]


@borrowing
def _measure_change(program: Program, k: int, z: Floats, has_slopes: bool, memory: Memory) -> None:
    """Measures slips where modes may change without an impact."""
    mechanics, room = program.mechanics, memory.flow.mechanics
    nx, is_end = memory.flow.points.shape[1], k == program.kinds.size
    run_tape(mechanics.code, mechanics.numbers, z[:nx], has_slopes, room.values, room.sums)
    for i in range(memory.modes.values.shape[0]):
        index = find_friction(mechanics.frictions, i)
        was_held = k > 0 and bool(program.held[k - 1, i])
        before = program.modes[k - 1, i] if was_held else 0
        sticks = not is_end and program.held[k, i] and program.modes[k, i] == 0
        if index < 0 or (before == 0 and (was_held or not sticks)):
            continue
        sign = before if before != 0 else 1
        for side in range(2 if sticks else 1):  # Slip either way is 0 where a contact sticks.
            _measure_slip(program, i, side, sign - 2 * side * sign, z, has_slopes, memory)


@borrowing
def _measure_cone(
    program: Program, i: int, unit: float, weight: float, columns: int, memory: Memory
) -> None:
    """Computes distances of a force or impulse to both sides of its cone, and derivatives."""
    modes, room = memory.modes, memory.flow.mechanics
    values, slopes, weights = modes.values, modes.slopes, modes.weights
    frictions, m, w = program.mechanics.frictions, values.shape[0], room.grip.shape[1]
    index = find_friction(frictions, i)
    friction = frictions[index, COEFFICIENT]
    for side in range(2):
        weights[i, side] = weight
        along = unit * (2 * side - 1)
        values[i, side] = unit * friction * room.grip[w, i] + along * room.grip[w, m + index]
        for c in range(slopes.shape[2]):
            slopes[i, side, c] = 0.0
        for c in range(columns):
            push, drag = room.by_force[c, i], room.by_force[c, m + index]
            slopes[i, side, c] = unit * friction * push + along * drag


@borrowing
def _measure_slip(
    program: Program, i: int, side: int, sign: int, z: Floats, has_slopes: bool, memory: Memory
) -> None:
    """Computes a slip velocity with a sign, and its derivatives by (q, v) at constant q and v."""
    values, slopes, weights = memory.modes.values, memory.modes.slopes, memory.modes.weights
    n, sums = memory.flow.points.shape[1] // 2, memory.flow.mechanics.sums
    m, w = program.held.shape[1], program.closed.shape[1]
    index = find_friction(program.mechanics.frictions, i)
    row, turns = find_row(n, m, m + index), find_slope(n, m, w, m + index, 0, 0)
    weights[i, side], values[i, side] = program.bounds.approach_weight, 0.0
    for j in range(n):
        values[i, side] += sign * sums[row + j] * z[n + j]
    for c in range(slopes.shape[2] if has_slopes else 0):
        slopes[i, side, c] = 0.0
    for c in range(n if has_slopes else 0):
        slopes[i, side, n + c] = sign * sums[row + c]
        for j in range(n):
            slopes[i, side, c] += sign * sums[turns + j * n + c] * z[n + j]
