"""A MathematicalProgram as formulas, and formulas as tapes: one operation after the other."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from pydrake.solvers import (
    Binding,
    BoundingBoxConstraint,
    ExpressionConstraint,
    ExpressionCost,
    LinearConstraint,
    LinearCost,
    MathematicalProgram,
    QuadraticConstraint,
    QuadraticCost,
)
from pydrake.symbolic import Expression, ExpressionKind

from drake_aigto.arrays import Floats, Ints
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.terms import (
    CONES,
    NORM_COSTS,
    check_continuous,
    evaluator_kind,
    evaluator_label,
    operands,
    read_bounds,
    shown,
)

# Evaluators that give their formulas back, what they are called, and the remedy for others.
_COSTS = (
    (LinearCost, QuadraticCost, ExpressionCost, *NORM_COSTS),
    "a LinearCost, a QuadraticCost, an ExpressionCost or a norm",
    "Add it as `c = ExpressionCost(expression); prog.AddCost(c, vars=c.vars())`.",
)
_ROWS = (
    (LinearConstraint, QuadraticConstraint, ExpressionConstraint, *CONES),
    "bounds, a cone, or a linear, quadratic or expression constraint",
    "Write it symbolically.",
)

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
    MIN = 15
    TANH = 16
    ATAN = 17


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
    """Formulas that share their entries.

    Attributes:
        tape: all of them as one; its first entries are the variables.
        roots: entries of the formulas (R,).
    """

    tape: Tape
    roots: Ints


@dataclass(frozen=True, eq=False)
class Summand:
    """A summand of the cost.

    Attributes:
        binding: the cost that it came from; of a row, the constraint.
        expression: its formula.
        index: of its variables.
        variables: indices of those that it reads, rising.
    """

    binding: Binding
    expression: Expression
    index: Index
    variables: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class BoundedFormula(Summand):
    """lower ≤ formula ≤ upper."""

    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class PricedRow(Summand):
    """factor · (formula − target) of a row, which is 0 or less where the row holds."""

    factor: float
    target: float


@dataclass(frozen=True, eq=False)
class Formulas:
    """A program as a sum of formulas, rows and bounds.

    Attributes:
        names: of the variables (n,).
        summands: of the cost; those of one binding follow each other.
        rows: all constraints but bounds.
        lower: bounds of x (n,).
        upper: shape (n,).
    """

    names: tuple[str, ...]
    summands: tuple[Summand, ...]
    rows: tuple[BoundedFormula, ...]
    lower: Floats
    upper: Floats

    @property
    def row_bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper bounds of the rows (R,)."""
        low, high = ([getattr(row, side) for row in self.rows] for side in ("lower", "upper"))
        return np.array(low, dtype=float), np.array(high, dtype=float)

    def groups(self) -> dict[tuple[int, ...], list[Summand]]:
        """Returns the summands by the variables that they read."""
        found: dict[tuple[int, ...], list[Summand]] = {}
        for each in self.summands:
            found.setdefault(each.variables, []).append(each)
        return found


def read_formulas(prog: MathematicalProgram) -> Formulas:
    """Returns the formulas of a program.

    Raises:
        UnsupportedTermError: a cost or a row has no formula that Drake gives back, a variable is
            not continuous, or a bound is NaN.
    """
    check_continuous(prog)
    index = {variable.get_id(): i for i, variable in enumerate(prog.decision_variables())}
    lower, upper = read_bounds(prog)
    summands: list[Summand] = []
    rows: list[BoundedFormula] = []
    for binding in prog.GetAllCosts():
        (total,), own = _expressions(binding, index, *_COSTS)
        parts = operands(total) if total.get_kind() == ExpressionKind.Add else [total]
        summands += [Summand(binding, part, own, _read(part, own)) for part in parts]
    for binding in prog.GetAllConstraints():
        evaluator = binding.evaluator()
        bounds = evaluator.lower_bound(), evaluator.upper_bound()
        if isinstance(evaluator, BoundingBoxConstraint):
            continue
        formulas, own = _expressions(binding, index, *_ROWS)
        for formula, low, high in zip(formulas, *(b.tolist() for b in bounds), strict=True):
            rows.append(BoundedFormula(binding, formula, own, _read(formula, own), low, high))
    names = tuple(variable.get_name() for variable in prog.decision_variables())
    of_variables = zip(names, lower.tolist(), upper.tolist(), strict=True)
    of_rows = ((evaluator_label(row.binding), row.lower, row.upper) for row in rows)
    for name, low, high in itertools.chain(of_variables, of_rows):
        if math.isnan(low) or math.isnan(high):
            raise UnsupportedTermError(
                f"{name} can't be bounded",
                got=f"the bounds [{low:g}, {high:g}]",
                expected="numbers",
                remedy="Look for a parameter that was not set.",
            )
    return Formulas(names, tuple(summands), tuple(rows), lower, upper)


