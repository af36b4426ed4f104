"""Rows of programs over knots: names and units, evaluators that stages share, and penalties."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pydrake.symbolic as sym
from numpy.typing import ArrayLike, NDArray
from pydrake import solvers
from pydrake.symbolic import Expression, MakeVectorVariable, Polynomial, Variable

from drake_aigto.arrays import Floats
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.terms import read_bounds
from drake_aigto.world import Scales, Scenario

NONPENETRATION, CLEARANCE = "nonpenetration", "clearance"
FLIGHT, DYNAMICS, CONTACT, RESTITUTION = "flight", "dynamics", "contact", "restitution"
KINEMATICS = "kinematics"
INTEGRATION = "integration"

# Row → the unit of its defect. Defects of other rows are relative to the task's scales.
UNITS: Mapping[str, str] = {
    **dict.fromkeys((FLIGHT, KINEMATICS, CONTACT, NONPENETRATION, CLEARANCE), "m"),
    **dict.fromkeys((DYNAMICS, RESTITUTION), "m/s"),
}


def scaled_defects(defects: Mapping[str, float], scales: Scales) -> dict[str, float]:
    """Returns each defect relative to the task's scale in its unit."""
    units = {"m": scales.length, "m/s": scales.velocity}
    return {name: by / units.get(UNITS.get(name, ""), 1.0) for name, by in defects.items()}


def largest_defect(defects: Mapping[str, float], scales: Scales) -> float:
    """Returns the largest of `scaled_defects`."""
    return max(scaled_defects(defects, scales).values())


def calc_cost(scenario: Scenario, times: Floats, positions: Floats, controls: Floats) -> float:
    """Returns J = w_u Σ h_k ‖u_k‖² + w_f ‖q_N − goal‖², without penalties or added costs."""
    effort = np.diff(times) @ np.sum(controls**2, axis=1)
    miss = np.sum((positions[-1] - scenario.goal_position) ** 2)
    return float(scenario.control_weight * effort + scenario.goal_weight * miss)


# Constraints that Drake evaluates symbolically.
_WITH_FORMULA = (
    solvers.LinearConstraint,
    solvers.QuadraticConstraint,
    solvers.ExpressionConstraint,
)


@dataclass(frozen=True)
class SharedEvaluator:
    """An evaluator, and the placeholder variables that it reads in order."""

    evaluator: solvers.EvaluatorBase  # a Drake cost or constraint
    # The variables of the expression that it was made of, in its own order.
    placeholders: tuple[Variable, ...]

    def bind(self, prog: solvers.MathematicalProgram, values: dict[int, Variable]) -> None:
        """Adds the evaluator to a program; values are variables by their placeholders' ids."""
        if isinstance(self.evaluator, solvers.Cost):
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
    """Returns a cost: linear or quadratic if possible, else an ExpressionCost.

    Drake keeps the formula of these three; the PolynomialCost that `AddCost` makes of higher
    degrees hides it.
    """
    if expression.is_polynomial() and Polynomial(expression).TotalDegree() <= 2:
        scratch = _scratch_program(expression)
        binding = scratch.AddCost(expression)
        evaluator, variables = binding.evaluator(), list(binding.variables())
    else:
        evaluator = solvers.ExpressionCost(expression)
        variables = list(evaluator.vars())
    evaluator.set_description(description)
    return SharedEvaluator(evaluator, tuple(variables))


def shared_constraint(
    expression: Expression, description: str, lower: float = 0.0, upper: float = 0.0
) -> SharedEvaluator:
    """Returns lower ≤ expression ≤ upper, as the most special constraint of Drake."""
    scratch = _scratch_program(expression)
    if expression.is_polynomial() and Polynomial(expression).TotalDegree() == 2:
        # Drake warns if its own test of convexity does not end.
        kind = solvers.QuadraticConstraint.HessianType.kIndefinite
        binding = scratch.AddQuadraticConstraint(expression, lower, upper, hessian_type=kind)
    else:
        binding = scratch.AddConstraint(expression, lower, upper)
    evaluator: solvers.Constraint = binding.evaluator()
    evaluator.set_description(description)
    return SharedEvaluator(evaluator, tuple(binding.variables()))


def formula_rows(
    constraint: solvers.EvaluatorBase, name: str, x: NDArray[Any]
) -> Iterator[tuple[Expression, float, float]]:
    """Yields each row of a constraint on x: its formula, and its lower and upper bound."""
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


def _scratch_program(expression: Expression) -> solvers.MathematicalProgram:
    scratch = solvers.MathematicalProgram()
    scratch.AddDecisionVariables(list(expression.GetVariables()))
    return scratch


