"""The backward pass: the best bounded control of each stage by the cost to go, to second order."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.kernels import borrowing
from drake_aigto.linear import add_rows, solve_factored
from drake_aigto.shooting.tables import CHOOSE, FLOW, Expansion, Program, SweepMemory


@borrowing
def clip_control(size: int, u: Floats, lower: Floats, upper: Floats, norm: float) -> None:
    """Moves a control into its bounds, then towards 0 until its norm is within its limit."""
    squares = 0.0
    for j in range(size):
        u[j] = min(max(u[j], lower[j]), upper[j])
        squares += u[j] * u[j]
    if squares > norm * norm:
        for j in range(size):
            u[j] *= norm / np.sqrt(squares)


@borrowing
def find_size(program: Program, k: int) -> tuple[int, float]:
    """Returns how many controls stage k has, and the limit of their norm."""
    nu, kind = program.task.control.size, program.kinds[k]
    if kind == FLOW:
        return nu, program.bounds.norm
    return nu if kind == CHOOSE else 1, np.inf


@borrowing
def sweep_back(
    program: Program,
    controls: Floats,
    has_gaps: bool,
    damping: float,
    holding: float,
    expansion: Expansion,
    memory: SweepMemory,
) -> float:
    """Computes the feedforward and the gains of each stage, and returns by how much the cost falls.

    That is −1 if a Hessian is not positive. Damping is the share of a control's own curvature that
    is added to it; holding is added to that of states in units of their scales.
    """
    V1, V2, Q1, Q2, H = memory.V1, memory.V2, memory.Q1, memory.Q2, memory.H
    bounds = program.bounds
    lower, upper, floors = bounds.lower_control, bounds.upper_control, bounds.floors
    K, nz = controls.shape[0], V1.size
    for i in range(nz):
        V1[i] = expansion.l1[K, i]
        for j in range(nz):
            V2[i, j] = expansion.l2[K, min(i, j), max(i, j)]
    drop = 0.0
    for k in range(K - 1, -1, -1):
        size, norm = find_size(program, k)
        _expand_value(k, nz, nz + size, has_gaps, expansion, memory)
        for i in range(nz):
            Q2[i, i] += holding * bounds.weights[i]
        for i in range(size):
            for j in range(size):
                H[i, j] = Q2[nz + i, nz + j]
            H[i, i] += damping * (H[i, i] + floors[k, i])
        u, du, low, high = controls[k], memory.feedforward[k], lower[k], upper[k]
        if not _solve_box(size, Q1[nz:], u, low, high, du, memory):
            return -1.0
        squares, multiplier = 0.0, 0.0
        for i in range(size):
            squares += (u[i] + du[i]) ** 2
        is_on_ball = squares > norm * norm * (1 + 1e-12)
        if is_on_ball:
            multiplier = _solve_ball(size, Q1[nz:], u, norm, du, memory)
            target = memory.room[5]
            for i in range(size):
                target[i] = u[i] + du[i]
            clip_control(size, target, low, high, norm)
            for i in range(size):
                du[i] = target[i] - u[i]
        _find_gains(k, nz, size, is_on_ball, u, du, memory)
        drop += _step_back(nz, size, multiplier, du, memory.gains[k], memory)
    return drop


@borrowing
def _expand_value(
    k: int, nz: int, nc: int, has_gaps: bool, expansion: Expansion, memory: SweepMemory
) -> None:
    """Computes gradient and Hessian of the cost from stage k on, by (z, u)."""
    F, l1, l2, gaps = expansion.F, expansion.l1, expansion.l2, expansion.gaps
    V1, V2, v1, VF, Q1, Q2 = memory.V1, memory.V2, memory.v1, memory.VF, memory.Q1, memory.Q2
    for i in range(nz):
        v1[i] = V1[i]
        if has_gaps:
            for j in range(nz):
                v1[i] += V2[i, j] * gaps[k, j]
        for c in range(nc):
            VF[i, c] = 0.0
        add_rows(1.0, V2, i, F[k], nz, VF[i, :nc])
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


@borrowing
def _factor_free(size: int, shift: float, H: Floats, is_free: Ints, L: Floats) -> bool:
    """Factors H + shift I on free controls, the identity elsewhere; False if not positive."""
    for i in range(size):
        for j in range(i + 1):
            if is_free[i] and is_free[j]:
                total = H[i, j] + (shift if i == j else 0.0)
            else:
                total = 1.0 if i == j else 0.0
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                L[i, i] = np.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    return True


@borrowing
def _solve_box(
    size: int, g: Floats, u: Floats, lower: Floats, upper: Floats, du: Floats, memory: SweepMemory
) -> bool:
    """Computes the du that minimizes g·du + ½ duᵀ H du within bounds of u + du.

    Projected Newton steps as of Tassa, Mansard & Todorov (2014), "Control-limited differential
    dynamic programming". The factor that it leaves behind is of the controls that are free; returns
    whether H is positive on them.
    """
    H, is_free, factor = memory.H, memory.is_free, memory.factor
    step, trial, slope, value = memory.room[0], memory.room[1], memory.room[2], 0.0
    for i in range(size):
        du[i] = 0.0
    for _ in range(30):
        for i in range(size):
            slope[i] = g[i]
            for j in range(size):
                slope[i] += H[i, j] * du[j]
            at_lower = u[i] + du[i] <= lower[i] and slope[i] > 0.0
            at_upper = u[i] + du[i] >= upper[i] and slope[i] < 0.0
            is_free[i] = not (at_lower or at_upper)
            step[i] = -slope[i] if is_free[i] else 0.0
        if not _factor_free(size, 0.0, H, is_free, factor):
            return False
        solve_factored(size, factor, step)
        length, is_better = 1.0, False
        for _ in range(20):
            attempt = 0.0
            for i in range(size):
                trial[i] = min(max(u[i] + du[i] + length * step[i], lower[i]), upper[i]) - u[i]
            for i in range(size):
                row = 0.0
                for j in range(size):
                    row += H[i, j] * trial[j]
                attempt += trial[i] * (g[i] + row / 2)
            is_better = attempt < value - 1e-12 * abs(value)
            if is_better:
                break
            length /= 2
        if not is_better:
            break
        value, is_best = attempt, True
        for i in range(size):
            # All are free, and nothing is clipped: the minimum.
            is_best = is_best and is_free[i] and trial[i] == u[i] + du[i] + step[i] - u[i]
            du[i] = trial[i]
        if is_best:
            break
    return True


@borrowing
def _solve_ball(
    size: int, g: Floats, u: Floats, norm: float, du: Floats, memory: SweepMemory
) -> float:
    """Computes the du that minimizes g·du + ½ duᵀ H du on ‖u + du‖ = norm, of the free controls.

    Newton steps on 1/‖u + du‖ = 1/norm, as of Moré & Sorensen (1983). Leaves behind the factor of H
    + ν I, and returns the multiplier ν.
    """
    H, is_free, factor = memory.H, memory.is_free, memory.factor
    w, y, nu, fixed = memory.room[3], memory.room[4], 0.0, 0.0
    for i in range(size):
        if not is_free[i]:
            fixed += (u[i] + du[i]) ** 2
    radius = np.sqrt(max(norm * norm - fixed, 0.0))
    for _ in range(40):
        _factor_free(size, nu, H, is_free, factor)
        squares, curve = 0.0, 0.0
        for i in range(size):
            w[i] = 0.0
            if is_free[i]:
                w[i] = -g[i]
                for j in range(size):
                    w[i] += H[i, j] * (u[j] if is_free[j] else -du[j])
        solve_factored(size, factor, w)
        for i in range(size):
            squares += w[i] * w[i]
            y[i] = w[i]
        solve_factored(size, factor, y)
        for i in range(size):
            curve += w[i] * y[i]
        length = np.sqrt(squares)
        if not curve > 0.0 or abs(length - radius) <= 1e-10 * norm or radius == 0.0:
            break
        nu = max(nu + squares / curve * (length - radius) / radius, 0.0)
    for i in range(size):
        if is_free[i]:
            du[i] = w[i] - u[i]
    return nu


@borrowing
def _find_gains(
    k: int, nz: int, size: int, is_on_ball: bool, u: Floats, du: Floats, memory: SweepMemory
) -> None:
    """Computes gains of the control: none where clamped, along the ball on its norm limit."""
    is_free, factor, gains = memory.is_free, memory.factor, memory.gains
    y, normal, along = memory.room[0], memory.room[1], 0.0
    if is_on_ball:
        for i in range(size):
            normal[i] = u[i] + du[i] if is_free[i] else 0.0
        solve_factored(size, factor, normal)
        for i in range(size):
            along += normal[i] * (u[i] + du[i]) if is_free[i] else 0.0
    for c in range(nz):
        for i in range(size):
            y[i] = -memory.Q2[nz + i, c] if is_free[i] else 0.0
        solve_factored(size, factor, y)
        off = 0.0
        if along > 0.0:
            for i in range(size):
                off += y[i] * (u[i] + du[i]) if is_free[i] else 0.0
            off /= along
        for i in range(size):
            gains[k, i, c] = y[i] - (off * normal[i] if along > 0.0 else 0.0)


@borrowing
def _step_back(
    nz: int, size: int, multiplier: float, du: Floats, gains: Floats, memory: SweepMemory
) -> float:
    """Computes the cost to go before the stage, and returns the gain of its control."""
    Q1, Q2, V1, V2, slope = memory.Q1, memory.Q2, memory.V1, memory.V2, memory.room[0]
    both, gain = memory.VF, 0.0
    for i in range(size):
        Hu = 0.0
        for j in range(size):
            Hu += Q2[nz + i, nz + j] * du[j]
        gain -= du[i] * (Q1[nz + i] + Hu / 2)
        slope[i] = Q1[nz + i] + Hu
    for i in range(size):
        Q2[nz + i, nz + i] += multiplier
    # V2 = Q_zz + Kᵀ (Q_uu K + Q_uz) + Q_zu K.
    for i in range(size):
        for d in range(nz):
            both[i, d] = Q2[nz + i, d]
        for j in range(size):
            Q2_ij = Q2[nz + i, nz + j]
            for d in range(nz):
                both[i, d] += Q2_ij * gains[j, d]
    for c in range(nz):
        V1[c] = Q1[c]
        for d in range(c, nz):
            V2[c, d] = Q2[c, d]
        for i in range(size):
            gain_ic, Q2_ic = gains[i, c], Q2[nz + i, c]
            V1[c] += Q2_ic * du[i] + gain_ic * slope[i]
            for d in range(c, nz):
                V2[c, d] += gain_ic * both[i, d] + Q2_ic * gains[i, d]
        for d in range(c + 1, nz):
            V2[d, c] = V2[c, d]
    return gain
