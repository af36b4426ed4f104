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

from drake_aigto.arrays import Bools, Floats
from drake_aigto.certify.enclosures import at, put
from drake_aigto.certify.intervals import UNIT, Interval, down, plus, times, up
from drake_aigto.kernels import inner, kernel

# A Cholesky factor of A − δ I that rounding lets be found shows A to be positive definite where
# δ ≥ (n + 2) u tr A (Rump 2006, "Verification of positive definiteness", BIT 46:433-452).
_ROUNDING = 16.0 * UNIT


ABOUT, OVER = 0, 1  # jets of f about a point, and over a cell
_STEPS = 8  # of the descent within a cell where f is convex


@inner
def bend_place(size: int, i: int, j: int) -> int:
    """Returns where ∂²f/∂x_i∂x_j is in a jet of a function of this many variables."""
    return 1 + size + (i * (i + 1) // 2 + j if j <= i else j * (j + 1) // 2 + i)


@inner
def _least_quadratic(slope: Interval, curvature: float, step: Interval) -> float:
    """Returns a bound of g d + ½ κ d² over g and d in intervals, that of d with 0 in it."""
    if not math.isfinite(curvature):
        return -np.inf
    best = 0.0
    for g in slope:
        for d in step:
            best = min(best, _least_of(g, curvature, d))
        if curvature > 0.0 and step[0] * curvature < -g < step[1] * curvature:
            # Its lowest point anywhere, −g²/2κ.
            best = min(best, -up(up(up(g * g) / (2.0 * curvature))))
    return best


@inner
def _least_of(slope: float, curvature: float, d: float) -> float:
    if math.isinf(d):
        return -np.inf if slope * d < 0.0 or curvature < 0.0 else 0.0
    straight, bent = slope * d, 0.5 * curvature * d * d
    # Two roundings of one, three of the other, and one of the sum.
    return straight + bent - 4.0 * UNIT * (abs(straight) + abs(bent)) - 1e-300


@inner
def _curvature(over: Floats, scales: Floats, i: int) -> float:
    """Returns κ_i, where ½ dᵀHd ≥ ½ Σ κ_i d_i² for all H in a jet (J, 2)."""
    size = scales.size
    total = over[bend_place(size, i, i), 0]
    for j in range(size):
        if j != i:
            place = bend_place(size, i, j)
            most = max(-over[place, 0], over[place, 1])
            if most > 0.0:
                total = down(total - up(up(most * scales[j]) / scales[i]))
    return total


@inner
def _is_convex(over: Floats, scales: Floats, matrix: Floats) -> bool:
    """Returns whether all symmetric matrices in the Hessian of a jet are positive definite."""
    size, trace = scales.size, 0.0
    for i in range(size):
        for j in range(i + 1):
            place = bend_place(size, i, j)
            low, high = over[place, 0], over[place, 1]
            if not (math.isfinite(low) and math.isfinite(high)):
                return False
            matrix[i, j] = 0.5 * low + 0.5 * high
        trace += abs(matrix[i, i])
    for i in range(size):
        radius = 0.0
        for j in range(size):
            place = bend_place(size, i, j)
            # (low + high)/2 is off by less than a unit of either.
            own = 0.5 * (over[place, 1] - over[place, 0])
            own += _ROUNDING * (abs(over[place, 0]) + abs(over[place, 1]))
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
    about: Floats, over: Floats, steps: Floats, matrix: Floats, scales: Floats
) -> tuple[float, bool]:
    """Returns the best of the bounds about a point, and whether f is convex over the cell.

    Args:
        about: jet of f at the point, with its gradient (J, 2).
        over: jet of f over the cell, with its Hessian (J, 2).
        steps: x − c of the cell's ends, rounded outward (L, 2).
        matrix: room (L, L).
        scales: room (L,).
    """
    for i in range(scales.size):
        scales[i] = max(steps[i, 1] - steps[i, 0], 1e-300)
    is_bowl = _is_convex(over, scales, matrix)
    mean = bent = flat = about[0, 0]
    for i in range(scales.size):
        step, slope = (steps[i, 0], steps[i, 1]), (about[1 + i, 0], about[1 + i, 1])
        mean = down(mean + times((over[1 + i, 0], over[1 + i, 1]), step)[0])
        flat = down(flat + times(slope, step)[0])
        bent = down(bent + _least_quadratic(slope, _curvature(over, scales, i), step))
    best = -np.inf
    for bound in (mean, bent, flat if is_bowl else -np.inf):
        if bound > best:  # NaN is not
            best = bound
    return best, is_bowl


@inner
def middle_of(low: float, high: float) -> float:
    """Returns where a side is cut, with or without ends."""
    if math.isinf(low) and math.isinf(high):
        return 0.0
    if math.isinf(high):
        return max(1.0, 2.0 * low) if low >= 0.0 else 0.0
    if math.isinf(low):
        return min(-1.0, 2.0 * high) if high <= 0.0 else 0.0
    return min(max(0.5 * low + 0.5 * high, low), high)


