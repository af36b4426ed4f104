"""Parts of a box that cannot meet rows, cut off by going forward and backward along their tapes.

Forward, every entry of a formula gets its range. Backward, from lower ≤ f ≤ upper on, what an
operation may give tells what its arguments may be, down to the variables (HC4: Benhamou, Goualard,
Granvilliers & Puget 1999, "Revising hull and box consistency"). All of it is rounded outward.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.certify.enclosures import VALUE, at, enclose, make_scratch, put
from drake_aigto.certify.formulas import Formulas, join
from drake_aigto.certify.intervals import (
    Interval,
    exponential,
    logarithm,
    minus,
    plus,
    real_power,
    reciprocal,
    times,
    up,
)
from drake_aigto.certify.tape import JointTape, Operation
from drake_aigto.kernels import inner, kernel

_GAIN = 0.1  # of a side: a sweep over all rows that cuts off less is the last one
_MOST_SWEEPS = 10


@inner
def narrow(jets: Floats, entry: int, x: Interval) -> bool:
    """Cuts an entry's range down to an interval; returns whether anything is left."""
    low, high = at(jets, entry, 0)
    low, high = x[0] if x[0] > low else low, x[1] if x[1] < high else high
    put(jets, entry, 0, (low, high))
    return low <= high


@inner
def _narrow_sizes(jets: Floats, entry: int, sizes: Interval) -> bool:
    """Cuts an entry's range down to numbers of a size within an interval, of either sign."""
    low, high = at(jets, entry, 0)
    least = -sizes[1] if low <= -sizes[0] else sizes[0]
    return narrow(jets, entry, (least, sizes[1] if high >= sizes[0] else -sizes[0]))


@inner
def _quotient(y: Interval, x: Interval) -> Interval:
    """Returns all a with a x = y."""
    if x[0] <= 0.0 <= x[1] and y[0] <= 0.0 <= y[1]:
        return -np.inf, np.inf
    return times(y, reciprocal(x))


@inner
def _narrow_both(jets: Floats, operation: int, y: Interval, a: int, b: int) -> bool:
    """Cuts the ranges of two arguments of an operation down to what may give y."""
    if operation == Operation.ADD:
        is_left = narrow(jets, a, plus(y, minus(at(jets, b, 0))))
        return is_left and narrow(jets, b, plus(y, minus(at(jets, a, 0))))
    if operation == Operation.MULTIPLY:
        is_left = narrow(jets, a, _quotient(y, at(jets, b, 0)))
        return is_left and narrow(jets, b, _quotient(y, at(jets, a, 0)))
    # The larger one of two is y.
    is_left = narrow(jets, a, (-np.inf, y[1])) and narrow(jets, b, (-np.inf, y[1]))
    if at(jets, a, 0)[1] < y[0]:
        is_left = is_left and narrow(jets, b, y)
    if at(jets, b, 0)[1] < y[0]:
        is_left = is_left and narrow(jets, a, y)
    return is_left


@inner
def _inverse(operation: int, y: Interval, p: float) -> Interval:
    """Returns what an argument may be for y, of functions that rise or fall."""
    if operation == Operation.SHIFT:
        return plus(y, (-p, -p))
    if operation == Operation.SCALE:
        return _quotient(y, (p, p))
    if operation == Operation.RECIPROCAL:
        return reciprocal(y)
    if operation == Operation.REAL_POWER:
        return real_power(y, reciprocal((p, p)))
    if operation == Operation.EXP:
        return logarithm(y)
    if operation == Operation.LOG:
        return exponential(y)
    if operation == Operation.X_LOG:  # x log x ≥ x − 1
        return 0.0, up(1.0 + max(y[1], 0.0))
    return -np.inf, np.inf


@inner
def _go_back(jets: Floats, entry: int, operation: int, a: int, b: int, p: float) -> bool:
    """Cuts the ranges of an entry's arguments; returns whether anything is left."""
    y = at(jets, entry, 0)
    if operation == Operation.NUMBER or (operation == Operation.POWER and b == 0):
        return True
    if operation == Operation.ABS:
        return _narrow_sizes(jets, a, (max(y[0], 0.0), y[1]))
    if operation == Operation.POWER and b % 2 == 0:
        return _narrow_sizes(jets, a, real_power(y, reciprocal((float(b), float(b)))))
    if operation == Operation.POWER:
        root = reciprocal((float(b), float(b)))
        low = real_power((abs(y[0]), abs(y[0])), root)
        high = real_power((abs(y[1]), abs(y[1])), root)
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
    if enclose(tape, 0, low, high, VALUE, jets) < 0:
        return False
    for r in range(roots.size):
        if not narrow(jets, roots[r], (lower[r], upper[r])):
            return False
    for k in range(tape.operations.size - 1, -1, -1):
        operation, a = tape.operations[k], tape.a[k]
        if operation == Operation.VARIABLE:
            low[a], high[a] = at(jets, k, 0)
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
    jets = make_scratch(joint.tape, low.size, VALUE)
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
