"""Prices of rows: multipliers, by which a row's violation pays for a lower cost."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats
from drake_aigto.certify.enclosures import GRADIENT, enclose_all
from drake_aigto.certify.formulas import Formulas, PricedRow, Tape, formula_of, make_tape

# A row or a variable is at its bound where it is this near, relative to its size.
_NEAR = 1e-5
_BEND = 10.0  # relative to what makes up for the cost's slope in a unit's length


class Rows(NamedTuple):
    """Rows lower ≤ r_j(x) ≤ upper, and their terms in the cost where they hold.

    On all feasible x, f ≥ f + λ_j (r_j − t_j) + ½ ρ_j (r_j − t_j)²: of an equality with any λ and
    ρ; of an inequality at its bound t with λ (r − t) ≤ 0 and ρ ≤ 2 |λ| / max |r − t|.

    Attributes:
        lower: bounds of r (R,).
        upper: shape (R,).
        targets: t (R,).
        slopes: λ (R,); 0 leaves a row out.
        bends: ρ (R,) of equalities, −ρ of inequalities, of which a cell may allow less.
    """

    lower: Floats
    upper: Floats
    targets: Floats
    slopes: Floats
    bends: Floats


def cost_and_rows(formulas: Formulas) -> tuple[Tape, Rows]:
    """Returns the cost, formula 0, and the rows of a program, without prices yet."""
    sums = [formulas.summands, *((row,) for row in formulas.rows)]
    tape = make_tape(formula_of(each, range(formulas.lower.size)) for each in sums)
    bounds = ([getattr(row, side) for row in formulas.rows] for side in ("lower", "upper"))
    return tape, Rows(*map(np.array, bounds), *np.zeros((3, len(formulas.rows))))


def with_prices(formulas: Formulas, x: Floats) -> Formulas:
    """Returns a program whose cost has terms of its rows; it is no larger where these hold.

    Args:
        formulas: the program.
        x: a point with next to no slope of the Lagrangian then (n,).
    """
    tape, rows = cost_and_rows(formulas)
    rows = priced_rows(tape, rows, np.array([formulas.lower, formulas.upper]), x)
    priced = tuple(
        PricedRow(row.binding, row.expression, row.index, row.variables, factor, target)
        for row, factor, target in zip(
            formulas.rows, rows.slopes.tolist(), rows.targets.tolist(), strict=True
        )
        if factor
    )
    return replace(formulas, summands=(*formulas.summands, *priced))


def priced_rows(tape: Tape, rows: Rows, outer: Floats, x: Floats) -> Rows:
    """Returns rows with which the Lagrangian has next to no slope at a point.

    Args:
        tape: the cost and the rows.
        rows: without prices.
        outer: bounds of the variables (2, n).
        x: the point (n,).
    """
    low, high, *_ = rows
    count = low.size + 1
    if count == 1:
        return rows
    points = np.tile(x, (count, 1))
    jets = enclose_all(tape, np.arange(count), points, points, GRADIENT)
    if not np.all(np.isfinite(jets)):
        return rows
    values, gradients = np.mean(jets[:, 0], axis=-1), np.mean(jets[:, 1:], axis=-1)
    at_low, at_high = _is_at(values[1:], low), _is_at(values[1:], high)
    # Of the side that is active: λ ≥ 0 at the upper one, ≤ 0 at the lower one.
    signs = np.where(at_high, 1.0, -1.0)
    active = at_low | at_high
    free = ~np.any([_is_at(x, bound) for bound in outer], axis=0)
    slopes = np.zeros(count - 1)
    while np.any(active) and np.any(free):
        matrix = gradients[1:][np.ix_(active, free)].T
        slopes[:] = 0.0
        slopes[active] = np.linalg.lstsq(matrix, -gradients[0][free], rcond=None)[0]
        wrong = active & (low != high) & (slopes * signs <= 0.0)
        if not np.any(wrong):
            break
        active &= ~wrong
        slopes[~active] = 0.0
    largest = max(1.0, float(np.max(np.abs(gradients[0]), initial=0.0)))
    with np.errstate(over="ignore", divide="ignore"):
        bends = np.where(low == high, _BEND, -_BEND) * largest / np.sum(gradients[1:] ** 2, axis=1)
    bends = np.where(active & np.isfinite(bends), bends, 0.0)
    targets = np.where(at_high, high, np.where(at_low, low, 0.0))
    return Rows(low, high, targets, np.where(active, slopes, 0.0), bends)


def _is_at(values: Floats, bounds: Floats) -> Bools:
    """Returns which values are next to their bounds, which are finite then."""
    return np.abs(values - bounds) <= _NEAR * np.maximum(1.0, np.abs(values))
