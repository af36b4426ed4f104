"""Steps of trees of joints that are implicit in velocities: friction and dampers may be stiff.

Positions drift for half a step with the old velocity and for half with the new one, which obeys

    w = v + h a(q, w, u),    q half a step ahead,

by Newton's method. For forces without velocities that is the leapfrog method. What brakes is as
stable as it is strong, at any h: a contact that sticks creeps by no more than the law lets it.
In a phase of free duration, h is a share of that. Steps of two stages are of order 2 and as stable,
by γ = 1 − 1/√2 (Alexander 1977, "Diagonally implicit Runge-Kutta methods for stiff O.D.E.'s"):

    w₁ = v + γ h a(q, w₁, u),    w = v + (1 − γ) h a(q, w₁, u) + γ h a(q, w, u).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.contact import TreeMechanics, only_of
from drake_aigto.kernels import borrowing
from drake_aigto.linear import add_rows
from drake_aigto.shooting.stages import accelerate_stage, accelerate_step, begin_step, bend
from drake_aigto.shooting.tables import FlowMemory

# Newton's method ends with the step from a residual whose square is below this share of velocities'
# squares: its own square is left then. Or it ends after `_MOST` evaluations. A step that raises the
# residual is shortened by this factor, and again, until it is as short as `_SHORTEST` of itself.
_TOLERANCE, _MOST, _SHORTER, _SHORTEST = 1e-12, 30, 0.3, 1e-3


@only_of(TreeMechanics)
def step_implicitly(
    mechanics: TreeMechanics,
    k: int,
    s: int,
    z: Floats,
    u: Floats,
    eps: float,
    h: float,
    unit: float,
    share: float,
    has_slopes: bool,
    is_trial: bool,
    room: FlowMemory,
) -> None:
    """Takes a step of length h from x; y becomes the middle's positions and the end's velocities.

    With two stages, these are the mean of the start's and the end's.

    The rate of x is known (`bend`), as are derivatives by (z, u) if asked: X of x, K of its rate.
    Those of y become Y. The unit is ∂h/∂τ, of phases. It is step s of stage k, where Newton's
    method starts from the change of velocities as the motion had it before, and keeps its own.
    The share is γ, 1 with a single stage.
    """
    x, y, slope, first = room.points[0], room.points[1], room.points[2], room.points[3]
    X, Y, K, first_X = room.slopes[0], room.slopes[1], room.slopes[2], room.slopes[3]
    nx, columns, half = x.size, room.by_column.size if has_slopes else 0, h / 2
    n, nu, count = nx // 2, u.size, 1 if share == 1.0 else 2
    nz = room.by_column.size - nu
    by_time = unit if has_slopes and nz > nx else 0.0
    for i in range(n):
        y[i], first[n + i] = x[i] + half * slope[i], x[n + i]
        for c in range(columns):
            Y[i, c], first_X[n + i, c] = X[i, c] + half * K[i, c], X[n + i, c]
        if by_time != 0.0:
            Y[i, nx] += by_time / 2 * slope[i]
    for r in range(count):
        row = count * s + r
        before, change = room.changes[0, k, row], room.changes[1 if is_trial else 0, k, row]
        for i in range(n):
            y[n + i] = x[n + i] + before[i]
            for c in range(columns):
                Y[n + i, c] = X[n + i, c]
        _find_velocities(mechanics, z, u, eps, share * h, has_slopes, room)
        if has_slopes:
            _chain(share * h, share * by_time, nz, room)
        for i in range(n):
            change[i] = y[n + i] - x[n + i] if np.isfinite(y[n + i]) else 0.0
        for i in range(n if r + 1 < count else 0):  # What the last stage adds to.
            x[n + i] += (1.0 - share) / share * (y[n + i] - x[n + i])
            for c in range(columns):
                X[n + i, c] += (1.0 - share) / share * (Y[n + i, c] - X[n + i, c])
    for i in range(n):
        slope[i] = y[n + i]
        for c in range(columns):
            K[i, c] = Y[n + i, c]
    bend(mechanics, y, has_slopes, slope, Y, K, room.mechanics)
    for i in range(n):
        x[i], x[n + i] = y[i] + half * slope[i], y[n + i]
        for c in range(columns):
            X[i, c], X[n + i, c] = Y[i, c] + half * K[i, c], Y[n + i, c]
        if by_time != 0.0:
            X[i, nx] += by_time / 2 * slope[i]
        if count > 1:
            y[n + i] = (first[n + i] + y[n + i]) / 2
            for c in range(columns):
                Y[n + i, c] = (first_X[n + i, c] + Y[n + i, c]) / 2


@borrowing
def _chain(h: float, unit: float, nz: int, room: FlowMemory) -> None:
    """Computes derivatives of a stage's velocities in Y, where those that it begins with are."""
    Y, slopes, (nx, columns) = room.slopes[1], room.mechanics.slopes, room.slopes[1].shape
    n, nu = nx // 2, columns - nz
    for i in range(n):
        add_rows(h, slopes, i, Y, n, Y[n + i])
        for j in range(nu):
            Y[n + i, nz + j] += h * slopes[nx + j, i]
        if unit != 0.0:
            Y[n + i, nx] += unit * room.mechanics.acceleration[0, i]
    _solve_rows(room.newton, room.pivots, Y)


