"""Complementarities 0 ≤ λ ⊥ s ≥ 0 in a program's rows, however written, and λ s ≤ ε instead."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drake_aigto import terms
from drake_aigto.arrays import Bools, Floats
from drake_aigto.local import InteriorPoint, LocalResult, PolynomialNlp
from drake_aigto.solver.program import AigoProgram
from drake_aigto.solver.ranges import sum_range

# A product that may be larger than this part of its variable's largest value is a row like others.
_LARGEST_PART = 1e-2
_ROUNDING = 1e-9

_TIGHTENED, _LAST, _STEPS = 0.01, 1e-5, 100  # how ε falls, its last value, and steps on each
_BARRIER, _PUSH = 1e-4, 1e-6  # from a point of a larger ε

# The terms of a sum without its constant, divided by the first one's coefficient.
_Form = frozenset[tuple[tuple[terms.Factor, ...], float]]


@dataclass(frozen=True, eq=False)
class Complementarity:
    """A row λ s ≤ ε of λ, s ≥ 0, with any signs."""

    row: int  # its number among the program's rows
    variable: int  # λ or −λ, one of y
    # S or −s, the sign such that the product is not below 0; by the slack variable of the row that
    # keeps it above 0, if it has one.
    gap: terms.Sum
    allowed: float  # ε; 0 of a row that says λ s = 0
    # Variable of y that the row itself has as an inequality; −1 if it is an equality.
    slack: int = -1

    @property
    def _own(self) -> terms.Sum:
        """λ over y."""
        return terms.function(self.variable, terms.FunctionKind.POWER)

    @property
    def sides(self) -> tuple[_Form, _Form]:
        """Forms of λ and s, by which those of others are known to be the same."""
        unit = abs(next(iter(self.gap.values())))
        gap = frozenset((parts, round(a / unit, 9)) for parts, a in self.gap.items())
        return _normal_form(self._own)[0], gap

    def product_row(self, total: terms.Sum) -> terms.TermBlock:
        """Returns the row λ s + total = 0."""
        return as_row(terms.add(terms.multiply(self.gap, self._own), total))


def as_row(total: terms.Sum) -> terms.TermBlock:
    """Returns a sum as a row of one copy."""
    own, read = terms.with_own_variables(total)
    return terms.TermBlock("complementarity", own, [read])


def are_shared(found: Sequence[Complementarity]) -> Bools:
    """Returns whether complementarities share a side, λ or s, with others, or within (k,).

    Equations λ s = ε of all of them are too restrictive: for f between −m and m, where v > 0
    implies f = −m and w > 0 implies f = m, three equations v w = w (m − f) = v (m + f) = ε
    determine all three variables; and so does λ (1 − λ) = ε.
    """
    counts = Counter(itertools.chain.from_iterable(each.sides for each in found))
    of_one = [{part.variable for parts in each.gap for part in parts} for each in found]
    return np.array(
        [
            read == {each.variable} or any(counts[side] > 1 for side in each.sides)
            for each, read in zip(found, of_one, strict=True)
        ],
        dtype=bool,
    )


class _Side(NamedTuple):
    """The sum that an inequality keeps at or above 0: sign · (unit · form − bound), by a slack."""

    unit: float  # divisor of its terms in normal form
    bound: float  # of the terms without their constant
    sign: float  # 1 for a lower bound, −1 for an upper one
    constant: float  # of the terms, by which slack and terms differ
    slack: int  # variable that stands for the terms, one of y


def find_complementarities(program: AigoProgram) -> tuple[Complementarity, ...]:
    """Returns the rows that are complementarities.

    Such a row is λ times a sum s, with λ ≥ 0 or ≤ 0 by bounds. That s keeps its sign is known from
    bounds of its variables, or from a row lower ≤ g ≤ upper with s = a (g − lower) or
    a (upper − g). The row says that their product is 0, or is not above a small number.
    """
    return tuple(_ComplementaritySearch(program).run())


class _ComplementaritySearch:
    """One run."""

    def __init__(self, program: AigoProgram) -> None:
        parsed = program.parsed
        self._lower, self._upper = parsed.lower, parsed.upper
        self._slacks = {row: i for i, row in enumerate(program.slack_rows, self._lower.size)}
        self._rows = [
            (terms.from_terms(each.block.terms, copy), each.lower, each.upper)
            for each in parsed.rows
            for copy in each.block.variables.tolist()
        ]
        self._sides: dict[_Form, list[_Side]] = {}
        for number, slack in self._slacks.items():
            total, lower, upper = self._rows[number]
            form, unit = _normal_form(total)
            value = total.get((), 0.0)
            for sign, bound in ((1.0, lower), (-1.0, upper)):
                if math.isfinite(bound):
                    side = _Side(unit, bound - value, sign, value, slack)
                    self._sides.setdefault(form, []).append(side)

    def run(self) -> Iterator[Complementarity]:
        """Yields them in the rows' order."""
        for number, (total, lower, upper) in enumerate(self._rows):
            value = total.get((), 0.0)
            product = {parts: a for parts, a in total.items() if parts and a}
            for variable in sorted({part.variable for parts in product for part in parts}):
                found = self._split(number, product, variable, (lower - value, upper - value))
                if found is not None:
                    yield found
                    break

    def _split(
        self, number: int, product: terms.Sum, variable: int, bounds: tuple[float, float]
    ) -> Complementarity | None:
        """Returns a row as a product of a variable and a sum, if that is a complementarity."""
        low, high = float(self._lower[variable]), float(self._upper[variable])
        sign = 0.0 if low == high else float(low == 0.0) or -float(high == 0.0)
        rest = _divide(product, variable)
        if sign == 0.0 or rest is None:
            return None
        largest = max(abs(low), abs(high))
        most = max(1.0, largest) if math.isfinite(largest) else 1.0
        for direction, distance in self._distances(rest):
            oriented = sign * direction
            allowed = bounds[1] if oriented > 0.0 else -bounds[0]
            if -_ROUNDING <= allowed <= _LARGEST_PART * most:
                gap = {parts: oriented * a for parts, a in distance.items()}
                slack = self._slacks.get(number, -1)
                return Complementarity(number, variable, gap, max(0.0, allowed), slack)
        return None

    def _distances(self, rest: terms.Sum) -> Iterator[tuple[float, terms.Sum]]:
        """Yields the sign that a sum keeps, and the sum by variables that show it."""
        own, read = terms.with_own_variables(rest)
        if not read:
            return
        least, most = sum_range(own, self._lower[read], self._upper[read])
        rounding = _ROUNDING * sum(abs(a) for a in rest.values())
        if least >= -rounding:
            yield 1.0, rest
        elif most <= rounding:
            yield -1.0, rest
        form, unit = _normal_form(rest)
        for side in self._sides.get(form, ()):
            scale = unit / side.unit
            if abs(scale * side.bound + rest.get((), 0.0)) <= rounding:
                # scale · (s − bound) of the slack variable s
                total: terms.Sum = {(terms.Factor(side.slack, terms.FunctionKind.POWER),): scale}
                bound = side.bound + side.constant
                total |= {(): -scale * bound} if bound else {}
                yield math.copysign(1.0, scale) * side.sign, total


