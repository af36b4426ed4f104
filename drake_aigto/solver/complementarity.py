"""Complementarities 0 ≤ λ ⊥ s ≥ 0 in a program's rows, however they are written."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools
from drake_aigto.solver.program import AigoProgram
from drake_aigto.solver.ranges import sum_range
from drake_aigto.terms import FunctionKind, Part, Sum, from_terms, with_own_variables

# A product that may be larger than this part of its variable's largest value is a row like others.
_LARGEST_PART = 1e-2
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Complementarity:
    """A row that says λ s ≤ ε of λ, s ≥ 0, in whatever signs.

    Attributes:
        row: its number among the program's rows.
        variable: λ or −λ, one of y.
        gap: s or −s, the sign such that the product is not below 0; by the variable of the row that
            keeps it above 0, if it has one.
        allowed: ε; 0 of a row that says λ s = 0.
        slack: variable of y that the row itself has as an inequality; −1 if it is an equality.
    """

    row: int
    variable: int
    gap: Sum
    allowed: float
    slack: int = -1

    @property
    def product(self) -> Sum:
        """λ s over y."""
        return {_times(parts, self.variable): a for parts, a in self.gap.items()}


def are_shared(found: Sequence[Complementarity]) -> Bools:
    """Returns which complementarities have a side, λ or s, that others have too, or both are (k,).

    Equations λ s = ε of all of them leave less than they should: of f between −m and m, of which
    v > 0 lets only −m and w > 0 only m, three equations v w = w (m − f) = v (m + f) = ε determine
    all three variables; and so does λ (1 − λ) = ε.
    """
    counts: dict[_Form, int] = {}
    sides = [_sides(each) for each in found]
    for side in itertools.chain.from_iterable(sides):
        counts[side] = counts.get(side, 0) + 1
    of_one = [{part.variable for parts in each.gap for part in parts} for each in found]
    return np.array(
        [
            read == {each.variable} or any(counts[side] > 1 for side in own)
            for each, own, read in zip(found, sides, of_one, strict=True)
        ],
        dtype=bool,
    )


def _sides(each: Complementarity) -> tuple[_Form, _Form]:
    """Returns what tells the sides of a complementarity from those of others."""
    own: Sum = {(Part(each.variable, FunctionKind.POWER),): 1.0}
    unit = abs(next(iter(each.gap.values())))
    gap = frozenset((parts, round(a / unit, 9)) for parts, a in each.gap.items())
    return _normal_form(own)[0], gap


class _Side(NamedTuple):
    """What an inequality keeps at or above 0: sign · (unit · form − bound), by a slack variable.

    Attributes:
        unit: what the normal form of its terms was divided by.
        bound: of the terms without their constant.
        sign: 1 for a lower bound, −1 for an upper one.
        constant: of the terms, by which slack and terms differ.
        slack: variable that stands for the terms, one of y.
    """

    unit: float
    bound: float
    sign: float
    constant: float
    slack: int


# The terms of a sum without its constant, divided by the first one's coefficient.
_Form = frozenset[tuple[tuple[Part, ...], float]]


def find_complementarities(program: AigoProgram) -> tuple[Complementarity, ...]:
    """Returns the rows that are complementarities.

    Such a row is λ times a sum s, with λ ≥ 0 or ≤ 0 by bounds. That s keeps its sign is known from
    bounds of its variables, or from a row lower ≤ g ≤ upper with s = a (g − lower) or
    a (upper − g). The row says that their product is 0, or is not above a small number.
    """
    return tuple(_Search(program).run())


class _Search:
    """One run."""

    def __init__(self, program: AigoProgram) -> None:
        question = program.reduced.question
        self._lower, self._upper = question.lower, question.upper
        first = question.lower.size
        self._slacks = {slack.row: first + i for i, slack in enumerate(program.slacks)}
        self._rows = [
            (from_terms(each.row.terms, copy), each.row.lower, each.row.upper)
            for each in question.rows
            for copy in each.block.variables.tolist()
        ]
        self._sides: dict[_Form, list[_Side]] = {}
        for number, slack in self._slacks.items():
            self._add_sides(slack, *self._rows[number])

    def _add_sides(self, slack: int, total: Sum, lower: float, upper: float) -> None:
        form, unit = _normal_form(total)
        for sign, bound in ((1.0, lower), (-1.0, upper)):
            if math.isfinite(bound):
                value = total.get((), 0.0)
                side = _Side(unit, bound - value, sign, value, slack)
                self._sides.setdefault(form, []).append(side)

    def run(self) -> Iterator[Complementarity]:
        """Yields them in the rows' order."""
        for number, (total, lower, upper) in enumerate(self._rows):
            value = total.get((), 0.0)
            product = {parts: a for parts, a in total.items() if parts and a}
            bounds = lower - value, upper - value
            for variable in sorted({part.variable for parts in product for part in parts}):
                found = self._split(number, product, variable, *bounds)
                if found is not None:
                    yield found
                    break

    def _split(
        self, number: int, product: Sum, variable: int, lower: float, upper: float
    ) -> Complementarity | None:
        """Returns a row as a product of a variable and a sum, if that is a complementarity."""
        sign = self._sign(variable)
        rest = _divide(product, variable)
        if sign == 0.0 or rest is None:
            return None
        for direction, distance in self._distances(rest):
            oriented = sign * direction
            allowed = upper if oriented > 0.0 else -lower
            if not (-_ROUNDING <= allowed <= _LARGEST_PART * self._most(variable)):
                continue
            gap = {parts: oriented * a for parts, a in distance.items()}
            slack = self._slacks.get(number, -1)
            return Complementarity(number, variable, gap, max(0.0, allowed), slack)
        return None

    def _most(self, variable: int) -> float:
        """Returns the largest size of a variable, at least 1; 1 if it has no bound."""
        most = float(max(abs(self._lower[variable]), abs(self._upper[variable])))
        return max(1.0, most) if math.isfinite(most) else 1.0

    def _sign(self, variable: int) -> float:
        """Returns which sign a variable has, 0 if it may have both, or is not 0 at its bound."""
        if self._lower[variable] == self._upper[variable]:
            return 0.0
        return float(self._lower[variable] == 0.0) or -float(self._upper[variable] == 0.0)

    def _distances(self, rest: Sum) -> Iterator[tuple[float, Sum]]:
        """Yields the sign that a sum keeps, and the sum by variables that tell it."""
        terms, read = with_own_variables(rest)
        if not read:
            return
        least, most = sum_range(terms, self._lower[read], self._upper[read])
        rounding = _ROUNDING * sum(abs(a) for a in rest.values())
        if least >= -rounding:
            yield 1.0, rest
        elif most <= rounding:
            yield -1.0, rest
        form, unit = _normal_form(rest)
        for side in self._sides.get(form, ()):
            scale = unit / side.unit
            at_bound = scale * side.bound + rest.get((), 0.0)
            if abs(at_bound) <= rounding:
                yield math.copysign(1.0, scale) * side.sign, _affine(scale, side)