@borrowing
def _find_velocities(
    mechanics: Any, z: Floats, u: Floats, eps: float, h: float, has_slopes: bool, room: FlowMemory
) -> None:
    """Computes velocities of y that obey w = v + h a, and derivatives of a if asked.

    These are derivatives at the last velocities but one, as near as counts, with the factors there.
    """
    x, y, off, n = room.points[0], room.points[1], room.off, room.off.size
    acceleration, best, length = room.mechanics.acceleration, np.inf, 1.0
    if not has_slopes:
        begin_step(mechanics, z, y, eps, room.mechanics)
    for count in range(_MOST + 1):
        if has_slopes and count == 0:
            accelerate_stage(mechanics, z, y, u, eps, True, room.mechanics)
        else:
            accelerate_step(mechanics, y, u, eps, room.mechanics)
        squares = total = 0.0
        for i in range(n):
            change = h * acceleration[0, i]
            error = y[n + i] - x[n + i] - change
            squares += error * error
            total += change * change + x[n + i] * x[n + i]
        is_last = count == _MOST or not np.isfinite(squares)
        is_near = squares <= _TOLERANCE * total
        is_better, expands = (
            squares < best or length < _SHORTEST,
            has_slopes and (is_last or is_near),
        )
        if expands and count > 0:
            accelerate_stage(mechanics, z, y, u, eps, True, room.mechanics)
        if is_better or expands:
            _factor(h, room.mechanics.slopes, room.newton, room.pivots)
        if is_last:
            return
        if is_better:
            best, length, shift = squares, 1.0, -1.0
            for i in range(n):
                off[i] = y[n + i] - x[n + i] - h * acceleration[0, i]
            _solve(room.newton, room.pivots, off)
        else:
            shift = (1.0 - _SHORTER) * length
            length *= _SHORTER
        for i in range(n):
            y[n + i] += shift * off[i]
        if is_near:
            return


@borrowing
def _factor(h: float, slopes: Floats, A: Floats, pivots: Ints) -> None:
    """Computes factors L R of 1 − h ∂a/∂v, its rows exchanged in turn; the diagonal of L is 1."""
    n = A.shape[0]
    for i in range(n):
        for j in range(n):
            A[i, j] = (1.0 if i == j else 0.0) - h * slopes[n + j, i]
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[pivot, k]):
                pivot = i
        pivots[k] = pivot
        for j in range(n if pivot != k else 0):
            A[k, j], A[pivot, j] = A[pivot, j], A[k, j]
        inverse = 1.0 / A[k, k]
        for i in range(k + 1, n):
            factor = A[i, k] * inverse
            A[i, k] = factor
            for j in range(k + 1, n if factor != 0.0 else 0):
                A[i, j] -= factor * A[k, j]


@borrowing
def _solve(A: Floats, pivots: Ints, x: Floats) -> None:
    """Replaces a vector by the inverse of a factored matrix times it."""
    for i in range(x.size):
        x[i], x[pivots[i]] = x[pivots[i]], x[i]
        for k in range(i):
            x[i] -= A[i, k] * x[k]
    for i in range(x.size - 1, -1, -1):
        for k in range(x.size - 1, i, -1):
            x[i] -= A[i, k] * x[k]
        x[i] *= 1.0 / A[i, i]


@borrowing
def _solve_rows(A: Floats, pivots: Ints, Y: Floats) -> None:
    """Replaces the lower half of a matrix by the inverse of a factored one times it."""
    n, columns = A.shape[0], Y.shape[1]
    for i in range(n):
        for c in range(columns if pivots[i] != i else 0):
            Y[n + i, c], Y[n + pivots[i], c] = Y[n + pivots[i], c], Y[n + i, c]
        for k in range(i):
            part = A[i, k]
            for c in range(columns):
                Y[n + i, c] -= part * Y[n + k, c]
    for i in range(n - 1, -1, -1):
        for k in range(n - 1, i, -1):
            part = A[i, k]
            for c in range(columns):
                Y[n + i, c] -= part * Y[n + k, c]
        inverse = 1.0 / A[i, i]
        for c in range(columns):
            Y[n + i, c] *= inverse
