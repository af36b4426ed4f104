"""Terms at knots: bounds as an augmented Lagrangian, and costs of users."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import (
    Mechanics,
    TreeMechanics,
    TreeMechanicsMemory,
    find_foremost,
    find_row,
    find_slope,
    measure_distance,
    only_of,
    place_bodies,
    run_tape,
    triangle,
)
from drake_aigto.kernels import borrowing, inner
from drake_aigto.shooting.flow import clear
from drake_aigto.shooting.modes import measure_modes
from drake_aigto.shooting.readings import push_start, read_coordinate
from drake_aigto.shooting.tables import CHOOSE, FLOW, Added, Bounds, Memory, Program

# Returns the penalties, adds their derivatives to the expansion, or returns the largest violation
# √w dist(s, [a, b]) and has multipliers become ρw (s + y/ρw − its projection on [a, b]), Hestenes'
# and Powell's rule.
PENALIZE, EXPAND, MEASURE, UPDATE = range(4)


@only_of(Mechanics)
def _visit_contacts(
    mechanics: Mechanics,
    program: Program,
    k: int,
    z: Floats,
    u: Floats,
    penalty: float,
    job: int,
    memory: Memory,
) -> float:
    """Does a job for the bounds of contacts at knot k."""
    total = 0.0
    if program.bounds.is_bounded[k, 1]:
        total = _join(job, total, _visit_distances(program, k, z, penalty, job, memory))
    if k < program.kinds.size and program.kinds[k] >= 0:
        total = _join(job, total, _visit_approach(program, k, z, penalty, job, memory))
    if measure_modes(program, k, z, u, job == EXPAND, memory):
        total = _join(job, total, _visit_modes(program, k, penalty, job, memory))
    return total


@borrowing
def visit_bounds(
    program: Program, states: Floats, controls: Floats, penalty: float, job: int, memory: Memory
) -> float:
    """Does a job for all bounds at knots: returns penalties, or the largest violation."""
    bounds, l1, l2, total = program.bounds, memory.expansion.l1, memory.expansion.l2, 0.0
    mechanics, room, nx = program.mechanics, memory.flow.mechanics, memory.flow.points.shape[1]
    returns = program.kinds[0] == CHOOSE  # The hard goal moves with the start.
    for k in range(states.shape[0]):
        if bounds.is_bounded[k, 0]:
            for i in range(bounds.does_turn.size):
                low, high = bounds.lower[k, i], bounds.upper[k, i]
                moved = returns and k == states.shape[0] - 1 and i < nx
                value = read_coordinate(mechanics, program.task.goal, states[k], i, moved, room)
                if bounds.does_turn[i] and k == states.shape[0] - 1:
                    value -= 2 * np.pi * np.round((value - low) / (2 * np.pi))
                weight = bounds.weights[i]
                found, push = _visit(bounds, k, i, value, low, high, weight, penalty, job)
                total = _join(job, total, found)
                if push != 0.0:
                    l1[k, i] += push
                    l2[k, i, i] += penalty * weight
                    if moved:
                        stiffness = penalty * weight
                        push_start(mechanics, states[k], i, push, stiffness, l1[k], l2[k], room)
        u = controls[min(k, controls.shape[0] - 1)]
        if bounds.is_bounded[k, 2]:
            total = _join(job, total, _visit_added(program, k, states[k], u, penalty, job, memory))
        found = _visit_contacts(mechanics, program, k, states[k], u, penalty, job, memory)
        total = _join(job, total, found)
    return total


@borrowing
def _join(job: int, total: float, part: float) -> float:
    """Returns a sum of penalties, or the larger one of violations."""
    return max(total, part) if job >= MEASURE else total + part


@borrowing
def _excess(value: float, lower: float, upper: float) -> float:
    """Returns the excess of a value above its upper bound, negative below the lower one."""
    return max(value - upper, 0.0) + min(value - lower, 0.0)


@borrowing
def _visit(
    bounds: Bounds,
    k: int,
    row: int,
    value: float,
    low: float,
    high: float,
    weight: float,
    penalty: float,
    job: int,
) -> tuple[float, float]:
    """Returns a row's penalty or violation, and the penalty's slope by the value if it expands."""
    y, stiffness = bounds.multipliers, penalty * weight
    if job < MEASURE:
        off = _excess(value + y[k, row] / stiffness, low, high)
        return stiffness * off * off / 2, stiffness * off if job == EXPAND else 0.0
    if job == UPDATE and row < bounds.weights.size:
        y[k, row] = stiffness * _excess(value + y[k, row] / stiffness, low, high)
    elif job == UPDATE:
        y[k, row] = min(y[k, row] + stiffness * value, 0.0)
    return np.sqrt(weight) * abs(_excess(value, low, high)), 0.0


@borrowing
def _add_slopes(
    k: int, push: float, stiffness: float, slope: Floats, columns: int, memory: Memory
) -> None:
    """Adds a row's derivatives by the first columns of (q, v, u) to those of the cost."""
    l1, l2 = memory.expansion.l1[k], memory.expansion.l2[k]
    nx, nz = memory.flow.points.shape[1], memory.sweep.V1.size
    for c in range(columns):
        i = c if c < nx else nz + c - nx
        l1[i] += push * slope[c]
        for d in range(c, columns):
            l2[i, d if d < nx else nz + d - nx] += stiffness * slope[c] * slope[d]


