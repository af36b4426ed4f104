"""Drake's MathematicalProgram → `BoxPolynomial`: a term table, or a refusal that names the term."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.solvers import (
    Binding,
    Cost,
    EvaluatorBase,
    ExpressionCost,
    LinearCost,
    MathematicalProgram,
    QuadraticCost,
)
from pydrake.symbolic import Expression, ExpressionKind, Monomial, Polynomial, Variable

from drake_aigto.box.functions import FunctionKind
from drake_aigto.box.polynomial import BoxPolynomial, Factor, Term, TermBlock
from drake_aigto.errors import UnsupportedTermError

# Place of a variable among those that an evaluator is bound to.
LocalIndex = Callable[[Variable], int]


def compile_program(prog: MathematicalProgram, order: ArrayLike | None = None) -> BoxPolynomial:
    """Compile the costs of a program into a term table.

    An evaluator that is bound to many sets of variables is parsed once. Constraints are not read:
    turn them into costs first (`transcription.penalize`).

    Args:
        prog: Costs may be linear, quadratic, or `ExpressionCost`s that sum polynomial terms,
            a·max(0, y)² and −a·log y with a constant a and y affine in one variable (a > 0 for the
            logarithm).
        order: Elimination order of the decision variables, see `BoxPolynomial`.

    Raises:
        UnsupportedTermError: A term has no closed-form mean here; the message names the cost and
            the term.
    """
    blocks = [
        block
        for label, evaluator, copies in shared_evaluators(prog, prog.GetAllCosts())
        for block in term_blocks(evaluator_name(evaluator), _parse_cost(label, evaluator), copies)
    ]
    return BoxPolynomial(prog.num_vars(), tuple(blocks), order)


def shared_evaluators(
    prog: MathematicalProgram, bindings: Sequence[Binding]
) -> Iterator[tuple[str, EvaluatorBase, list[list[int]]]]:
    """Group bindings by evaluator, so that each is parsed once.

    Yields:
        How messages call it, the evaluator, and the variables' indices of each of its bindings.
    """
    # The evaluators themselves are the keys, which keeps them alive: Drake's Python objects for
    # evaluators that were made in C++ are temporary, and the next one may be given the same id().
    grouped: dict[EvaluatorBase, list[Binding]] = {}
    for binding in bindings:
        grouped.setdefault(binding.evaluator(), []).append(binding)
    for evaluator, group in grouped.items():
        copies = [prog.FindDecisionVariableIndices(binding.variables()) for binding in group]
        yield _label(group[0]), evaluator, copies


def evaluator_name(evaluator: EvaluatorBase) -> str:
    """The description, or else the type."""
    return evaluator.get_description() or type(evaluator).__name__


def term_blocks(
    name: str, terms: tuple[Term, ...], copies: Sequence[Sequence[int]]
) -> Iterator[TermBlock]:
    """Blocks of one sum of terms over the variables of its copies, some of which may repeat."""
    by_pattern: dict[tuple[int, ...], list[Sequence[int]]] = {}
    for variables in copies:
        by_pattern.setdefault(_repetition(variables), []).append(variables)
    for pattern, alike in by_pattern.items():
        yield TermBlock(name, _identify(terms, pattern), alike)


def _label(binding: Binding) -> str:
    """How messages call a cost or constraint: its name and its first variables."""
    evaluator = binding.evaluator()
    role = "cost" if isinstance(evaluator, Cost) else "constraint"
    variables = [str(v) for v in binding.variables()[:4]]
    listed = ", ".join([*variables[:3], "…"] if len(variables) > 3 else variables)
    name = f"the {role} '{evaluator_name(evaluator)}'"
    return f"{name} of {listed}" if listed else name


def _repetition(variables: Sequence[int]) -> tuple[int, ...]:
    """For each place of a binding, the first place that holds the same variable."""
    first: dict[int, int] = {}
    return tuple(first.setdefault(variable, place) for place, variable in enumerate(variables))


def _identify(terms: tuple[Term, ...], pattern: tuple[int, ...]) -> tuple[Term, ...]:
    """The terms once places that hold one variable are identified: x·y ↦ x² where y is x.

    A cost may be bound to the same variable twice, and mean(x·x) is not mean(x)². Only powers
    x^p stand in products here.
    """
    if pattern == tuple(range(len(pattern))):
        return terms
    identified = []
    for term in terms:
        powers: dict[int, int] = {}
        others = []
        for factor in term.factors:
            variable = pattern[factor.variable]
            if factor.kind == FunctionKind.POWER:
                powers[variable] = powers.get(variable, 0) + factor.exponent
            else:
                others.append(replace(factor, variable=variable))
        factors = (*others, *(_power(i, p) for i, p in powers.items()))
        identified.append(Term(term.coefficient, factors))
    return tuple(identified)


def _parse_cost(label: str, cost: EvaluatorBase) -> tuple[Term, ...]:
    """The terms of one cost over its own variables 0 … L−1."""
    if isinstance(cost, LinearCost):
        return affine_terms(cost.a(), cost.b())
    if isinstance(cost, QuadraticCost):
        return quadratic_terms(np.asarray(cost.Q()), cost.b(), cost.c())
    if isinstance(cost, ExpressionCost):
        index = {v.get_id(): i for i, v in enumerate(cost.vars())}
        return _parse_expression(label, cost.expression(), lambda v: index[v.get_id()])
    # PolynomialCost has no Python class of its own.
    kind = "PolynomialCost" if type(cost) is Cost else type(cost).__name__
    raise UnsupportedTermError(
        f"{label} can't be integrated",
        got=f"a {kind}, whose formula Drake does not give back",
        expected="a LinearCost, a QuadraticCost or an ExpressionCost",
        remedy="Add it as `c = ExpressionCost(expression); prog.AddCost(c, vars=c.vars())`.",
    )


def affine_terms(a: ArrayLike, b: float) -> tuple[Term, ...]:
    """The terms of aᵀx + b."""
    linear = (Term(float(a_i), (_power(i, 1),)) for i, a_i in enumerate(np.asarray(a)) if a_i)
    return (*linear, *_constant_term(b))


def _constant_term(value: float) -> tuple[Term, ...]:
    return (Term(float(value), ()),) if value else ()


def quadratic_terms(q: NDArray[np.float64], b: ArrayLike, c: float) -> tuple[Term, ...]:
    """The terms of ½ xᵀQx + bᵀx + c."""
    terms = []
    for i, j in np.argwhere(q).tolist():
        if i == j:
            terms.append(Term(0.5 * float(q[i, i]), (_power(i, 2),)))
        elif i < j:  # Drake keeps Q symmetric
            terms.append(Term(float(q[i, j]), (_power(i, 1), _power(j, 1))))
    return (*terms, *affine_terms(b, c))


def _power(variable: int, exponent: int) -> Factor:
    return Factor(variable, FunctionKind.POWER, exponent)


def _parse_expression(label: str, expression: Expression, index: LocalIndex) -> tuple[Term, ...]:
    """Split a sum into its polynomial part and its one-variable functions."""
    terms: list[Term] = []
    polynomial = Expression(0.0)
    for summand in _summands(expression):
        if summand.is_polynomial():
            polynomial += summand
        else:
            terms.append(_one_variable_term(label, summand, index))
    return (*polynomial_terms(polynomial, index), *terms)


def _summands(expression: Expression) -> Iterator[Expression]:
    """Polynomial parts as they stand, and the rest multiplied out."""
    if expression.is_polynomial():
        yield expression
    elif expression.get_kind() == ExpressionKind.Add:
        for operand in _operands(expression):
            yield from _summands(operand)
    else:
        try:
            expanded = expression.Expand()
        except RuntimeError:  # Drake expands neither if-then-else nor NaN
            expanded = expression
        yield from _operands(expanded) if expanded.get_kind() == ExpressionKind.Add else [expanded]


def _operands(expression: Expression) -> list[Expression]:
    """Arguments of an operation; Drake gives constants back as floats."""
    _, operands = cast("tuple[Any, list[Any]]", expression.Unapply())
    return [e if isinstance(e, Expression) else Expression(e) for e in operands]


def polynomial_terms(expression: Expression, index: LocalIndex) -> tuple[Term, ...]:
    """The terms of a polynomial expression, multiplied out."""
    terms = []
    for monomial, coefficient in Polynomial(expression).monomial_to_coefficient_map().items():
        powers = monomial.get_powers().items()
        factors = sorted((_power(index(v), p) for v, p in powers), key=lambda f: f.variable)
        terms.append(Term(coefficient.Evaluate(), tuple(factors)))
    return tuple(terms)


def _one_variable_term(label: str, summand: Expression, index: LocalIndex) -> Term:
    """The term constant · max(0, y)² or −constant · log y, y affine in one variable."""
    constant, function = _split_constant(summand)
    matched = _match_squared_hinge(function) or _match_log(function)
    affine = _affine_in_one_variable(matched[1]) if matched else None
    if matched is None or affine is None:
        raise UnsupportedTermError(
            f"{label} can't be integrated",
            got=f"the term {summand}",
            expected="polynomial terms, and max(0, y)² or -log(y) times a constant, "
            "with y affine in one variable",
            remedy="Give a function of several variables a variable of its own by an equality "
            "constraint, or approximate the term by a polynomial.",
        )
    kind = matched[0]
    if kind is FunctionKind.NEG_LOG:
        constant = -constant
        if constant < 0.0:
            raise UnsupportedTermError(
                f"{label} can't be minimised",
                got=f"the term {summand}, which falls to minus infinity where its argument is 0",
                expected="logarithms as barriers, -a*log(y) with a > 0",
                remedy="Check the term's sign.",
            )
    variable, scale, offset = affine
    return Term(constant, (Factor(index(variable), kind, 1, scale, offset),))


def _split_constant(expression: Expression) -> tuple[float, Expression]:
    """Write an expression as constant · rest."""
    if expression.get_kind() != ExpressionKind.Mul:
        return 1.0, expression
    constant, *rest = _operands(expression)  # Drake puts the constant first, also when it is 1
    return constant.Evaluate(), functools.reduce(operator.mul, rest)


def _match_squared_hinge(e: Expression) -> tuple[FunctionKind, Expression] | None:
    """Read max(0, y)² as the table's max(0, −(−y))²: SQUARED_HINGE of −y."""
    if e.get_kind() != ExpressionKind.Pow:
        return None
    base, exponent = _operands(e)
    if base.get_kind() != ExpressionKind.Max or not exponent.EqualTo(Expression(2.0)):
        return None
    first, second = _operands(base)
    zero = Expression(0.0)
    if first.EqualTo(zero):
        return FunctionKind.SQUARED_HINGE, -second
    if second.EqualTo(zero):
        return FunctionKind.SQUARED_HINGE, -first
    return None


def _match_log(e: Expression) -> tuple[FunctionKind, Expression] | None:
    """Read log y as minus the table's −log y."""
    if e.get_kind() != ExpressionKind.Log:
        return None
    return FunctionKind.NEG_LOG, _operands(e)[0]


def _affine_in_one_variable(e: Expression) -> tuple[Variable, float, float] | None:
    """The parts (x, scale, offset) of scale · x + offset."""
    if len(e.GetVariables()) != 1 or not e.is_polynomial():
        return None
    polynomial = Polynomial(e)
    if polynomial.TotalDegree() != 1:
        return None
    (variable,) = polynomial.indeterminates()
    parts = polynomial.monomial_to_coefficient_map()
    offset = parts.get(Monomial(), Expression(0.0))
    return variable, parts[Monomial(variable)].Evaluate(), offset.Evaluate()
