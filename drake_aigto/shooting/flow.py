"""Stages of a motion with their exact derivatives: flights under a held control, and impacts."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.kernels import borrowing
from drake_aigto.linear import add_rows
from drake_aigto.shooting.hold import hold_stage, strike_stage
from drake_aigto.shooting.implicit import step_implicitly
from drake_aigto.shooting.stages import (
    accelerate_stage,
    add_frames,
    bend,
    compare,
    enter,
    leave,
    turn_end,
    turn_error_rows,
)
from drake_aigto.shooting.tables import CHOOSE, CHORDAL, MODULO, FlowMemory, Memory, Program


@borrowing
def clear(vector: Floats, matrix: Floats) -> None:
    """Makes both zero, in loops: slices take seconds to compile."""
    for i in range(vector.size):
        vector[i] = 0.0
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            matrix[i, j] = 0.0


@borrowing
def _find_error(kind: int, error: float) -> tuple[float, float]:
    """Returns the error of a coordinate, and its square; a chord's is sin e: half its slope."""
    if kind == MODULO:
        error -= 2 * np.pi * np.round(error / (2 * np.pi))
    elif kind == CHORDAL:
        return np.sin(error), 2 - 2 * np.cos(error)
    return error, error * error


@borrowing
def _measure(program: Program, time: float, z: Floats, y: Floats, room: FlowMemory) -> float:
    """Returns Σ w e² about the reference, and computes the gradient and the reference's motion."""
    task, errors = program.task, room.points[4:]
    weights, times, reference = task.running, task.times, task.reference
    last, row, share, pace, rate = times.size - 1, 0, 0.0, 0.0, 0.0
    if last > 0:
        while row < last - 1 and time >= times[row + 1]:
            row += 1
        length = times[row + 1] - times[row]
        share = min(max((time - times[row]) / length, 0.0), 1.0)
        pace = 1 / length if times[0] <= time < times[last] else 0.0
    before, after = reference[row], reference[min(row + 1, last)]
    compare(program.mechanics, before, after, share, z, y, errors[0], room.mechanics)
    for i in range(y.size):
        errors[1, i] = 0.0
        if weights[i] != 0.0:
            error, square = _find_error(task.errors[i], errors[0, i])
            rate += weights[i] * square
            errors[1, i], errors[2, i] = 2 * weights[i] * error, pace * (after[i] - before[i])
    return rate


@borrowing
def flow(
    program: Program,
    k: int,
    z: Floats,
    u: Floats,
    eps: float,
    has_slopes: bool,
    is_trial: bool,
    after: Floats,
    memory: Memory,
) -> float:
    """Computes the end of a flight, and returns its cost; with derivatives if asked.

    Of phases, z (nz,) has their duration and its time. A trial is another motion than that about
    which the problem is. F, l1 and the upper triangle of l2 are of the stage.
    """
    task, method, mechanics, room = program.task, program.method, program.mechanics, memory.flow
    F, l1, l2 = memory.expansion.F[k], memory.expansion.l1[k], memory.expansion.l2[k]
    closed, leans, substeps = program.closed[k], program.leans[k], program.substeps
    points, by_column = room.points, room.by_column
    x, y, slope, total = points[0], points[1], points[2], points[3]
    X, Y, K, sum_K = room.slopes[0], room.slopes[1], room.slopes[2], room.slopes[3]
    acceleration = room.mechanics.acceleration
    nx, nz, n, columns = x.size, memory.sweep.V1.size, x.size // 2, by_column.size
    start, share, tau = program.times[k], program.steps[k], z.size - nz + nx
    duration, has_phases, holds = share, nz > nx, bool(closed.any())
    is_measured = has_phases or bool(task.running.any())
    if has_phases:
        duration, start = share * float(z[tau]), float(z[tau + 1])
    delta, unit, cost = duration / substeps, share / substeps, 0.0
    enter(mechanics, z, x)
    if has_slopes:
        clear(l1, l2)
        clear(by_column, X)
        for i in range(nx):
            X[i, i] = 1.0
    for s in range(substeps):
        for i in range(n):
            slope[i], slope[n + i] = x[n + i], 0.0
        clear(total, sum_K)
        if has_slopes:
            for i in range(n):
                for c in range(columns):
                    K[i, c], K[n + i, c] = X[n + i, c], 0.0
        bend(mechanics, x, has_slopes, slope, X, K, room.mechanics)
        if method.shape[0] == 1:  # Of trees.
            step_implicitly(
                mechanics, k, s, z, u, eps, delta, unit, method[0, 1], has_slopes, is_trial, room
            )
            if is_measured:
                ahead = s + method[0, 0]
                time, lag = start + ahead * delta, ahead * unit
                cost += _add_part(program, time, lag, delta, unit, z, has_slopes, nz, room, l1, l2)
            continue
        for r in range(method.shape[0]):
            ahead, part = method[r, 0], method[r, 1]
            for i in range(nx):
                y[i] = x[i] + ahead * delta * slope[i]
            accelerate_stage(mechanics, z, y, u, eps, has_slopes or holds, room.mechanics)
            if holds:
                hold_stage(mechanics, closed, leans, y, has_slopes, room.mechanics)
            if has_slopes:
                _chain(ahead * delta, ahead * unit, nz, room)
            for i in range(n):
                slope[i], slope[n + i] = y[n + i], acceleration[0, i]
            bend(mechanics, y, has_slopes, slope, Y, K, room.mechanics)
            for i in range(nx):
                total[i] += part * slope[i]
                for c in range(columns if has_slopes else 0):
                    sum_K[i, c] += part * K[i, c]
            if part == 0.0 or not is_measured:
                continue
            time, lag = start + (s + ahead) * delta, (s + ahead) * unit
            cost += _add_part(
                program, time, lag, part * delta, part * unit, z, has_slopes, nz, room, l1, l2
            )
        for i in range(nx):
            x[i] += delta * total[i]
            if has_slopes:
                for c in range(columns):
                    X[i, c] += delta * sum_K[i, c]
                if has_phases:
                    X[i, nx] += unit * total[i]
    for i in range(nx if has_slopes else 0):
        for c in range(columns):
            F[i, c] = X[i, c]
    leave(mechanics, z, x, has_slopes, F, after, room.mechanics)
    if has_phases:
        for i in range(tau, z.size):
            after[i] = z[i]
        after[tau + 1] = start + duration
    squares = 0.0
    for j in range(task.control.size):
        squares += task.control[j] * u[j] * u[j]
    if has_slopes:
        for c in range(columns):
            by_column[c] = 0.0
        for j in range(task.control.size):
            by_column[nz + j] = 2 * task.control[j] * u[j]
            l1[nz + j] += duration * by_column[nz + j]
            l2[nz + j, nz + j] += 2 * duration * task.control[j]
        if has_phases:
            for i in range(nx, nz):
                for c in range(columns):
                    F[i, c] = 0.0
                F[i, i] = 1.0
            F[nx + 1, nx] = share
            _add_duration(nx, duration, share, squares, by_column, l1, l2)
    return cost + duration * squares


