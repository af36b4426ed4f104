"""Lower bounds of a function over a cell, from enclosures of its derivatives.

About a point c of the cell, with d = x − c and the Hessian's enclosure H = C ± R:

    f(c) + Σ_i min G_i d_i                          the mean value theorem
    f(c) + Σ_i min (g_i d_i + ½ κ_i d_i²)           κ_i = H_ii − Σ_j |H_ij| s_j / s_i  (Gershgorin)
    f(c) + Σ_i min g_i d_i                          where f is convex: C − diag(Σ_j R_ij s_j / s_i)
                                                    has a Cholesky factor

G is the gradient over the cell, g that at c, s the cell's widths. The second and third bound are
off by what falls with the cell's width squared, and by nothing at a minimum.
"""

from __future__ import annotations

import math

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.certify.intervals import down, times, up
from drake_aigto.jit import inner

# A Cholesky factor of A − δ I that rounding lets be found shows A to be positive definite where
# δ ≥ (n + 2) u tr A (Rump 2006, "Verification of positive definiteness", BIT 46:433-452).
_ROUNDING = 16.0 * 2.0**-52


@inner
def least_linear(a: float, b: float, low: float, high: float) -> float:
    """Returns a bound of [a, b] · d over d in [low, high], which has 0 in it."""
    return times(a, b, low, high)[0]


@inner
def least_quadratic(a: float, b: float, curvature: float, low: float, high: float) -> float:
    """Returns a bound of g d + ½ κ d² over g in [a, b] and low ≤ d ≤ high, low ≤ 0 ≤ high."""
    if not math.isfinite(curvature):
        return -np.inf
    best = 0.0
    for slope in (a, b):
        best = min(best, _least_of(slope, curvature, low), _least_of(slope, curvature, high))
        if curvature > 0.0 and low * curvature < -slope < high * curvature:
            # Its lowest point anywhere, −g²/2κ.
            best = min(best, -up(up(up(slope * slope) / (2.0 * curvature))))
    return best


@inner
def _least_of(slope: float, curvature: float, d: float) -> float:
    if math.isinf(d):
        return -np.inf if slope * d < 0.0 or curvature < 0.0 else 0.0
    straight, bent = slope * d, 0.5 * curvature * d * d
    # Two roundings of one, three of the other, and one of the sum.
    return straight + bent - 4.0 * 2.0**-52 * (abs(straight) + abs(bent)) - 1e-300


@inner
def curvatures(hessian: Floats, scales: Floats, found: Floats) -> None:
    """Fills κ (L,) with ½ dᵀHd ≥ ½ Σ κ_i d_i² of all H in an enclosure (P, 2)."""
    size = scales.size
    for i in range(size):
        total = hessian[i * (i + 1) // 2 + i, 0]
        for j in range(size):
            if j != i:
                place = i * (i + 1) // 2 + j if j < i else j * (j + 1) // 2 + i
                most = max(-hessian[place, 0], hessian[place, 1])
                if most > 0.0:
                    total = down(total - up(up(most * scales[j]) / scales[i]))
        found[i] = total


@inner
def is_convex(hessian: Floats, scales: Floats, matrix: Floats) -> bool:
    """Returns whether all symmetric matrices in an enclosure (P, 2) are positive definite."""
    size, trace = scales.size, 0.0
    for i in range(size):
        for j in range(i + 1):
            low, high = hessian[i * (i + 1) // 2 + j, 0], hessian[i * (i + 1) // 2 + j, 1]
            if not (math.isfinite(low) and math.isfinite(high)):
                return False
            matrix[i, j] = 0.5 * low + 0.5 * high
        trace += abs(matrix[i, i])
    for i in range(size):
        radius = 0.0
        for j in range(size):
            place = i * (i + 1) // 2 + j if j < i else j * (j + 1) // 2 + i
            # (low + high)/2 is off by less than a unit of either.
            own = 0.5 * (hessian[place, 1] - hessian[place, 0])
            own += _ROUNDING * (abs(hessian[place, 0]) + abs(hessian[place, 1]))
            radius += own * scales[j] / scales[i]
        matrix[i, i] -= radius * (1.0 + _ROUNDING) + _ROUNDING * (size + 2) * (trace + radius)
    for j in range(size):
        for i in range(j, size):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                matrix[j, j] = math.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    return True


@inner
def expansion_bound(
    value: float,
    at_point: Floats,
    over_cell: Floats,
    hessian: Floats,
    steps_low: Floats,
    steps_high: Floats,
    work: Floats,
) -> tuple[float, bool]:
    """Returns the best of the bounds about a point, and whether f is convex over the cell.

    Args:
        value: lower end of f(c).
        at_point: g (L, 2).
        over_cell: G (L, 2).
        hessian: H over the cell (L (L + 1)/2, 2).
        steps_low: x − c of the cell's lower ends (L,), rounded down.
        steps_high: of its upper ends (L,), rounded up.
        work: room for L rows of L + 2 numbers.
    """
    size = steps_low.size
    scales, kappa = work[:, size], work[:, size + 1]
    for i in range(size):
        scales[i] = max(steps_high[i] - steps_low[i], 1e-300)
    is_bowl = is_convex(hessian, scales, work[:, :size])
    curvatures(hessian, scales, kappa)
    mean = bent = flat = value
    for i in range(size):
        low, high = steps_low[i], steps_high[i]
        mean = down(mean + least_linear(over_cell[i, 0], over_cell[i, 1], low, high))
        flat = down(flat + least_linear(at_point[i, 0], at_point[i, 1], low, high))
        bent = down(bent + least_quadratic(at_point[i, 0], at_point[i, 1], kappa[i], low, high))
    best = -np.inf
    for bound in (mean, bent, flat if is_bowl else -np.inf):
        if bound > best:  # NaN is not
            best = bound
    return best, is_bowl