def _expressions(
    binding: Binding, index: Index, kinds: tuple[Any, ...], expected: str, remedy: str
) -> tuple[Any, Index]:
    """Returns the formulas of a cost or constraint, and the indices of their variables."""
    evaluator, variables = binding.evaluator(), binding.variables()
    if not isinstance(evaluator, kinds):
        raise UnsupportedTermError(
            f"{evaluator_label(binding)} can't be bounded",
            got=f"a {evaluator_kind(evaluator)}, whose formula Drake does not give back",
            expected=expected,
            remedy=remedy,
        )
    if not isinstance(evaluator, (ExpressionCost, ExpressionConstraint)):
        return evaluator.Eval(variables), index
    own = {
        local.get_id(): index[bound.get_id()]
        for local, bound in zip(evaluator.vars(), variables, strict=True)
    }
    is_cost = isinstance(evaluator, ExpressionCost)
    return [evaluator.expression()] if is_cost else evaluator.expressions(), own


def _read(e: Expression, index: Index) -> tuple[int, ...]:
    return tuple(sorted({index[variable.get_id()] for variable in e.GetVariables()}))


def formula_of(parts: Sequence[Summand], variables: Sequence[int]) -> list[Entry]:
    """Returns the sum of some summands as a formula over some of the program's variables.

    Raises:
        UnsupportedTermError: one has a function without an enclosure, by name.
    """
    formula = Formula()
    formula.add_all(parts, {variable: k for k, variable in enumerate(variables)})
    return formula.finish()


def join(
    sums: Iterable[Sequence[Summand]], num_variables: int, is_nested: bool = True
) -> JointTape:
    """Returns sums of summands as formulas that share their entries.

    Args:
        sums: the formulas.
        num_variables: n.
        is_nested: whether powers of one variable are written as Horner does.

    Raises:
        UnsupportedTermError: as in `formula_of`.
    """
    formula, places = Formula(is_nested), {i: i for i in range(num_variables)}
    for i in range(num_variables):
        formula.put(Operation.VARIABLE, i)
    roots = []
    for parts in sums:
        formula.add_all(parts, places)
        roots.append(formula.pop())
    return JointTape(make_tape([formula.entries]), np.array(roots, dtype=np.int64))


def make_tape(formulas: Iterable[Sequence[Entry]]) -> Tape:
    """Returns formulas as one tape."""
    lists = list(formulas)
    entries = [entry for each in lists for entry in each]
    columns = list(zip(*entries, strict=True)) or [(), (), (), ()]
    operations, a, b = (np.array(column, dtype=np.int64) for column in columns[:3])
    starts = np.cumsum([0, *map(len, lists)], dtype=np.int64)
    return Tape(operations, a, b, np.array(columns[3], dtype=float), starts)


class _NoEnclosureError(Exception):
    """A formula has a function without an enclosure; its message is the function."""


_FUNCTIONS = {
    getattr(ExpressionKind, name): Operation[name.upper()]
    for name in ("Exp", "Log", "Sin", "Cos", "Abs", "Tanh", "Atan", "Max", "Min")
}