def _affine(scale: float, side: _Side) -> Sum:
    """Returns scale · (s − bound) of a slack variable s."""
    total: Sum = {(Part(side.slack, FunctionKind.POWER),): scale}
    bound = side.bound + side.constant
    return total | {(): -scale * bound} if bound else total


def _normal_form(total: Sum) -> tuple[_Form, float]:
    """Returns a sum's terms but the constant, divided by the first one's coefficient, and that."""
    rest = {parts: a for parts, a in total.items() if parts}
    unit = rest[min(rest)] if rest else 1.0
    return frozenset((parts, round(a / unit, 9)) for parts, a in rest.items()), unit


def _divide(product: Sum, variable: int) -> Sum | None:
    """Returns a sum divided by a variable; None where a term has no power of it."""
    found: Sum = {}
    for parts, a in product.items():
        for place, part in enumerate(parts):
            if part.variable == variable and part.kind == FunctionKind.POWER:
                less = () if part.exponent == 1 else (part._replace(exponent=part.exponent - 1),)
                found[(*parts[:place], *less, *parts[place + 1 :])] = a
                break
        else:
            return None
    return found


def _times(parts: tuple[Part, ...], variable: int) -> tuple[Part, ...]:
    """Returns a product of powers and functions times a variable."""
    powers = {part.variable: part for part in parts}
    own = powers.get(variable)
    powers[variable] = (
        Part(variable, FunctionKind.POWER)
        if own is None
        else own._replace(exponent=own.exponent + 1)
    )
    return tuple(powers[each] for each in sorted(powers))
