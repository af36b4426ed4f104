"""A program as polynomials with exact coefficients, over −1 ≤ y ≤ 1.

Waves of angles are variables of their own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.certify.formulas import (
    BoundedFormula,
    Entry,
    Formulas,
    Operation,
    Summand,
    formula_of,
)
from drake_aigto.certify.intervals import LIBRARY, UNIT

# Indices of a product's factors, rising; a square has one twice.
Monomial = tuple[int, ...]
# Σ c_m m as m ↦ c_m.
Polynomial = dict[Monomial, Fraction]

ONE = Fraction(1)
_MOST_TERMS = 10_000
_MOST_TURNS = 8  # as cos(8 x) has 8 factors
_TINY = 1e-9


class NoSquaresError(Exception):
    """A program without a bound by squares of polynomials; its message says why."""


def plus(p: Polynomial, q: Polynomial, factor: int = 1) -> Polynomial:
    """Returns p + factor q."""
    total = dict(p)
    for monomial, c in q.items():
        total[monomial] = total.get(monomial, 0) + factor * c
    return {monomial: c for monomial, c in total.items() if c}


def times(p: Polynomial, q: Polynomial) -> Polynomial:
    """Returns p q.

    Raises:
        NoSquaresError: it has too many terms.
    """
    if len(p) * len(q) > _MOST_TERMS:
        raise NoSquaresError("it has too many terms, multiplied out")
    product: Polynomial = {}
    for a, c in p.items():
        for b, d in q.items():
            monomial = tuple(sorted(a + b))
            product[monomial] = product.get(monomial, 0) + c * d
    return {monomial: c for monomial, c in product.items() if c}


def number(c: float | Fraction) -> Polynomial:
    """Returns a constant."""
    return {(): Fraction(c)} if c else {}


def variables_of(p: Iterable[Monomial]) -> set[int]:
    """Returns the indices of all variables."""
    return {i for monomial in p for i in monomial}


class _PolynomialReader:
    """Reads formulas over n variables; cos x_i and sin x_i become variables n, n + 1, ….

    Args:
        num_variables: n.

    Attributes:
        waves: i ↦ the index of cos x_i, which that of sin x_i follows.
    """

    def __init__(self, num_variables: int) -> None:
        self._num_variables = num_variables
        self.waves: dict[int, int] = {}

    def read(self, summand: Summand) -> Polynomial:
        """Returns a formula's polynomial.

        Raises:
            NoSquaresError: it is not one.
        """
        values: list[Polynomial] = []
        for entry in formula_of((summand,), summand.variables):
            values.append(self._apply(entry, values, summand.variables))
        return values[-1]

    def _apply(
        self, entry: Entry, values: Sequence[Polynomial], variables: Sequence[int]
    ) -> Polynomial:
        operation, a, b, p = Operation(entry[0]), *entry[1:]
        match operation:
            case Operation.NUMBER:
                return number(p)
            case Operation.VARIABLE:
                return {(variables[a],): ONE}
            case Operation.SHIFT:
                return plus(values[a], number(p))
            case Operation.SCALE:
                return times(values[a], number(p))
            case Operation.ADD:
                return plus(values[a], values[b])
            case Operation.MULTIPLY:
                return times(values[a], values[b])
            case Operation.POWER:
                return reduce(times, [values[a]] * b, number(1))
            case Operation.RECIPROCAL if set(values[a]) == {()}:
                return number(1 / values[a][()])
            case Operation.COS:
                return self._wave(values[a])[0]
            case Operation.SIN:
                return self._wave(values[a])[1]
        raise NoSquaresError(f"{operation.name.lower()} is no polynomial")

    def _wave(self, angle: Polynomial) -> tuple[Polynomial, Polynomial]:
        """Returns cos and sin of Σ n_i x_i, by the addition theorem."""
        if any(len(monomial) != 1 or c.denominator != 1 for monomial, c in angle.items()):
            raise NoSquaresError("a wave is of more than whole multiples of variables")
        if sum(abs(c) for c in angle.values()) > _MOST_TURNS:
            raise NoSquaresError(f"a wave is of more than {_MOST_TURNS} variables")
        cosine, sine = number(1), number(0)
        for (i,), turns in angle.items():
            first = self.waves.setdefault(i, self._num_variables + 2 * len(self.waves))
            c: Polynomial = {(first,): ONE}
            s: Polynomial = {(first + 1,): ONE if turns > 0 else -ONE}
            for _ in range(abs(int(turns))):
                cosine, sine = (
                    plus(times(cosine, c), times(sine, s), -1),
                    plus(times(sine, c), times(cosine, s)),
                )
        return cosine, sine


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
        """Returns p without the tiny intervals that enclose rounding errors."""
        return {m: c for m, c in p.items() if all(self.half_widths[i] > _TINY for i in m)}

    def start(self, y: Mapping[int, float], x: Floats) -> Floats:
        """Returns a point x (n,) near y, and as given where y says nothing."""
        values = {i: self.centers[i] + self.half_widths[i] * float(v) for i, v in y.items()}
        start = np.array([values.get(i, own) for i, own in enumerate(x)])
        for i, first in self.waves.items():
            if first in values and first + 1 in values and i not in values:
                start[i] = math.atan2(values[first + 1], values[first])
        return start


def box_program(formulas: Formulas) -> BoxProgram:
    """Returns a program of polynomials.

    Raises:
        NoSquaresError: the cost is none, or reads a variable without bounds.
    """
    reader = _PolynomialReader(formulas.lower.size)
    cost: Polynomial = {}
    for summand in formulas.summands:
        cost = plus(cost, reader.read(summand))
    sides = [side for row in formulas.rows for side in _sides(reader, row)]
    centers, halves = _box(formulas, reader.waves)
    for i in sorted(variables_of(cost)):
        if not math.isfinite(halves[i]):
            raise NoSquaresError(f"{formulas.names[i]} lacks a bound")
    moved = {
        i: plus(number(float(centers[i])), {(i,): Fraction(float(halves[i]))})
        for i in np.flatnonzero(np.isfinite(halves)).tolist()
    }
    sides = [(p, is_equal) for p, is_equal in sides if variables_of(p) <= moved.keys()]
    for first in reader.waves.values():
        sides.append(({(first, first): ONE, (first + 1, first + 1): ONE, (): -ONE}, True))
    own, scale = _scaled(cost, moved)
    scaled = [(_scaled(p, moved)[0], is_equal) for p, is_equal in sides]
    return BoxProgram(
        cost=own,
        inequalities=tuple(p for p, is_equal in scaled if not is_equal),
        equalities=tuple(p for p, is_equal in scaled if is_equal),
        scale=scale,
        centers=centers,
        half_widths=halves,
        waves=reader.waves,
    )


def _sides(reader: _PolynomialReader, row: BoundedFormula) -> Iterator[tuple[Polynomial, bool]]:
    """Yields polynomials of a polynomial row that are ≥ 0, or, if flagged, equal to 0."""
    try:
        p = reader.read(row)
    except NoSquaresError:
        return
    if row.lower == row.upper:
        yield plus(p, number(row.lower), -1), True
        return
    if math.isfinite(row.lower):
        yield plus(p, number(row.lower), -1), False
    if math.isfinite(row.upper):
        yield plus(number(row.upper), p, -1), False


def _box(formulas: Formulas, waves: Mapping[int, int]) -> tuple[Floats, Floats]:
    """Returns centers of variables and of waves, and half widths; ∞ where a bound is missing."""
    more = np.ones(2 * len(waves))
    low, high = np.append(formulas.lower, -more), np.append(formulas.upper, more)
    for i, first in waves.items():
        if low[i] == high[i]:
            at = np.array([math.cos(low[i]), math.sin(low[i])])
            low[first : first + 2], high[first : first + 2] = at - LIBRARY, at + LIBRARY
    with np.errstate(invalid="ignore"):
        centers = 0.5 * low + 0.5 * high
        halves = np.maximum(high - centers, centers - low) * (1.0 + UNIT)
    halves[~np.isfinite(halves)] = np.inf
    return centers, halves


def _scaled(p: Polynomial, moved: Mapping[int, Polynomial]) -> tuple[Polynomial, float]:
    """Returns p with polynomials in place of its variables, over a power of two, and that."""
    total: Polynomial = {}
    for monomial, c in p.items():
        total = plus(total, reduce(times, (moved[i] for i in monomial), number(c)))
    size = max((abs(float(c)) for m, c in total.items() if m), default=1.0)
    scale = 2.0 ** math.frexp(size)[1]
    return {m: c / Fraction(scale) for m, c in total.items()}, scale
