"""A MathematicalProgram as AIGO needs it: costs with means, equality rows, and bounds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.solvers import (
    Binding,
    BoundingBoxConstraint,
    ExpressionConstraint,
    LinearConstraint,
    MathematicalProgram,
    QuadraticConstraint,
)
from pydrake.symbolic import Expression, Monomial, Polynomial, Variable

from drake_aigto.box import BoxPolynomial, compile_program
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.local import PolynomialNlp, compile_nlp
from drake_aigto.transcription import penalize
from drake_aigto.transcription.shared import as_expression, shared_constraint
from drake_aigto.world.polynomials import PolynomialMap

if TYPE_CHECKING:
    import numpy.typing as npt

_WITH_FORMULA = (LinearConstraint, QuadraticConstraint, ExpressionConstraint)
# A row of constants may miss its bounds by this.
_ROUNDING = 1e-9


class ContradictionError(Exception):
    """Bounds or constants alone leave no feasible point."""


@dataclass(frozen=True, eq=False)
class AigoProgram:
    """Minimise f(x) subject to r(y) = 0, lower ≤ y ≤ upper, over y = (x, s).

    An inequality of several variables, or one that is not affine, has a slack s of its own: lower ≤
    g(x) ≤ upper becomes g(x) − s = 0 with s between the bounds. Inequalities that are affine in one
    variable are bounds.

    Attributes:
        source: the program that was asked, over x.
        nlp: f, r and bounds over y, for a local solver.
        costs: f over y.
        penalties: Σ r_i², a block for each row, named unlike all costs.
        slack_rows: g of each slack.
        slack_map: all of them, in numbers.
    """

    source: MathematicalProgram
    nlp: PolynomialNlp
    costs: BoxPolynomial
    penalties: BoxPolynomial
    slack_rows: tuple[Polynomial, ...]
    slack_map: PolynomialMap

    @property
    def num_rows(self) -> int:
        """Number of equality rows r."""
        return self.nlp.num_rows

    def cost(self, x: npt.NDArray[np.float64]) -> float:
        """Returns f at x (n,)."""
        values = [self.source.EvalBinding(cost, x)[0] for cost in self.source.GetAllCosts()]
        return float(sum(values))

    def violation(self, x: npt.NDArray[np.float64]) -> float:
        """Returns the largest violation of the source's constraints at x (n,); 0 without any."""
        worst = 0.0
        for binding in self.source.GetAllConstraints():
            evaluator = binding.evaluator()
            value = self.source.EvalBinding(binding, x)
            if not np.all(np.isfinite(value)):
                return np.inf
            excess = np.maximum(evaluator.lower_bound() - value, value - evaluator.upper_bound())
            worst = max(worst, float(np.max(excess, initial=0.0)))
        return worst

    def with_slacks(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns y = (x, s) with s = g(x), moved within the bounds."""
        y = np.concatenate([x, np.zeros(len(self.slack_rows))])
        if self.slack_rows:
            y[x.size :] = self.slack_map(x)
        return np.clip(y, self.nlp.lower, self.nlp.upper)


def read_program(prog: MathematicalProgram) -> AigoProgram:
    """Returns a program with slacks.

    Raises:
        UnsupportedTermError: a cost without a mean in closed form, a constraint that is no
            polynomial, or variables that are not continuous; by name.
        ContradictionError: bounds or constants alone leave no feasible point.
    """
    _check_variables(prog)
    rows = _Rows(prog)
    for binding in prog.GetAllConstraints():
        rows.add(binding)
    return rows.finish()


@dataclass
class _Rows:
    """Collects equality rows, bounds and slacks of a program."""

    source: MathematicalProgram
    equalities: list[Expression] = field(default_factory=list)
    slacks: list[tuple[Polynomial, float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        n = self.source.num_vars()
        self._lower, self._upper = np.full(n, -np.inf), np.full(n, np.inf)

    def add(self, binding: Binding) -> None:
        """Adds all rows of a constraint."""
        evaluator = binding.evaluator()
        if isinstance(evaluator, BoundingBoxConstraint):
            self._bound(binding.variables(), evaluator.lower_bound(), evaluator.upper_bound())
            return
        values = np.ravel(_evaluate(binding))
        bounds = evaluator.lower_bound(), evaluator.upper_bound()
        for value, lower, upper in zip(values, *bounds, strict=True):
            if np.isnan(lower) or np.isnan(upper) or lower > upper:
                raise ContradictionError
            self._add_row(_as_polynomial(binding, value), float(lower), float(upper))

    def _add_row(self, row: Polynomial, lower: float, upper: float) -> None:
        """Adds lower ≤ row ≤ upper as bounds, an equality, or with a slack."""
        affine = _as_affine(row)
        if affine is not None:
            self._add_affine(*affine, lower, upper)
        elif lower == upper:
            self.equalities.append(row.ToExpression() - lower)
        elif np.isfinite(lower) or np.isfinite(upper):
            self.slacks.append((row, lower, upper))

    def _add_affine(
        self, variable: Variable | None, scale: float, offset: float, lower: float, upper: float
    ) -> None:
        """Adds lower ≤ scale · x + offset ≤ upper."""
        if variable is None:
            if not lower - _ROUNDING <= offset <= upper + _ROUNDING:
                raise ContradictionError
            return
        low, high = sorted(((lower - offset) / scale, (upper - offset) / scale))
        self._bound(np.array([variable]), np.array([low]), np.array([high]))

    def _bound(
        self, variables: Any, lower: npt.NDArray[np.float64], upper: npt.NDArray[np.float64]
    ) -> None:
        index = self.source.FindDecisionVariableIndices(variables)
        np.maximum.at(self._lower, index, lower)
        np.minimum.at(self._upper, index, upper)
        low, high = self._lower[index], self._upper[index]
        if not np.all(low <= high) or np.any(np.isposinf(low) | np.isneginf(high)):
            raise ContradictionError

    def _row_prefix(self) -> str:
        """Returns how rows' names begin, as no cost's does: weights are given by name."""
        costs = [cost.evaluator().get_description() for cost in self.source.GetAllCosts()]
        prefix = "row "
        while any(name.startswith(prefix) for name in costs):
            prefix = f"constraint {prefix}"
        return prefix

    def finish(self) -> AigoProgram:
        """Returns the program."""
        constrained = MathematicalProgram()
        constrained.AddDecisionVariables(self.source.decision_variables())
        slacks = constrained.NewContinuousVariables(len(self.slacks), "slack")
        rows = list(self.equalities)
        for slack, (row, _, _) in zip(slacks, self.slacks, strict=True):
            rows.append(row.ToExpression() - slack)
        prefix = self._row_prefix()
        for number, row in enumerate(rows):
            shared = shared_constraint(as_expression(row), f"{prefix}{number}")
            constrained.AddConstraint(shared.evaluator, vars=list(shared.placeholders))
        penalties = compile_program(penalize(constrained))
        lower = np.concatenate([self._lower, [bounds[1] for bounds in self.slacks]])
        upper = np.concatenate([self._upper, [bounds[2] for bounds in self.slacks]])
        constrained.AddBoundingBoxConstraint(lower, upper, constrained.decision_variables())
        for cost in self.source.GetAllCosts():
            constrained.AddCost(cost.evaluator(), vars=cost.variables())
        slack_rows = tuple(row for row, _, _ in self.slacks)
        nlp = compile_nlp(constrained)
        return AigoProgram(
            source=self.source,
            nlp=nlp,
            costs=BoxPolynomial(nlp.num_variables, nlp.costs),
            penalties=penalties,
            slack_rows=slack_rows,
            slack_map=PolynomialMap(
                np.array([row.ToExpression() for row in slack_rows], dtype=object),
                self.source.decision_variables(),
            ),
        )


def _check_variables(prog: MathematicalProgram) -> None:
    for variable in prog.decision_variables():
        if variable.get_type() != Variable.Type.CONTINUOUS:
            raise UnsupportedTermError(
                f"the variable {variable} can't be solved for",
                got=f"one of type {variable.get_type().name}",
                expected="continuous variables",
                remedy="Relax it, or use a mixed-integer solver.",
            )


def _name(binding: Binding) -> str:
    evaluator = binding.evaluator()
    return evaluator.get_description() or type(evaluator).__name__


def _evaluate(binding: Binding) -> npt.NDArray[Any]:
    """Returns a constraint's rows as expressions."""
    evaluator = binding.evaluator()
    if not isinstance(evaluator, _WITH_FORMULA):
        raise UnsupportedTermError(
            f"the constraint '{_name(binding)}' can't be solved for",
            got=f"a {type(evaluator).__name__}",
            expected="bounds, or a linear, quadratic or polynomial equality or inequality",
            remedy="Write it as symbolic formulas: prog.AddConstraint(expression >= 0).",
        )
    rows: npt.NDArray[Any] = evaluator.Eval(binding.variables())
    return rows


def _as_polynomial(binding: Binding, row: Any) -> Polynomial:
    expression = as_expression(row)
    if not expression.is_polynomial():
        raise UnsupportedTermError(
            f"the constraint '{_name(binding)}' can't be solved for",
            got=f"the row {expression}",
            expected="a polynomial",
            remedy="Multiply denominators out, or give sin, cos and exp variables of their own.",
        )
    polynomial = Polynomial(expression)
    coefficients = polynomial.monomial_to_coefficient_map().values()
    if not all(np.isfinite(coefficient.Evaluate()) for coefficient in coefficients):
        raise UnsupportedTermError(
            f"the constraint '{_name(binding)}' can't be solved for",
            got=f"the row {expression}",
            expected="finite numbers",
            remedy="Look for a parameter that was not set.",
        )
    return polynomial


def _as_affine(row: Polynomial) -> tuple[Variable | None, float, float] | None:
    """Returns the parts (x, scale, offset) of scale · x + offset; None if it is something else."""
    parts = row.monomial_to_coefficient_map()
    offset = parts.pop(Monomial(), Expression(0.0)).Evaluate()
    if not parts:
        return None, 0.0, offset
    ((monomial, scale), *others) = parts.items()
    if others or monomial.total_degree() != 1:
        return None
    (variable,) = monomial.get_powers()
    return variable, scale.Evaluate(), offset
