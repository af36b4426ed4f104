"""Over a cell: parts that cannot meet rows, cut off, and lower bounds of functions.

Cuts go forward and backward along tapes. Forward, every entry of a formula gets its range.
Backward, from lower ≤ f ≤ upper on, what an operation may give tells what its arguments may be,
down to the variables (HC4: Benhamou, Goualard, Granvilliers & Puget 1999, "Revising hull and box
consistency"). All of it is rounded outward.

Lower bounds come from enclosures of derivatives. About a point c of the cell, with d = x − c and
the Hessian's enclosure H:

    f(c) + Σ_i min G_i d_i                          the mean value theorem
    f(c) + Σ_i min (g_i d_i + ½ κ_i d_i²)           κ_i = H_ii − Σ_j |H_ij| s_j / s_i  (Gershgorin)

G is the gradient over the cell, g that at c, s the cell's widths. The second bound is off
by what falls with the cell's width squared, and by nothing at a minimum.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.certify import enclosures
from drake_aigto.certify import intervals as iv
from drake_aigto.certify.formulas import Formulas, join
from drake_aigto.certify.intervals import Interval
from drake_aigto.certify.tape import JointTape, Operation, Tape
from drake_aigto.kernels import inner, kernel

_GAIN = 0.1  # of a side: a sweep over all rows that cuts off less is the last one
_MOST_SWEEPS = 10


@inner
def narrow(jets: Floats, entry: int, x: Interval) -> bool:
    """Cuts an entry's range down to an interval; returns whether anything is left."""
    low, high = enclosures.at(jets, entry, 0)
    low, high = x[0] if x[0] > low else low, x[1] if x[1] < high else high
    enclosures.put(jets, entry, 0, (low, high))
    return low <= high


@inner
def _narrow_sizes(jets: Floats, entry: int, sizes: Interval) -> bool:
    """Cuts an entry's range down to numbers of a size within an interval, of either sign."""
    low, high = enclosures.at(jets, entry, 0)
    least = -sizes[1] if low <= -sizes[0] else sizes[0]
    return narrow(jets, entry, (least, sizes[1] if high >= sizes[0] else -sizes[0]))


@inner
def _quotient(y: Interval, x: Interval) -> Interval:
    """Returns all a with a x = y."""
    if x[0] <= 0.0 <= x[1] and y[0] <= 0.0 <= y[1]:
        return -np.inf, np.inf
    return iv.times(y, iv.reciprocal(x))


@inner
def _narrow_both(jets: Floats, operation: int, y: Interval, a: int, b: int) -> bool:
    """Cuts the ranges of two arguments of an operation down to what may give y."""
    if operation == Operation.ADD:
        is_left = narrow(jets, a, iv.plus(y, iv.minus(enclosures.at(jets, b, 0))))
        return is_left and narrow(jets, b, iv.plus(y, iv.minus(enclosures.at(jets, a, 0))))
    if operation == Operation.MULTIPLY:
        is_left = narrow(jets, a, _quotient(y, enclosures.at(jets, b, 0)))
        return is_left and narrow(jets, b, _quotient(y, enclosures.at(jets, a, 0)))
    # The larger one of two is y.
    is_left = narrow(jets, a, (-np.inf, y[1])) and narrow(jets, b, (-np.inf, y[1]))
    if enclosures.at(jets, a, 0)[1] < y[0]:
        is_left = is_left and narrow(jets, b, y)
    if enclosures.at(jets, b, 0)[1] < y[0]:
        is_left = is_left and narrow(jets, a, y)
    return is_left


