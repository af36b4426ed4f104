"""The backward pass: the best control of each stage by the cost to go, to second order."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.jit import inner, pasted
from drake_aigto.linear import solve_factored
from drake_aigto.shooting.controls import clip_control, solve_ball, solve_box
from drake_aigto.shooting.tables import FLOW, Expansion, Program, SweepMemory


@inner
def sweep_back(
    program: Program,
    controls: Floats,
    has_gaps: bool,
    damping: float,
    expansion: Expansion,
    memory: SweepMemory,
) -> float:
    """Computes the feedforward and the gains of each stage.

    Args:
        program: the problem.
        controls: of the motion that it is expanded about, shape (K, nu).
        has_gaps: whether the motion is no roll-out.
        damping: share of a control's own curvature that is added to it.
        expansion: the problem about that motion.
        memory: room, and the result.

    Returns:
        What the cost falls by in the expansion; −1 if a Hessian is not positive.
    """
    F, l1, l2, gaps = expansion
    feedforward, gains, V1, V2, v1, VF, Q1, Q2, H, factor, is_free, room = memory
    lower, upper = program.bounds.lower_control, program.bounds.upper_control
    kinds, floors = program.kinds, program.bounds.floors
    K, nz, nu = controls.shape[0], V1.size, program.task.control.size
    for i in range(nz):
        V1[i] = l1[K, i]
        for j in range(nz):
            V2[i, j] = l2[K, min(i, j), max(i, j)]
    drop = 0.0
    for k in range(K - 1, -1, -1):
        size, norm = (nu, program.bounds.norm) if kinds[k] == FLOW else (1, np.inf)
        _expand_value(k, nz, nz + size, has_gaps, F, l1, l2, gaps, V1, V2, v1, VF, Q1, Q2)
        for i in range(size):
            for j in range(size):
                H[i, j] = Q2[nz + i, nz + j]
            H[i, i] += damping * (H[i, i] + floors[k, i])
        g, u, du, low, high = Q1[nz:], controls[k], feedforward[k], lower[k], upper[k]
        if not solve_box(size, g, H, u, low, high, du, is_free, factor, room):
            return -1.0
        squares, multiplier = 0.0, 0.0
        for i in range(size):
            squares += (u[i] + du[i]) ** 2
        is_on_ball = squares > norm * norm * (1 + 1e-12)
        if is_on_ball:
            multiplier = solve_ball(size, g, H, u, norm, du, is_free, factor, room)
            _stay_within(size, u, low, high, norm, du, room)
        _find_gains(nz, size, is_on_ball, u, du, Q2, is_free, factor, gains[k], room)
        drop += _step_back(nz, size, multiplier, du, gains[k], Q1, Q2, V1, V2, room)
    return drop


@pasted
def _expand_value(
    k: int,
    nz: int,
    nc: int,
    has_gaps: bool,
    F: Floats,
    l1: Floats,
    l2: Floats,
    gaps: Floats,
    V1: Floats,
    V2: Floats,
    v1: Floats,
    VF: Floats,
    Q1: Floats,
    Q2: Floats,
) -> None:
    """Computes gradient and Hessian of the cost from stage k on, by (z, u)."""
    for i in range(nz):
        v1[i] = V1[i]
        if has_gaps:
            for j in range(nz):
                v1[i] += V2[i, j] * gaps[k, j]
        for c in range(nc):
            VF[i, c] = 0.0
        for j in range(nz):
            V2_ij = V2[i, j]
            for c in range(nc):
                VF[i, c] += V2_ij * F[k, j, c]
    for c in range(nc):
        Q1[c] = l1[k, c]
        for d in range(c, nc):
            Q2[c, d] = l2[k, c, d]
    for i in range(nz):
        for c in range(nc):
            F_ic = F[k, i, c]
            Q1[c] += F_ic * v1[i]
            for d in range(c, nc):
                Q2[c, d] += F_ic * VF[i, d]
    for c in range(nc):
        for d in range(c):
            Q2[c, d] = Q2[d, c]


@pasted
def _stay_within(
    size: int, u: Floats, lower: Floats, upper: Floats, norm: float, du: Floats, room: Floats
) -> None:
    """Moves u + du into all bounds at once."""
    target = room[5]
    for i in range(size):
        target[i] = u[i] + du[i]
    clip_control(size, target, lower, upper, norm)
    for i in range(size):
        du[i] = target[i] - u[i]


@pasted
def _find_gains(
    nz: int,
    size: int,
    is_on_ball: bool,
    u: Floats,
    du: Floats,
    Q2: Floats,
    is_free: Ints,
    factor: Floats,
    gains: Floats,
    room: Floats,
) -> None:
    """Computes how the control follows the state: not where clamped, along the ball on it."""
    y, normal, along = room[0], room[1], 0.0
    if is_on_ball:
        for i in range(size):
            normal[i] = u[i] + du[i] if is_free[i] else 0.0
        solve_factored(size, factor, normal)
        for i in range(size):
            along += normal[i] * (u[i] + du[i]) if is_free[i] else 0.0
    for c in range(nz):
        for i in range(size):
            y[i] = -Q2[nz + i, c] if is_free[i] else 0.0
        solve_factored(size, factor, y)
        off = 0.0
        if along > 0.0:
            for i in range(size):
                off += y[i] * (u[i] + du[i]) if is_free[i] else 0.0
            off /= along
        for i in range(size):
            gains[i, c] = y[i] - (off * normal[i] if along > 0.0 else 0.0)


@pasted
def _step_back(
    nz: int,
    size: int,
    multiplier: float,
    du: Floats,
    gains: Floats,
    Q1: Floats,
    Q2: Floats,
    V1: Floats,
    V2: Floats,
    room: Floats,
) -> float:
    """Computes the cost to go before the stage, and returns what its control gains."""
    slope, gain = room[0], 0.0
    for i in range(size):
        Hu = 0.0
        for j in range(size):
            Hu += Q2[nz + i, nz + j] * du[j]
        gain -= du[i] * (Q1[nz + i] + Hu / 2)
        slope[i] = Q1[nz + i] + Hu
    for i in range(size):
        Q2[nz + i, nz + i] += multiplier
    for c in range(nz):
        V1[c] = Q1[c]
        for i in range(size):
            V1[c] += Q2[c, nz + i] * du[i] + gains[i, c] * slope[i]
        for d in range(c, nz):
            total = Q2[c, d]
            for i in range(size):
                row = Q2[nz + i, d]
                for j in range(size):
                    row += Q2[nz + i, nz + j] * gains[j, d]
                total += gains[i, c] * row + Q2[c, nz + i] * gains[i, d]
            V2[c, d] = V2[d, c] = total
    return gain