def _normal_form(total: terms.Sum) -> tuple[_Form, float]:
    """Returns a sum's terms but the constant, divided by the first one's coefficient, and that."""
    rest = {parts: a for parts, a in total.items() if parts}
    unit = rest[min(rest)] if rest else 1.0
    return frozenset((parts, round(a / unit, 9)) for parts, a in rest.items()), unit


def _divide(product: terms.Sum, variable: int) -> terms.Sum | None:
    """Returns a sum divided by a variable; None where a term has no power of it."""
    found: terms.Sum = {}
    for parts, a in product.items():
        for place, part in enumerate(parts):
            if part.variable == variable and part.kind == terms.FunctionKind.POWER:
                less = () if part.exponent == 1 else (part._replace(exponent=part.exponent - 1),)
                found[(*parts[:place], *less, *parts[place + 1 :])] = a
                break
        else:
            return None
    return found


class TightenedProgram:
    """A program with a variable p for each product λ s, which a bound ε keeps small.

    Scholtes (2001), "Convergence properties of a regularization scheme for mathematical programs
    with complementarity constraints", SIAM J. Optim. 11:918-936: λ s ≤ ε has an inside, however
    many complementarities share a λ or s, where equations λ s = ε may have none in common.
    """

    def __init__(self, nlp: PolynomialNlp, found: Sequence[Complementarity]) -> None:
        """Adds variables.

        Args:
            nlp: costs and all other rows, over y (n,).
            found: the complementarities (k,).
        """
        self._size, count = nlp.num_variables, len(found)
        self._allowed = np.array([each.allowed for each in found])
        rows = [
            each.product_row({(terms.Factor(number, terms.FunctionKind.POWER),): -1.0})
            for number, each in enumerate(found, self._size)
        ]
        self._nlp = PolynomialNlp(
            *(self._size + count, nlp.costs, (*nlp.blocks[len(nlp.costs) :], *rows)),
            np.append(nlp.lower, np.full(count, -np.inf)),
            np.append(nlp.upper, np.full(count, np.inf)),
        )

    def solve(self, local: InteriorPoint, y: Floats, most: Floats | float) -> LocalResult:
        """Returns an optimum from y (n,) for bounds ε (k,) of the products, over (y, p)."""
        upper = self._nlp.upper.copy()
        upper[self._size :] = np.maximum(most, self._allowed)
        nlp = self._nlp.with_bounds(self._nlp.lower, upper)
        start = np.append(y, np.zeros(self._allowed.size))
        start[self._size :] = nlp.evaluate(start)[1][nlp.num_rows - self._allowed.size :]
        return local.solve(nlp, np.clip(start, nlp.lower, nlp.upper))

    def tighten(self, y: Floats, sizes: Floats, first: float, is_warm: bool) -> tuple[Floats, int]:
        """Returns the point that y (n,) leads to as ε decreases, and steps.

        The largest ε is relative to sizes (k,) of products; a warm y is near an optimum.
        """
        steps, relaxation = 0, first
        while True:
            local = InteriorPoint(max_iterations=_STEPS)
            if steps or is_warm:
                local = InteriorPoint.warm(
                    max_iterations=_STEPS, initial_barrier=_BARRIER, bound_push=_PUSH
                )
            found = self.solve(local, y, relaxation * sizes)
            y, steps = found.x[: self._size], steps + found.iterations
            if relaxation <= _LAST:
                return y, steps
            relaxation = max(_LAST, _TIGHTENED * relaxation)
