"""Bounds of functions without rows over cells of few variables, in compiled code."""

from __future__ import annotations

import math

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.certify.contraction import contract
from drake_aigto.certify.enclosures import GRADIENT, HESSIAN, VALUE, enclose, make_scratch
from drake_aigto.certify.expansions import (
    bend_place,
    expansion_bound,
    make_room,
    middle_of,
    set_steps,
)
from drake_aigto.certify.formulas import JointTape, Tape
from drake_aigto.kernels import inner, kernel


@inner
def _press(over: Floats, outer: Floats, low: Floats, high: Floats) -> bool:
    """Makes a cell flat where f rises or falls over all of it, in place.

    Returns whether it holds no minimizer: where f falls towards a face that is not the whole box's,
    what is beyond it is lower, if f has values there: a finite Hessian says so.
    """
    size = low.size
    for i in range(size):
        a, b = over[1 + i]
        bend = over[bend_place(size, i, i)]
        if low[i] == high[i] or not (a > 0.0 or b < 0.0):
            continue
        face = low[i] if a > 0.0 else high[i]
        if not (math.isfinite(bend[1] - bend[0]) and math.isfinite(b - a) and math.isfinite(face)):
            continue
        if face != (outer[0, i] if a > 0.0 else outer[1, i]):
            return True
        low[i] = high[i] = face
    return False


@inner
def _choose_point(low: Floats, high: Floats, best: Floats, point: Floats) -> None:
    """Fills the point of a cell that is nearest to the best known one, if that is near; else c."""
    is_near = True
    for i in range(low.size):
        reach = high[i] - low[i]
        is_near &= low[i] - reach <= best[i] <= high[i] + reach
    for i in range(low.size):
        near = min(max(best[i], low[i]), high[i])
        point[i] = near if is_near else middle_of(low[i], high[i])


@kernel
def bound_cells(
    tape: Tape,
    joint: JointTape,
    outer: Floats,
    low: Floats,
    high: Floats,
    best: Floats,
    least: float,
    bounds: Floats,
) -> float:
    """Raises bounds of f over cells, +∞ of those without a minimizer, and narrows cells in place.

    Args:
        tape: f.
        joint: the same, with entries that are shared.
        outer: the whole box (2, n).
        low: lower ends of the cells (C, n).
        high: upper ends.
        best: the best known point (n,), replaced by better ones.
        least: f there, rounded up.
        bounds: shape (C,).

    Returns:
        The least value that is known, rounded up.
    """
    size, limits = best.size, np.empty((2, 1))
    jets, about, over, steps, matrix, scales = make_room(tape, size)
    ranges, old = make_scratch(joint.tape, size, VALUE), np.empty((2, size))
    point = np.empty(size)
    for c in range(bounds.size):
        limits[0, 0], limits[1, 0] = -np.inf, least
        end = -1
        if contract(joint, limits[0], limits[1], low[c], high[c], ranges, old):
            end = enclose(tape, 0, low[c], high[c], HESSIAN, jets)
        if end < 0:
            bounds[c] = np.inf
            continue
        over[:] = jets[end]
        if _press(over, outer, low[c], high[c]):
            bounds[c] = np.inf
            continue
        bounds[c] = max(bounds[c], over[0, 0])
        _choose_point(low[c], high[c], best, point)
        end = enclose(tape, 0, point, point, GRADIENT, jets)
        if end < 0:
            continue
        about[:] = jets[end]
        if about[0, 1] < least:
            least, best[:] = about[0, 1], point
        set_steps(point, low[c], high[c], steps)
        bounds[c] = max(bounds[c], expansion_bound(about, over, steps, matrix, scales))
    return least