@borrowing
def _chain(ahead: float, unit: float, nz: int, room: FlowMemory) -> None:
    """Computes ∂y/∂(z, u), and ∂ẏ/∂(z, u) but for turns (`bend`)."""
    X, Y, K = room.slopes[0], room.slopes[1], room.slopes[2]
    slopes, slope, (nx, columns) = room.mechanics.slopes, room.points[2], X.shape
    n, nu = nx // 2, columns - nz
    for i in range(nx):
        for c in range(columns):
            Y[i, c] = X[i, c] + ahead * K[i, c]
        if nz > nx:
            Y[i, nx] += unit * slope[i]
    for i in range(n):
        for c in range(columns):
            K[i, c] = Y[n + i, c]
            K[n + i, c] = 0.0
        add_rows(1.0, slopes, i, Y, nx, K[n + i])
        for j in range(nu):
            K[n + i, nz + j] += slopes[nx + j, i]


@borrowing
def _add_part(
    program: Program,
    time: float,
    lag: float,
    length: float,
    unit: float,
    z: Floats,
    has_slopes: bool,
    nz: int,
    room: FlowMemory,
    l1: Floats,
    l2: Floats,
) -> float:
    """Returns length·Σ w e² at y, and adds its derivatives if asked.

    In phases, `lag` is ∂time/∂τ, and `unit` is ∂length/∂τ.
    """
    y, weights = room.points[1], program.task.running
    rate = _measure(program, time, z, y, room)
    if has_slopes:
        turn_error_rows(program.mechanics, y, room.slopes[1], room.mechanics)
        _add_rate(weights, length, nz, lag, room, l1, l2)
        if nz > y.size:
            _add_duration(y.size, length, unit, rate, room.by_column, l1, l2)
    return length * rate


@borrowing
def _add_rate(
    weights: Floats, length: float, nz: int, lag: float, room: FlowMemory, l1: Floats, l2: Floats
) -> None:
    """Adds the derivatives of length·Σ w e², and computes those of the sum; upper triangle only."""
    Y, by_column, errors = room.slopes[1], room.by_column, room.points[4:]
    nx, columns = Y.shape
    for c in range(columns):
        by_column[c] = 0.0
    for i in range(nx):
        if weights[i] == 0.0:
            continue
        if nz > nx:
            Y[i, nx] -= lag * errors[2, i]
            Y[i, nx + 1] -= errors[2, i]
        weight, gradient = 2 * length * weights[i], errors[1, i]
        for c in range(columns):
            by_column[c] += gradient * Y[i, c]
            scaled = weight * Y[i, c]
            for d in range(c, columns):
                l2[c, d] += scaled * Y[i, d]
    for c in range(columns):
        l1[c] += length * by_column[c]


