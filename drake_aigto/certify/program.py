"""A MathematicalProgram as formulas: costs by the variables they read, rows, and bounds."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

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

from drake_aigto.arrays import Floats
from drake_aigto.certify.tape import Entry, Formula, NoEnclosureError
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.terms import CONES, NORM_COSTS, evaluator_kind, evaluator_label, operands, shown

_COSTS = (LinearCost, QuadraticCost, ExpressionCost, *NORM_COSTS)
_ROWS = (LinearConstraint, QuadraticConstraint, ExpressionConstraint, *CONES)

# Id of a variable ↦ its index in the program.
Index = Mapping[int, int]


@dataclass(frozen=True, eq=False)
class Summand:
    """A summand of the cost, or a row.

    Attributes:
        binding: what it came from.
        origin: its number.
        expression: its formula.
        index: of its variables.
        variables: indices of those that it reads, rising.
    """

    binding: Binding
    origin: int
    expression: Expression
    index: Index
    variables: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class BoundedRow:
    """lower ≤ formula ≤ upper."""

    formula: Summand
    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class Formulas:
    """A program as a sum of formulas, rows and bounds.

    Attributes:
        names: of the variables (n,).
        summands: of the cost, no two of which are sums of the same variables.
        rows: all constraints but bounds.
        lower: bounds of x (n,).
        upper: shape (n,).
    """

    names: tuple[str, ...]
    summands: tuple[Summand, ...]
    rows: tuple[BoundedRow, ...]
    lower: Floats
    upper: Floats


def read_formulas(prog: MathematicalProgram) -> Formulas:
    """Returns the formulas of a program.

    Raises:
        UnsupportedTermError: a cost or a row has no formula that Drake gives back.
    """
    reader = _Reader(prog)
    summands = [each for cost in prog.GetAllCosts() for each in reader.summands(cost)]
    lower, upper = np.full(prog.num_vars(), -np.inf), np.full(prog.num_vars(), np.inf)
    rows: list[BoundedRow] = []
    for binding in prog.GetAllConstraints():
        evaluator = binding.evaluator()
        if isinstance(evaluator, BoundingBoxConstraint):
            places = reader.places(binding)
            np.maximum.at(lower, places, evaluator.lower_bound())
            np.minimum.at(upper, places, evaluator.upper_bound())
        else:
            rows += reader.rows(binding)
    for row in rows:
        _bound_by(row, lower, upper)
    names = tuple(variable.get_name() for variable in prog.decision_variables())
    return Formulas(names, tuple(summands), tuple(rows), lower, upper)


class _Reader:
    """Turns bindings into expressions."""

    def __init__(self, prog: MathematicalProgram) -> None:
        self._prog = prog
        variables = prog.decision_variables()
        self._index = {variable.get_id(): i for i, variable in enumerate(variables)}
        self._num_read = 0

    def places(self, binding: Binding) -> list[int]:
        return [self._index[variable.get_id()] for variable in binding.variables()]

    def summands(self, binding: Binding) -> Iterator[Summand]:
        evaluator = binding.evaluator()
        self._num_read += 1
        if not isinstance(evaluator, _COSTS):
            raise _refusal(
                binding,
                "a LinearCost, a QuadraticCost, an ExpressionCost or a norm",
                "Add it as `c = ExpressionCost(expression); prog.AddCost(c, vars=c.vars())`.",
            )
        if isinstance(evaluator, ExpressionCost):
            index = self._own_index(evaluator, binding)
            for part in _parts(evaluator.expression()):
                yield self._summand(binding, part, index)
            return
        (total,) = evaluator.Eval(binding.variables())
        for part in _parts(total):
            yield self._summand(binding, part, self._index)

    def rows(self, binding: Binding) -> Iterator[BoundedRow]:
        evaluator = binding.evaluator()
        self._num_read += 1
        if not isinstance(evaluator, _ROWS):
            raise _refusal(
                binding,
                "bounds, a cone, or a linear, quadratic or expression constraint",
                "Write it symbolically.",
            )
        if isinstance(evaluator, ExpressionConstraint):
            index, formulas = self._own_index(evaluator, binding), evaluator.expressions()
        else:
            index, formulas = self._index, evaluator.Eval(binding.variables())
        bounds = evaluator.lower_bound().tolist(), evaluator.upper_bound().tolist()
        for formula, low, high in zip(formulas, *bounds, strict=True):
            yield BoundedRow(self._summand(binding, formula, index), low, high)

    def _own_index(self, evaluator: ExpressionCost | ExpressionConstraint, of: Binding) -> Index:
        """Returns what an evaluator's own variables are bound to."""
        own = [variable.get_id() for variable in evaluator.vars()]
        return dict(zip(own, self.places(of), strict=True))

    def _summand(self, binding: Binding, e: Expression, index: Index) -> Summand:
        read = {index[variable.get_id()] for variable in e.GetVariables()}
        return Summand(binding, self._num_read, e, index, tuple(sorted(read)))


def _parts(e: Expression) -> Iterable[Expression]:
    return operands(e) if e.get_kind() == ExpressionKind.Add else [e]


def _refusal(binding: Binding, expected: str, remedy: str) -> UnsupportedTermError:
    return UnsupportedTermError(
        f"{evaluator_label(binding)} can't be bounded",
        got=f"a {evaluator_kind(binding.evaluator())}, whose formula Drake does not give back",
        expected=expected,
        remedy=remedy,
    )


def _bound_by(row: BoundedRow, lower: Floats, upper: Floats) -> None:
    """Bounds a variable by a row a x ≤ b, rounded outward."""
    e = row.formula.expression
    if len(row.formula.variables) != 1 or not e.is_polynomial():
        return
    (i,) = row.formula.variables
    (variable,) = e.GetVariables()
    slope = e.Differentiate(variable)
    if slope.get_kind() != ExpressionKind.Constant or e.Evaluate({variable: 0.0}) != 0.0:
        return
    a = slope.Evaluate()
    low, high = sorted((row.lower / a, row.upper / a))
    lower[i] = max(lower[i], math.nextafter(low, -math.inf))
    upper[i] = min(upper[i], math.nextafter(high, math.inf))


def formula_of(parts: Sequence[Summand], variables: Sequence[int]) -> list[Entry]:
    """Returns the sum of some summands as a formula over some of the program's variables.

    Raises:
        UnsupportedTermError: one has a function without an enclosure, by name.
    """
    place = {variable: k for k, variable in enumerate(variables)}
    formula = Formula()
    # What one sum had is put together again, as powers of one variable are bounded together.
    for _, alike in itertools.groupby(parts, lambda part: part.origin):
        first, *others = alike
        total = sum((part.expression for part in others), first.expression)
        try:
            local = {i: place[j] for i, j in first.index.items() if j in place}
            formula.join(total, local)
        except NoEnclosureError as error:
            raise UnsupportedTermError(
                f"{evaluator_label(first.binding)} can't be bounded",
                got=f"{error} in {shown(total)}",
                expected="sums, products, quotients, powers, roots, exp, log, sin, cos, tan, tan⁻¹,"
                " tanh, |x|, max and min",
            ) from None
    return formula.finish()