class Parameters(NamedTuple):
    """Parameters of a program from a scenario without its start: numbers, or symbols for them.

    Rows divide by none of these, so that programs are polynomials of the symbols.
    """

    goal: NDArray[Any]  # of q(T), shape (nq,) [m]
    control_weight: Any  # w_u [1/(N² s)]
    goal_weight: Any  # w_f [1/m²]
    time_step: Any  # dt [s]
    rate: Any  # 1/dt [1/s]
    per_length: Any  # 1/L, of the length scale [1/m]
    restitutions: NDArray[Any]  # e of each contact, shape (m,)

    @classmethod
    def of(cls, scenario: Scenario, length_scale: float, restitutions: Floats) -> Parameters:
        """Returns a scenario's numbers."""
        return cls(
            goal=scenario.goal_position,
            control_weight=scenario.control_weight,
            goal_weight=scenario.goal_weight,
            time_step=scenario.time_step,
            rate=1 / scenario.time_step,
            per_length=1 / length_scale,
            restitutions=restitutions,
        )

    @classmethod
    def symbols(cls, num_positions: int, num_contacts: int) -> Parameters:
        """Returns new symbols."""
        names = cls._fields[1:-1]
        found = MakeVectorVariable(num_positions + len(names) + num_contacts, "p")
        goal, scalars, returned = np.split(found, [num_positions, num_positions + len(names)])
        given = dict(zip(names, scalars.tolist(), strict=True))
        return cls(goal=goal, **given, restitutions=returned)

    def vector(self) -> NDArray[Any]:
        """Returns all of them, shape (nq + 5 + m,)."""
        return np.array([*self.goal, *self[1:-1], *self.restitutions])


# Lower and upper bound of each variable, shape (n,) each.
Bounds: TypeAlias = "tuple[Floats, Floats]"


def penalize(
    prog: solvers.MathematicalProgram, scale: float = 1.0, per_unit: Mapping[str, Any] | None = None
) -> solvers.MathematicalProgram:
    """Returns a program over the same variables with penalties for constraints as costs.

        r(x) = 0     ↦   scale · r(x)²
        y(x_i) ≥ 0   ↦   scale · max(0, −y)²      (y affine in one variable)

    Each penalty carries its constraint's description, so that `BoxPolynomial.with_weights` can
    weight it; constraints that share an evaluator share its penalty. A variable with equal bounds
    keeps them: `cut_to` holds it.

    Args:
        prog: the program; it is not changed.
        scale: common factor of all penalties.
        per_unit: description → factor of residuals of such constraints: a number, or one of the
            program's variables; 1 if left out.

    Raises:
        UnsupportedTermError: a constraint whose formula Drake does not give, or an inequality of
            several variables.
    """
    penalized = solvers.MathematicalProgram()
    penalized.AddDecisionVariables(prog.decision_variables())
    for cost in prog.GetAllCosts():
        penalized.AddCost(cost.evaluator(), vars=cost.variables())
    factors = {name: as_expression(factor) for name, factor in (per_unit or {}).items()}
    read = [np.array(list(factor.GetVariables())) for factor in factors.values()]
    themselves = substitutions(read, read)
    # Keyed by the evaluators themselves: ids repeat once an evaluator's Python object is gone.
    penalties: dict[solvers.Constraint, tuple[list[int], SharedEvaluator | None]] = {}
    for binding in prog.GetAllConstraints():
        evaluator, variables = binding.evaluator(), binding.variables()
        if evaluator not in penalties:
            x = MakeVectorVariable(len(variables), "x")
            factor = factors.get(evaluator.get_description(), Expression(1.0))
            penalty = _penalty(evaluator, x, scale, factor)
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


def cut_to(bounds: Bounds, center: ArrayLike, half_width: ArrayLike) -> tuple[Floats, Floats]:
    """Returns center and half width of the part of a box that is within lower and upper bounds.

    Where bounds fix a variable its half width is 0. A box outside of the bounds in some variable
    shrinks to the nearest bound there.
    """
    lower, upper = bounds
    center, half_width = np.asarray(center, dtype=float), np.asarray(half_width, dtype=float)
    low = np.clip(center - half_width, lower, upper)
    high = np.clip(center + half_width, lower, upper)
    return (low + high) / 2, (high - low) / 2


def _penalty(
    constraint: solvers.Constraint, x: NDArray[Any], scale: float, factor: Expression
) -> SharedEvaluator | None:
    """Returns the penalty over placeholders x of lower ≤ g(x) ≤ upper; None if empty."""
    name = constraint.get_description() or type(constraint).__name__
    total = Expression(0.0)
    for y, lower, upper in formula_rows(constraint, name, x):
        if lower == upper:
            if not isinstance(constraint, solvers.BoundingBoxConstraint):
                total += scale * sym.pow((y - lower) * factor, 2)
            continue
        sides = (y - lower, lower), (upper - y, upper)
        for side in (side for side, bound in sides if np.isfinite(bound)):
            total += scale * _inequality_penalty(name, as_expression(side), factor)
    if total.EqualTo(Expression(0.0)):
        return None
    return shared_cost(total, name)


def _inequality_penalty(name: str, y: Expression, factor: Expression) -> Expression:
    """Returns max(0, −y)² of y times the factor."""
    if not is_affine_in_one(y):
        raise UnsupportedTermError(
            f"the constraint '{name}' can't be penalized",
            got=f"the inequality {y} ≥ 0",
            expected="inequalities that are affine in one variable",
            remedy="Give the expression a variable s of its own: expression == s, s ≥ 0.",
        )
    return sym.pow(factor, 2) * sym.pow(sym.max(0.0, -y), 2)
