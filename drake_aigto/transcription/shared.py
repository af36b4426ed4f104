"""Evaluators that many bindings share, so that N stages are parsed, compiled and stored once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.solvers import (
    Constraint,
    Cost,
    EvaluatorBase,
    ExpressionConstraint,
    ExpressionCost,
    LinearConstraint,
    MathematicalProgram,
    QuadraticConstraint,
)
from pydrake.symbolic import Expression, Polynomial, Variable

from drake_aigto.errors import UnsupportedTermError

# Constraints that Drake evaluates symbolically.
_WITH_FORMULA = (LinearConstraint, QuadraticConstraint, ExpressionConstraint)


@dataclass(frozen=True)
class SharedEvaluator:
    """An evaluator, and which placeholder variables it reads in which order.

    Attributes:
        evaluator: a Drake cost or constraint.
        placeholders: the variables of the expression that it was made of, in its own order.
    """

    evaluator: EvaluatorBase
    placeholders: tuple[Variable, ...]

    def bind(self, prog: MathematicalProgram, values: dict[int, Variable]) -> None:
        """Adds the evaluator to a program; values are variables by their placeholders' ids."""
        if isinstance(self.evaluator, Cost):
            prog.AddCost(self.evaluator, vars=self.variables(values))
        else:
            prog.AddConstraint(self.evaluator, vars=self.variables(values))

    def variables(self, values: dict[int, Variable]) -> list[Variable]:
        """Returns the decision variables that it reads, of those for each placeholder's id."""
        return [values[identity] for identity in self._identities]

    @cached_property
    def _identities(self) -> list[int]:
        return [placeholder.get_id() for placeholder in self.placeholders]


def is_affine_in_one(y: Expression) -> bool:
    """Returns whether an expression is affine in one variable, and reads no other."""
    is_of_one = y.is_polynomial() and len(y.GetVariables()) == 1
    return is_of_one and Polynomial(y).TotalDegree() == 1


def as_expression(value: Any) -> Expression:
    """Returns a float, Variable or Expression as an Expression."""
    return value if isinstance(value, Expression) else Expression(value)


def shared_cost(expression: Expression, description: str) -> SharedEvaluator:
    """Returns a cost: linear or quadratic where it is one, else an ExpressionCost.

    Drake keeps the formula of these three; the PolynomialCost that `AddCost` makes of higher
    degrees hides it.
    """
    if expression.is_polynomial() and Polynomial(expression).TotalDegree() <= 2:
        scratch = _scratch_program(expression)
        binding = scratch.AddCost(expression)
        evaluator, variables = binding.evaluator(), list(binding.variables())
    else:
        evaluator = ExpressionCost(expression)
        variables = list(evaluator.vars())
    evaluator.set_description(description)
    return SharedEvaluator(evaluator, tuple(variables))


def shared_constraint(
    expression: Expression, description: str, lower: float = 0.0, upper: float = 0.0
) -> SharedEvaluator:
    """Returns lower ≤ expression ≤ upper, as special a constraint as Drake has for it."""
    scratch = _scratch_program(expression)
    if expression.is_polynomial() and Polynomial(expression).TotalDegree() == 2:
        # Drake warns where its own test of convexity does not come to an end.
        kind = QuadraticConstraint.HessianType.kIndefinite
        binding = scratch.AddQuadraticConstraint(expression, lower, upper, hessian_type=kind)
    else:
        binding = scratch.AddConstraint(expression, lower, upper)
    evaluator: Constraint = binding.evaluator()
    evaluator.set_description(description)
    return SharedEvaluator(evaluator, tuple(binding.variables()))


def formula_rows(
    constraint: EvaluatorBase, name: str, x: NDArray[Any]
) -> Iterator[tuple[Expression, float, float]]:
    """Yields each row of a constraint on x: its formula, and its lower and upper bound.

    Raises:
        UnsupportedTermError: Drake does not give the formula.
    """
    if not isinstance(constraint, _WITH_FORMULA):
        raise UnsupportedTermError(
            f"the constraint '{name}' can't be met",
            got=f"a {type(constraint).__name__}, whose formula Drake does not give back",
            expected="a linear, quadratic or expression constraint, or bounds",
            remedy="Write it as a symbolic expression: prog.AddConstraint(expression == 0).",
        )
    bounds = constraint.lower_bound().tolist(), constraint.upper_bound().tolist()
    for y, lower, upper in zip(constraint.Eval(x), *bounds, strict=True):
        yield as_expression(y), lower, upper


def substitutions(
    placeholders: Iterable[NDArray[Any]], values: Iterable[NDArray[Any]]
) -> dict[int, Variable]:
    """Returns placeholder id → decision variable for arrays of both, paired in order."""
    return {
        placeholder.get_id(): value
        for group, chosen in zip(placeholders, values, strict=True)
        for placeholder, value in zip(np.ravel(group), np.ravel(chosen), strict=True)
    }


def _scratch_program(expression: Expression) -> MathematicalProgram:
    scratch = MathematicalProgram()
    scratch.AddDecisionVariables(list(expression.GetVariables()))
    return scratch