@borrowing
def _visit_distances(
    program: Program, k: int, z: Floats, penalty: float, job: int, memory: Memory
) -> float:
    """Does a job for the bounds of φ at knot k: a solid is left by one of its faces."""
    bounds, sums, solids = program.bounds, memory.flow.mechanics.sums, program.mechanics.solids
    n, m, nz, total = memory.flow.points.shape[1] // 2, program.held.shape[1], z.size, 0.0
    phi = _measure_distances(program, z, False, memory)
    for i in range(m):
        low, high, weight = bounds.lower[k, nz + i], bounds.upper[k, nz + i], bounds.weights[nz + i]
        s = np.searchsorted(solids, i, side="right") - 1
        if high == np.inf and find_foremost(solids[s], solids[s + 1], phi, sums) != i:
            continue
        value = sums[phi + i]
        found, push = _visit(bounds, k, nz + i, value, low, high, weight, penalty, job)
        total = _join(job, total, found)
        if push != 0.0:
            _add_slopes(k, push, penalty * weight, sums[phi + m + i * n :], n, memory)
    return total


@borrowing
def _visit_approach(
    program: Program, k: int, z: Floats, penalty: float, job: int, memory: Memory
) -> float:
    """Does a job for the bound of −φ̇ = −J v before the impact at knot k.

    With φ̇ > 0 a motion would come out of a wall, and be pulled back by the impact.
    """
    bounds, contact, m = program.bounds, program.kinds[k], program.held.shape[1]
    sums, slope, rate = memory.flow.mechanics.sums, memory.flow.points[0], 0.0
    n, weight = slope.size // 2, bounds.approach_weight
    _measure_distances(program, z, job == EXPAND, memory)
    row = find_row(n, m, contact)
    for j in range(n):
        rate += sums[row + j] * z[n + j]
    value, place = -(rate + bounds.slowest), bounds.weights.size
    found, push = _visit(bounds, k, place, value, 0.0, np.inf, weight, penalty, job)
    if push != 0.0:
        bends = find_slope(n, m, program.closed.shape[1], contact, 0, 0)
        for c in range(n):
            slope[c], slope[n + c] = 0.0, -sums[row + c]
            for j in range(n):
                slope[c] -= sums[bends + triangle(n, j, c)] * z[n + j]
        _add_slopes(k, push, penalty * weight, slope, 2 * n, memory)
    return found


@borrowing
def _visit_modes(program: Program, k: int, penalty: float, job: int, memory: Memory) -> float:
    """Does a job for the rows of modes at knot k, which are in the memory."""
    values, slopes, weights = memory.modes.values, memory.modes.slopes, memory.modes.weights
    row, total, columns = program.bounds.weights.size + 1, 0.0, slopes.shape[2]
    if k == program.kinds.size or program.kinds[k] != FLOW:
        columns = memory.flow.points.shape[1]  # The control of a phase's start is its duration.
    for i in range(values.shape[0]):
        for side in range(3):
            value, weight = values[i, side], weights[i, side]
            if weight > 0.0:
                place = row + 3 * i + side
                found, push = _visit(
                    program.bounds, k, place, value, 0.0, np.inf, weight, penalty, job
                )
                total = _join(job, total, found)
                if push != 0.0:
                    _add_slopes(k, push, penalty * weight, slopes[i, side], columns, memory)
    return total


