"""Bounds of many cells of small cliques at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.certify.cells import expansion_bound, least_linear
from drake_aigto.certify.enclosures import GRADIENT, HESSIAN, VALUE
from drake_aigto.certify.intervals import UNIT, down, plus, times
from drake_aigto.certify.tape import Tape
from drake_aigto.certify.values import Enclosures, enclose_all, sum_outward
from drake_aigto.jit import kernel

MOST_VARIABLES = 3  # of a clique
_CHUNK = 100_000  # cells whose enclosures are held at once


@dataclass(frozen=True, eq=False)
class Group:
    """Formulas of as many variables, all of them costs or all of them rows.

    Attributes:
        formulas: their numbers (G,).
        variables: those that each reads (G, m).
        rows: lower and upper bounds (2, G) of rows; None of costs.
    """

    formulas: Ints
    variables: Ints
    rows: Floats | None


class Bins(NamedTuple):
    """Bins of all variables, one variable after the other.

    Attributes:
        starts: first bin of each variable (n + 1,).
        low: lower ends (K,).
        high: upper ends (K,).
        points: c (K,).
    """

    starts: Ints
    low: Floats
    high: Floats
    points: Floats

    @property
    def counts(self) -> Ints:
        """How many each variable has (n,)."""
        return np.diff(self.starts)


@dataclass(frozen=True, eq=False)
class Slopes:
    """s of formulas of a group, in the order formula, variable, bin.

    Attributes:
        first: of each formula and variable (G, m).
        bins: whose each is (S,).
        values: s (S,).
    """

    first: Ints
    bins: Ints
    values: Floats


def ranks(counts: Ints) -> tuple[Ints, Ints]:
    """Returns the owner of each of Σ counts things, and which of its own it is."""
    owners = np.repeat(np.arange(counts.size), counts)
    return owners, np.arange(owners.size) - np.repeat(np.cumsum(counts) - counts, counts)


def bins_of(group: Group, bins: Bins) -> tuple[Ints, Ints]:
    """Returns all bins of each variable of each formula: the places in (G, m), and the bins."""
    read = group.variables.ravel()
    owners, own = ranks(bins.counts[read])
    return owners, bins.starts[read][owners] + own


def slopes_of(tape: Tape, group: Group, bins: Bins, points: Floats) -> Slopes:
    """Returns each formula's slope along a variable, at a bin's point and neighbors (S, m)."""
    size = group.variables.shape[1]
    owners, own = bins_of(group, bins)
    at = enclose_all(tape, group.formulas[owners // size], points, points, GRADIENT)
    values = np.mean(at.gradients[np.arange(owners.size), owners % size], axis=-1)
    counts = bins.counts[group.variables.ravel()]
    first = (np.cumsum(counts) - counts).reshape(group.variables.shape)
    return Slopes(first, own, np.where(np.isfinite(values), values, 0.0))


def moved_slopes(found: list[Slopes], count: int) -> Floats:
    """Returns the sums of slopes of each of so many bins, rounded outward (K, 2)."""
    values = np.concatenate([np.empty(0), *(slopes.values for slopes in found)])
    owners = np.concatenate([np.empty(0, dtype=np.int64), *(slopes.bins for slopes in found)])
    return sum_outward(np.column_stack([values, values]), owners, count)


def bound_cells(
    tape: Tape, group: Group, bins: Bins, slopes: Slopes | None, moved: Floats
) -> list[Floats]:
    """Returns bounds over all cells of each formula's bins, an axis for each variable.

    Of costs of several variables, s (x − c) is taken off; of one variable, what others moved to it
    is added. Of rows, it is 0 where one may hold, else ∞.

    Args:
        tape: holds the formulas.
        group: which.
        bins: of all variables.
        slopes: of costs of several variables.
        moved: to those of one variable (K, 2).
    """
    shapes = bins.counts[group.variables]
    sizes = np.prod(shapes, axis=1)
    ends = np.cumsum(sizes)
    cuts = np.searchsorted(ends, np.arange(_CHUNK, ends[-1] + _CHUNK, _CHUNK), side="right")
    found: list[Floats] = []
    for part in np.split(np.arange(sizes.size), np.unique(cuts)):
        if part.size:
            flat = _bound_part(tape, group, part, shapes, bins, slopes, moved)
            tables = np.split(flat, np.cumsum(sizes[part])[:-1])
            found += [table.reshape(shapes[k]) for k, table in zip(part, tables, strict=True)]
    return found


def _bound_part(
    tape: Tape,
    group: Group,
    part: Ints,
    shapes: Ints,
    bins: Bins,
    slopes: Slopes | None,
    moved: Floats,
) -> Floats:
    owners, rest = ranks(np.prod(shapes[part], axis=1))
    owners = part[owners]
    local = np.empty((owners.size, shapes.shape[1]), dtype=np.int64)
    for k in range(shapes.shape[1] - 1, -1, -1):
        rest, local[:, k] = np.divmod(rest, shapes[owners, k])
    cell = bins.starts[group.variables[owners]] + local
    low, high, point = bins.low[cell], bins.high[cell], bins.points[cell]
    formulas, steps = group.formulas[owners], steps_from(point, low, high)
    if group.rows is not None:
        at = enclose_all(tape, formulas, point, point, VALUE)
        over = enclose_all(tape, formulas, low, high, GRADIENT)
        is_out = rows_exclude(at, over, steps, *group.rows[:, owners])
        return np.where(is_out, np.inf, 0.0)
    if slopes is None:
        added = moved[cell]
    else:
        own = -slopes.values[slopes.first[owners] + local]
        added = np.stack([own, own], axis=-1)
    at = enclose_all(tape, formulas, point, point, GRADIENT)
    over = enclose_all(tape, formulas, low, high, HESSIAN)
    return expand_all(at, over, added, steps)


def steps_from(point: Floats, low: Floats, high: Floats) -> Floats:
    """Returns x − c of the cells' ends (C, L, 2), rounded outward, with 0 in between."""
    least, most = np.nextafter(low - point, -np.inf), np.nextafter(high - point, np.inf)
    return np.stack([np.minimum(least, 0.0), np.maximum(most, 0.0)], axis=-1)


