"""Enclosures of many formulas at once, and the range of a sum of formulas."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.certify.enclosures import GRADIENT, VALUE, Scratch, enclose, make_scratch
from drake_aigto.certify.intervals import UNIT, Interval
from drake_aigto.certify.program import Summand
from drake_aigto.certify.tape import Tape
from drake_aigto.jit import kernel


class Enclosures(NamedTuple):
    """Of C formulas over L variables; the last axis is (low, high).

    Attributes:
        values: shape (C, 2); ∞ where a formula has no value anywhere in its cell.
        gradients: shape (C, L, 2), 0 there.
        hessians: shape (C, L (L + 1)/2, 2), 0 there; row i ≥ column j at i (i + 1)/2 + j.
    """

    values: Floats
    gradients: Floats
    hessians: Floats


def enclose_all(tape: Tape, formulas: Ints, low: Floats, high: Floats, order: int) -> Enclosures:
    """Returns enclosures of formulas, each over a cell of its own.

    Args:
        tape: holds them.
        formulas: their numbers (C,).
        low: lower ends of the cells (C, L).
        high: upper ends.
        order: 0 for values, 1 for gradients too, 2 for Hessians too.
    """
    count, size = low.shape
    found = Enclosures(
        np.full((count, 2), np.inf),
        np.zeros((count, size if order > 0 else 0, 2)),
        np.zeros((count, size * (size + 1) // 2 if order > 1 else 0, 2)),
    )
    scratch = make_scratch(tape, size)
    cells = np.ascontiguousarray(low), np.ascontiguousarray(high)
    _fill(tape, formulas, *cells, order, scratch, found)
    return found


@kernel
def _fill(
    tape: Tape,
    formulas: Ints,
    low: Floats,
    high: Floats,
    order: int,
    scratch: Scratch,
    found: Enclosures,
) -> None:
    values, gradients, hessians = found
    for c in range(formulas.size):
        end = enclose(tape, formulas[c], low[c], high[c], order, scratch)
        if end < 0:
            continue
        for side in range(2):
            values[c, side] = scratch.values[end, side]
            for i in range(gradients.shape[1]):
                gradients[c, i, side] = scratch.gradients[end, i, side]
            for i in range(hessians.shape[1]):
                hessians[c, i, side] = scratch.hessians[end, i, side]


class SumOfFormulas:
    """Σ f_p over the program's variables.

    Args:
        tape: holds them.
        variables: those that each of its first formulas reads, which are summed up.
    """

    def __init__(self, tape: Tape, variables: Sequence[Sequence[int]]) -> None:
        """Says which variables are read."""
        self._tape = tape
        self._read = np.zeros((len(variables), max(1, *map(len, variables), 0)), dtype=np.int64)
        for row, read in zip(self._read, variables, strict=True):
            row[: len(read)] = read

    def range(self, low: Floats, high: Floats) -> Interval:
        """Returns bounds over low ≤ x ≤ high (n,), rounded outward."""
        formulas = np.arange(self._read.shape[0])
        values = enclose_all(self._tape, formulas, low[self._read], high[self._read], VALUE).values
        if np.any(values[:, 0] == np.inf):
            return math.inf, math.inf
        ((least, most),) = sum_outward(values, np.zeros_like(formulas), 1).tolist()
        return least, most


def sum_outward(intervals: Floats, owners: Ints, count: int) -> Floats:
    """Returns the sums (count, 2) of intervals (C, 2) by their owners (C,), rounded outward."""
    # Each addition is off by half a unit of what is no more than the sum of sizes.
    terms = np.bincount(owners, minlength=count)
    found = np.empty((count, 2))
    for side, sign in enumerate((-1.0, 1.0)):
        own = np.ascontiguousarray(intervals[:, side])
        sizes = np.bincount(owners, np.abs(own), count)
        found[:, side] = np.bincount(owners, own, count) + sign * (terms + 2) * UNIT * sizes
    return found


def slopes_at(tape: Tape, x: Floats) -> tuple[Floats, Floats]:
    """Returns values (F,) and gradients (F, n) of all formulas at a point, unrounded."""
    formulas = np.arange(tape.starts.size - 1)
    points = np.tile(x, (formulas.size, 1))
    found = enclose_all(tape, formulas, points, points, GRADIENT)
    gradients = np.mean(found.gradients, axis=-1)
    gradients[~np.isfinite(found.values[:, 0])] = np.nan
    return np.mean(found.values, axis=-1), gradients


def group(summands: Sequence[Summand]) -> dict[tuple[int, ...], list[Summand]]:
    """Returns summands by the variables that they read."""
    found: dict[tuple[int, ...], list[Summand]] = {}
    for each in summands:
        found.setdefault(each.variables, []).append(each)
    return found