@inner
def _inverse(operation: int, y: Interval, p: float) -> Interval:
    """Returns what an argument may be for y, of functions that rise or fall."""
    if operation == Operation.SHIFT:
        return iv.plus(y, (-p, -p))
    if operation == Operation.SCALE:
        return _quotient(y, (p, p))
    if operation == Operation.RECIPROCAL:
        return iv.reciprocal(y)
    if operation == Operation.REAL_POWER:
        return iv.real_power(y, iv.reciprocal((p, p)))
    if operation == Operation.EXP:
        return iv.logarithm(y)
    if operation == Operation.LOG:
        return iv.exponential(y)
    if operation == Operation.X_LOG:  # x log x ≥ x − 1
        return 0.0, iv.up(1.0 + max(y[1], 0.0))
    return -np.inf, np.inf


@inner
def _go_back(jets: Floats, entry: int, operation: int, a: int, b: int, p: float) -> bool:
    """Cuts the ranges of an entry's arguments; returns whether anything is left."""
    y = enclosures.at(jets, entry, 0)
    if operation == Operation.NUMBER or (operation == Operation.POWER and b == 0):
        return True
    if operation == Operation.ABS:
        return _narrow_sizes(jets, a, (max(y[0], 0.0), y[1]))
    if operation == Operation.POWER and b % 2 == 0:
        return _narrow_sizes(jets, a, iv.real_power(y, iv.reciprocal((float(b), float(b)))))
    if operation == Operation.POWER:
        root = iv.reciprocal((float(b), float(b)))
        low = iv.real_power((abs(y[0]), abs(y[0])), root)
        high = iv.real_power((abs(y[1]), abs(y[1])), root)
        least = low[0] if y[0] >= 0.0 else -low[1]
        return narrow(jets, a, (least, high[1] if y[1] >= 0.0 else -high[0]))
    if operation == Operation.ADD or operation == Operation.MULTIPLY or operation == Operation.MAX:
        return _narrow_both(jets, operation, y, a, b)
    return narrow(jets, a, _inverse(operation, y, p))


@inner
def _contract_once(
    joint: JointTape, lower: Floats, upper: Floats, low: Floats, high: Floats, jets: Floats
) -> bool:
    tape, roots = joint
    if enclosures.enclose(tape, 0, low, high, enclosures.VALUE, jets) < 0:
        return False
    for r in range(roots.size):
        if not narrow(jets, roots[r], (lower[r], upper[r])):
            return False
    for k in range(tape.operations.size - 1, -1, -1):
        operation, a = tape.operations[k], tape.a[k]
        if operation == Operation.VARIABLE:
            low[a], high[a] = enclosures.at(jets, k, 0)
        elif not _go_back(jets, k, operation, a, tape.b[k], tape.numbers[k]):
            return False
    return True


@inner
def contract(
    joint: JointTape, lower: Floats, upper: Floats, low: Floats, high: Floats, jets: Floats
) -> bool:
    """Narrows a box low ≤ x ≤ high (n,), in place, to where all formulas may be within bounds (R,).

    Fills jets, as `make_scratch` returns them, with the ranges of entries. Returns whether anything
    is left; if not, the box says nothing.
    """
    for _ in range(_MOST_SWEEPS):
        width = high - low
        if not _contract_once(joint, lower, upper, low, high, jets):
            return False
        if not np.any(high - low < (1.0 - _GAIN) * width):
            break
    return True


@kernel
def contract_box(joint: JointTape, lower: Floats, upper: Floats, low: Floats, high: Floats) -> bool:
    """Narrows a box in place, as `contract` does, and returns whether anything is left."""
    jets = enclosures.make_scratch(joint.tape, low.size, enclosures.VALUE)
    return contract(joint, lower, upper, low, high, jets)


def narrowed(formulas: Formulas) -> tuple[Formulas, bool]:
    """Returns formulas with bounds that rows leave something of, and whether they leave any."""
    lower, upper = formulas.lower.copy(), formulas.upper.copy()
    joint = join([(row,) for row in formulas.rows], lower.size)
    low, high = formulas.row_bounds
    is_left = bool(np.all(lower <= upper))
    if is_left and formulas.rows:
        is_left = bool(contract_box(joint, low, high, lower, upper))
    return (replace(formulas, lower=lower, upper=upper) if is_left else formulas), is_left


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
        is_before = -g <= step[0] * curvature - iv.TINY
        if curvature > 0.0 and not (is_before or -g >= step[1] * curvature + iv.TINY):
            # Its lowest point anywhere, −g²/2κ.
            best = min(best, -iv.up_product(abs(g), iv.up_quotient(abs(g), 2.0 * curvature)))
    return best


