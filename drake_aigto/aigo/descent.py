"""The hot loop of Newton's method on means over boxes: evaluate, factorize, solve, compare.

Shape letters: n variables of u unknowns each, (c_i, z_i = log w_i) or c_i alone; size = u n.
Unknowns are in elimination order, those of one variable next to each other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import objmode

from drake_aigto.arrays import Floats, Ints
from drake_aigto.box import Lanes, System, add_means
from drake_aigto.kernels import borrowing, inner, kernel, njit
from drake_aigto.linear import Pattern, factorize, factorize_band, solve_band

_ARMIJO = 1e-4  # share of the linear decrease that a step must reach
_HARDER, _SOFTER = 4.0, 0.25  # factors on the damping after a failed and an immediate success
_LEAST_DAMPING, _FIRST_DAMPING = 1e-8, 1e-3
_MAX_TRIALS = 40  # of the damping, in one step: 4⁴⁰ is past any scale
_LARGEST_LOG_STEP = 1.0  # A half width changes by no more than a factor e in one Newton step.
_SMALLEST_SCALE = float(np.finfo(float).tiny)


class NewtonProblem(NamedTuple):
    """Objective of Newton's method: f̄(c, w) over c, or f̄(c, e^z) − μ Σ z over c and z."""

    lanes: Lanes  # the sums, for CENTERS or BOXES
    weights: Floats  # factor of each copy (C,)
    multipliers: Floats  # ones (C,)
    copy_places: Ints  # no places (C,)
    values: Floats  # room for the mean of each copy (C,)
    places: Ints  # of each variable's first unknown (n,)
    free_places: Ints  # the same, −1 for a variable that is held (n,)
    half_width: Floats  # w (n,) where the unknowns are c alone
    lower: Floats  # lower bounds of the unknowns (size,), or none at all (0,)
    upper: Floats  # upper bounds
    temperature: float  # μ; 0 where the unknowns are c alone
    # Of the Hessian's storage: a lower band (size, diagonals), or entries (E, 1).
    shape: tuple[int, int]
    pattern: Pattern | None  # of the Hessian, if it is no band


@borrowing
def _evaluate(
    problem: NewtonProblem,
    y: Floats,
    center: Floats,
    half_width: Floats,
    gradient: Floats,
    band: Floats,
) -> tuple[float, float]:
    """Fills center and half width (n,), gradient (size,) and Hessian (size, diagonals) at y.

    Returns:
        The objective, and the mean f̄.
    """
    places, free_places, mu = problem.places, problem.free_places, problem.temperature
    with_z = y.size > center.size
    for i in range(center.size):
        center[i] = y[places[i]]
        half_width[i] = math.exp(y[places[i] + 1]) if with_z else problem.half_width[i]
    gradient[:] = 0.0
    band[:] = 0.0
    system = System(
        *(problem.multipliers, free_places, problem.copy_places, gradient, band),
        *(problem.pattern, None),
    )
    mean = add_means(problem.lanes, problem.weights, center, half_width, problem.values, system)
    entropy = 0.0
    for i in range(center.size):
        if free_places[i] < 0:
            band[places[i], 0] = 1.0
            if with_z:
                band[places[i] + 1, 0] = 1.0
        elif with_z:
            gradient[places[i] + 1] -= mu
            entropy += y[places[i] + 1]
    lower, upper = problem.lower, problem.upper
    for k in range(lower.size):
        if (y[k] <= lower[k] and gradient[k] > 0.0) or (y[k] >= upper[k] and gradient[k] < 0.0):
            leave_out(problem.pattern, k, gradient, band)
    return mean - mu * entropy, mean


@inner
def _copy(band: Floats, copy: Floats) -> None:
    """Copies a matrix: slices take Numba seconds to compile, for the sake of their messages."""
    for k in range(band.shape[0]):
        for d in range(band.shape[1]):
            copy[k, d] = band[k, d]


