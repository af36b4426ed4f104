"""Rows of linear relaxations over cells, and bounds by their multipliers, rounded outward.

Every entry of a tape is a column. Its rows hold for all x of a cell, whatever is rounded: of a sum,
its definition; of a product, McCormick's four (1976, Math. Program. 10:147); of a convex or concave
function of one variable, its secant and tangents; of any other one, lines through its ends with its
least and its largest slope, and its secant, moved by an eighth of its curvature times the width
squared.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.certify import intervals as iv
from drake_aigto.certify.contraction import contract, narrow
from drake_aigto.certify.enclosures import GRADIENT, HESSIAN, VALUE, at, derivatives, function_value
from drake_aigto.certify.intervals import Interval
from drake_aigto.certify.tape import JointTape, Operation
from drake_aigto.kernels import inner, kernel

ROWS_OF_ONE, ROWS_OF_TWO = 6, 4  # of a function of one argument, and of two
LARGEST_COEFFICIENT = 1e12  # coefficient of a row; larger ones are left out


class Structure(NamedTuple):
    """Places of the coefficients of a program's linear relaxation; entries are columns.

    A row has coefficients of an entry and of its arguments, or of all that it sums up.
    """

    joint: JointTape  # cost and rows as one tape; its entries are the columns (E)
    # First row of each entry, and their number M; a sum has one, or none if it is a part of another
    # (E + 1,).
    first: Ints
    starts: Ints  # first coefficient of each row, and their number (M + 1,)
    columns: Ints  # of the coefficients
    values: Floats  # the coefficients of sums; those of functions are filled for each cell
    lower: Floats  # of rows of sums (M,)
    upper: Floats  # shape (M,)


class LinearProgram(NamedTuple):
    """The linear program of a cell: minimize cost · w with lower ≤ A w ≤ upper, w in `box`."""

    values: Floats  # coefficients of A
    lower: Floats  # of its rows (M,)
    upper: Floats  # shape (M,)
    box: Floats  # ends of columns (2, E)
    ranges: Floats  # of the tape's entries (E, 1, 2)


@inner
def _put_row(
    structure: Structure, cell: LinearProgram, row: int, slopes: tuple[float, float], ends: Interval
) -> None:
    """Sets ends ≤ w − s a − t b ≤; leaves the row out where a number is too large, or is none."""
    first, last = structure.starts[row], structure.starts[row + 1]
    (s, t), (low, high) = slopes, ends
    is_finite = abs(s) <= LARGEST_COEFFICIENT and abs(t) <= LARGEST_COEFFICIENT
    if not (is_finite and low < np.inf and high > -np.inf):
        s = t = 0.0
        low, high = -np.inf, np.inf
    cell.values[first], cell.values[first + 1] = 1.0, -s
    if last - first > 2:
        cell.values[first + 2] = -t
    cell.lower[row], cell.upper[row] = low, high


@inner
def _line_through(value: Interval, slope: float, t: float) -> Interval:
    """Returns value − slope t, of a line with that slope through a point."""
    return iv.plus(value, iv.times((-slope, -slope), (t, t)))


@inner
def _tangent(operation: int, b: int, p: float, x: Interval, t: float) -> tuple[float, Interval]:
    """Returns a slope s near that at t, and what φ(t) + φ′(t) (a − t) − s a is over x."""
    value, first, _ = derivatives(operation, (t, t), b, p, GRADIENT)
    slope = 0.5 * (first[0] + first[1])
    turn = iv.times(iv.plus(first, (-slope, -slope)), iv.plus(x, (-t, -t)))
    return slope, iv.plus(_line_through(value, slope, t), turn)


@inner
def _put_function(structure: Structure, cell: LinearProgram, k: int) -> None:
    """Fills the rows of a function of one argument."""
    tape, row = structure.joint.tape, structure.first[k]
    operation, argument, b, p = tape.operations[k], tape.a[k], tape.b[k], tape.numbers[k]
    x = cell.box[0, argument], cell.box[1, argument]
    _, first, second = derivatives(operation, x, b, p, HESSIAN)
    is_convex = second[0] >= 0.0 or operation == Operation.ABS
    is_concave = second[1] <= 0.0 and not is_convex
    at_low, _, _ = derivatives(operation, (x[0], x[0]), b, p, VALUE)
    at_high, _, _ = derivatives(operation, (x[1], x[1]), b, p, VALUE)
    for extra in range(ROWS_OF_ONE):
        _put_row(structure, cell, row + extra, (np.nan, 0.0), (-np.inf, np.inf))
    width = x[1] - x[0]
    if 0.0 < width < np.inf:
        slope = (0.5 * (at_high[0] + at_high[1]) - 0.5 * (at_low[0] + at_low[1])) / width
        one, other = _line_through(at_low, slope, x[0]), _line_through(at_high, slope, x[1])
        least, most = min(one[0], other[0]), max(one[1], other[1])
        if not (is_convex or is_concave):
            square = iv.up(iv.up_product(width, width) * 0.125) * 1.000001
            least = iv.down(least - iv.up_product(max(second[1], 0.0), square))
            most = iv.up(most + iv.up_product(max(-second[0], 0.0), square))
        ends = (-np.inf if is_convex else least, np.inf if is_concave else most)
        _put_row(structure, cell, row, (slope, 0.0), ends)
    if is_convex or is_concave:
        for n, part in enumerate((0.0, 1.0, 0.5, 0.25, 0.75)):
            t = iv.product(1.0 - part, x[0]) + iv.product(part, x[1])
            slope, ends = _tangent(operation, b, p, x, t)
            ends = (ends[0], np.inf) if is_convex else (-np.inf, ends[1])
            _put_row(structure, cell, row + 1 + n, (slope, 0.0), ends)
        return
    for n in range(4):
        slope = first[n % 2]
        t, value = (x[0], at_low) if n < 2 else (x[1], at_high)
        line = _line_through(value, slope, t)
        is_below = (n == 0) or (n == 3)
        ends = (line[0], np.inf) if is_below else (-np.inf, line[1])
        _put_row(structure, cell, row + 1 + n, (slope, 0.0), ends)


@inner
def _put_pair(structure: Structure, cell: LinearProgram, k: int) -> None:
    """Fills the rows of a product, or of the larger one of two."""
    tape, row, box = structure.joint.tape, structure.first[k], cell.box
    operation, i, j = tape.operations[k], tape.a[k], tape.b[k]
    for n in range(ROWS_OF_TWO):
        if operation == Operation.MULTIPLY:
            # (a − a₀)(b − b₀) is 0 or more at two corners, and 0 or less at the others.
            a, b = box[n % 2, i], box[n // 2, j]
            corner = iv.minus(iv.times((a, a), (b, b)))
            is_below = n % 2 == n // 2
            ends = (corner[0], np.inf) if is_below else (-np.inf, corner[1])
            _put_row(structure, cell, row + n, (b, a), ends)
            continue
        one, other = (i, j) if n % 2 == 0 else (j, i)
        # max(a, b) − a is b − a at most, or 0.
        ahead = max(0.0, iv.up(box[1, other] - box[0, one]))
        ends = (0.0, np.inf) if n < 2 else (-np.inf, ahead)
        _put_row(structure, cell, row + n, (1.0, 0.0) if one == i else (0.0, 1.0), ends)


@kernel
def relax(
    structure: Structure,
    lower: Floats,
    upper: Floats,
    low: Floats,
    high: Floats,
    cell: LinearProgram,
) -> bool:
    """Fills the linear program of a cell, which is narrowed in place; returns if anything is left.

    Its cost and rows are between lower and upper (1 + R,), the cell between low and high (n,).
    """
    operations, first, last, numbers, _ = structure.joint.tape
    if not contract(structure.joint, lower, upper, low, high, cell.ranges):
        return False
    for k in range(operations.size):
        if structure.first[k + 1] - structure.first[k] > 1:
            # Rows narrow what they read, and that may be read by other functions, too.
            value = function_value(operations[k], first[k], last[k], numbers[k], cell.ranges)
            if not narrow(cell.ranges, k, value):
                return False
        cell.box[0, k], cell.box[1, k] = at(cell.ranges, k, 0)
    for k in range(cell.box.shape[1]):
        count = structure.first[k + 1] - structure.first[k]
        if count == ROWS_OF_TWO:
            _put_pair(structure, cell, k)
        elif count == ROWS_OF_ONE:
            _put_function(structure, cell, k)
    return True


@inner
def _add_to(residuals: Floats, column: int, x: Interval) -> None:
    total = iv.plus((residuals[column, 0], residuals[column, 1]), x)
    residuals[column, 0], residuals[column, 1] = total


@kernel
def safe_bound(
    structure: Structure, cell: LinearProgram, cost: tuple[int, float], multipliers: Floats
) -> float:
    """Returns a bound of a column times 1 or −1, by any multipliers of the rows.

    y · (A w) ≥ Σ y_i lower_i or y_i upper_i, and the rest (cost − Aᵀy) · w is least at ends of
    columns (Neumaier & Shcherbina 2004, Math. Program. 99:283). What is left of a sum without such
    an end is passed on to its summands.

    Args:
        structure: of the program.
        cell: its linear program.
        cost: the column and its sign.
        multipliers: y (M,); those of rows without an end on their side are left out.
    """
    total, residuals = 0.0, np.zeros((cell.box.shape[1], 2))  # cost − Aᵀy
    residuals[cost[0]] = cost[1]
    for row in range(multipliers.size):
        y = multipliers[row]
        end = cell.lower[row] if y > 0.0 else cell.upper[row]
        if y == 0.0 or not math.isfinite(end) or not math.isfinite(y):
            continue
        total = iv.down(total + iv.times((y, y), (end, end))[0])
        for k in range(structure.starts[row], structure.starts[row + 1]):
            a = cell.values[k]
            _add_to(residuals, structure.columns[k], iv.minus(iv.times((y, y), (a, a))))
    for c in range(residuals.shape[0] - 1, -1, -1):
        left = residuals[c, 0], residuals[c, 1]
        own = iv.times(left, (cell.box[0, c], cell.box[1, c]))[0]
        row = structure.first[c]
        is_sum = structure.first[c + 1] - row == 1 and math.isfinite(cell.lower[row])
        if is_sum and not math.isfinite(own):
            own = iv.times(left, (cell.lower[row], cell.upper[row]))[0]
            residuals[c] = 0.0
            for k in range(structure.starts[row] + 1, structure.starts[row + 1]):
                a = -cell.values[k]
                _add_to(residuals, structure.columns[k], iv.times((a, a), left))
        total = iv.down(total + own)
    return total if not math.isnan(total) else -np.inf


@kernel
def violations(
    structure: Structure, cell: LinearProgram, functions: Ints, w: Floats, multipliers: Floats
) -> Floats:
    """Returns how far functions are from their columns at a point, in the cost's unit (F,).

    Functions are given by their columns (F,), the point is w (E,), multipliers are of rows (M,).
    """
    operations, first, last, numbers, _ = structure.joint.tape
    points, scores = np.empty_like(cell.ranges), np.zeros(functions.size)
    for k in range(w.size):
        points[k] = min(max(w[k], cell.box[0, k]), cell.box[1, k])
    for n in range(functions.size):
        k = functions[n]
        low, high = function_value(operations[k], first[k], last[k], numbers[k], points)
        weight = np.sum(np.abs(multipliers[structure.first[k] : structure.first[k + 1]]))
        score = weight * abs(w[k] - (0.5 * low + 0.5 * high))
        scores[n] = score if math.isfinite(score) else 0.0
    return scores