@borrowing
def _add_duration(
    tau: int, length: float, unit: float, rate: float, by_column: Floats, l1: Floats, l2: Floats
) -> None:
    """Adds derivatives by τ, as length = unit·τ: √length·e is the residual, not e."""
    l1[tau] += unit * rate
    for c in range(tau + 1):
        l2[c, tau] += unit * by_column[c] / 2
    for c in range(tau, by_column.size):
        l2[tau, c] += unit * by_column[c] / 2
    l2[tau, tau] += unit * unit * rate / (2 * length)


@borrowing
def jump(
    program: Program, k: int, z: Floats, u: Floats, has_slopes: bool, after: Floats, memory: Memory
) -> None:
    """Computes the state (q, v⁺, τ, t) after the start of a phase; with derivatives if asked.

    Contacts that are struck change the velocity (`strike`): the one that is hit, if any, and all
    that are held from then on. The duration, a control, becomes τ. A start that was chosen before
    it becomes (q, v) ⊕ s.
    """
    F, nx, nz = memory.expansion.F[k], memory.flow.points.shape[1], memory.sweep.V1.size
    _stay(k, z, has_slopes, after, memory)
    after[z.size - nz + nx] = u[0]
    if has_slopes:
        F[nx, nx], F[nx, nz] = 0.0, 1.0
    if k > 0 and program.kinds[k - 1] == CHOOSE:
        x, first = memory.flow.points[0], z.size - nx
        enter(program.mechanics, z, x)
        for i in range(nx):
            x[i] += z[first + i]
            if has_slopes:
                F[i, i], F[i, nx + 2 + i] = 0.0, 1.0
        leave(program.mechanics, z, x, has_slopes, F, after, memory.flow.mechanics)
        for i in range(nx if has_slopes else 0):
            F[i, i] = 1.0  # It is where all begins, and does not change.
    if program.closed[k].any():
        strike_stage(program.mechanics, program, k, z, has_slopes, F, after, memory.flow.mechanics)


@borrowing
def choose(
    k: int, size: int, z: Floats, u: Floats, has_slopes: bool, after: Floats, memory: Memory
) -> None:
    """Computes the state after stage k, whose control is a part of s; with derivatives if asked."""
    F, nx, nz = memory.expansion.F[k], memory.flow.points.shape[1], memory.sweep.V1.size
    _stay(k, z, has_slopes, after, memory)
    for j in range(min(size, nx - k * size)):
        i = nz - nx + k * size + j
        after[z.size - nz + i] = u[j]
        if has_slopes:
            F[i, i], F[i, nz + j] = 0.0, 1.0


@borrowing
def _stay(k: int, z: Floats, has_slopes: bool, after: Floats, memory: Memory) -> None:
    """Computes the same state after stage k, with derivatives if asked."""
    F, l1, l2 = memory.expansion.F[k], memory.expansion.l1[k], memory.expansion.l2[k]
    for i in range(z.size):
        after[i] = z[i]
    if has_slopes:
        clear(l1, l2)
        clear(l1, F)
        for i in range(F.shape[0]):
            F[i, i] = 1.0


@borrowing
def measure_end(program: Program, z: Floats, has_slopes: bool, memory: Memory) -> float:
    """Returns eᵀ W e of the last state and costs of frames, with derivatives if asked."""
    mechanics, task = program.mechanics, program.task
    K, room, cost = memory.controls.shape[0], memory.flow, 0.0
    weights, x, errors, squares = task.final, room.points[0], room.points[4], room.points[5]
    nx = x.size
    l1, l2 = memory.expansion.l1[K], memory.expansion.l2[K]
    if has_slopes:
        clear(l1, l2)
    enter(mechanics, z, x)
    compare(mechanics, task.goal, task.goal, 0.0, z, x, errors, room.mechanics)
    for i in range(nx):
        errors[i], squares[i] = _find_error(task.errors[i], errors[i])
    for i in range(nx):
        total = 0.0
        for j in range(nx):
            total += weights[i, j] * errors[j]
            if has_slopes:
                l2[i, j] = 2 * weights[i, j]
        cost += total * errors[i]
        if task.errors[i] == CHORDAL:
            cost += weights[i, i] * (squares[i] - errors[i] * errors[i])
        if has_slopes:
            l1[i] = 2 * total
    if has_slopes:
        turn_end(mechanics, l1, l2, room.mechanics)
    return cost + add_frames(mechanics, task.frames, z, has_slopes, l1, l2, room.mechanics)
