"""The best change of a bounded control, and how it follows the state."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.jit import inner
from drake_aigto.linear import solve_factored


@inner
def clip_control(size: int, u: Floats, lower: Floats, upper: Floats, norm: float) -> None:
    """Moves a control into its bounds, then towards 0 until its norm is what it may be."""
    squares = 0.0
    for j in range(size):
        u[j] = min(max(u[j], lower[j]), upper[j])
        squares += u[j] * u[j]
    if squares > norm * norm:
        for j in range(size):
            u[j] *= norm / np.sqrt(squares)


@inner
def _factor_free(size: int, shift: float, H: Floats, is_free: Ints, L: Floats) -> bool:
    """Factors H + shift I on what is free, the identity elsewhere; False if it is not positive."""
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


@inner
def _model(size: int, g: Floats, H: Floats, du: Floats) -> float:
    """Returns g·du + ½ duᵀ H du."""
    total = 0.0
    for i in range(size):
        row = 0.0
        for j in range(size):
            row += H[i, j] * du[j]
        total += du[i] * (g[i] + row / 2)
    return total


@inner
def solve_box(
    size: int,
    g: Floats,
    H: Floats,
    u: Floats,
    lower: Floats,
    upper: Floats,
    du: Floats,
    is_free: Ints,
    factor: Floats,
    room: Floats,
) -> bool:
    """Computes the du that minimizes g·du + ½ duᵀ H du within bounds of u + du.

    Projected Newton steps as of Tassa, Mansard & Todorov (2014), "Control-limited differential
    dynamic programming". The factor that it leaves behind is of the controls that are free.

    Returns:
        Whether H is positive on them.
    """
    step, trial, slope = room[0], room[1], room[2]
    value = 0.0
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
            for i in range(size):
                trial[i] = min(max(u[i] + du[i] + length * step[i], lower[i]), upper[i]) - u[i]
            attempt = _model(size, g, H, trial)
            is_better = attempt < value - 1e-12 * abs(value)
            if is_better:
                break
            length /= 2
        if not is_better:
            break
        value, is_best = attempt, True
        for i in range(size):
            # All are free, and nothing is clipped: the least there is.
            is_best = is_best and is_free[i] and trial[i] == u[i] + du[i] + step[i] - u[i]
            du[i] = trial[i]
        if is_best:
            break
    return True


@inner
def solve_ball(
    size: int,
    g: Floats,
    H: Floats,
    u: Floats,
    norm: float,
    du: Floats,
    is_free: Ints,
    factor: Floats,
    room: Floats,
) -> float:
    """Computes the du that minimizes g·du + ½ duᵀ H du on ‖u + du‖ = norm, of the free controls.

    Newton steps on 1/‖u + du‖ = 1/norm, as of Moré & Sorensen (1983). Leaves behind the factor of
    H + ν I.

    Returns:
        ν, the multiplier.
    """
    w, y, nu, fixed = room[3], room[4], 0.0, 0.0
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
