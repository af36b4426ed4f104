"""Prices of rows: multipliers, by which a row's violation pays for a lower cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drake_aigto.arrays import Bools, Floats
from drake_aigto.certify.enclosures import GRADIENT, enclose_all
from drake_aigto.certify.formulas import Formulas, PricedRow, formula_of, make_tape

# A row or a variable is at its bound where it is this near, relative to its size.
_NEAR = 1e-5


def with_prices(formulas: Formulas, x: Floats) -> Formulas:
    """Returns a program whose rows are terms of its cost, which is no larger where they hold.

    On all feasible x, f ≥ f + λ_j (r_j − t_j): of an equality with any λ; of an inequality that is
    at its bound t, with λ (r − t) ≤ 0. Least squares make the Lagrangian's slope at x small.

    Args:
        formulas: the program.
        x: a point, the nearer to an optimum the better (n,).
    """
    rows = formulas.rows
    sums = [formulas.summands, *((row,) for row in rows)]
    tape = make_tape(formula_of(each, range(x.size)) for each in sums)
    points = np.tile(x, (len(sums), 1))
    jets = enclose_all(tape, np.arange(len(sums)), points, points, GRADIENT)
    if not np.all(np.isfinite(jets)):
        return replace(formulas, rows=())
    values, gradients = np.mean(jets[1:, 0], axis=-1), np.mean(jets[:, 1:], axis=-1)
    low, high = formulas.row_bounds
    at_low, at_high = _is_at(values, low), _is_at(values, high)
    active = at_low | at_high
    free = ~(_is_at(x, formulas.lower) | _is_at(x, formulas.upper))
    prices = np.zeros(len(rows))
    while np.any(active) and np.any(free):
        matrix = gradients[1:][np.ix_(active, free)].T
        prices[active] = np.linalg.lstsq(matrix, -gradients[0][free], rcond=None)[0]
        # Of the side that is active: λ ≥ 0 at the upper one, ≤ 0 at the lower one.
        wrong = active & (low != high) & np.where(at_high, prices <= 0.0, prices >= 0.0)
        if not np.any(wrong):
            break
        active &= ~wrong
        prices[~active] = 0.0
    priced = (
        PricedRow(row.binding, row.expression, row.index, row.variables, price, target)
        for row, price, target in zip(
            rows, prices.tolist(), np.where(at_high, high, low).tolist(), strict=True
        )
        if price
    )
    return replace(formulas, summands=(*formulas.summands, *priced), rows=())


def _is_at(values: Floats, bounds: Floats) -> Bools:
    """Returns which values are next to their bounds, which are finite then."""
    return np.abs(values - bounds) <= _NEAR * np.maximum(1.0, np.abs(values))