class Formula:
    """A sum of expressions as entries of a tape, each made once.

    Args:
        is_nested: whether powers of one variable are written as Horner does.
    """

    def __init__(self, is_nested: bool = True) -> None:
        """Starts empty."""
        self._place: Index = {}
        self._known: dict[Entry, int] = {}
        self._last: int | None = None
        self._is_nested = is_nested

    @property
    def entries(self) -> list[Entry]:
        """All of them, in their order."""
        return list(self._known)

    def add(self, place_of: Index, e: Expression) -> None:
        """Adds an expression to the sum.

        Args:
            place_of: id of a variable ↦ its place among the formula's.
            e: the expression.
        """
        self._place = place_of
        self._add(self._enter(e))

    def _add(self, place: int) -> None:
        self._last = place if self._last is None else self.put(Operation.ADD, self._last, place)

    def add_all(self, parts: Sequence[Summand], places: Index) -> None:
        """Adds summands; index of a variable in the program ↦ its place among the formula's."""
        # Summands of one binding are added again, as powers of one variable are bounded together.
        for _, alike in itertools.groupby(
            parts, lambda part: id(part) if isinstance(part, PricedRow) else id(part.binding)
        ):
            first, *others = alike
            total = sum((part.expression for part in others), first.expression)
            try:
                self._place = {i: places[j] for i, j in first.index.items() if j in places}
                place = self._enter(total)
            except _NoEnclosureError as error:
                raise UnsupportedTermError(
                    f"{evaluator_label(first.binding)} can't be bounded",
                    got=f"{error} in {shown(total)}",
                    expected="sums, products, quotients, powers, roots, exp, log, sin, cos, tan, "
                    "tan⁻¹, tanh, |x|, max and min",
                ) from None
            if isinstance(first, PricedRow):
                place = self.put(Operation.SHIFT, place, 0, -first.target)
                place = self.put(Operation.SCALE, place, 0, first.factor)
            self._add(place)

    def pop(self) -> int:
        """Returns the entry of the sum, 0 if it is empty, and begins a new one."""
        last = self.put(Operation.NUMBER) if self._last is None else self._last
        self._last = None
        return last

    def finish(self) -> list[Entry]:
        """Returns the entries, that of the sum last."""
        last, entries = self.pop(), self.entries
        if last < len(entries) - 1:
            entries.append((int(Operation.SHIFT), last, 0, 0.0))
        return entries

    def put(self, operation: Operation, a: int = 0, b: int = 0, number: float = 0.0) -> int:
        """Returns the place of an entry, which is new or known."""
        return self._known.setdefault((int(operation), a, b, number), len(self._known))

    def _enter(self, e: Expression) -> int:
        """Enters an expression, and returns the place of its value."""
        kind = e.get_kind()
        if kind == ExpressionKind.Constant:
            return self.put(Operation.NUMBER, number=e.Evaluate())
        if kind == ExpressionKind.Var:
            (variable,) = e.GetVariables()
            return self.put(Operation.VARIABLE, self._place[variable.get_id()])
        parts = operands(e)
        if kind in _FUNCTIONS:
            return self.put(_FUNCTIONS[kind], *map(self._enter, parts))
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
        raise _NoEnclosureError(kind.name)

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
            total = self.put(operation, total, self._enter(part))
        return total

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
            raise _NoEnclosureError("power with an exponent that is no number")
        p = exponent.Evaluate()
        place = self._enter(base)
        if abs(p) > _MOST_EXPONENT:
            raise _NoEnclosureError(f"power with the exponent {p:g}")
        if p != int(p):
            return self.put(Operation.REAL_POWER, place, number=p)
        if p >= 0:
            return self.put(Operation.POWER, place, int(p))
        return self.put(Operation.RECIPROCAL, self.put(Operation.POWER, place, int(-p)))

    def _divide(self, above: int, below: int) -> int:
        return self.put(Operation.MULTIPLY, above, self.put(Operation.RECIPROCAL, below))


def _split_number(parts: Sequence[Expression], neutral: float) -> tuple[float, list[Expression]]:
    """Returns the number among some parts, of which Drake keeps one, and the others."""
    numbers = [part.Evaluate() for part in parts if part.get_kind() == ExpressionKind.Constant]
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