@kernel
def leave_out(pattern: Pattern | None, k: int, gradient: Floats, band: Floats) -> None:
    """Makes the row and column of an unknown the identity's, and its slope 0."""
    gradient[k] = 0.0
    if pattern is not None:
        for e in range(pattern.beside_starts[k], pattern.beside_starts[k + 1]):
            band[pattern.beside[e], 0] = 0.0
        band[k, 0] = 1.0
        return
    band[k, :] = 0.0
    band[k, 0] = 1.0
    for d in range(1, min(k + 1, band.shape[1])):
        band[k - d, d] = 0.0


@inner
def _fill_scale(
    free_places: Ints, mu: float, half_width: Floats, band: Floats, scale: Floats
) -> None:
    """Fills the diagonal D > 0 (size,) that the damping λD and the residual are measured in.

    For boxes that is the Hessian μ (3/w², 2) of a separable cost where w ∂f̄/∂w = μ; for centers
    alone, |diag H|, kept off zero.
    """
    if scale.size == half_width.size:
        largest = 0.0
        for k in range(scale.size):
            largest = max(largest, abs(band[k, 0]))
        for k in range(scale.size):
            scale[k] = abs(band[k, 0]) + 1e-12 * largest + _SMALLEST_SCALE
        return
    scale[:] = 1.0
    for i in range(half_width.size):
        if free_places[i] >= 0:
            scale[free_places[i]] = 3.0 * mu / (half_width[i] * half_width[i])
            scale[free_places[i] + 1] = 2.0 * mu


@inner
def _residual(gradient: Floats, scale: Floats) -> float:
    """Returns √(Σ g²/D); infinity where that is too large for a number."""
    total = 0.0
    for k in range(gradient.size):
        total += gradient[k] * gradient[k] / scale[k]
    return math.sqrt(total)


@inner
def _move(lower: Floats, upper: Floats, y: Floats, step: Floats, moved: Floats) -> None:
    """Fills moved with the point after a step, cut to bounds; the step is cut likewise."""
    for k in range(y.size):
        moved[k] = y[k] + step[k]
    if lower.size == 0:
        return
    for k in range(y.size):
        if step[k] != 0.0:
            moved[k] = min(max(moved[k], lower[k]), upper[k])
            step[k] = moved[k] - y[k]


@inner
def _shorten(step: Floats, with_z: bool) -> None:
    """Cuts a step down so that no half width changes by more than a factor e."""
    if not with_z:
        return
    largest = 0.0
    for k in range(1, step.size, 2):
        largest = max(largest, abs(step[k]))
    if largest > _LARGEST_LOG_STEP:
        for k in range(step.size):
            step[k] *= _LARGEST_LOG_STEP / largest


@kernel
def descend(
    problem: NewtonProblem, y: Floats, largest_residual: float, max_steps: int, damping: float
) -> tuple[float, float, int, float, float]:
    """Minimizes from y, which is overwritten, by steps (H + λD) s = −g.

    λ is raised until H + λD is positive definite and s descends (Armijo), and lowered after a step
    that did so at once. Returns the objective, the mean, the number of steps, the residual
    √(Σ g²/D), and λ.
    """
    n, size = problem.places.size, y.size
    center, half_width = np.empty(n), np.empty(n)
    gradient, new_gradient, scale = np.empty(size), np.empty(size), np.empty(size)
    step, moved = np.empty(size), np.empty(size)
    shape = problem.shape
    band, new_band, factors = np.empty(shape), np.empty(shape), np.empty(shape)
    for k in range(size):
        moved[k] = y[k]
    value, mean, decrease, residual = math.inf, math.inf, 0.0, math.inf
    steps, trial = -1, 0  # The start is tried as a step, too.
    while trial < _MAX_TRIALS:
        found, found_mean = _evaluate(problem, moved, center, half_width, new_gradient, new_band)
        if steps < 0 or found <= value + _ARMIJO * decrease:
            value, mean = found, found_mean
            for k in range(size):
                y[k] = moved[k]
            gradient, new_gradient = new_gradient, gradient
            band, new_band = new_band, band
            if steps >= 0 and trial == 0:
                damping = max(_SOFTER * damping, _LEAST_DAMPING)
            steps, trial = steps + 1, 0
            _fill_scale(problem.free_places, problem.temperature, half_width, band, scale)
            residual = _residual(gradient, scale)
            if steps == max_steps or residual <= largest_residual:
                break
        else:
            damping, trial = max(_HARDER * damping, _FIRST_DAMPING), trial + 1
        while trial < _MAX_TRIALS:  # Where it ends without a step, rounding hides any descent.
            _copy(band, factors)
            for k in range(size):
                factors[k, 0] += damping * scale[k]
                step[k] = -gradient[k]
            if solve_system(problem.pattern, factors, step):
                break
            damping, trial = max(_HARDER * damping, _FIRST_DAMPING), trial + 1
        _shorten(step, size > n)
        _move(problem.lower, problem.upper, y, step, moved)
        decrease = 0.0
        for k in range(size):
            decrease += gradient[k] * step[k]
    return value, mean, steps, residual, damping


