"""Motion under a held control by Runge-Kutta steps, and its exact derivatives.

Arrays are handed on one by one, as compiled code counts references to those in tuples. Names are
those of `tables` and of `mechanism`.
"""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.jit import inner
from drake_aigto.shooting.hold import hold
from drake_aigto.shooting.mechanism import accelerate
from drake_aigto.shooting.tables import CHORDAL, MODULO


@inner
def clear(vector: Floats, matrix: Floats) -> None:
    """Makes both zero, in loops: slices take seconds to compile."""
    for i in range(vector.size):
        vector[i] = 0.0
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            matrix[i, j] = 0.0


@inner
def find_errors(kinds: Ints, x: Floats, place: Floats, errors: Floats) -> None:
    """Computes the errors of a state about a place, a chord's as sin e: half its square's slope."""
    for i in range(place.size):
        error = x[i] - place[i]
        if kinds[i] == MODULO:
            error -= 2 * np.pi * np.round(error / (2 * np.pi))
        elif kinds[i] == CHORDAL:
            error = np.sin(error)
        errors[0, i] = error


@inner
def _find_row(times: Floats, time: float) -> int:
    """Returns which of a reference's pieces a time is in, the nearest one outside of all."""
    row = 0
    while row < times.size - 2 and time >= times[row + 1]:
        row += 1
    return row


@inner
def _measure(
    kinds: Ints,
    weights: Floats,
    times: Floats,
    reference: Floats,
    time: float,
    y: Floats,
    errors: Floats,
) -> float:
    """Returns Σ w e² about the reference, and computes the gradient and the reference's motion."""
    last, row, share, pace = times.size - 1, 0, 0.0, 0.0
    if last > 0:
        row = _find_row(times, time)
        length = times[row + 1] - times[row]
        share = min(max((time - times[row]) / length, 0.0), 1.0)
        pace = 1 / length if times[0] <= time < times[last] else 0.0
    rate = 0.0
    for i in range(y.size):
        if weights[i] == 0.0:
            errors[1, i] = 0.0
            continue
        step = reference[min(row + 1, last), i] - reference[row, i]
        errors[2, i] = pace * step
        error = y[i] - reference[row, i] - share * step
        square = error * error
        if kinds[i] == MODULO:
            error -= 2 * np.pi * np.round(error / (2 * np.pi))
            square = error * error
        elif kinds[i] == CHORDAL:
            square = 2 - 2 * np.cos(error)
            error = np.sin(error)
        rate += weights[i] * square
        errors[1, i] = 2 * weights[i] * error
    return rate


@inner
def flow(
    code: Ints,
    numbers: Floats,
    actuation: Floats,
    contacts: Floats,
    solids: Ints,
    rubs: Floats,
    effort: Floats,
    running: Floats,
    kinds: Ints,
    times: Floats,
    reference: Floats,
    start: float,
    share: float,
    substeps: int,
    method: Floats,
    closed: Bools,
    leans: Floats,
    z: Floats,
    u: Floats,
    eps: float,
    has_slopes: bool,
    values: Floats,
    sums: Floats,
    factor: Floats,
    force: Floats,
    rub: Floats,
    acceleration: Floats,
    slopes: Floats,
    support: Floats,
    grip: Floats,
    by_force: Floats,
    points: Floats,
    by_column: Floats,
    by_start: Floats,
    after: Floats,
    F: Floats,
    l1: Floats,
    l2: Floats,
) -> float:
    """Computes where a stage ends, and returns its cost; with derivatives if asked.

    It takes what `Mechanics` and `Task` hold, when the stage starts [s] (of phases the state says
    it), how long it lasts [s] (of phases, as a share of τ), its Runge-Kutta steps and their method,
    which rows of contacts are held and how these lean (`hold`), its state z and control u, the
    smoothing ε [m], whether derivatives are asked for, and what the memories hold. Results are the
    state after it, shape (nz,); F, its derivative by (z, u), shape (nz, nc); l1, the gradient of
    the cost, shape (nc,); and l2, the upper triangle of its Gauss-Newton Hessian.
    """
    nx, nz, n, columns = points.shape[1], z.size, actuation.shape[0], by_column.size
    x, y, slope, total, errors = points[0], points[1], points[2], points[3], points[4:]
    X, Y, K, sum_K = by_start[0], by_start[1], by_start[2], by_start[3]
    duration, has_phases, holds = share, nz > nx, bool(closed.any())
    if has_phases:
        duration, start = share * float(z[nx]), float(z[nx + 1])
    delta, unit, cost = duration / substeps, share / substeps, 0.0
    for i in range(nx):
        x[i] = z[i]
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
        for r in range(method.shape[0]):
            ahead, part = method[r, 0], method[r, 1]
            for i in range(nx):
                y[i] = x[i] + ahead * delta * slope[i]
            accelerate(
                code,
                numbers,
                actuation,
                contacts,
                solids,
                rubs,
                y,
                u,
                eps,
                has_slopes or holds,
                values,
                sums,
                factor,
                force,
                rub,
                acceleration,
                slopes,
            )
            if holds:
                hold(
                    closed,
                    leans,
                    y,
                    has_slopes,
                    rubs,
                    sums,
                    factor,
                    support,
                    grip,
                    by_force,
                    acceleration,
                    slopes,
                )
            if has_slopes:
                _chain(ahead * delta, part, slopes, X, K, Y, sum_K, nz, ahead * unit, slope)
            for i in range(n):
                slope[i], slope[n + i] = y[n + i], acceleration[0, i]
            for i in range(nx):
                total[i] += part * slope[i]
            if part == 0.0:
                continue
            time = start + (s + ahead) * delta
            rate = _measure(kinds, running, times, reference, time, y, errors)
            cost += part * delta * rate
            if has_slopes:
                lag = (s + ahead) * unit if has_phases else 0.0
                _add_rate(running, part * delta, nz, lag, Y, errors, by_column, l1, l2)
                if has_phases:
                    _add_duration(nx, part * delta, part * unit, rate, by_column, l1, l2)
        for i in range(nx):
            x[i] += delta * total[i]
            if has_slopes:
                for c in range(columns):
                    X[i, c] += delta * sum_K[i, c]
                if has_phases:
                    X[i, nx] += unit * total[i]
    for i in range(nx):
        after[i] = x[i]
    if has_phases:
        after[nx], after[nx + 1] = z[nx], start + duration
    squares = 0.0
    for j in range(effort.size):
        squares += effort[j] * u[j] * u[j]
    if has_slopes:
        _finish(effort, u, duration, share, squares, nx, nz, X, by_column, F, l1, l2)
    return cost + duration * squares