@inner
def _least_of(slope: float, curvature: float, d: float) -> float:
    if math.isinf(d):
        return -np.inf if slope * d < 0.0 or curvature < 0.0 else 0.0
    straight, bent = slope * d, 0.5 * curvature * d * d
    # Two roundings of one, three of the other, and one of the sum.
    value = straight + bent - 4.0 * iv.UNIT * (abs(straight) + abs(bent)) - iv.TINY
    return value if value < np.inf else -np.inf


@inner
def curvature(over: Floats, steps: Floats, i: int) -> float:
    """Returns κ_i, where ½ dᵀHd ≥ ½ Σ κ_i d_i² for all H in a jet (J, 2)."""
    size, own = len(steps), max(steps[i, 1] - steps[i, 0], iv.TINY)
    total = over[bend_place(size, i, i), 0]
    for j in range(size):
        if j != i:
            place, other = bend_place(size, i, j), max(steps[j, 1] - steps[j, 0], iv.TINY)
            most = max(-over[place, 0], over[place, 1])
            if most > 0.0:
                total = iv.down(total - iv.up_product(most, iv.up_quotient(other, own)))
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
    end = enclosures.enclose(tape, formula, low, high, enclosures.HESSIAN, jets)
    if end < 0:
        return np.inf
    over[:] = jets[end]
    best = over[0, 0]
    for i in range(point.size):
        steps[i, 0] = min(iv.down(low[i] - point[i]), 0.0)
        steps[i, 1] = max(iv.up(high[i] - point[i]), 0.0)
        best = iv.down(best + iv.times((cell[3, i], cell[4, i]), (steps[i, 0], steps[i, 1]))[0])
    end = enclosures.enclose(tape, formula, point, point, enclosures.GRADIENT, jets)
    if end < 0:
        return best
    about[:] = jets[end]
    mean = bent = about[0, 0]
    for i in range(point.size):
        moved, step = (cell[3, i], cell[4, i]), (steps[i, 0], steps[i, 1])
        slope = iv.plus((about[1 + i, 0], about[1 + i, 1]), moved)
        mean = iv.down(mean + iv.times(iv.plus((over[1 + i, 0], over[1 + i, 1]), moved), step)[0])
        bent = iv.down(bent + least_quadratic(slope, curvature(over, steps, i), step))
    for bound in (bent, mean):
        if bound > best:  # NaN is not
            best = bound
    return best


@kernel
def bound_all(tape: Tape, formula: int, sides: Floats, cells: Ints) -> Floats:
    """Returns bounds of f + s (x − c) over cells (C,); ∞ where f has no value.

    Sides (5, K) are lower and upper ends, points c, and lower and upper ends of s; cells (C, L) say
    which sides each has.
    """
    size, length = cells.shape[1], tape.starts[formula + 1] - tape.starts[formula]
    jets = np.empty((length, enclosures.jet_size(size, enclosures.HESSIAN), 2))
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
    concave between others. A finite Hessian says that f has values around them, too. Slopes and
    bends are ∂f/∂x_i and ∂²f/∂x_i² (K, 2), ends and outer ends (2, K).
    """
    at_lower, at_upper = ends == outer
    falls, rises = (slopes[:, 1] < 0.0) & ~at_upper, (slopes[:, 0] > 0.0) & ~at_lower
    is_concave = (bends[:, 1] < 0.0) & ~at_lower & ~at_upper
    is_smooth = np.all(np.isfinite(np.hstack([slopes, bends])), axis=1)
    return ~(is_smooth & (rises | falls | is_concave))