@kernel
def descend_boldly(
    problem: NewtonProblem, y: Floats, largest_residual: float, max_steps: int
) -> int:
    """Takes Newton steps of many problems at once, that are not coupled, without looking back.

    Where the Hessian is not positive definite, its diagonal is raised until it dominates. No step
    is damped, as damping would bind the problems together: the caller judges each problem's end.

    Returns:
        The number of steps; y is overwritten.
    """
    n = problem.places.size
    center, half_width = np.empty(n), np.empty(n)
    gradient, scale, moved = np.empty(y.size), np.empty(y.size), np.empty(y.size)
    band, factors = np.empty(problem.shape), np.empty(problem.shape)
    for steps in range(max_steps):
        _evaluate(problem, y, center, half_width, gradient, band)
        _fill_scale(problem.free_places, problem.temperature, half_width, band, scale)
        if not _residual(gradient, scale) > largest_residual:
            return steps
        for k in range(y.size):
            gradient[k] = -gradient[k]
        _copy(band, factors)
        if not solve_system(problem.pattern, factors, gradient):
            _dominate(problem.pattern, band, factors)
            if not solve_system(problem.pattern, factors, gradient):
                return steps  # The gradient is flat, or not finite.
        _move(problem.lower, problem.upper, y, gradient, moved)
        for k in range(y.size):
            y[k] = moved[k]
    return max_steps


@inner
def _dominate(pattern: Pattern | None, band: Floats, raised: Floats) -> None:
    """Fills raised with the Hessian, and H_ii raised to 1.1 Σ_j≠i |H_ij|, or to |H_ii| if more."""
    _copy(band, raised)
    if pattern is not None:
        for k in range(pattern.starts.size - 1):
            total = 0.0
            for e in range(pattern.beside_starts[k], pattern.beside_starts[k + 1]):
                total += abs(band[pattern.beside[e], 0])
            raised[k, 0] = max(abs(band[k, 0]), 1.1 * total)
        return
    size, width = band.shape
    beside = np.zeros(size)
    for j in range(size):
        for d in range(1, min(width, size - j)):
            beside[j] += abs(band[j, d])
            beside[j + d] += abs(band[j, d])
    for j in range(size):
        raised[j, 0] = max(abs(band[j, 0]), 1.1 * beside[j])


@inner
def solve_system(pattern: Pattern | None, matrix: Floats, x: Floats) -> bool:
    """Overwrites x (size,) with the solution, if a matrix is positive definite; returns if it is.

    It is a band (size, diagonals), or entries (E, 1) if it has a pattern, and becomes its factors.
    """
    if pattern is None:  # An argument of its own, for then Numba leaves out the other case.
        if not factorize_band(matrix):
            return False
        solve_band(matrix, x)
        return True
    return _solve_sparse(pattern, matrix, x)


# Not nogil: what runs in Python takes the interpreter's lock.
@njit(no_cpython_wrapper=True)
def _solve_sparse(pattern: Pattern, matrix: Floats, x: Floats) -> bool:
    with objmode(is_definite="boolean"):
        is_definite = _solve_in_python(pattern, matrix, x)
    return is_definite


def _solve_in_python(pattern: Pattern, matrix: Floats, x: Floats) -> bool:
    factors = factorize(pattern, matrix[:, 0])
    if factors is None or factors.num_negative:
        return False
    x[:] = factors.solve(x)
    return True
