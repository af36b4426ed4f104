"""Constraints as penalties, so that a program only has costs (AIGTO Sec. III-A)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, TypeAlias

import numpy as np
import pydrake.symbolic as sym
from numpy.typing import ArrayLike, NDArray
from pydrake.solvers import BoundingBoxConstraint, Constraint, MathematicalProgram
from pydrake.symbolic import Expression, MakeVectorVariable

from drake_aigto.arrays import Floats
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.terms import read_bounds
from drake_aigto.transcription.shared import (
    SharedEvaluator,
    as_expression,
    formula_rows,
    is_affine_in_one,
    shared_cost,
    substitutions,
)

InequalityPenalty = Literal["squared hinge", "log barrier"]
# Lower and upper bound of each variable, shape (n,) each.
Bounds: TypeAlias = "tuple[Floats, Floats]"


def penalize(
    prog: MathematicalProgram,
    inequality: InequalityPenalty = "squared hinge",
    scale: float = 1.0,
    per_unit: Mapping[str, Any] | None = None,
) -> MathematicalProgram:
    """Returns a program over the same variables whose costs include penalties for the constraints.

        r(x) = 0     ↦   scale · r(x)²
        y(x_i) ≥ 0   ↦   scale · max(0, −y)²   or   −scale · log y      (y affine in one variable)

    Each penalty carries its constraint's description, so that `BoxPolynomial.with_weights` can
    weigh it; constraints that share an evaluator share its penalty. A variable that equal bounds
    fix keeps them: `cut_to_bounds` holds it.

    Args:
        prog: the program; it is not changed.
        inequality: how inequalities are penalized. A log barrier needs boxes that stay on its
            feasible side.
        scale: common factor of all penalties.
        per_unit: description → what residuals of such constraints are multiplied by: a number, or
            one of the program's variables; 1 if left out.

    Raises:
        UnsupportedTermError: a constraint whose formula Drake does not give, or an inequality of
            several variables.
    """
    penalized = MathematicalProgram()
    penalized.AddDecisionVariables(prog.decision_variables())
    for cost in prog.GetAllCosts():
        penalized.AddCost(cost.evaluator(), vars=cost.variables())
    factors = {name: as_expression(factor) for name, factor in (per_unit or {}).items()}
    read = [np.array(list(factor.GetVariables())) for factor in factors.values()]
    themselves = substitutions(read, read)
    # Keyed by the evaluators themselves: ids repeat once an evaluator's Python object is gone.
    penalties: dict[Constraint, tuple[list[int], SharedEvaluator | None]] = {}
    for binding in prog.GetAllConstraints():
        evaluator, variables = binding.evaluator(), binding.variables()
        if evaluator not in penalties:
            x = MakeVectorVariable(len(variables), "x")
            factor = factors.get(evaluator.get_description(), Expression(1.0))
            penalty = _penalty(evaluator, x, inequality, scale, factor)
            penalties[evaluator] = [each.get_id() for each in x], penalty
        placeholders, penalty = penalties[evaluator]
        if penalty is not None:
            penalty.bind(penalized, themselves | dict(zip(placeholders, variables, strict=True)))
    lower, upper = read_bounds(prog)
    fixed = np.flatnonzero(lower == upper)
    if fixed.size:
        held = lower[fixed], upper[fixed]
        penalized.AddBoundingBoxConstraint(*held, prog.decision_variables()[fixed])
    return penalized


def cut_to_bounds(
    prog: MathematicalProgram, center: ArrayLike, half_width: ArrayLike
) -> tuple[Floats, Floats]:
    """Returns center and half width of the part of a box that is within the program's bounds.

    Where bounds fix a variable its half width is 0. A box outside of the bounds in some variable
    shrinks to the nearest bound there.
    """
    return cut_to(read_bounds(prog), center, half_width)


def cut_to(bounds: Bounds, center: ArrayLike, half_width: ArrayLike) -> tuple[Floats, Floats]:
    """Returns the same for the lower and upper bounds of the variables."""
    lower, upper = bounds
    center, half_width = np.asarray(center, dtype=float), np.asarray(half_width, dtype=float)
    low = np.clip(center - half_width, lower, upper)
    high = np.clip(center + half_width, lower, upper)
    return (low + high) / 2, (high - low) / 2


def _penalty(
    constraint: Constraint,
    x: NDArray[Any],
    inequality: InequalityPenalty,
    scale: float,
    factor: Expression,
) -> SharedEvaluator | None:
    """Returns the cost over placeholders x that stands for lower ≤ g(x) ≤ upper; None if empty."""
    name = constraint.get_description() or type(constraint).__name__
    total = Expression(0.0)
    for y, lower, upper in formula_rows(constraint, name, x):
        if lower == upper:
            if not isinstance(constraint, BoundingBoxConstraint):
                total += scale * sym.pow((y - lower) * factor, 2)
            continue
        sides = (y - lower, lower), (upper - y, upper)
        for side in (side for side, bound in sides if np.isfinite(bound)):
            total += scale * _inequality_penalty(name, as_expression(side), factor, inequality)
    if total.EqualTo(Expression(0.0)):
        return None
    return shared_cost(total, name)


def _inequality_penalty(
    name: str, y: Expression, factor: Expression, inequality: InequalityPenalty
) -> Expression:
    """Returns max(0, −y)² or −log y, of y times the factor."""
    if not is_affine_in_one(y):
        raise UnsupportedTermError(
            f"the constraint '{name}' can't be penalized",
            got=f"the inequality {y} ≥ 0",
            expected="inequalities that are affine in one variable",
            remedy="Give the expression a variable s of its own: expression == s, s ≥ 0.",
        )
    if inequality == "log barrier":
        return -sym.log(y * factor)
    return sym.pow(factor, 2) * sym.pow(sym.max(0.0, -y), 2)
