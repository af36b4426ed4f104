"""Functions without a mean in closed form, by variables of their own and rows that define them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pydrake.symbolic as sym
from pydrake.solvers import (
    Binding,
    EvaluatorBase,
    ExpressionConstraint,
    ExpressionCost,
    MathematicalProgram,
)
from pydrake.symbolic import Expression, ExpressionKind, Variable

from drake_aigto.arrays import Floats
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.solver.formulas import formulas_of, ranges_of, rows_of
from drake_aigto.solver.intervals import interval
from drake_aigto.solver.signs import Signs
from drake_aigto.terms import (
    evaluator_label,
    evaluator_name,
    expression_terms,
    operands,
    shown,
)

# Roots of a higher order are exponentials of logarithms.
_HIGHEST_ROOT = 6


@dataclass(frozen=True, eq=False)
class Lifted:
    """A program without such functions, over x and variables that stand for them.

    Attributes:
        prog: over (x, z).
        rows: what each of the source's constraints became, in order.
        formulas: what each z_i is, over x and those before it.
    """

    prog: MathematicalProgram
    rows: tuple[tuple[EvaluatorBase, ...], ...]
    formulas: tuple[Expression, ...] = ()

    @classmethod
    def of(cls, prog: MathematicalProgram) -> Lifted:
        """Returns a program as it is."""
        return cls(prog, tuple((each.evaluator(),) for each in prog.GetAllConstraints()))

    def extend(self, x: Floats) -> Floats:
        """Returns (x, z) of x (n,): NaN where a formula has no value."""
        values = np.concatenate([x, np.full(len(self.formulas), np.nan)])
        for i, formula in enumerate(self.formulas, x.size):
            read = list(formula.GetVariables())
            known = values[self.prog.FindDecisionVariableIndices(read)]
            if np.all(np.isfinite(known)):
                try:
                    values[i] = formula.Evaluate(dict(zip(read, known.tolist(), strict=True)))
                except (RuntimeError, ValueError):  # It has no value there.
                    continue
        return values


def lift(prog: MathematicalProgram) -> Lifted:
    """Returns a program in which all functions have means in closed form.

    A variable z stands for a function of others, and a row, or two, say of which:

        a/b          z b = a                       where b is not 0
        b^(p/q)      z^p,  z^q = b,  z ≥ 0         where b ≥ 0
        log b        exp z = b                     where b > 0
        f(a)         f(z),  z = a                  of sin, cos or exp, a not affine
        atan a       sin z = a cos z,  |z| ≤ π/2; likewise asin and acos
        tanh a       1 − 2/(exp 2a + 1); likewise sinh and cosh
        |a|          z ≥ a,  z ≥ −a                where less of it is better; else z² = a²
        max(a, b)    z ≥ a,  z ≥ b                 likewise; else (a + b + |a − b|)/2

    Ranges of z follow from those of what it is of, by interval arithmetic.

    Raises:
        UnsupportedTermError: a function may have no value within the bounds, or is none of these.
    """
    return _Lift(prog).run()


class _Lift:
    """One run: the new program, what stands for what, and the ranges of its variables."""

    def __init__(self, prog: MathematicalProgram) -> None:
        self._source, self._prog = prog, MathematicalProgram()
        self._prog.AddDecisionVariables(prog.decision_variables())
        self._known: dict[str, Variable] = {}
        self._formulas: list[Expression] = []
        self._ranges = ranges_of(prog)
        rows = (row for binding in prog.GetAllConstraints() for row in rows_of(binding))
        self._signs = Signs(rows, self._ranges)
        self._label, self._is_row = "", False

    def run(self) -> Lifted:
        """Copies what has means, and lifts the rest."""
        for binding in self._source.GetAllCosts():
            self._add_cost(binding)
        constraints = self._source.GetAllConstraints()
        rows = tuple(tuple(self._add_constraint(binding)) for binding in constraints)
        return Lifted(self._prog, rows, tuple(self._formulas))

    def _add_cost(self, binding: Binding) -> None:
        evaluator = binding.evaluator()
        self._label, self._is_row = evaluator_label(binding), False
        formulas = formulas_of(binding)
        if formulas is None:
            self._prog.AddCost(binding)
            return
        (formula,) = formulas
        cost = ExpressionCost(self._lift(formula, 1))
        cost.set_description(evaluator_name(evaluator))
        self._prog.AddCost(cost, vars=cost.vars())

    def _add_constraint(self, binding: Binding) -> Iterator[EvaluatorBase]:
        """Adds what a constraint becomes, and yields it."""
        evaluator = binding.evaluator()
        self._label, self._is_row = evaluator_label(binding), True
        formulas = formulas_of(binding)
        if formulas is None:
            self._prog.AddConstraint(binding)
            yield evaluator
            return
        bounds = evaluator.lower_bound(), evaluator.upper_bound()
        for formula, low, high in zip(formulas, *bounds, strict=True):
            # Where only less of it, or more, breaks the row.
            sign = int(math.isinf(low)) - int(math.isinf(high))
            yield self._add_row(evaluator_name(evaluator), self._lift(formula, sign), low, high)

    def _add_row(self, name: str, formula: Expression, low: float, high: float) -> EvaluatorBase:
        row = ExpressionConstraint(np.array([formula]), np.array([low]), np.array([high]))
        row.set_description(name)
        self._prog.AddConstraint(row, vars=row.vars())
        return row

    def _has_mean(self, e: Expression) -> bool:
        try:
            expression_terms("", e, list(e.GetVariables()), self._is_row)
        except UnsupportedTermError:
            return False
        return True

    def _lift(self, e: Expression, sign: int) -> Expression:
        """Returns an expression that has a mean.

        Args:
            e: what it stands for.
            sign: 1 where less of it is better whatever else there is, −1 where more is; else 0.
        """
        if self._has_mean(e):
            return e
        kind = e.get_kind()
        if kind == ExpressionKind.Add:
            return sum((self._lift(each, sign) for each in operands(e)), Expression(0.0))
        if kind == ExpressionKind.Mul:
            return self._lift_product(e, sign)
        if kind == ExpressionKind.Div and not operands(e)[1].GetVariables():
            above, below = operands(e)
            return self._lift(above, sign if self._evaluate(below) > 0 else -sign) / below
        if kind in _WAVES:
            return _WAVES[kind](self._alone(operands(e)[0]))
        rule = _RULES.get(kind)
        if rule is None:
            raise self._refusal(e, "which has no equation of means", "Write it by other functions.")
        return rule(self, e, sign)

    def _lift_product(self, e: Expression, sign: int) -> Expression:
        """Returns a product whose factors have a mean, and then together, one by one alone."""
        number, rest = self._split_number(e)
        others = operands(rest) if rest.get_kind() == ExpressionKind.Mul else [rest]
        inner = sign * int(math.copysign(1.0, number)) if len(others) == 1 else 0
        found = Expression(number)
        for each in others:
            lifted = self._lift(each, inner)
            product = found * lifted
            found = product if self._has_mean(product) else found * self._alone(lifted)
        return found

    def _lift_for_row(self, e: Expression, sign: int = 0) -> Expression:
        """Returns what may stand in a row for an expression, wherever that is."""
        was_row, self._is_row = self._is_row, True
        lifted = self._lift(e, sign)
        self._is_row = was_row
        return lifted

    def _alone(self, e: Expression) -> Expression:
        """Returns an affine expression that stands for another: a variable, if it is not affine."""
        lifted = self._lift_for_row(e)
        if lifted.is_polynomial() and sym.Polynomial(lifted).TotalDegree() <= 1:
            return lifted
        return self._variable(e, lambda z: [(z - lifted, 0.0, 0.0)])

    def _variable(
        self,
        e: Expression,
        rows: Callable[[Expression], list[tuple[Expression, float, float]]],
        is_bound: bool = False,
    ) -> Expression:
        """Returns the variable that stands for an expression, with rows that say so.

        Args:
            e: the expression.
            rows: formulas of the variable, and their bounds.
            is_bound: whether they hold it no more than above e.
        """
        name = f"bound of {e}" if is_bound else str(e)
        if name not in self._known:
            z = Variable(shown(e))
            low, high = interval(e, self._ranges)
            self._prog.AddDecisionVariables(np.array([z]))
            self._prog.AddBoundingBoxConstraint(low, high, z)
            self._ranges[z.get_id()] = low, high
            self._formulas.append(e)
            self._known[name] = z
            for formula, least, most in rows(Expression(z)):
                self._add_row(shown(f"{e} in {self._label}"), formula, least, most)
        return Expression(self._known[name])

    def _require(self, e: Expression, function: Expression, is_strict: bool = True) -> None:
        """Refuses a function of e where e may be too low for it."""
        if self._signs.are_positive(e, is_strict):
            return
        relation = ">" if is_strict else ">="
        low, high = interval(e, self._ranges)
        raise self._refusal(
            function,
            f"where {shown(e)} is in [{low:g}, {high:g}] for all that bounds say",
            f"Bound its variables such that {shown(e)} {relation} 0, or add that as a constraint.",
            f"an argument {relation} 0",
        )

    def _refusal(
        self, e: Expression, got: str, remedy: str, expected: str | None = None
    ) -> UnsupportedTermError:
        return UnsupportedTermError(
            f"{self._label} can't be searched", f"{shown(e)}, {got}", expected, remedy
        )

    def _evaluate(self, e: Expression) -> float:
        """Returns what an expression without variables is."""
        try:
            return e.Evaluate()
        except RuntimeError as error:  # NaN, or a division by zero
            remedy = "Look for a parameter that was not set, or a division by zero."
            raise self._refusal(e, "which is no number", remedy, "finite numbers") from error

    def _split_number(self, e: Expression) -> tuple[float, Expression]:
        """Returns the number that an expression is a multiple of, and what is multiplied."""
        if e.get_kind() != ExpressionKind.Mul:
            return 1.0, e
        factors = operands(e)
        number = math.prod(self._evaluate(each) for each in factors if not each.GetVariables())
        others = (each for each in factors if each.GetVariables())
        return number, math.prod(others, start=Expression(1.0))

    def _lift_quotient(self, e: Expression, _: int) -> Expression:
        above, below = operands(e)
        number, rest = self._split_number(above)
        if number not in (0.0, 1.0):
            return number * self._lift_quotient(rest / below, 0)
        if not self._signs.keeps(below):
            low, high = interval(below, self._ranges)
            raise self._refusal(
                e,
                f"where {shown(below)} is in [{low:g}, {high:g}] for all that bounds say",
                f"Bound its variables such that {shown(below)} keeps its sign and is not 0.",
                "a divisor that is not 0",
            )
        top, bottom = self._lift_for_row(above), self._lift_for_row(below)
        return self._variable(e, lambda z: [(z * bottom - top, 0.0, 0.0)])

    def _lift_power(self, e: Expression, _: int) -> Expression:
        base, exponent = operands(e)
        if exponent.GetVariables():
            return self._lift(sym.exp(exponent * sym.log(base)), 0)
        p = exponent.Evaluate()
        if p < 0.0:
            return self._lift_quotient(1.0 / sym.pow(base, -p), 0)
        if p == int(p):
            return sym.pow(self._alone(base), p)
        part = Fraction(p).limit_denominator(_HIGHEST_ROOT)
        if float(part) != p and abs(float(part) - p) > 1e-12:
            return self._lift(sym.exp(p * sym.log(base)), 0)
        return self._root(e, base, part)

    def _lift_square_root(self, e: Expression, _: int) -> Expression:
        return self._root(e, operands(e)[0], Fraction(1, 2))

    def _root(self, e: Expression, base: Expression, part: Fraction) -> Expression:
        self._require(base, e, is_strict=False)
        right, q = self._lift_for_row(base), part.denominator
        root = sym.sqrt(base) if q == 2 else sym.pow(base, 1.0 / q)
        z = self._variable(root, lambda z: [(sym.pow(z, q) - right, 0.0, 0.0)])
        return sym.pow(z, part.numerator)

    def _lift_log(self, e: Expression, _: int) -> Expression:
        (argument,) = operands(e)
        self._require(argument, e)
        right = self._lift_for_row(argument)
        return self._variable(e, lambda z: [(sym.exp(z) - right, 0.0, 0.0)])

    def _lift_tangent(self, e: Expression, _: int) -> Expression:
        (angle,) = operands(e)
        return self._lift_quotient(sym.sin(angle) / sym.cos(angle), 0)

    def _lift_inverse_tangent(self, e: Expression, _: int) -> Expression:
        above = self._lift_for_row(operands(e)[0])
        return self._variable(e, lambda z: [(sym.sin(z) - above * sym.cos(z), 0.0, 0.0)])

    def _lift_inverse_wave(self, e: Expression, _: int) -> Expression:
        (argument,) = operands(e)
        self._require(1.0 - argument, e, is_strict=False)
        self._require(1.0 + argument, e, is_strict=False)
        wave, right = _INVERSES[e.get_kind()], self._lift_for_row(argument)
        return self._variable(e, lambda z: [(wave(z) - right, 0.0, 0.0)])

    def _lift_hyperbolic_tangent(self, e: Expression, sign: int) -> Expression:
        return self._lift(1.0 - 2.0 / (sym.exp(2.0 * operands(e)[0]) + 1.0), sign)

    def _lift_hyperbola(self, e: Expression, sign: int) -> Expression:
        (a,) = operands(e)
        side = 1.0 if e.get_kind() == ExpressionKind.Cosh else -1.0
        return self._lift((sym.exp(a) + side * sym.exp(-a)) / 2.0, sign if side > 0.0 else 0)

    def _lift_abs(self, e: Expression, sign: int) -> Expression:
        (argument,) = operands(e)
        if sign > 0:
            a = self._lift_for_row(argument)
            return self._variable(e, lambda z: [(z - a, 0.0, np.inf), (z + a, 0.0, np.inf)], True)
        own = self._alone(argument)
        return self._variable(e, lambda z: [(z**2 - own**2, 0.0, 0.0)])

    def _lift_max(self, e: Expression, sign: int) -> Expression:
        a, b = operands(e)
        return self._larger(e, a, b, sign)

    def _lift_min(self, e: Expression, sign: int) -> Expression:
        a, b = operands(e)
        return -self._larger(sym.max(-a, -b), -a, -b, -sign)

    def _larger(self, e: Expression, a: Expression, b: Expression, sign: int) -> Expression:
        if sign > 0:
            sides = [self._lift_for_row(each, sign) for each in (a, b)]
            return self._variable(e, lambda z: [(z - each, 0.0, np.inf) for each in sides], True)
        return self._lift((a + b + sym.abs(a - b)) / 2, sign)


_WAVES = {ExpressionKind.Sin: sym.sin, ExpressionKind.Cos: sym.cos, ExpressionKind.Exp: sym.exp}
_INVERSES = {ExpressionKind.Asin: sym.sin, ExpressionKind.Acos: sym.cos}
_RULES: Mapping[ExpressionKind, Callable[[_Lift, Expression, int], Expression]] = {
    ExpressionKind.Div: _Lift._lift_quotient,
    ExpressionKind.Pow: _Lift._lift_power,
    ExpressionKind.Sqrt: _Lift._lift_square_root,
    ExpressionKind.Log: _Lift._lift_log,
    ExpressionKind.Tan: _Lift._lift_tangent,
    ExpressionKind.Atan: _Lift._lift_inverse_tangent,
    ExpressionKind.Asin: _Lift._lift_inverse_wave,
    ExpressionKind.Acos: _Lift._lift_inverse_wave,
    ExpressionKind.Sinh: _Lift._lift_hyperbola,
    ExpressionKind.Cosh: _Lift._lift_hyperbola,
    ExpressionKind.Tanh: _Lift._lift_hyperbolic_tangent,
    ExpressionKind.Abs: _Lift._lift_abs,
    ExpressionKind.Max: _Lift._lift_max,
    ExpressionKind.Min: _Lift._lift_min,
}
