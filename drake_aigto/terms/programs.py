"""Costs and constraints of Drake's MathematicalProgram → sums of `Term`s, or a refusal by name."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from pydrake import solvers
from pydrake.symbolic import Expression, Variable

from drake_aigto.arrays import Floats
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.terms.expressions import expression_terms, shown
from drake_aigto.terms.hidden_polynomials import HiddenError, is_hidden_polynomial, read_polynomial
from drake_aigto.terms.products import NoClosedFormError, from_terms, to_terms
from drake_aigto.terms.sums import Factor, FunctionKind, Term, TermBlock, with_own_numbers

# Drake evaluates their formulas with symbols for numbers.
NORM_COSTS = (
    solvers.L1NormCost,
    solvers.L2NormCost,
    solvers.LInfNormCost,
    solvers.PerspectiveQuadraticCost,
)
CONES = (
    solvers.LorentzConeConstraint,
    solvers.RotatedLorentzConeConstraint,
    solvers.ExponentialConeConstraint,
)

_Labelled = tuple[str, solvers.EvaluatorBase]  # how messages call it


def parse_costs(prog: solvers.MathematicalProgram) -> tuple[TermBlock, ...]:
    """Returns the costs of a program, over its decision variables.

    An evaluator that is bound to many sets of variables is parsed once, and like terms of costs
    that share their name and variables are merged. Constraints are not read: turn them into costs
    first (`drake_aigto.transcription.penalize`).

    Args:
        prog: Costs may be linear, quadratic, a PolynomialCost (`read_polynomial`), or
            `ExpressionCost` of sums of products of powers, sin, cos and exp of affine functions,
            but not of exp and sin or cos of the same variable; a·max(0, y)²; and −a·log y with
            a > 0 (y affine in one variable, a constant). Products and powers are multiplied out.

    Raises:
        UnsupportedTermError: A term has no closed-form mean here, or a cost has too many; the
            message names the cost and the term.
    """
    sums: dict[tuple[str, tuple[tuple[int, ...], ...]], list[_Labelled]] = {}
    for label, evaluator, copies in shared_evaluators(prog, prog.GetAllCosts()):
        alike = evaluator_name(evaluator), tuple(map(tuple, copies))
        sums.setdefault(alike, []).append((label, evaluator))
    return tuple(
        block
        for (name, copies), costs in sums.items()
        for block in term_blocks(name, _merged(_parse_alike(costs)), copies)
    )


def _parse_alike(costs: Sequence[_Labelled]) -> list[tuple[Term, ...]]:
    """Returns the terms of costs of the same variables, of polynomials as one sum where it fits.

    Where they share their monomials, as sums of squares do, that is most of the work saved.
    """
    parsed = []
    polynomials: dict[tuple[int, ...], list[tuple[str, solvers.ExpressionCost]]] = {}
    for label, cost in costs:
        if isinstance(cost, solvers.ExpressionCost) and cost.expression().is_polynomial():
            names = tuple(variable.get_id() for variable in cost.vars())
            polynomials.setdefault(names, []).append((label, cost))
        else:
            parsed.append(_parse_cost(label, cost))
    for alike in polynomials.values():
        total = sum((cost.expression() for _, cost in alike), Expression(0.0))
        try:
            parsed.append(expression_terms(alike[0][0], total, alike[0][1].vars()))
        except UnsupportedTermError:  # Too many terms in all, or in one, which is to be named.
            parsed += [_parse_cost(label, cost) for label, cost in alike]
    return parsed


def _merged(summands: Sequence[tuple[Term, ...]]) -> tuple[Term, ...]:
    """Returns one sum of several, like terms added up."""
    if len(summands) == 1:
        return summands[0]
    total: dict[tuple[Factor, ...], float] = {}
    for term in itertools.chain(*summands):
        total[term.factors] = total.get(term.factors, 0.0) + term.coefficient
    return tuple(Term(coefficient, factors) for factors, coefficient in total.items())


def shared_evaluators(
    prog: solvers.MathematicalProgram, bindings: Sequence[solvers.Binding]
) -> Iterator[tuple[str, solvers.EvaluatorBase, list[list[int]]]]:
    """Groups bindings by evaluator, so that each is parsed once.

    Yields:
        How messages call it, the evaluator, and the variables' indices of each of its bindings.
    """
    # The evaluators themselves are the keys, which keeps them alive: Drake's Python objects for
    # evaluators that were made in C++ are temporary, and the next one may be given the same id().
    grouped: dict[solvers.EvaluatorBase, list[solvers.Binding]] = {}
    for binding in bindings:
        grouped.setdefault(binding.evaluator(), []).append(binding)
    for evaluator, group in grouped.items():
        copies = [prog.FindDecisionVariableIndices(binding.variables()) for binding in group]
        yield evaluator_label(group[0]), evaluator, copies


def check_continuous(prog: solvers.MathematicalProgram) -> None:
    """Refuses variables that are not continuous.

    Raises:
        UnsupportedTermError: there is one, by name.
    """
    for variable in prog.decision_variables():
        if variable.get_type() != Variable.Type.CONTINUOUS:
            raise UnsupportedTermError(
                f"the variable {variable} can't be solved for",
                got=f"one of type {variable.get_type().name}",
                expected="continuous variables",
                remedy="Relax it, or use a mixed-integer solver.",
            )


def evaluator_name(evaluator: solvers.EvaluatorBase) -> str:
    """Returns the description, or else the type."""
    return evaluator.get_description() or evaluator_kind(evaluator)


def evaluator_kind(evaluator: solvers.EvaluatorBase) -> str:
    """Returns the type, of a PolynomialCost too, which has none in Python."""
    return "PolynomialCost" if is_hidden_polynomial(evaluator) else type(evaluator).__name__


def term_blocks(
    name: str, terms: tuple[Term, ...], copies: Sequence[Sequence[int]]
) -> Iterator[TermBlock]:
    """Yields blocks of one sum over the variables of its copies, some of which may repeat.

    Places that hold one variable are identified, x·y ↦ x² where y is x, as mean(x·x) is not
    mean(x)².
    """
    by_pattern: dict[tuple[int, ...], list[Sequence[int]]] = {}
    for variables in copies:
        first: dict[int, int] = {}  # The first place that holds a variable.
        pattern = tuple(first.setdefault(variable, i) for i, variable in enumerate(variables))
        by_pattern.setdefault(pattern, []).append(variables)
    for pattern, alike in by_pattern.items():
        identified = terms
        if pattern != tuple(range(len(pattern))):
            try:
                identified = to_terms(from_terms(terms, pattern))
            except NoClosedFormError as error:
                raise UnsupportedTermError(
                    f"the cost '{name}' can't be integrated where it is bound to a variable twice",
                    got=f"a term where {error}",
                    expected="factors whose product has a closed-form mean",
                    remedy="Write the cost out for that variable, to see what it is.",
                ) from None
        yield TermBlock(name, identified, alike)


def evaluator_label(binding: solvers.Binding) -> str:
    """Returns how messages call a cost or constraint: its name and its first variables."""
    evaluator = binding.evaluator()
    role = "cost" if isinstance(evaluator, solvers.Cost) else "constraint"
    variables = [str(v) for v in binding.variables()[:4]]
    listed = ", ".join([*variables[:3], "…"] if len(variables) > 3 else variables)
    name = f"the {role} '{evaluator_name(evaluator)}'"
    return f"{name} of {listed}" if listed else name


def _parse_cost(label: str, cost: solvers.EvaluatorBase) -> tuple[Term, ...]:
    """Returns the terms of one cost over its own variables 0 … L−1."""
    if isinstance(cost, solvers.LinearCost):
        return _affine_terms(cost.a(), cost.b())
    if isinstance(cost, solvers.QuadraticCost):
        return _quadratic_terms(np.asarray(cost.Q()), cost.b(), cost.c())
    if isinstance(cost, solvers.ExpressionCost):
        return expression_terms(label, cost.expression(), cost.vars())
    expected, got = "a LinearCost, a QuadraticCost or an ExpressionCost", evaluator_kind(cost)
    if is_hidden_polynomial(cost):
        try:
            return read_polynomial(cost)
        except HiddenError as error:
            got = f"{got}, whose formula Drake hides, and its values do not tell: {error}"
    raise UnsupportedTermError(
        f"{label} can't be integrated",
        got=f"a {got}",
        expected=expected,
        remedy="Add it as `c = ExpressionCost(expression); prog.AddCost(c, vars=c.vars())`.",
    )


def _affine_terms(a: ArrayLike, b: float) -> tuple[Term, ...]:
    """Returns the terms of aᵀx + b."""
    a = np.asarray(a, dtype=float)
    linear = (Term(float(a[i]), (_power(i, 1),)) for i in np.flatnonzero(a).tolist())
    return (*linear, *((Term(float(b), ()),) if b else ()))


def _quadratic_terms(q: Floats, b: ArrayLike, c: float) -> tuple[Term, ...]:
    """Returns the terms of ½ xᵀQx + bᵀx + c."""
    terms = []
    for i, j in np.argwhere(q).tolist():
        if i == j:
            terms.append(Term(0.5 * float(q[i, i]), (_power(i, 2),)))
        elif i < j:  # Drake keeps Q symmetric
            terms.append(Term(float(q[i, j]), (_power(i, 1), _power(j, 1))))
    return (*terms, *_affine_terms(b, c))


def _power(variable: int, exponent: int) -> Factor:
    return Factor(variable, FunctionKind.POWER, exponent)


@dataclass(frozen=True, eq=False)
class ParsedRow:
    """Copies of a row lower ≤ Σ terms ≤ upper of a constraint.

    Attributes:
        label: How messages call the constraint.
        block: The terms over the variables that they read, and the program's of each copy.
        lower: Lower bound.
        upper: Upper bound.
        formula: The formula whose expansion the terms are, for messages.
        origin: The constraint, and the row's number there; None where rows were combined.
    """

    label: str
    block: TermBlock
    lower: float
    upper: float
    formula: Expression | None = None
    origin: tuple[solvers.EvaluatorBase, int] | None = None

    def __str__(self) -> str:
        """Returns the formula, or the beginning of a long one."""
        return _formula(self.block.terms, self.formula)

    @property
    def is_free(self) -> bool:
        """Whether it has no bound."""
        return bool(np.isneginf(self.lower) and np.isposinf(self.upper))

    @property
    def is_equality(self) -> bool:
        """Whether both bounds are one."""
        return self.lower == self.upper

    def divided(self, size: float) -> ParsedRow:
        """Returns the row with all its numbers divided by a size."""
        if size == 1.0:
            return self
        block = self.block.with_coefficients([a.coefficient / size for a in self.block.terms])
        return replace(self, block=block, lower=self.lower / size, upper=self.upper / size)

    def tighten(self, lower: Floats, upper: Floats) -> bool:
        """Tightens bounds (n,) in place if the row is scale · x + offset; returns whether it is."""
        constant = sum(term.coefficient for term in self.block.terms if not term.factors)
        linear = [term for term in self.block.terms if term.factors]
        if len(linear) != 1 or len(linear[0].factors) != 1:
            return False
        (factor,), scale = linear[0].factors, linear[0].coefficient
        if factor.kind != FunctionKind.POWER or factor.exponent != 1 or scale == 0.0:
            return False
        low, high = sorted(((self.lower - constant) / scale, (self.upper - constant) / scale))
        index = self.block.variables[:, factor.variable]
        np.maximum.at(lower, index, low)
        np.minimum.at(upper, index, high)
        return True


def parse_rows(
    label: str, constraint: solvers.EvaluatorBase, copies: Sequence[Sequence[int]]
) -> Iterator[ParsedRow]:
    """Yields the rows of one constraint, those apart whose copies are bound to a variable twice.

    Args:
        label: How messages call it.
        constraint: Linear, quadratic, or an `ExpressionConstraint` of sums of products of powers,
            sin, cos and exp of affine functions.
        copies: Which variables of the program it is bound to, K times.

    Raises:
        UnsupportedTermError: It is another one, or a number is NaN.
    """
    sums = _row_sums(label, constraint)
    bound_to = np.array(copies, dtype=np.int64)
    is_symbolic = isinstance(constraint, solvers.ExpressionConstraint)
    formulas = constraint.expressions() if is_symbolic else [None] * len(sums)
    bounds = (side.tolist() for side in (constraint.lower_bound(), constraint.upper_bound()))
    rows = zip(sums, *bounds, formulas, strict=True)
    for number, (terms, lower, upper, formula) in enumerate(rows):
        numbers = [term.coefficient for term in terms]
        if not np.all(np.isfinite(numbers)) or np.any(np.isnan([lower, upper])):
            row = f"{lower:g} ≤ {_formula(terms, formula)} ≤ {upper:g}"
            raise UnsupportedTermError(
                f"{label} can't be compiled",
                got=f"a number that is NaN or infinite in {row}",
                expected="finite coefficients",
                remedy="Look for a parameter that was not set.",
            )
        own, read = with_own_numbers(terms)
        for block in term_blocks(evaluator_name(constraint), own, bound_to[:, read].tolist()):
            yield ParsedRow(label, block, lower, upper, formula, (constraint, number))


def _formula(terms: Sequence[Term], formula: Expression | None) -> str:
    return shown(" + ".join(map(str, terms)) if formula is None else formula)


def _row_sums(label: str, constraint: solvers.EvaluatorBase) -> list[tuple[Term, ...]]:
    """Returns the terms of each row."""
    if isinstance(constraint, solvers.BoundingBoxConstraint):
        return [(Term(1.0, (_power(i, 1),)),) for i in range(constraint.num_vars())]
    if isinstance(constraint, solvers.LinearConstraint):  # equalities among them
        return [_affine_terms(a, 0.0) for a in constraint.GetDenseA()]
    if isinstance(constraint, solvers.QuadraticConstraint):
        return [_quadratic_terms(np.asarray(constraint.Q()), constraint.b(), 0.0)]
    if isinstance(constraint, solvers.ExpressionConstraint):
        variables, formulas = constraint.vars(), constraint.expressions()
        return [expression_terms(label, each, variables, is_row=True) for each in formulas]
    raise UnsupportedTermError(
        f"{label} can't be compiled",
        got=f"a {type(constraint).__name__}",
        expected="bounds, or a linear, quadratic or expression constraint",
        remedy="Write it symbolically: prog.AddConstraint(expression == 0).",
    )


def read_bounds(prog: solvers.MathematicalProgram) -> tuple[Floats, Floats]:
    """Returns the tightest lower and upper bound of each decision variable, shape (n,) each."""
    lower, upper = np.full(prog.num_vars(), -np.inf), np.full(prog.num_vars(), np.inf)
    for binding in prog.bounding_box_constraints():
        index = prog.FindDecisionVariableIndices(binding.variables())
        with np.errstate(invalid="ignore"):  # NaN stays
            np.maximum.at(lower, index, binding.evaluator().lower_bound())
            np.minimum.at(upper, index, binding.evaluator().upper_bound())
    return lower, upper
