"""Test functions as modeling tools write them: parts have variables of their own, by equalities.

Their minimum stays what it was. Bounds are cut at random, so that no minimizer is in the middle.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from pydrake.solvers import ExpressionCost, MathematicalProgram
from pydrake.symbolic import Expression, ExpressionKind

from benchmarks.collections.global_functions import global_problems
from benchmarks.collections.global_problem import GlobalProblem

MOST_VARIABLES = 10
_SHARE = 0.6  # of a formula's parts, that have a variable
_CUT = 0.8  # of the way to a minimizer, that a bound is moved by at most
_LEAVES = (ExpressionKind.Constant, ExpressionKind.Var)


def lifted_problems() -> Iterator[GlobalProblem]:
    """Yields the functions of few variables."""
    for problem in global_problems():
        if problem.num_variables <= MOST_VARIABLES:
            yield problem


def lift(problem: GlobalProblem, seed: int) -> MathematicalProgram:
    """Returns a program of a function, lifted and cut as the seed has it."""
    rng = np.random.default_rng([seed, *problem.name.encode()])
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(problem.num_variables, "x")
    minimizer = rng.choice(problem.minimizers)
    part = _CUT * rng.random((2, x.size))
    lower = problem.lower + part[0] * (minimizer - problem.lower)
    upper = problem.upper + part[1] * (minimizer - problem.upper)
    prog.AddBoundingBoxConstraint(lower, upper, x)
    cost = ExpressionCost(_Lift(prog, rng).replace(problem.evaluate(x)))
    prog.AddCost(cost, vars=cost.vars())
    return prog


class _Lift:
    """Replaces parts of formulas from the leaves up; equal ones by the same variable."""

    def __init__(self, prog: MathematicalProgram, rng: np.random.Generator) -> None:
        self._prog, self._rng = prog, rng
        self._known: dict[str, Any] = {}

    def replace(self, formula: Any) -> Any:
        """Returns a formula with variables in place of its parts, never of all of it."""
        return self._rebuild(_expression(formula))

    def _rebuild(self, formula: Expression) -> Any:
        if formula.get_kind() in _LEAVES:
            return formula
        make, operands = formula.Unapply()
        return make(*(self._replace_part(_expression(operand)) for operand in operands))

    def _replace_part(self, part: Expression) -> Any:
        if part.get_kind() in _LEAVES:
            return part
        if (text := str(part)) not in self._known:
            inner = self._rebuild(part)
            if self._rng.random() < _SHARE:
                (own,) = self._prog.NewContinuousVariables(1, f"y{len(self._known)}")
                self._prog.AddConstraint(own - inner == 0)
                inner = Expression(own)
            self._known[text] = inner
        return self._known[text]


def _expression(operand: Any) -> Expression:
    return operand if isinstance(operand, Expression) else Expression(operand)