@inner
def choose_point(low: Floats, high: Floats, best: Floats, point: Floats) -> None:
    """Fills the point of a cell that is nearest to the best known one, if that is near; else c."""
    is_near = True
    for i in range(low.size):
        reach = high[i] - low[i]
        is_near &= low[i] - reach <= best[i] <= high[i] + reach
    for i in range(low.size):
        if is_near:
            point[i] = min(max(best[i], low[i]), high[i])
        else:
            point[i] = middle_of(low[i], high[i])


@inner
def set_steps(point: Floats, low: Floats, high: Floats, steps: Floats) -> None:
    """Fills x − c of a cell's ends (L, 2), rounded outward, with 0 in between."""
    for i in range(point.size):
        steps[i, 0] = min(down(low[i] - point[i]), 0.0)
        steps[i, 1] = max(up(high[i] - point[i]), 0.0)


@inner
def descend(jets: Floats, start: Floats, low: Floats, high: Floats, point: Floats) -> None:
    """Fills where the model g d + ½ dᵀ H d is nearly least in a cell, a coordinate at a time."""
    size = point.size
    for i in range(size):
        point[i] = start[i]
    for _ in range(_STEPS):
        for i in range(size):
            slope = 0.5 * (jets[ABOUT, 1 + i, 0] + jets[ABOUT, 1 + i, 1])
            curvature = 0.0
            for j in range(size):
                place = bend_place(size, i, j)
                middle = 0.5 * (jets[OVER, place, 0] + jets[OVER, place, 1])
                slope += middle * (point[j] - start[j])
                curvature = middle if j == i else curvature
            if curvature > 0.0:
                point[i] = min(max(point[i] - slope / curvature, low[i]), high[i])


@inner
def mean_value(value: Interval, jets: Floats, entry: int, steps: Floats) -> Interval:
    """Returns f over a cell by the mean value theorem.

    Args:
        value: of f at a point of the cell.
        jets: with the gradient over the cell (E, J, 2).
        entry: which of them.
        steps: as in `expansion_bound`.
    """
    for i in range(steps.shape[0]):
        value = plus(value, times(at(jets, entry, 1 + i), (steps[i, 0], steps[i, 1])))
    return value


def steps_from(point: Floats, low: Floats, high: Floats) -> Floats:
    """Returns x − c of cells' ends (C, L, 2), rounded outward, with 0 in between."""
    least, most = np.nextafter(low - point, -np.inf), np.nextafter(high - point, np.inf)
    return np.stack([np.minimum(least, 0.0), np.maximum(most, 0.0)], axis=-1)


@kernel
def expand_all(about: Floats, over: Floats, slopes: Floats, steps: Floats) -> Floats:
    """Returns bounds of f + s (x − c) over cells (C,); ∞ where f has no value.

    Args:
        about: jets of f at the points c, with gradients (C, J, 2), to which s is added.
        over: jets of f over the cells, with Hessians (C, J, 2), to which s is added.
        slopes: s (C, L, 2).
        steps: as `steps_from` returns them.
    """
    size = steps.shape[1]
    found, matrix, scales = np.empty(len(steps)), np.empty((size, size)), np.empty(size)
    for c in range(found.size):
        natural = over[c, 0, 0]
        found[c] = natural
        if natural == np.inf:
            continue
        for i in range(size):
            slope = at(slopes, c, i)
            natural = down(natural + times(slope, at(steps, c, i))[0])
            for jets in (about, over):
                put(jets, c, 1 + i, plus(at(jets, c, 1 + i), slope))
        bound = -np.inf
        if np.isfinite(about[c, 0, 0]):
            bound, _ = expansion_bound(about[c], over[c], steps[c], matrix, scales)
        found[c] = max(natural, bound)
    return found


@kernel
def rows_exclude(about: Floats, over: Floats, steps: Floats, lower: Floats, upper: Floats) -> Bools:
    """Returns for each cell whether lower ≤ r ≤ upper holds nowhere in it (C,).

    Args:
        about: jets of r at points of the cells (C, J, 2).
        over: jets of r over the cells, with gradients (C, J, 2).
        steps: as `steps_from` returns them.
        lower: bounds of r (C,).
        upper: shape (C,).
    """
    found = np.empty(lower.size, dtype=np.bool_)
    for c in range(found.size):
        value = at(about, c, 0)
        value = mean_value((-np.inf, value[1]) if value[0] == np.inf else value, over, c, steps[c])
        low, high = max(value[0], over[c, 0, 0]), min(value[1], over[c, 0, 1])
        found[c] = low > upper[c] or high < lower[c]
    return found
