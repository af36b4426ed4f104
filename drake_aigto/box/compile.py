"""Drake's MathematicalProgram → `BoxPolynomial`: the costs as a term table, or a refusal that names the term."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from pydrake.solvers import (
    Binding,
    EvaluatorBase,
    ExpressionCost,
    LinearCost,
    MathematicalProgram,
    QuadraticCost,
)
from pydrake.symbolic import Expression, ExpressionKind, Polynomial, Variable, Variables

from drake_aigto.box.functions import FunctionKind
from drake_aigto.box.polynomial import BoxPolynomial, Factor, Term, TermBlock
from drake_aigto.errors import UnsupportedTermError

_LocalIndex = Callable[[Variable], int]


def compile_program(prog: MathematicalProgram, order: ArrayLike | None = None) -> BoxPolynomial:
    """Compile the costs of a program into a term table.

    An evaluator that is bound to many sets of variables is parsed once. Constraints are not read: turn them into costs
    first (`transcription.penalize`).

    Args:
        prog: Costs may be linear, quadratic, or `ExpressionCost`s that sum polynomial terms, `max(0, a·x + b)²` and
            `log(a·x + b)` with constant factors.
        order: Elimination order of the decision variables, see `BoxPolynomial`.

    Raises:
        UnsupportedTermError: A term has no closed-form mean here; the message names the cost and the term.
    """
    grouped: dict[int, list[Binding]] = {}
    for binding in prog.GetAllCosts():
        grouped.setdefault(id(binding.evaluator()), []).append(binding)
    blocks = []
    for bindings in grouped.values():
        evaluator = bindings[0].evaluator()
        name = evaluator.get_description() or type(evaluator).__name__
        variables = [prog.FindDecisionVariableIndices(b.variables()) for b in bindings]
        blocks.append(TermBlock(name, _parse_cost(name, evaluator), np.array(variables)))
    return BoxPolynomial(prog.num_vars(), tuple(blocks), order)


def _parse_cost(name: str, cost: EvaluatorBase) -> tuple[Term, ...]:
    """The terms of one cost over its own variables 0 … L−1."""
    if isinstance(cost, LinearCost):
        return _affine_terms(cost.a(), cost.b())
    if isinstance(cost, QuadraticCost):
        return _quadratic_terms(cost.Q(), cost.b(), cost.c())
    if isinstance(cost, ExpressionCost):
        index = {v.get_id(): i for i, v in enumerate(cost.vars())}
        return _parse_expression(name, cost.expression(), lambda v: index[v.get_id()])
    raise UnsupportedTermError(
        what=f"the cost '{name}' can't be integrated",
        got=f"an opaque {type(cost).__name__}, whose formula Drake does not give back",
        expected="a LinearCost, a QuadraticCost or an ExpressionCost",
        remedy="add it as `c = ExpressionCost(expression); prog.AddCost(c, vars=c.vars())`",
    )


def _affine_terms(a: Sequence[float], b: float) -> tuple[Term, ...]:
    linear = (Term(float(a[i]), (_power(i, 1),)) for i in np.flatnonzero(a))
    return (*linear, *_constant_term(b))


def _constant_term(value: float) -> tuple[Term, ...]:
    return (Term(float(value), ()),) if value else ()


def _quadratic_terms(q: np.ndarray, b: np.ndarray, c: float) -> tuple[Term, ...]:
    """½ xᵀQx + bᵀx + c."""
    symmetric = 0.5 * (q + q.T)
    squares = (Term(0.5 * symmetric[i, i], (_power(i, 2),)) for i in np.flatnonzero(np.diag(q)))
    products = (
        Term(symmetric[i, j], (_power(i, 1), _power(j, 1)))
        for i, j in np.argwhere(np.triu(symmetric, 1))
    )
    return (*squares, *products, *_affine_terms(b, c))


def _power(variable: int, exponent: int) -> Factor:
    return Factor(int(variable), FunctionKind.POWER, int(exponent))


def _parse_expression(
    name: str, expression: Expression, index: _LocalIndex
) -> tuple[Term, ...]:
    """Split a sum into its polynomial part and its one-variable functions."""
    terms: list[Term] = []
    polynomial = Expression(0.0)
    for summand in _summands(expression):
        if summand.is_polynomial():
            polynomial += summand
        else:
            terms.append(_one_variable_term(name, summand, index))
    return (*_polynomial_terms(polynomial, index), *terms)


def _summands(expression: Expression) -> list[Expression]:
    if expression.get_kind() != ExpressionKind.Add:
        return [expression]
    return _operands(expression)


def _operands(expression: Expression) -> list[Expression]:
    """Arguments of an operation; Drake gives constants back as floats."""
    return [e if isinstance(e, Expression) else Expression(e) for e in expression.Unapply()[1]]


def _polynomial_terms(expression: Expression, index: _LocalIndex) -> tuple[Term, ...]:
    terms = []
    for monomial, coefficient in Polynomial(expression).monomial_to_coefficient_map().items():
        powers = monomial.get_powers().items()
        factors = sorted((_power(index(v), p) for v, p in powers), key=lambda f: f.variable)
        terms.append(Term(coefficient.Evaluate(), tuple(factors)))
    return tuple(terms)


def _one_variable_term(name: str, summand: Expression, index: _LocalIndex) -> Term:
    """constant · max(0, y)² or constant · log y, y affine in one variable."""
    coefficient, function = _split_constant(summand)
    matched = _match_squared_hinge(function) or _match_log(function)
    if matched is None or (affine := _affine_in_one_variable(matched[2])) is None:
        raise UnsupportedTermError(
            what=f"the cost '{name}' can't be integrated",
            got=f"the term {summand}",
            expected="polynomial terms, and max(0, y)² or log(y) with a constant factor, y affine in one variable",
            remedy="give a function of several variables a variable of its own by an equality constraint, "
            "or approximate the term by a polynomial",
        )
    kind, sign, _ = matched
    variable, scale, offset = affine
    # The table's functions are max(0, −y)² and −log y.
    y_sign = -1.0 if kind is FunctionKind.SQUARED_HINGE else 1.0
    factor = Factor(index(variable), kind, 1, y_sign * scale, y_sign * offset)
    return Term(sign * coefficient, (factor,))


def _split_constant(expression: Expression) -> tuple[float, Expression]:
    """Write an expression as constant · rest."""
    if expression.get_kind() != ExpressionKind.Mul:
        return 1.0, expression
    constant, *rest = _operands(expression)
    return constant.Evaluate(), functools.reduce(operator.mul, rest)


def _match_squared_hinge(e: Expression) -> tuple[FunctionKind, float, Expression] | None:
    """max(0, y)² ↦ y."""
    if e.get_kind() != ExpressionKind.Pow:
        return None
    base, exponent = _operands(e)
    if base.get_kind() != ExpressionKind.Max or not exponent.EqualTo(Expression(2.0)):
        return None
    first, second = _operands(base)
    zero = Expression(0.0)
    if first.EqualTo(zero):
        return FunctionKind.SQUARED_HINGE, 1.0, second
    if second.EqualTo(zero):
        return FunctionKind.SQUARED_HINGE, 1.0, first
    return None


def _match_log(e: Expression) -> tuple[FunctionKind, float, Expression] | None:
    """log y ↦ y."""
    if e.get_kind() != ExpressionKind.Log:
        return None
    return FunctionKind.NEG_LOG, -1.0, _operands(e)[0]


def _affine_in_one_variable(e: Expression) -> tuple[Variable, float, float] | None:
    """scale · x + offset ↦ (x, scale, offset)."""
    variables = list(e.GetVariables())
    if len(variables) != 1 or not e.is_polynomial():
        return None
    polynomial = Polynomial(e, Variables(variables))
    if polynomial.TotalDegree() != 1:
        return None
    offset = e.Evaluate({variables[0]: 0.0})
    return variables[0], e.Evaluate({variables[0]: 1.0}) - offset, offset
