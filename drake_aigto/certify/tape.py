"""Formulas as tapes: one operation after the other, for enclosures of values and derivatives."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from pydrake.symbolic import Expression, ExpressionKind

from drake_aigto.arrays import Floats, Ints
from drake_aigto.terms import operands


class Operation(IntEnum):
    """What an entry of a tape computes of earlier entries a and b, and a number p."""

    NUMBER = 0  # p
    VARIABLE = 1  # x_a
    SHIFT = 2  # a + p
    SCALE = 3  # p a
    ADD = 4  # a + b
    MULTIPLY = 5  # a b
    RECIPROCAL = 6  # 1 / a
    POWER = 7  # a^b of a whole number b
    REAL_POWER = 8  # a^p, a ≥ 0
    EXP = 9
    LOG = 10
    SIN = 11
    COS = 12
    ABS = 13
    MAX = 14
    MIN = 15
    TANH = 16
    ATAN = 17


class Tape(NamedTuple):
    """Formulas, one behind the other.

    Attributes:
        operations: `Operation` of each entry (E,).
        a: its first argument, counted from its formula's first entry (E,).
        b: its second argument, or an exponent (E,).
        numbers: its p (E,).
        starts: first entry of each formula, and E (F + 1,). A formula's value is its last entry.
    """

    operations: Ints
    a: Ints
    b: Ints
    numbers: Floats
    starts: Ints


class NoEnclosureError(Exception):
    """A formula has a function without an enclosure; its message is the function."""


Entry = tuple[int, int, int, float]

_FUNCTIONS = {
    ExpressionKind.Exp: Operation.EXP,
    ExpressionKind.Log: Operation.LOG,
    ExpressionKind.Sin: Operation.SIN,
    ExpressionKind.Cos: Operation.COS,
    ExpressionKind.Abs: Operation.ABS,
    ExpressionKind.Tanh: Operation.TANH,
    ExpressionKind.Atan: Operation.ATAN,
}
_PAIRS = {
    ExpressionKind.Max: Operation.MAX,
    ExpressionKind.Min: Operation.MIN,
}


def make_tape(formulas: Iterable[Sequence[Entry]]) -> Tape:
    """Returns formulas as one tape."""
    lists = list(formulas)
    entries = [entry for each in lists for entry in each]
    columns = list(zip(*entries, strict=True)) or [(), (), (), ()]
    operations, a, b = (np.array(column, dtype=np.int64) for column in columns[:3])
    starts = np.cumsum([0, *map(len, lists)], dtype=np.int64)
    return Tape(operations, a, b, np.array(columns[3], dtype=float), starts)


class Formula:
    """Entries of one formula, each made once."""

    def __init__(self) -> None:
        """Starts empty."""
        self._place: Mapping[int, int] = {}
        self._known: dict[Entry, int] = {}
        self._last: int | None = None

    def join(self, e: Expression, place_of: Mapping[int, int]) -> None:
        """Adds an expression to the sum.

        Args:
            e: the expression.
            place_of: id of a variable ↦ its place among the formula's.

        Raises:
            NoEnclosureError: it has a function without an enclosure.
        """
        self._place = place_of
        place = self._enter(e)
        self._last = place if self._last is None else self._add(Operation.ADD, self._last, place)

    def finish(self) -> list[Entry]:
        """Returns the entries, that of the sum last."""
        last = self._add(Operation.NUMBER) if self._last is None else self._last
        entries = list(self._known)
        if last < len(entries) - 1:
            entries.append((int(Operation.SHIFT), last, 0, 0.0))
        return entries

    def _add(self, operation: Operation, a: int = 0, b: int = 0, number: float = 0.0) -> int:
        return self._known.setdefault((int(operation), a, b, number), len(self._known))

    def _enter(self, e: Expression) -> int:
        """Enters an expression, and returns the place of its value."""
        kind = e.get_kind()
        if kind == ExpressionKind.Constant:
            return self._add(Operation.NUMBER, number=e.Evaluate())
        if kind == ExpressionKind.Var:
            (variable,) = e.GetVariables()
            return self._add(Operation.VARIABLE, self._place[variable.get_id()])
        parts = operands(e)
        if kind in _FUNCTIONS:
            return self._add(_FUNCTIONS[kind], self._enter(parts[0]))
        if kind in _PAIRS:
            return self._add(_PAIRS[kind], self._enter(parts[0]), self._enter(parts[1]))
        if kind not in _RULES:
            raise NoEnclosureError(kind.name)
        return _RULES[kind](self, parts)

    def _sum(self, parts: Sequence[Expression]) -> int:
        """Adds summands, numbers last: x − a is one entry; powers of one variable as Horner does.

        Of an interval, a x² + b x + c is wider than (a x + b) x + c, and ∞ − ∞ if that has no end.
        """
        powers = _powers_of_one(parts)
        if powers is not None:
            return self._nested(*powers)
        number, others = _split_number(parts, 0.0, float.__add__)
        total = self._enter(others[0])
        for part in others[1:]:
            total = self._add(Operation.ADD, total, self._enter(part))
        return self._add(Operation.SHIFT, total, 0, number) if number else total

    def _nested(self, variable: Expression, coefficients: Mapping[int, float]) -> int:
        """Adds Σ a_p x^p: x^r (… (a_p x^(p−q) + a_q) …)."""
        x = self._enter(variable)
        exponents = sorted(coefficients, reverse=True)
        total = self._scaled(self._add(Operation.NUMBER, number=1.0), coefficients[exponents[0]])
        for p, q in itertools.pairwise([*exponents, 0]):
            if p > q:
                factor = x if p == q + 1 else self._add(Operation.POWER, x, p - q)
                total = self._add(Operation.MULTIPLY, factor, total)
            if q in coefficients and q < p:
                total = self._add(Operation.SHIFT, total, 0, coefficients[q])
        return total

    def _product(self, parts: Sequence[Expression]) -> int:
        number, others = _split_number(parts, 1.0, float.__mul__)
        total = self._enter(others[0])
        for part in others[1:]:
            total = self._add(Operation.MULTIPLY, total, self._enter(part))
        return self._scaled(total, number)

    def _scaled(self, place: int, number: float) -> int:
        return self._add(Operation.SCALE, place, 0, number) if number != 1.0 else place

    def _power(self, parts: Sequence[Expression]) -> int:
        base, exponent = parts
        if exponent.get_kind() != ExpressionKind.Constant:
            raise NoEnclosureError("power with an exponent that is no number")
        p = exponent.Evaluate()
        place = self._enter(base)
        if p != int(p):
            return self._add(Operation.REAL_POWER, place, number=p)
        if p >= 0:
            return self._add(Operation.POWER, place, int(p))
        return self._add(Operation.RECIPROCAL, self._add(Operation.POWER, place, int(-p)))

    def _root(self, parts: Sequence[Expression]) -> int:
        return self._add(Operation.REAL_POWER, self._enter(parts[0]), number=0.5)

    def _tangent(self, parts: Sequence[Expression]) -> int:
        place = self._enter(parts[0])
        above, below = self._add(Operation.SIN, place), self._add(Operation.COS, place)
        return self._divide(above, below)

    def _quotient(self, parts: Sequence[Expression]) -> int:
        return self._divide(*map(self._enter, parts))

    def _divide(self, above: int, below: int) -> int:
        return self._add(Operation.MULTIPLY, above, self._add(Operation.RECIPROCAL, below))


_RULES: Mapping[ExpressionKind, Callable[[Formula, Sequence[Expression]], int]] = {
    ExpressionKind.Add: Formula._sum,
    ExpressionKind.Mul: Formula._product,
    ExpressionKind.Pow: Formula._power,
    ExpressionKind.Sqrt: Formula._root,
    ExpressionKind.Tan: Formula._tangent,
    ExpressionKind.Div: Formula._quotient,
}


def _split_number(
    parts: Sequence[Expression], neutral: float, join: Callable[[float, float], float]
) -> tuple[float, list[Expression]]:
    """Returns the numbers among some parts as one, and the others.

    Drake keeps one number in a sum or a product, so nothing is rounded here.
    """
    number, others = neutral, []
    for part in parts:
        if part.get_kind() == ExpressionKind.Constant:
            number = join(number, part.Evaluate())
        else:
            others.append(part)
    return number, others


def _powers_of_one(parts: Sequence[Expression]) -> tuple[Expression, dict[int, float]] | None:
    """Returns the variable and the coefficients of Σ a_p x^p; None if it is another sum."""
    found: dict[int, float] = {}
    base: Expression | None = None
    for part in parts:
        kind = part.get_kind()
        number, factors = 1.0, [part]
        if kind == ExpressionKind.Constant:
            number, factors = part.Evaluate(), []
        elif kind == ExpressionKind.Mul:
            number, factors = _split_number(operands(part), 1.0, float.__mul__)
        exponent = 0
        for factor in factors:
            x, p = factor, 1
            if factor.get_kind() == ExpressionKind.Pow:
                x, power = operands(factor)
                p = int(power.Evaluate()) if power.get_kind() == ExpressionKind.Constant else -1
                if p < 0 or p != power.Evaluate():
                    return None
            if x.get_kind() != ExpressionKind.Var or exponent:
                return None
            if base is not None and not base.EqualTo(x):
                return None
            base, exponent = x, p
        if exponent in found:
            return None
        found[exponent] = number
    return None if base is None else (base, found)
