"""Lower bounds of a function over a cell, from enclosures of its derivatives.

About a point c of the cell, with d = x − c and the Hessian's enclosure H:

    f(c) + Σ_i min G_i d_i                          the mean value theorem
    f(c) + Σ_i min (g_i d_i + ½ κ_i d_i²)           κ_i = H_ii − Σ_j |H_ij| s_j / s_i  (Gershgorin)

G is the gradient over the cell, g that at c, s the cell's widths. The second bound is off
by what falls with the cell's width squared, and by nothing at a minimum.
"""

from __future__ import annotations

import math

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.certify.enclosures import GRADIENT, HESSIAN, enclose, jet_size
from drake_aigto.certify.intervals import (
    TINY,
    UNIT,
    Interval,
    down,
    plus,
    times,
    up,
    up_product,
    up_quotient,
)
from drake_aigto.certify.tape import Tape
from drake_aigto.kernels import inner, kernel

# Room for jets of entries (E, J, 2), jets about a point and over a cell (J, 2), and steps (L, 2).
Room = tuple[Floats, Floats, Floats, Floats]


@inner
def bend_place(size: int, i: int, j: int) -> int:
    """Returns where ∂²f/∂x_i∂x_j is in a jet of a function of this many variables."""
    return 1 + size + (i * (i + 1) // 2 + j if j <= i else j * (j + 1) // 2 + i)


@inner
def least_quadratic(slope: Interval, curvature: float, step: Interval) -> float:
    """Returns a bound of g d + ½ κ d² over g and d in intervals, that of d with 0 in it."""
    if not math.isfinite(curvature):
        return -np.inf
    best = 0.0
    for g in slope:
        for d in step:
            best = min(best, _least_of(g, curvature, d))
        is_before = -g <= step[0] * curvature - TINY
        if curvature > 0.0 and not (is_before or -g >= step[1] * curvature + TINY):
            # Its lowest point anywhere, −g²/2κ.
            best = min(best, -up_product(abs(g), up_quotient(abs(g), 2.0 * curvature)))
    return best


@inner
def _least_of(slope: float, curvature: float, d: float) -> float:
    if math.isinf(d):
        return -np.inf if slope * d < 0.0 or curvature < 0.0 else 0.0
    straight, bent = slope * d, 0.5 * curvature * d * d
    # Two roundings of one, three of the other, and one of the sum.
    value = straight + bent - 4.0 * UNIT * (abs(straight) + abs(bent)) - TINY
    return value if value < np.inf else -np.inf


@inner
def curvature(over: Floats, steps: Floats, i: int) -> float:
    """Returns κ_i, where ½ dᵀHd ≥ ½ Σ κ_i d_i² for all H in a jet (J, 2)."""
    size, own = len(steps), max(steps[i, 1] - steps[i, 0], TINY)
    total = over[bend_place(size, i, i), 0]
    for j in range(size):
        if j != i:
            place, other = bend_place(size, i, j), max(steps[j, 1] - steps[j, 0], TINY)
            most = max(-over[place, 0], over[place, 1])
            if most > 0.0:
                total = down(total - up_product(most, up_quotient(other, own)))
    return total


@kernel
def middles(low: Floats, high: Floats) -> Floats:
    """Returns where sides are cut (n,), with or without ends."""
    found = np.zeros(low.size)
    for i in range(low.size):
        a, b = low[i], high[i]
        if math.isfinite(a) and math.isfinite(b):
            found[i] = min(max(0.5 * a + 0.5 * b, a), b)
        elif math.isfinite(a) and a >= 0.0:
            found[i] = max(1.0, 2.0 * a)
        elif math.isfinite(b) and b <= 0.0:
            found[i] = min(-1.0, 2.0 * b)
    return found


@inner
def _bound_about(tape: Tape, formula: int, cell: Floats, room: Room) -> float:
    """Returns a bound of f + s (x − c) over a cell (5, L); see `bound_all`."""
    jets, about, over, steps = room
    low, high, point = cell[0], cell[1], cell[2]
    end = enclose(tape, formula, low, high, HESSIAN, jets)
    if end < 0:
        return np.inf
    over[:] = jets[end]
    best = over[0, 0]
    for i in range(point.size):
        steps[i, 0] = min(down(low[i] - point[i]), 0.0)
        steps[i, 1] = max(up(high[i] - point[i]), 0.0)
        best = down(best + times((cell[3, i], cell[4, i]), (steps[i, 0], steps[i, 1]))[0])
    end = enclose(tape, formula, point, point, GRADIENT, jets)
    if end < 0:
        return best
    about[:] = jets[end]
    mean = bent = about[0, 0]
    for i in range(point.size):
        moved, step = (cell[3, i], cell[4, i]), (steps[i, 0], steps[i, 1])
        slope = plus((about[1 + i, 0], about[1 + i, 1]), moved)
        mean = down(mean + times(plus((over[1 + i, 0], over[1 + i, 1]), moved), step)[0])
        bent = down(bent + least_quadratic(slope, curvature(over, steps, i), step))
    for bound in (bent, mean):
        if bound > best:  # NaN is not
            best = bound
    return best


@kernel
def bound_all(tape: Tape, formula: int, sides: Floats, cells: Ints) -> Floats:
    """Returns bounds of f + s (x − c) over cells (C,); ∞ where f has no value.

    Args:
        tape: holds f.
        formula: its number.
        sides: of cells: lower and upper ends, points c, and lower and upper ends of s (5, K).
        cells: which sides each has (C, L).
    """
    size, length = cells.shape[1], tape.starts[formula + 1] - tape.starts[formula]
    jets = np.empty((length, jet_size(size, HESSIAN), 2))
    room = jets, np.empty_like(jets[0]), np.empty_like(jets[0]), np.empty((size, 2))
    found, cell = np.empty(len(cells)), np.empty((5, size))
    for c in range(found.size):
        for i in range(size):
            cell[:, i] = sides[:, cells[c, i]]
        found[c] = _bound_about(tape, formula, cell, room)
    return found


def may_hold_minima(slopes: Floats, bends: Floats, ends: Floats, outer: Floats) -> Bools:
    """Returns where f may have a minimum along a variable that is within ends of it (K,).

    It has none where it rises or falls all over, up to ends that are none of the outer ones, or is
    concave between others. A finite Hessian says that f has values around them, too.

    Args:
        slopes: ∂f/∂x_i (K, 2).
        bends: ∂²f/∂x_i² (K, 2).
        ends: of x_i (2, K).
        outer: ends that it may have (2, K).
    """
    at_lower, at_upper = ends == outer
    falls, rises = (slopes[:, 1] < 0.0) & ~at_upper, (slopes[:, 0] > 0.0) & ~at_lower
    is_concave = (bends[:, 1] < 0.0) & ~at_lower & ~at_upper
    is_smooth = np.all(np.isfinite(np.hstack([slopes, bends])), axis=1)
    return ~(is_smooth & (rises | falls | is_concave))