def expand_all(at: Enclosures, over: Enclosures, slopes: Floats, steps: Floats) -> Floats:
    """Returns bounds of f + s (x − c) over cells (C,); ∞ where f has no value.

    Args:
        at: of f at the points c, with gradients.
        over: of f over the cells, with Hessians.
        slopes: s (C, L, 2).
        steps: as `steps_from` returns them.
    """
    found = np.empty(len(steps))
    _expand(at, over, np.ascontiguousarray(slopes), steps, found)
    return found


@kernel
def _expand(at: Enclosures, over: Enclosures, slopes: Floats, steps: Floats, found: Floats) -> None:
    size = steps.shape[1]
    work, low, high = np.empty((size, size + 2)), np.empty(size), np.empty(size)
    for c in range(found.size):
        natural = over.values[c, 0]
        found[c] = natural
        if natural == np.inf:
            continue
        for i in range(size):
            a, b = slopes[c, i, 0], slopes[c, i, 1]
            low[i], high[i] = steps[c, i, 0], steps[c, i, 1]
            natural = down(natural + least_linear(a, b, low[i], high[i]))
            for of in (at.gradients, over.gradients):
                of[c, i, 0], of[c, i, 1] = plus(of[c, i, 0], of[c, i, 1], a, b)
        bound = -np.inf
        if np.isfinite(at.values[c, 0]):
            bound, _ = expansion_bound(
                at.values[c, 0],
                at.gradients[c],
                over.gradients[c],
                over.hessians[c],
                low,
                high,
                work,
            )
        found[c] = max(natural, bound)


def rows_exclude(
    at: Enclosures, over: Enclosures, steps: Floats, lower: Floats, upper: Floats
) -> Bools:
    """Returns for each cell whether lower ≤ r ≤ upper holds nowhere in it (C,).

    Args:
        at: of r at a point of the cell.
        over: of r over the cell, with gradients.
        steps: as `steps_from` returns them.
        lower: bounds of r (C,).
        upper: shape (C,).
    """
    found = np.empty(lower.size, dtype=np.bool_)
    _exclude(at, over, steps, np.ascontiguousarray(lower), np.ascontiguousarray(upper), found)
    return found


@kernel
def _exclude(
    at: Enclosures, over: Enclosures, steps: Floats, lower: Floats, upper: Floats, found: Bools
) -> None:
    for c in range(found.size):
        a, b = at.values[c, 0], at.values[c, 1]
        if a == np.inf:
            a = -np.inf
        for i in range(steps.shape[1]):
            step, slope = steps[c, i], over.gradients[c, i]
            a, b = plus(a, b, *times(slope[0], slope[1], step[0], step[1]))
        least, most = over.values[c, 0], over.values[c, 1]
        found[c] = max(a, least) > upper[c] or min(b, most) < lower[c]


