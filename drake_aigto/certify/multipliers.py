"""What rows add to the cost in bounds about a point: multipliers by least squares."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats


class Multipliers(NamedTuple):
    """What rows add to the cost where they hold, about the best known point.

    On all feasible x, f ≥ f + λ_j (r_j − t_j) + ½ ρ_j (r_j − t_j)²: of an equality with any λ and
    ρ; of an inequality at its bound t with λ (r − t) ≤ 0 and ρ ≤ 2 |λ| / max |r − t|.

    Attributes:
        targets: t (R,).
        slopes: λ (R,); 0 leaves a row out.
        bends: ρ (R,) of equalities, −ρ of inequalities, of which a cell may allow less.
    """

    targets: Floats
    slopes: Floats
    bends: Floats


# A row or a variable is at its bound where it is so near, relative to its size.
_NEAR = 1e-5
_BEND = 10.0  # relative to what makes up for the cost's slope in a unit's length


def no_multipliers(num_rows: int) -> Multipliers:
    """Returns those that leave all rows out."""
    return Multipliers(*(np.zeros(num_rows) for _ in range(3)))


def multipliers_at(
    x: Floats,
    values: Floats,
    gradients: Floats,
    rows: tuple[Floats, Floats],
    bounds: tuple[Floats, Floats],
) -> Multipliers:
    """Returns multipliers with which the Lagrangian has next to no slope at a point.

    Args:
        x: the point (n,).
        values: of the cost and the rows (1 + R,).
        gradients: shape (1 + R, n).
        rows: lower and upper bounds of the rows, shapes (R,).
        bounds: of x, shapes (n,).
    """
    found = no_multipliers(values.size - 1)
    if not np.all(np.isfinite(gradients)):
        return found
    own, (low, high) = values[1:], rows
    at_low, at_high = _is_at(own, low), _is_at(own, high)
    # Of the side that is active: λ ≥ 0 at the upper one, ≤ 0 at the lower one.
    signs = np.where(at_high, 1.0, -1.0)
    active = at_low | at_high
    free = ~np.any([_is_at(x, bound) for bound in bounds], axis=0)
    slopes = np.zeros(own.size)
    while np.any(active) and np.any(free):
        matrix = gradients[1:][np.ix_(active, free)].T
        slopes[:] = 0.0
        slopes[active] = np.linalg.lstsq(matrix, -gradients[0][free], rcond=None)[0]
        wrong = active & (low != high) & (slopes * signs <= 0.0)
        if not np.any(wrong):
            break
        active &= ~wrong
        slopes[~active] = 0.0
    sizes = np.sum(gradients[1:] ** 2, axis=1)
    found.targets[:] = np.where(at_high, high, np.where(at_low, low, 0.0))
    found.slopes[:] = np.where(active, slopes, 0.0)
    largest = max(1.0, float(np.max(np.abs(gradients[0]), initial=0.0)))
    bent = active & (sizes > 0.0)
    found.bends[bent] = np.where(low == high, _BEND, -_BEND)[bent] * largest / sizes[bent]
    return found


def _is_at(values: Floats, bounds: Floats) -> Bools:
    """Returns which values are next to their bounds, none of which is infinite then."""
    return np.abs(values - bounds) <= _NEAR * np.maximum(1.0, np.abs(values))
