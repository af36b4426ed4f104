"""A program of polynomials over −1 ≤ y ≤ 1."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.certify.intervals import UNIT
from drake_aigto.certify.polynomials import (
    NotPolynomialError,
    Polynomial,
    PolynomialReader,
    number,
    plus,
    substitute,
    variables_of,
)
from drake_aigto.certify.program import BoundedRow, Formulas, Summand, formula_of

# Of waves at an angle that is given: the C library's are within one unit.
_LIBRARY = 4.0 * UNIT
_TINY = 1e-9


@dataclass(frozen=True, eq=False)
class BoxProgram:
    """Minimize scale · cost(y) with inequalities(y) ≥ 0, equalities(y) = 0 and −1 ≤ y ≤ 1.

    Coefficients are exact. Where x = center + half width · y, every feasible x of the program that
    this was made of has such a y; rows that are no polynomials, or read what has no bounds, are
    left out.

    Attributes:
        cost: its largest coefficient has a size of about 1, and so have those of the rows.
        inequalities: that are 0 or more.
        equalities: that are 0.
        scale: of the cost, a power of two.
        centers: of x, and of the waves of angles (m,).
        half_widths: shape (m,).
        waves: i ↦ which y is that of cos x_i, which that of sin x_i follows.
    """

    cost: Polynomial
    inequalities: tuple[Polynomial, ...]
    equalities: tuple[Polynomial, ...]
    scale: float
    centers: Floats
    half_widths: Floats
    waves: Mapping[int, int]

    def main(self, p: Polynomial) -> Polynomial:
        """Returns p without what tiny intervals add, which are there for what is rounded."""
        return {m: c for m, c in p.items() if all(self.half_widths[i] > _TINY for i in m)}

    def start(self, y: Mapping[int, float], x: Floats) -> Floats:
        """Returns a point x (n,) near y, and as given where y says nothing."""
        values = {i: self.centers[i] + self.half_widths[i] * float(v) for i, v in y.items()}
        start = x.copy()
        for i in range(x.size):
            start[i] = values.get(i, start[i])
        for i, first in self.waves.items():
            if first in values and first + 1 in values and i not in values:
                start[i] = math.atan2(values[first + 1], values[first])
        return start


def box_program(formulas: Formulas) -> BoxProgram:
    """Returns a program of polynomials.

    Raises:
        NotPolynomialError: the cost is none, or reads a variable without bounds.
    """
    reader = PolynomialReader(formulas.lower.size)
    parts = [_read(reader, summand) for summand in formulas.summands]
    cost: Polynomial = {}
    for part in parts:
        cost = plus(cost, part)
    rows = [(row, p) for row in formulas.rows if (p := _read_row(reader, row)) is not None]
    low, high = _ends(formulas, reader.waves)
    for i in sorted(variables_of([cost])):
        if not math.isfinite(high[i] - low[i]):
            raise NotPolynomialError(f"{formulas.names[i]} lacks a bound")
    centers, halves = _centers(low, high)
    moved = {
        i: plus(number(float(centers[i])), {(i,): Fraction(float(halves[i]))})
        for i in np.flatnonzero(np.isfinite(halves)).tolist()
    }
    sides = [
        side for row, p in rows if variables_of([p]) <= moved.keys() for side in _sides(row, p)
    ]
    sides += [(_circle(first), True) for first in reader.waves.values()]
    own, scale = _scaled(substitute(cost, moved))
    scaled = [(_scaled(substitute(p, moved))[0], is_equal) for p, is_equal in sides]
    return BoxProgram(
        cost=own,
        inequalities=tuple(p for p, is_equal in scaled if not is_equal),
        equalities=tuple(p for p, is_equal in scaled if is_equal),
        scale=scale,
        centers=centers,
        half_widths=halves,
        waves=reader.waves,
    )


def _read(reader: PolynomialReader, summand: Summand) -> Polynomial:
    return reader.read(formula_of((summand,), summand.variables), summand.variables)


def _read_row(reader: PolynomialReader, row: BoundedRow) -> Polynomial | None:
    try:
        return _read(reader, row.formula)
    except NotPolynomialError:
        return None


def _sides(row: BoundedRow, p: Polynomial) -> Iterator[tuple[Polynomial, bool]]:
    """Yields what is 0 or more, or 0 where it says so."""
    if row.lower == row.upper:
        yield plus(p, number(row.lower), -1), True
        return
    if math.isfinite(row.lower):
        yield plus(p, number(row.lower), -1), False
    if math.isfinite(row.upper):
        yield plus(number(row.upper), p, -1), False


def _circle(first: int) -> Polynomial:
    one = Fraction(1)
    return {(first, first): one, (first + 1, first + 1): one, (): -one}


def _ends(formulas: Formulas, waves: Mapping[int, int]) -> tuple[Floats, Floats]:
    """Returns bounds of variables and of waves."""
    more = np.ones(2 * len(waves))
    low, high = np.append(formulas.lower, -more), np.append(formulas.upper, more)
    for i, first in waves.items():
        if low[i] == high[i]:
            at = np.array([math.cos(low[i]), math.sin(low[i])])
            low[first : first + 2], high[first : first + 2] = at - _LIBRARY, at + _LIBRARY
    return low, high


def _centers(low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Returns centers, and half widths that reach both ends; ∞ where one is missing."""
    with np.errstate(invalid="ignore"):
        centers = 0.5 * low + 0.5 * high
        halves = np.maximum(high - centers, centers - low) * (1.0 + UNIT)
    halves[~np.isfinite(halves)] = np.inf
    return centers, halves


def _scaled(p: Polynomial) -> tuple[Polynomial, float]:
    """Returns p over a power of two, and that."""
    size = max((abs(float(c)) for m, c in p.items() if m), default=1.0)
    scale = 2.0 ** math.frexp(size)[1]
    return {m: c / Fraction(scale) for m, c in p.items()}, scale