def may_hold_minima(
    tape: Tape, groups: Sequence[Group], bins: Bins, lower: Floats, upper: Floats
) -> Bools:
    """Returns for each bin whether Σ f_p may have a minimum in it along the bin's variable (K,).

    Args:
        tape: holds the costs.
        groups: all of them.
        bins: of all variables.
        lower: bounds of x (n,).
        upper: shape (n,).
    """
    slopes, bends, owners = [], [], []
    for group in groups:
        size = group.variables.shape[1]
        places, own = bins_of(group, bins)
        of, local = np.divmod(places, size)
        low = bins.low[bins.starts[:-1]][group.variables[of]]
        high = bins.high[bins.starts[1:] - 1][group.variables[of]]
        rows = np.arange(own.size)
        low[rows, local], high[rows, local] = bins.low[own], bins.high[own]
        over = enclose_all(tape, group.formulas[of], low, high, HESSIAN)
        slopes.append(over.gradients[rows, local])
        bends.append(over.hessians[rows, local * (local + 1) // 2 + local])
        owners.append(own)
    count, whose = bins.low.size, np.concatenate(owners)
    with np.errstate(invalid="ignore"):
        rise = sum_outward(np.concatenate(slopes), whose, count)
        bend = sum_outward(np.concatenate(bends), whose, count)
    variable = np.repeat(np.arange(lower.size), bins.counts)
    at_lower, at_upper = bins.low == lower[variable], bins.high == upper[variable]
    is_bent = (bend[:, 1] < 0.0) & ~at_lower & ~at_upper
    falls, rises = (rise[:, 1] < 0.0) & ~at_upper, (rise[:, 0] > 0.0) & ~at_lower
    return ~(np.all(np.isfinite(rise), axis=1) & (rises | falls | is_bent))


def bound_box(
    tape: Tape, groups: Sequence[Group], low: Floats, high: Floats, point: Floats
) -> float:
    """Returns a bound of Σ f_p over a box, about a point of it: tight if all f is convex there."""
    values, slopes, bends, owners = [], [], [], []
    for group in groups:
        read = group.variables
        at = enclose_all(tape, group.formulas, point[read], point[read], GRADIENT)
        over = enclose_all(tape, group.formulas, low[read], high[read], HESSIAN)
        values.append(at.values)
        slopes.append(at.gradients.reshape(-1, 2))
        bends.append(_curvatures(over.hessians, read.shape[1]).ravel())
        owners.append(read.ravel())
    whose = np.concatenate(owners)
    values_all = np.concatenate(values)
    if not np.all(np.isfinite(values_all)):
        return -np.inf
    ((total, _),) = sum_outward(values_all, np.zeros(len(values_all), dtype=np.int64), 1)
    slope = sum_outward(np.concatenate(slopes), whose, low.size)
    bend = np.concatenate(bends)
    bend = sum_outward(np.column_stack([bend, bend]), whose, low.size)[:, 0]
    # Σ_i min (g_i d + ½ κ_i d²): functions of one variable that are 0 at the point.
    nothing, all_ = np.zeros((low.size, 2)), np.tile([-np.inf, np.inf], (low.size, 1))
    least = expand_all(
        Enclosures(nothing, slope[:, None], np.empty((low.size, 0, 2))),
        Enclosures(all_, all_[:, None], np.stack([bend, bend], axis=-1)[:, None]),
        np.zeros((low.size, 1, 2)),
        steps_from(point, low, high)[:, None],
    )
    whole = np.append(least, total)
    if not np.all(np.isfinite(whole)):
        return -np.inf
    ends = np.column_stack([whole, whole])
    return float(sum_outward(ends, np.zeros(whole.size, dtype=np.int64), 1)[0, 0])


def _curvatures(hessians: Floats, size: int) -> Floats:
    """Returns κ (C, m) with dᵀHd ≥ Σ κ_i d_i² of all H in enclosures, by Gershgorin's circles."""
    found = np.empty((len(hessians), size))
    for i in range(size):
        row = [max(i, j) * (max(i, j) + 1) // 2 + min(i, j) for j in range(size)]
        own, others = hessians[:, row[i], 0], np.delete(hessians[:, row], i, axis=1)
        radii = np.sum(np.maximum(-others[..., 0], others[..., 1]), axis=1)
        found[:, i] = own - radii - 2.0 * size * UNIT * (np.abs(own) + radii)
    return found
