"""Drake's symbolic expressions → sums of `Term`s, or a refusal that names the term."""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Iterable, Mapping
from typing import Any, cast

from pydrake.symbolic import (
    DecomposeAffineExpression,
    Expression,
    ExpressionKind,
    ExtractVariablesFromExpression,
    Polynomial,
    Variable,
)

from drake_aigto.errors import UnsupportedTermError
from drake_aigto.terms import products
from drake_aigto.terms.sums import WAVES, Factor, FunctionKind, Term

# Id of a variable ↦ its place among those that an evaluator is bound to.
LocalIndex = Mapping[int, int]

_VARIABLE = operator.attrgetter("variable")

_LONGEST_SHOWN = 300  # characters of a formula in a message

_IN_ROWS = "sums of products of powers, sin, cos and exp of affine functions"
_IN_COSTS = f"{_IN_ROWS}, and max(0, y)² or -log(y) times a constant, with y affine in one variable"
_FOR_ROWS = "Multiply denominators out, and take exp of both sides of a logarithm. "
_FOR_ALL = (
    "Give a function of several variables a variable of its own by an equality constraint, or "
    "approximate the term by a polynomial."
)

_WAVES = {
    ExpressionKind.Cos: FunctionKind.COSINE,
    ExpressionKind.Sin: FunctionKind.SINE,
    ExpressionKind.Exp: FunctionKind.EXPONENTIAL,
}


def expression_terms(
    label: str, expression: Expression, variables: Iterable[Variable], is_row: bool = False
) -> tuple[Term, ...]:
    """Returns the terms of a sum of products of one-variable functions, multiplied out.

    Args:
        label: name in messages of the expression's cost or constraint.
        expression: See `parse_costs` for what may stand in it.
        variables: The local variables, in their order.
        is_row: Whether it is a row of a constraint, where penalties and barriers have no place.

    Raises:
        UnsupportedTermError: A term has no closed-form mean here, or there are too many.
    """
    try:
        index = {variable.get_id(): i for i, variable in enumerate(variables)}
        return _all_terms(label, expression, index, is_row)
    except products.TooManyTermsError as error:
        raise error.refusal(label, "when multiplied out") from None


def _all_terms(
    label: str, expression: Expression, index: LocalIndex, is_row: bool
) -> tuple[Term, ...]:
    polynomial, functions, is_sum = Expression(0.0), [], expression.get_kind() == ExpressionKind.Add
    is_whole = expression.is_polynomial() or not is_sum
    for summand in [expression] if is_whole else operands(expression):
        if summand.is_polynomial():
            polynomial += summand
        else:
            functions.append(_summand_terms(label, summand, index, is_row))
    _check_count(_count_monomials(polynomial)[0])
    terms = _polynomial_terms(polynomial, index)
    if not functions:
        return terms
    total = products.add(products.from_terms(terms), *functions)
    _check_count(len(total))
    return products.to_terms(total)


def _polynomial_terms(expression: Expression, index: LocalIndex) -> tuple[Term, ...]:
    """Returns the terms of a polynomial expression, multiplied out."""
    terms = []
    known: dict[tuple[int, int], Factor] = {}  # few factors make up many terms
    for monomial, coefficient in Polynomial(expression).monomial_to_coefficient_map().items():
        factors = []
        for variable, exponent in monomial.get_powers().items():
            key = variable.get_id(), exponent
            if key not in known:
                known[key] = Factor(index[key[0]], FunctionKind.POWER, exponent)
            factors.append(known[key])
        factors.sort(key=_VARIABLE)
        terms.append(Term(coefficient.Evaluate(), tuple(factors)))
    return tuple(terms)


def operands(expression: Expression) -> list[Expression]:
    """Returns arguments of an operation; Drake gives constants back as floats."""
    _, parts = cast("tuple[Any, list[Any]]", expression.Unapply())
    return [e if isinstance(e, Expression) else Expression(e) for e in parts]


def _summand_terms(
    label: str, summand: Expression, index: LocalIndex, is_row: bool
) -> products.Sum:
    """Returns the terms of one summand, or refuses it by name."""
    try:
        total = _expand(summand, index)
        if not is_row:
            _check_barriers(label, summand, total)
        # The square of a row must have a mean, too.
        elif not {p.kind for parts in total for p in parts} <= {FunctionKind.POWER, *WAVES}:
            raise products.NoClosedFormError("max(0, y)² or log(y) stands in a constraint")
    except products.NoClosedFormError as error:
        raise UnsupportedTermError(
            f"{label} can't be integrated",
            got=f"the term {shown(summand)}, where {error}",
            expected=_IN_ROWS if is_row else _IN_COSTS,
            remedy=(_FOR_ROWS if is_row else "") + _FOR_ALL,
        ) from None
    return total


def _check_barriers(label: str, summand: Expression, total: products.Sum) -> None:
    """Refuses logarithms that are not alone, or have not the sign of a barrier."""
    for parts, coefficient in total.items():
        if any(part.kind == FunctionKind.NEG_LOG for part in parts):
            if len(parts) > 1:
                raise products.NoClosedFormError("a logarithm is multiplied by another function")
            if coefficient < 0.0:
                raise UnsupportedTermError(
                    f"{label} can't be minimized",
                    got=f"the term {shown(summand)}, which falls to minus infinity where the "
                    "logarithm's argument is 0",
                    expected="logarithms as barriers, -a*log(y) with a > 0",
                    remedy="Check the term's sign.",
                )


def shown(formula: object) -> str:
    """Returns a formula's text, or the beginning of a long one."""
    text = str(formula)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]} …"


