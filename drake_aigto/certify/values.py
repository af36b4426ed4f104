"""Values of sums of formulas, and slopes of rows, at a point or over a box."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.certify.enclosures import GRADIENT, VALUE, Scratch, enclose, make_scratch
from drake_aigto.certify.intervals import Interval, plus
from drake_aigto.certify.program import Summand, formula_of
from drake_aigto.certify.tape import Tape, make_tape
from drake_aigto.jit import kernel


class SumOfFormulas:
    """Σ f_p over the program's variables.

    Args:
        groups: summands by the variables that they read.
    """

    def __init__(self, groups: dict[tuple[int, ...], list[Summand]]) -> None:
        """Makes one tape."""
        self.tape = make_tape(formula_of(parts, read) for read, parts in groups.items())
        self._read = np.array([i for read in groups for i in read], dtype=np.int64)
        self._starts = np.cumsum([0, *map(len, groups)], dtype=np.int64)
        self._most = max(map(len, groups), default=1)
        self._scratch = make_scratch(self.tape, 1)

    def range(self, low: Floats, high: Floats) -> Interval:
        """Returns bounds over low ≤ x ≤ high (n,), rounded outward."""
        least, most = _range(
            self.tape, self._starts, self._read, low, high, max(1, self._most), self._scratch
        )
        return float(least), float(most)


@kernel
def _range(
    tape: Tape, starts: Ints, read: Ints, low: Floats, high: Floats, most: int, scratch: Scratch
) -> Interval:
    a, b = np.zeros(most), np.zeros(most)
    total = 0.0, 0.0
    for formula in range(starts.size - 1):
        for k in range(starts[formula + 1] - starts[formula]):
            i = read[starts[formula] + k]
            a[k], b[k] = low[i], high[i]
        end = enclose(tape, formula, a, b, VALUE, scratch)
        if end < 0:
            return np.inf, np.inf
        total = plus(total[0], total[1], scratch.values[end, 0], scratch.values[end, 1])
    return total


@kernel
def slopes_at(tape: Tape, x: Floats, scratch: Scratch) -> tuple[Floats, Floats]:
    """Returns values (F,) and gradients (F, n) of all formulas at a point, unrounded."""
    count = tape.starts.size - 1
    values, gradients = np.full(count, np.nan), np.full((count, x.size), np.nan)
    for formula in range(count):
        end = enclose(tape, formula, x, x, GRADIENT, scratch)
        if end >= 0:
            values[formula] = 0.5 * (scratch.values[end, 0] + scratch.values[end, 1])
            for i in range(x.size):
                gradients[formula, i] = 0.5 * (
                    scratch.gradients[end, i, 0] + scratch.gradients[end, i, 1]
                )
    return values, gradients


def group(summands: Sequence[Summand]) -> dict[tuple[int, ...], list[Summand]]:
    """Returns summands by the variables that they read."""
    found: dict[tuple[int, ...], list[Summand]] = {}
    for each in summands:
        found.setdefault(each.variables, []).append(each)
    return found
