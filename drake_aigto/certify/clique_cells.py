"""Bounds of many cells of small cliques at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.certify.enclosures import GRADIENT, HESSIAN, VALUE, enclose_all, sum_outward
from drake_aigto.certify.expansions import expand_all, rows_exclude, steps_from
from drake_aigto.certify.formulas import Tape
from drake_aigto.certify.intervals import UNIT

MOST_VARIABLES = 3  # of a clique
_CHUNK = 100_000  # cells whose enclosures are held at once


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
        """Number of bins of each variable (n,)."""
        return np.diff(self.starts)


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

    def bins(self, bins: Bins) -> tuple[Ints, Ints, Ints]:
        """Returns all S bins of each variable of each formula, in the order formula, variable, bin.

        Their formulas, which of the formula's variables each is of, and the bins, all (S,).
        """
        read = self.variables.ravel()
        owners, own = _ranks(bins.counts[read])
        return *np.divmod(owners, self.variables.shape[1]), bins.starts[read][owners] + own


def _ranks(counts: Ints) -> tuple[Ints, Ints]:
    """Returns the owner of each of Σ counts things, and which of its own it is."""
    owners = np.repeat(np.arange(counts.size), counts)
    return owners, np.arange(owners.size) - np.repeat(np.cumsum(counts) - counts, counts)


def slopes_of(tape: Tape, group: Group, bins: Bins, points: Floats) -> Floats:
    """Returns s: a formula's slope along a variable, at each of `Group.bins` and neighbors (S, m).

    0 where it has none.
    """
    of, local, _ = group.bins(bins)
    found = enclose_all(tape, group.formulas[of], points, points, GRADIENT)
    slopes = np.mean(found[np.arange(of.size), 1 + local], axis=-1)
    return np.where(np.isfinite(slopes), slopes, 0.0)


def moved_slopes(slopes: dict[Group, Floats], bins: Bins) -> Floats:
    """Returns the sums of the slopes of each bin, rounded outward (K, 2)."""
    values = np.concatenate([np.empty(0), *slopes.values()])
    none = np.empty(0, dtype=np.int64)
    owners = np.concatenate([none, *(group.bins(bins)[-1] for group in slopes)])
    return sum_outward(np.column_stack([values, values]), owners, bins.low.size)


def bound_cells(
    tape: Tape, group: Group, bins: Bins, slopes: Floats | None, moved: Floats
) -> Iterator[Floats]:
    """Yields bounds over all cells of each formula's bins, an axis for each variable.

    Of costs of several variables, s (x − c) is taken off; of one variable, what others moved to it
    is added. Of rows, it is 0 where one may hold, else ∞.

    Args:
        tape: holds the formulas.
        group: their group.
        bins: of all variables.
        slopes: of costs of several variables (S,).
        moved: to those of one variable (K, 2).
    """
    shapes = bins.counts[group.variables]
    sizes = np.prod(shapes, axis=1)
    chunks = np.cumsum(sizes) // _CHUNK
    for part in np.split(np.arange(sizes.size), np.flatnonzero(np.diff(chunks)) + 1):
        owners, rest = _ranks(sizes[part])
        owners = part[owners]
        local = np.empty((owners.size, shapes.shape[1]), dtype=np.int64)
        for k in range(shapes.shape[1] - 1, -1, -1):
            rest, local[:, k] = np.divmod(rest, shapes[owners, k])
        cells = bins.starts[group.variables[owners]] + local
        low, high, point = bins.low[cells], bins.high[cells], bins.points[cells]
        formulas, steps = group.formulas[owners], steps_from(point, low, high)
        if group.rows is not None:
            about = enclose_all(tape, formulas, point, point, VALUE)
            over = enclose_all(tape, formulas, low, high, GRADIENT)
            rows = np.ascontiguousarray(group.rows[:, owners])
            flat = np.where(rows_exclude(about, over, steps, *rows), np.inf, 0.0)
        else:
            added = moved[cells]
            if slopes is not None:
                first = (np.cumsum(shapes) - shapes.ravel()).reshape(shapes.shape)
                own = -slopes[first[owners] + local]
                added = np.stack([own, own], axis=-1)
            about = enclose_all(tape, formulas, point, point, GRADIENT)
            over = enclose_all(tape, formulas, low, high, HESSIAN)
            flat = expand_all(about, over, added, steps)
        for k, table in zip(part, np.split(flat, np.cumsum(sizes[part])[:-1]), strict=True):
            yield table.reshape(shapes[k])


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
        of, local, own = group.bins(bins)
        low = bins.low[bins.starts[:-1]][group.variables[of]]
        high = bins.high[bins.starts[1:] - 1][group.variables[of]]
        rows = np.arange(own.size)
        low[rows, local], high[rows, local] = bins.low[own], bins.high[own]
        over = enclose_all(tape, group.formulas[of], low, high, HESSIAN)
        slopes.append(over[rows, 1 + local])
        bends.append(over[rows, 1 + low.shape[1] + local * (local + 1) // 2 + local])
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
        about = enclose_all(tape, group.formulas, point[read], point[read], GRADIENT)
        over = enclose_all(tape, group.formulas, low[read], high[read], HESSIAN)
        values.append(about[:, 0])
        slopes.append(about[:, 1:].reshape(-1, 2))
        bends.append(_curvatures(over[:, 1 + read.shape[1] :], read.shape[1]).ravel())
        owners.append(read.ravel())
    values_all, whose, size = np.concatenate(values), np.concatenate(owners), low.size
    if not np.all(np.isfinite(values_all)):
        return -np.inf
    total = sum_outward(values_all, np.zeros(len(values_all), dtype=np.int64), 1)[0, 0]
    slope = sum_outward(np.concatenate(slopes), whose, size)
    bend = np.concatenate(bends)
    bend = sum_outward(np.column_stack([bend, bend]), whose, size)[:, 0]
    # Σ_i min (g_i d + ½ κ_i d²): functions of one variable that are 0 at the point.
    anything = np.tile([-np.inf, np.inf], (size, 2, 1))
    least = expand_all(
        np.stack([np.zeros((size, 2)), slope], axis=1),
        np.concatenate([anything, np.stack([bend, bend], axis=-1)[:, None]], axis=1),
        np.zeros((size, 1, 2)),
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