def _check_count(count: int) -> None:
    if count > products.MAX_TERMS:
        raise products.TooManyTermsError(count)


def _expand(e: Expression, index: LocalIndex) -> products.Sum:
    """Returns the terms of an expression.

    Raises:
        NoClosedFormError: Something in it is no sum of products of factors.
        TooManyTermsError: There are more than MAX_TERMS.
    """
    kind = e.get_kind()
    if e.is_polynomial():
        _check_count(_count_monomials(e)[0])
        return products.from_terms(_polynomial_terms(e, index))
    if kind == ExpressionKind.Add:
        return products.add(*(_expand(operand, index) for operand in operands(e)))
    if kind == ExpressionKind.Mul:
        return functools.reduce(
            products.multiply, (_expand(operand, index) for operand in operands(e))
        )
    if kind == ExpressionKind.Div:
        dividend, divisor = operands(e)
        if divisor.GetVariables():
            raise products.NoClosedFormError(f"the divisor {divisor} is not constant")
        number = divisor.Evaluate()
        return {parts: a / number for parts, a in _expand(dividend, index).items()}
    if kind == ExpressionKind.Pow:
        return _expand_power(e, index)
    if kind in _WAVES:
        scales, offset = _affine(e, operands(e)[0])
        return products.wave_of_sum(
            _WAVES[kind], [(index[v.get_id()], a) for v, a in scales], offset
        )
    if kind == ExpressionKind.Log:
        return _of_one_variable(-1.0, FunctionKind.NEG_LOG, e, operands(e)[0], index)
    if kind == ExpressionKind.Max:
        raise products.NoClosedFormError(f"{e} is not the square of a max(0, y)")
    raise products.NoClosedFormError(f"{e} has no closed-form mean")


def _expand_power(e: Expression, index: LocalIndex) -> products.Sum:
    base, exponent = operands(e)
    number = math.nan if exponent.GetVariables() else exponent.Evaluate()
    if not (number >= 0.0 and number == int(number)):
        raise products.NoClosedFormError(f"the exponent of {e} is not a whole number")
    factor, hinge = _split_constant(base)
    if hinge.get_kind() != ExpressionKind.Max or number != 2.0:
        return products.power(_expand(base, index), int(number))
    first, second = operands(hinge)
    zero = Expression(0.0)
    if not (first.EqualTo(zero) or second.EqualTo(zero)):
        raise products.NoClosedFormError(f"{hinge} is not max(0, y)")
    below = -second if first.EqualTo(zero) else -first  # the table has max(0, −y)²
    kind = FunctionKind.SQUARED_HINGE
    return _of_one_variable(factor * factor, kind, hinge, below, index)


def _split_constant(expression: Expression) -> tuple[float, Expression]:
    """Writes an expression as constant · rest."""
    constant, rest = 1.0, expression
    if rest.get_kind() == ExpressionKind.Div and not operands(rest)[1].GetVariables():
        rest, divisor = operands(rest)
        constant /= divisor.Evaluate()
    if rest.get_kind() == ExpressionKind.Mul:
        factor, *others = operands(rest)  # Drake puts the constant first, also when it is 1
        constant *= factor.Evaluate()
        rest = functools.reduce(operator.mul, others)
    return constant, rest


def _of_one_variable(
    coefficient: float, kind: FunctionKind, e: Expression, argument: Expression, index: LocalIndex
) -> products.Sum:
    """Returns coefficient times function of an affine argument, shown as e in messages."""
    scales, offset = _affine(e, argument)
    if len(scales) != 1:
        raise products.NoClosedFormError(f"{e} is a function of {len(scales)} variables at once")
    ((variable, scale),) = scales
    (parts,) = products.function(index[variable.get_id()], kind, 1, scale, offset)
    return {parts: coefficient}


def _affine(e: Expression, argument: Expression) -> tuple[list[tuple[Variable, float]], float]:
    """Returns [(x, scale), …] and the offset of e's argument Σ scale·x + offset."""
    variables, index = ExtractVariablesFromExpression(argument)
    try:
        scales, offset = DecomposeAffineExpression(argument, index)
    except RuntimeError:
        raise products.NoClosedFormError(f"the argument of {e} is not affine") from None
    pairs = zip(variables[::-1], scales[::-1].tolist(), strict=True)
    found = [(variable, scale) for variable, scale in pairs if scale != 0.0]
    return found or [(next(iter(e.GetVariables())), 0.0)], offset


def _count_monomials(e: Expression | float) -> tuple[int, int]:
    """Returns a bound on the monomials of a polynomial, without expanding it, and its degree.

    Of n variables and degree d there are at most C(n + d, d).
    """
    if not isinstance(e, Expression):  # a constant; sums have one also when it is 0
        return int(e != 0.0), 0
    kind = e.get_kind()
    if kind in (ExpressionKind.Constant, ExpressionKind.Var):
        return 1, int(kind == ExpressionKind.Var)
    _, parts = cast("tuple[Any, list[Any]]", e.Unapply())
    if kind == ExpressionKind.Pow:
        count, degree = _count_monomials(parts[0])
        exponent = int(operands(e)[1].Evaluate())
        count, degree = math.comb(count + exponent - 1, exponent), degree * exponent
    else:
        counts, degrees = zip(*map(_count_monomials, parts), strict=True)
        if kind == ExpressionKind.Add:
            count, degree = sum(counts), max(degrees)
        else:  # Mul, or Div by a constant
            count, degree = math.prod(counts), sum(degrees)
    if count > products.MAX_TERMS:
        count = min(count, math.comb(e.GetVariables().size() + degree, degree))
    return count, degree