@borrowing
def _visit_added(
    program: Program, k: int, z: Floats, u: Floats, penalty: float, job: int, memory: Memory
) -> float:
    """Does a job for the constraints of users at knot k."""
    bounds, sums, total = program.bounds, memory.added.sums, 0.0
    R, nz = program.added.is_running.size, bounds.does_turn.size
    C, first = memory.flow.points.shape[1] + u.size, nz + program.held.shape[1]
    _evaluate_added(program, z, u, memory)
    for r in range(R):
        low, high, weight = bounds.lower[k, first + r], bounds.upper[k, first + r], 0.0
        if low > -np.inf or high < np.inf:
            weight = bounds.weights[first + r]
            found, push = _visit(bounds, k, first + r, sums[r], low, high, weight, penalty, job)
            total = _join(job, total, found)
            if push != 0.0:
                _add_slopes(k, push, penalty * weight, sums[R + r * C :], C, memory)
    return total


@borrowing
def _evaluate_added(program: Program, z: Floats, u: Floats, memory: Memory) -> None:
    """Computes the functions of users at a knot with all derivatives."""
    added, x, sums = program.added, memory.added.x, memory.added.sums
    width = x.size - u.size
    for i in range(x.size):
        x[i] = z[i] if i < width else u[i - width]
    run_tape(added.code, added.numbers, x, True, memory.added.values, sums)
    _measure_apart(program.mechanics, added, z, sums, memory.flow.mechanics)


@only_of(TreeMechanics)
def _measure_apart(
    mechanics: TreeMechanics, added: Added, z: Floats, sums: Floats, memory: TreeMechanicsMemory
) -> None:
    """Computes distances of pairs that are kept apart, and their slopes by δ."""
    tree, R, P = mechanics.tree, added.is_running.size, added.pairs.size
    n, C = tree.up.size, 2 * tree.up.size + tree.actuation.shape[1]
    if P > 0:
        place_bodies(mechanics, z, memory)
    for p in range(P):
        r = R - P + p
        sums[r] = measure_distance(
            mechanics.touch, added.pairs[p], memory.tree.motions, memory.touch, memory.reference
        )
        for s in range(n):
            sums[R + r * C + tree.velocities[s]] = memory.reference[s]


@inner
def add_costs(
    program: Program, k: int, z: Floats, u: Floats, has_slopes: bool, memory: Memory
) -> float:
    """Returns the costs of users at knot k; adds their derivatives if asked, Hessians ≥ 0.

    The Hessian has its negative eigenvalues set to 0. If it overflows, the cost is infinite.
    """
    added, sums = program.added, memory.added.sums
    gradient, A = memory.added.gradient, memory.added.hessian
    R, nx, cost = added.is_running.size, memory.flow.points.shape[1], 0.0
    C = nx + u.size
    nz, l1, l2 = memory.sweep.V1.size, memory.expansion.l1[k], memory.expansion.l2[k]
    has_phases = nz > nx
    _evaluate_added(program, z, u, memory)
    clear(gradient, A)
    for r in range(R):
        factor, stretches = added.factors[k, r], has_phases and added.is_running[r]
        length = factor * z[z.size - nz + nx] if stretches else factor
        cost += length * sums[r] if factor != 0.0 else 0.0
        at = R + R * C + r * (C * (C + 1) // 2)
        for c in range(C if has_slopes and factor != 0.0 else 0):
            slope = sums[R + r * C + c]
            gradient[c] += length * slope
            if stretches:
                A[C, c] += factor * slope
            for d in range(c, C):
                A[d, c] += length * sums[at]
                at += 1
        if stretches:
            gradient[C] += factor * sums[r]
    if has_slopes:
        size = gradient.size
        if not np.isfinite(A).all():
            return np.inf
        squares, V = np.linalg.eigh(A)  # Of which it reads the lower triangle.
        for c in range(size):
            i = nx if c == C else c if c < nx else nz + c - nx
            l1[i] += gradient[c]
            for d in range(c, size):
                j = nx if d == C else d if d < nx else nz + d - nx
                for e in range(size):
                    l2[min(i, j), max(i, j)] += max(squares[e], 0.0) * V[c, e] * V[d, e]
    return cost


@borrowing
def _measure_distances(program: Program, z: Floats, has_slopes: bool, memory: Memory) -> int:
    """Computes φ and J, with their derivatives if asked, and returns where φ starts in the sums."""
    mechanics, room, nx = program.mechanics, memory.flow.mechanics, memory.flow.points.shape[1]
    run_tape(mechanics.code, mechanics.numbers, z[:nx], has_slopes, room.values, room.sums)
    return nx // 2 * (nx // 2 + 1) // 2 + nx // 2
