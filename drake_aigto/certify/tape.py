"""Formulas as tapes: one operation after the other."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from pydrake.symbolic import Expression, ExpressionKind

from drake_aigto.arrays import Floats, Ints
from drake_aigto.terms import operands

_MOST_EXPONENT = 1e6  # in size; rounding errors of larger ones would leave nothing of a power

# Id of a variable ↦ its index in the program, or its place in a formula.
Index = Mapping[int, int]


class Operation(IntEnum):
    """Functions of earlier entries a and b of a tape, and of a number p."""

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
    TANH = 15
    ATAN = 16
    X_LOG = 17  # a log a, 0 at 0


# Operation, a, b and p.
Entry = tuple[int, int, int, float]


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


class JointTape(NamedTuple):
    """Formulas that share their entries."""

    tape: Tape  # all of them as one; its first entries are the variables
    roots: Ints  # entries of the formulas (R,)


def make_tape(formulas: Iterable[Sequence[Entry]]) -> Tape:
    """Returns formulas as one tape."""
    lists = list(formulas)
    entries = [entry for each in lists for entry in each]
    columns = list(zip(*entries, strict=True)) or [(), (), (), ()]
    operations, a, b = (np.array(column, dtype=np.int64) for column in columns[:3])
    starts = np.cumsum([0, *map(len, lists)], dtype=np.int64)
    return Tape(operations, a, b, np.array(columns[3], dtype=float), starts)


class NoEnclosureError(Exception):
    """A formula has a function without an enclosure; its message is the function."""


_FUNCTIONS = {
    getattr(ExpressionKind, name): Operation[name.upper()]
    for name in ("Exp", "Log", "Sin", "Cos", "Abs", "Tanh", "Atan", "Max")
}


class Formula:
    """Expressions as entries of a tape, each made once; if nested, powers as Horner has them."""

    def __init__(self, is_nested: bool = True) -> None:
        """Starts empty."""
        self._place: Index = {}
        self._known: dict[Entry, int] = {}
        self._is_nested = is_nested

    def enter(
        self, place_of: Index, e: Expression, factor: float = 1.0, target: float = 0.0
    ) -> int:
        """Returns the place of factor · (e − target), of variables in these places of the formula.

        Raises:
            NoEnclosureError: it has a function without an enclosure.
        """
        self._place = place_of
        place = self._enter(e)
        place = self.put(Operation.SHIFT, place, 0, -target) if target else place
        return self._scaled(place, factor)

    def entries(self, last: int = -1) -> list[Entry]:
        """Returns all entries in their order, a certain one last."""
        found = list(self._known)
        if 0 <= last < len(found) - 1:
            found.append((int(Operation.SHIFT), last, 0, 0.0))
        return found

    def put(self, operation: Operation, a: int = 0, b: int = 0, number: float = 0.0) -> int:
        """Returns the place of an entry, which is new or known."""
        return self._known.setdefault((int(operation), a, b, number), len(self._known))

    def _enter(self, e: Expression) -> int:
        """Enters an expression, and returns the place of its value."""
        kind = e.get_kind()
        if kind == ExpressionKind.Constant:
            return self.put(Operation.NUMBER, number=_number(e))
        if kind == ExpressionKind.Var:
            (variable,) = e.GetVariables()
            return self.put(Operation.VARIABLE, self._place[variable.get_id()])
        if kind == ExpressionKind.IfThenElse:  # Its first argument is a formula of logic.
            raise NoEnclosureError(kind.name)
        parts = operands(e)
        if kind in _FUNCTIONS:
            return self.put(_FUNCTIONS[kind], *map(self._enter, parts))
        if kind == ExpressionKind.Min:
            negative = [self._scaled(self._enter(part), -1.0) for part in parts]
            return self._scaled(self.put(Operation.MAX, *negative), -1.0)
        if kind == ExpressionKind.Add:
            return self._sum(parts)
        if kind == ExpressionKind.Mul:
            number, others = _split_number(parts, 1.0)
            return self._scaled(self._fold(Operation.MULTIPLY, others), number)
        if kind == ExpressionKind.Pow:
            return self._power(*parts)
        if kind == ExpressionKind.Sqrt:
            return self.put(Operation.REAL_POWER, self._enter(parts[0]), number=0.5)
        if kind == ExpressionKind.Tan:
            place = self._enter(parts[0])
            return self._divide(self.put(Operation.SIN, place), self.put(Operation.COS, place))
        if kind == ExpressionKind.Div:
            return self._divide(*map(self._enter, parts))
        raise NoEnclosureError(kind.name)

    def _sum(self, parts: Sequence[Expression]) -> int:
        """Adds summands, numbers last: x − a is one entry; powers of one variable as Horner does.

        Of an interval, a x² + b x + c is wider than (a x + b) x + c, and ∞ − ∞ if that has no end.
        """
        if self._is_nested and (powers := _powers_of_one(parts)):
            return self._nested(*powers)
        number, others = _split_number(parts, 0.0)
        total = self._fold(Operation.ADD, others)
        return self.put(Operation.SHIFT, total, 0, number) if number else total

    def _fold(self, operation: Operation, parts: Sequence[Expression]) -> int:
        """Enters a sum or a product, from left to right."""
        total = self._enter(parts[0])
        for part in parts[1:]:
            total = self._join(operation, total, self._enter(part))
        return total

    def _join(self, operation: Operation, a: int, b: int) -> int:
        """Enters a sum or a product of two; x log x, which has a limit at 0, is one function."""
        x, y = min(a, b), max(a, b)
        if operation == Operation.MULTIPLY and self._known.get((Operation.LOG, x, 0, 0.0)) == y:
            return self.put(Operation.X_LOG, x)
        return self.put(operation, a, b)

    def _nested(self, variable: Expression, coefficients: Mapping[int, float]) -> int:
        """Adds Σ a_p x^p: x^r (… (a_p x^(p−q) + a_q) …)."""
        x, total = self._enter(variable), -1
        exponents = sorted(coefficients, reverse=True)
        for p, q in itertools.pairwise([*exponents, 0]):
            if p > q:
                factor = x if p == q + 1 else self.put(Operation.POWER, x, p - q)
                if total < 0:
                    total = self._scaled(factor, coefficients[p])
                else:
                    total = self.put(Operation.MULTIPLY, factor, total)
            if q in coefficients and q < p:
                total = self.put(Operation.SHIFT, total, 0, coefficients[q])
        return total

    def _scaled(self, place: int, number: float) -> int:
        return self.put(Operation.SCALE, place, 0, number) if number != 1.0 else place

    def _power(self, base: Expression, exponent: Expression) -> int:
        if exponent.get_kind() != ExpressionKind.Constant:
            raise NoEnclosureError("power with an exponent that is no number")
        p = exponent.Evaluate()
        place = self._enter(base)
        if abs(p) > _MOST_EXPONENT:
            raise NoEnclosureError(f"power with the exponent {p:g}")
        if p != int(p):
            return self.put(Operation.REAL_POWER, place, number=p)
        if p >= 0:
            return self.put(Operation.POWER, place, int(p))
        return self.put(Operation.RECIPROCAL, self.put(Operation.POWER, place, int(-p)))

    def _divide(self, above: int, below: int) -> int:
        return self.put(Operation.MULTIPLY, above, self.put(Operation.RECIPROCAL, below))


def _number(e: Expression) -> float:
    value = e.Evaluate()
    if math.isinf(value):
        raise NoEnclosureError(f"the number {value:g}")
    return value


def _split_number(parts: Sequence[Expression], neutral: float) -> tuple[float, list[Expression]]:
    """Returns the number among some parts, of which Drake keeps one, and the others."""
    numbers = [_number(part) for part in parts if part.get_kind() == ExpressionKind.Constant]
    others = [part for part in parts if part.get_kind() != ExpressionKind.Constant]
    return (numbers[0] if numbers else neutral), others


def _powers_of_one(parts: Sequence[Expression]) -> tuple[Expression, dict[int, float]] | None:
    """Returns the variable and the coefficients of Σ a_p x^p; None if it is another sum."""
    found: dict[int, float] = {}
    base: Expression | None = None
    for part in parts:
        is_product = part.get_kind() == ExpressionKind.Mul
        number, factors = _split_number(operands(part) if is_product else [part], 1.0)
        exponent = 0.0
        for x in factors:
            power = operands(x) if x.get_kind() == ExpressionKind.Pow else [x, Expression(1.0)]
            is_number = power[1].get_kind() == ExpressionKind.Constant
            is_other = base is not None and not base.EqualTo(power[0])
            if exponent or is_other or not is_number or power[0].get_kind() != ExpressionKind.Var:
                return None
            base, exponent = power[0], power[1].Evaluate()
        if exponent < 0.0 or exponent != int(exponent) or int(exponent) in found:
            return None
        found[int(exponent)] = number
    return None if base is None else (base, found)
