"""Functions without a mean in closed form, by variables of their own and rows that define them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pydrake.symbolic as sym
from pydrake import solvers
from pydrake.symbolic import Expression, ExpressionKind, Variable

from drake_aigto import terms
from drake_aigto.arrays import Floats
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.solver.signs import RowRange, Signs, interval

# Roots of a higher order are exponentials of logarithms.
_HIGHEST_ROOT = 6


@dataclass(frozen=True, eq=False)
class Lifted:
    """A program without such functions, over x and variables that stand for them."""

    prog: solvers.MathematicalProgram  # over (x, z)
    # The constraints that each of the source's constraints became, in order.
    rows: tuple[tuple[solvers.EvaluatorBase, ...], ...]
    formulas: tuple[Expression, ...] = ()  # of each z_i, over x and those before it

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


def lift(prog: solvers.MathematicalProgram) -> Lifted:
    """Returns a program in which all functions have means in closed form.

    A variable z stands for a function of others, which a row, or two, define:

        a/b          z b = a                       where b is not 0
        b^(p/q)      z^p,  z^q = b,  z ≥ 0         where b ≥ 0
        log b        exp z = b                     where b ≥ 0, and not 0 in an answer
        f(a)         f(z),  z = a                  of sin, cos or exp, a not affine
        atan a       sin z = a cos z,  |z| ≤ π/2; likewise asin and acos
        tanh a       1 − 2/(exp 2a + 1); likewise sinh and cosh
        |a|          z ≥ a,  z ≥ −a                where less of it is better; else z² = a²
        max(a, b)    z ≥ a,  z ≥ b                 likewise; else (a + b + |a − b|)/2

    Ranges of z follow from those of its function's arguments, by interval arithmetic.

    Raises:
        UnsupportedTermError: a function may have no value within the bounds, or is none of these.
    """
    return _Lift(prog).run()


def _formulas(binding: solvers.Binding) -> Sequence[Expression] | None:
    """Returns the formulas of a symbolic cost or constraint, a norm or a cone; None of others."""
    evaluator, variables = binding.evaluator(), binding.variables()
    if isinstance(evaluator, (*terms.NORM_COSTS, *terms.CONES)):
        formulas: Sequence[Expression] = evaluator.Eval(variables)
        return formulas
    if isinstance(evaluator, solvers.ExpressionConstraint):
        formulas = evaluator.expressions()
    elif isinstance(evaluator, solvers.ExpressionCost):
        formulas = [evaluator.expression()]
    else:
        return None
    both = zip(evaluator.vars(), variables, strict=True)
    pairs = {own: Expression(bound) for own, bound in both if not own.EqualTo(bound)}
    return [each.Substitute(pairs) if pairs else each for each in formulas]


def _rows(binding: solvers.Binding) -> Iterator[RowRange]:
    """Yields formulas and bounds of a linear or symbolic constraint, or a cone."""
    evaluator, variables = binding.evaluator(), binding.variables()
    formulas = _formulas(binding)
    if isinstance(evaluator, solvers.LinearConstraint):
        formulas = [
            sum((a * x for a, x in zip(row, variables, strict=True)), Expression(0.0))
            for row in evaluator.GetDenseA().tolist()
        ]
    if formulas is not None:
        yield from zip(formulas, evaluator.lower_bound(), evaluator.upper_bound(), strict=True)


class _Lift:
    """One run: the new program, its variables that stand for formulas, and all ranges."""

    def __init__(self, prog: solvers.MathematicalProgram) -> None:
        variables = prog.decision_variables()
        self._source, self._prog = prog, solvers.MathematicalProgram()
        self._prog.AddDecisionVariables(variables)
        self._known: dict[str, Variable] = {}
        self._formulas: list[Expression] = []
        bounds = zip(*(side.tolist() for side in terms.read_bounds(prog)), strict=True)
        self._ranges = {x.get_id(): pair for x, pair in zip(variables, bounds, strict=True)}
        rows = (row for binding in prog.GetAllConstraints() for row in _rows(binding))
        self._signs = Signs(rows, self._ranges)
        self._label, self._is_row = "", False

    def run(self) -> Lifted:
        """Copies costs and constraints that have means, and lifts the others."""
        for binding in self._source.GetAllCosts():
            self._add_cost(binding)
        constraints = self._source.GetAllConstraints()
        rows = tuple(tuple(self._add_constraint(binding)) for binding in constraints)
        return Lifted(self._prog, rows, tuple(self._formulas))

    def _add_cost(self, binding: solvers.Binding) -> None:
        self._label, self._is_row = terms.evaluator_label(binding), False
        formulas = _formulas(binding)
        if formulas is None:
            self._prog.AddCost(binding)
            return
        (formula,) = formulas
        cost = solvers.ExpressionCost(self._lift(formula, 1))
        cost.set_description(terms.evaluator_name(binding.evaluator()))
        self._prog.AddCost(cost, vars=cost.vars())

    def _add_constraint(self, binding: solvers.Binding) -> Iterator[solvers.EvaluatorBase]:
        """Adds the lifted constraints of one, and yields them."""
        evaluator = binding.evaluator()
        self._label, self._is_row = terms.evaluator_label(binding), True
        if _formulas(binding) is None:
            self._prog.AddConstraint(binding)
            yield evaluator
            return
        for formula, low, high in _rows(binding):
            # Where only less of it, or more, breaks the row.
            sign = int(math.isinf(low)) - int(math.isinf(high))
            yield self._add_row(
                terms.evaluator_name(evaluator), self._lift(formula, sign), low, high
            )

    def _add_row(
        self, name: str, formula: Expression, low: float, high: float
    ) -> solvers.EvaluatorBase:
        row = solvers.ExpressionConstraint(np.array([formula]), np.array([low]), np.array([high]))
        row.set_description(name)
        self._prog.AddConstraint(row, vars=row.vars())
        return row

    def _has_mean(self, e: Expression) -> bool:
        try:
            terms.expression_terms("", e, list(e.GetVariables()), self._is_row)
        except UnsupportedTermError:
            return False
        return True

    def _lift(self, e: Expression, sign: int = 0) -> Expression:
        """Returns an expression that has a mean.

        Args:
            e: the expression that it stands for.
            sign: 1 where less of it is better whatever else there is, −1 where more is; else 0.
        """
        if self._has_mean(e):
            return e
        kind = e.get_kind()
        if kind == ExpressionKind.Add:
            return sum((self._lift(each, sign) for each in terms.operands(e)), Expression(0.0))
        if kind == ExpressionKind.Mul:
            return self._lift_product(e, sign)
        if kind == ExpressionKind.Div and not terms.operands(e)[1].GetVariables():
            above, below = terms.operands(e)
            return self._lift(above, sign if self._evaluate(below) > 0 else -sign) / below
        if kind in _WAVES:
            return _WAVES[kind](self._alone(terms.operands(e)[0]))
        if kind in _FORMULAS:
            return self._lift(_FORMULAS[kind](terms.operands(e)[0]), sign)
        rule = _RULES.get(kind)
        if rule is None:
            raise self._refusal(e, "which has no equation of means", "Write it by other functions.")
        return rule(self, e, sign)

    def _lift_product(self, e: Expression, sign: int) -> Expression:
        """Returns a product whose factors have a mean, and then together, one by one alone."""
        number, rest = self._split_number(e)
        others = terms.operands(rest) if rest.get_kind() == ExpressionKind.Mul else [rest]
        inner = sign * int(math.copysign(1.0, number)) if len(others) == 1 else 0
        found = Expression(number)
        for each in others:
            lifted = self._lift(each, inner)
            product = found * lifted
            found = product if self._has_mean(product) else found * self._alone(lifted)
        return found

    def _lift_for_row(self, e: Expression, sign: int = 0) -> Expression:
        """Returns an expression that may stand in a row, wherever the given one is."""
        was_row, self._is_row = self._is_row, True
        lifted = self._lift(e, sign)
        self._is_row = was_row
        return lifted

    def _alone(self, e: Expression) -> Expression:
        """Returns an affine expression that stands for another: a variable, if it is not affine."""
        lifted = self._lift_for_row(e)
        if lifted.is_polynomial() and sym.Polynomial(lifted).TotalDegree() <= 1:
            return lifted
        return self._variable(e, lambda z: [z - lifted])

    def _variable(
        self, e: Expression, rows: Callable[[Expression], list[Expression]], is_bound: bool = False
    ) -> Expression:
        """Returns the variable that stands for an expression, with rows that say so.

        Args:
            e: the expression.
            rows: formulas of the variable that are 0.
            is_bound: whether they are only at or above 0, and hold it no more than above e.
        """
        name = f"bound of {e}" if is_bound else str(e)
        if name not in self._known:
            z = Variable(terms.shown(e))
            low, high = interval(e, self._ranges)
            self._prog.AddDecisionVariables(np.array([z]))
            self._prog.AddBoundingBoxConstraint(low, high, z)
            self._ranges[z.get_id()] = low, high
            self._formulas.append(e)
            self._known[name] = z
            for formula in rows(Expression(z)):
                most = np.inf if is_bound else 0.0
                self._add_row(terms.shown(f"{e} in {self._label}"), formula, 0.0, most)
        return Expression(self._known[name])

    def _require(self, e: Expression, function: Expression, is_strict: bool = True) -> None:
        """Refuses a function of e where e may be too low for it."""
        if self._signs.find(e, is_strict) <= 0:
            need = f"{terms.shown(e)} {'>' if is_strict else '>='} 0"
            remedy = f"Bound its variables such that {need}, or add that as a constraint."
            expected = f"an argument {'>' if is_strict else '>='} 0"
            raise self._refusal(function, self._where(e), remedy, expected)

    def _where(self, e: Expression) -> str:
        low, high = interval(e, self._ranges)
        return f"where {terms.shown(e)} is in [{low:g}, {high:g}] for all that bounds say"

    def _refusal(
        self, e: Expression, got: str, remedy: str, expected: str | None = None
    ) -> UnsupportedTermError:
        return UnsupportedTermError(
            f"{self._label} can't be searched", f"{terms.shown(e)}, {got}", expected, remedy
        )

    def _evaluate(self, e: Expression) -> float:
        """Returns the value of an expression without variables."""
        try:
            return e.Evaluate()
        except RuntimeError as error:  # NaN, or a division by zero
            remedy = "Look for a parameter that was not set, or a division by zero."
            raise self._refusal(e, "which is no number", remedy, "finite numbers") from error

    def _split_number(self, e: Expression) -> tuple[float, Expression]:
        """Returns the numeric factor of an expression, and its other factors."""
        if e.get_kind() != ExpressionKind.Mul:
            return 1.0, e
        factors = terms.operands(e)
        number = math.prod(self._evaluate(each) for each in factors if not each.GetVariables())
        others = (each for each in factors if each.GetVariables())
        return number, math.prod(others, start=Expression(1.0))

    def _lift_quotient(self, e: Expression, _: int = 0) -> Expression:
        above, below = terms.operands(e)
        number, rest = self._split_number(above)
        if number not in (0.0, 1.0):
            return number * self._lift(rest / below)  # No quotient any more where both are alike.
        if not self._signs.find(below):
            remedy = (
                f"Bound its variables such that {terms.shown(below)} keeps its sign and is not 0."
            )
            raise self._refusal(e, self._where(below), remedy, "a divisor that is not 0")
        top, bottom = self._lift_for_row(above), self._lift_for_row(below)
        return self._variable(e, lambda z: [z * bottom - top])

    def _lift_power(self, e: Expression, _: int) -> Expression:
        base, exponent = terms.operands(e)
        if exponent.GetVariables():
            return self._lift(sym.exp(exponent * sym.log(base)))
        p = exponent.Evaluate()
        if p < 0.0:
            return self._lift_quotient(1.0 / sym.pow(base, -p))
        if p == int(p):
            return sym.pow(self._alone(base), p)
        part = Fraction(p).limit_denominator(_HIGHEST_ROOT)
        if float(part) != p and abs(float(part) - p) > 1e-12:
            return self._lift(sym.exp(p * sym.log(base)))
        return self._root(e, base, part)

    def _root(self, e: Expression, base: Expression, part: Fraction) -> Expression:
        self._require(base, e, is_strict=False)
        right, q = self._lift_for_row(base), part.denominator
        root = sym.sqrt(base) if q == 2 else sym.pow(base, 1.0 / q)
        return sym.pow(self._variable(root, lambda z: [sym.pow(z, q) - right]), part.numerator)

    def _lift_inverse(self, e: Expression, _: int) -> Expression:
        (argument,) = terms.operands(e)
        if e.get_kind() == ExpressionKind.Log:
            # At 0 itself it has no value, and exp z = 0 has no solution.
            self._require(argument, e, is_strict=False)
        else:
            self._require(1.0 - argument, e, is_strict=False)
            self._require(1.0 + argument, e, is_strict=False)
        wave, right = _INVERSES[e.get_kind()], self._lift_for_row(argument)
        return self._variable(e, lambda z: [wave(z) - right])

    def _lift_inverse_tangent(self, e: Expression, _: int) -> Expression:
        above = self._lift_for_row(terms.operands(e)[0])
        return self._variable(e, lambda z: [sym.sin(z) - above * sym.cos(z)])

    def _lift_abs(self, e: Expression, sign: int) -> Expression:
        (argument,) = terms.operands(e)
        if sign > 0:
            a = self._lift_for_row(argument)
            return self._variable(e, lambda z: [z - a, z + a], is_bound=True)
        own = self._alone(argument)
        return self._variable(e, lambda z: [z**2 - own**2])

    def _lift_max(self, e: Expression, sign: int) -> Expression:
        a, b = terms.operands(e)
        if sign > 0:
            sides = [self._lift_for_row(each, sign) for each in (a, b)]
            return self._variable(e, lambda z: [z - each for each in sides], is_bound=True)
        return self._lift((a + b + sym.abs(a - b)) / 2, sign)


_WAVES = {ExpressionKind.Sin: sym.sin, ExpressionKind.Cos: sym.cos, ExpressionKind.Exp: sym.exp}
# Functions by formulas of others.
_FORMULAS: Mapping[ExpressionKind, Callable[[Expression], Expression]] = {
    ExpressionKind.Tan: lambda a: sym.sin(a) / sym.cos(a),
    ExpressionKind.Tanh: lambda a: 1.0 - 2.0 / (sym.exp(2.0 * a) + 1.0),
    ExpressionKind.Sinh: lambda a: (sym.exp(a) + -1.0 * sym.exp(-a)) / 2.0,
    ExpressionKind.Cosh: lambda a: (sym.exp(a) + 1.0 * sym.exp(-a)) / 2.0,
}
# Waves that give a function's argument.
_INVERSES: Mapping[ExpressionKind, Callable[[Expression], Expression]] = {
    ExpressionKind.Log: sym.exp,
    ExpressionKind.Asin: sym.sin,
    ExpressionKind.Acos: sym.cos,
}
_RULES: Mapping[ExpressionKind, Callable[[_Lift, Expression, int], Expression]] = {
    **dict.fromkeys(_INVERSES, _Lift._lift_inverse),
    ExpressionKind.Div: _Lift._lift_quotient,
    ExpressionKind.Pow: _Lift._lift_power,
    ExpressionKind.Sqrt: lambda lift, e, _: lift._root(e, terms.operands(e)[0], Fraction(1, 2)),
    ExpressionKind.Atan: _Lift._lift_inverse_tangent,
    ExpressionKind.Abs: _Lift._lift_abs,
    ExpressionKind.Max: _Lift._lift_max,
    ExpressionKind.Min: lambda lift, e, sign: (
        -lift._lift_max(sym.max(*(-each for each in terms.operands(e))), -sign)
    ),
}