@inner
def _chain(
    ahead: float,
    part: float,
    slopes: Floats,
    X: Floats,
    K: Floats,
    Y: Floats,
    sum_K: Floats,
    nz: int,
    unit: float,
    slope: Floats,
) -> None:
    """Computes ∂y/∂(z, u) and ∂ẏ/∂(z, u), and adds the latter to the sum."""
    nx, columns = X.shape
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
        for j in range(nx):
            slope_ij = slopes[j, i]
            for c in range(columns):
                K[n + i, c] += slope_ij * Y[j, c]
        for j in range(nu):
            K[n + i, nz + j] += slopes[nx + j, i]
    for i in range(nx):
        for c in range(columns):
            sum_K[i, c] += part * K[i, c]


@inner
def _add_rate(
    weights: Floats,
    length: float,
    nz: int,
    lag: float,
    Y: Floats,
    errors: Floats,
    by_column: Floats,
    l1: Floats,
    l2: Floats,
) -> None:
    """Adds the derivatives of length·Σ w e², and computes those of the sum; upper triangle only."""
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


@inner
def _add_duration(
    tau: int,
    length: float,
    unit: float,
    rate: float,
    by_column: Floats,
    l1: Floats,
    l2: Floats,
) -> None:
    """Adds what follows from the length's being unit·τ: √length·e is the residual, not e."""
    l1[tau] += unit * rate
    for c in range(tau + 1):
        l2[c, tau] += unit * by_column[c] / 2
    for c in range(tau, by_column.size):
        l2[tau, c] += unit * by_column[c] / 2
    l2[tau, tau] += unit * unit * rate / (2 * length)


@inner
def _finish(
    effort: Floats,
    u: Floats,
    duration: float,
    share: float,
    squares: float,
    nx: int,
    nz: int,
    X: Floats,
    by_column: Floats,
    F: Floats,
    l1: Floats,
    l2: Floats,
) -> None:
    """Adds the effort's derivatives, and completes those of the state."""
    for i in range(nx):
        for c in range(by_column.size):
            F[i, c] = X[i, c]
    for c in range(by_column.size):
        by_column[c] = 0.0
    for j in range(effort.size):
        by_column[nz + j] = 2 * effort[j] * u[j]
        l1[nz + j] += duration * by_column[nz + j]
        l2[nz + j, nz + j] += 2 * duration * effort[j]
    if nz > nx:
        for c in range(by_column.size):
            F[nx, c] = F[nx + 1, c] = 0.0
        F[nx, nx] = F[nx + 1, nx + 1] = 1.0
        F[nx + 1, nx] = share
        _add_duration(nx, duration, share, squares, by_column, l1, l2)


@inner
def measure_end(
    kinds: Ints,
    weights: Floats,
    goal: Floats,
    z: Floats,
    has_slopes: bool,
    errors: Floats,
    l1: Floats,
    l2: Floats,
) -> float:
    """Returns eᵀ W e of the last state, with its derivatives if asked."""
    nx, cost = goal.size, 0.0
    find_errors(kinds, z, goal, errors)
    if has_slopes:
        clear(l1, l2)
    for i in range(nx):
        total = 0.0
        for j in range(nx):
            total += weights[i, j] * errors[0, j]
            if has_slopes:
                l2[i, j] = 2 * weights[i, j]
        cost += total * errors[0, i]
        if kinds[i] == CHORDAL:
            chord = 2 - 2 * np.cos(z[i] - goal[i])
            cost += weights[i, i] * (chord - errors[0, i] * errors[0, i])
        if has_slopes:
            l1[i] = 2 * total
    return cost
