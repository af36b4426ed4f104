"""What the costs, constraints and bounds of a program are as formulas of its variables."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from pydrake.solvers import (
    Binding,
    ExpressionConstraint,
    ExpressionCost,
    LinearConstraint,
    MathematicalProgram,
)
from pydrake.symbolic import Expression

from drake_aigto.solver.ranges import Range
from drake_aigto.solver.signs import RowRange
from drake_aigto.terms import CONES, NORM_COSTS


def formulas_of(binding: Binding) -> Sequence[Expression] | None:
    """Returns what a symbolic cost or constraint, a norm or a cone is; None of all others."""
    evaluator, variables = binding.evaluator(), binding.variables()
    if isinstance(evaluator, ExpressionConstraint):
        return [_bind(each, evaluator.vars(), variables) for each in evaluator.expressions()]
    if isinstance(evaluator, ExpressionCost):
        return [_bind(evaluator.expression(), evaluator.vars(), variables)]
    if isinstance(evaluator, (*NORM_COSTS, *CONES)):
        formulas: Sequence[Expression] = evaluator.Eval(variables)
        return formulas
    return None


def rows_of(binding: Binding) -> Iterator[RowRange]:
    """Yields formulas and bounds of a linear or symbolic constraint, or a cone."""
    evaluator, variables = binding.evaluator(), binding.variables()
    formulas = formulas_of(binding)
    if isinstance(evaluator, LinearConstraint):
        formulas = [
            sum((a * x for a, x in zip(row, variables, strict=True)), Expression(0.0))
            for row in evaluator.GetDenseA().tolist()
        ]
    if formulas is None:
        return
    yield from zip(formulas, evaluator.lower_bound(), evaluator.upper_bound(), strict=True)


def ranges_of(prog: MathematicalProgram) -> dict[int, Range]:
    """Returns the bounds of a program's variables, by their ids."""
    found: dict[int, Range] = {}
    for binding in prog.bounding_box_constraints():
        evaluator = binding.evaluator()
        bounds = evaluator.lower_bound(), evaluator.upper_bound()
        for variable, low, high in zip(binding.variables(), *bounds, strict=True):
            before = found.get(variable.get_id(), (-np.inf, np.inf))
            found[variable.get_id()] = max(before[0], low), min(before[1], high)
    return found


def _bind(e: Expression, own: Any, variables: Any) -> Expression:
    """Returns a formula of other variables than its evaluator's own."""
    pairs = {a: Expression(b) for a, b in zip(own, variables, strict=True) if not a.EqualTo(b)}
    return e.Substitute(pairs) if pairs else e
