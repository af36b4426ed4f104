"""Constraints of Drake's MathematicalProgram → rows of `Term`s, or a refusal that names one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydrake.solvers import (
    BoundingBoxConstraint,
    EvaluatorBase,
    ExponentialConeConstraint,
    ExpressionConstraint,
    LinearConstraint,
    LorentzConeConstraint,
    QuadraticConstraint,
    RotatedLorentzConeConstraint,
)
from pydrake.symbolic import Expression

from drake_aigto.arrays import Ints
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.terms.costs import affine_terms, quadratic_terms
from drake_aigto.terms.expressions import expression_terms, shown
from drake_aigto.terms.sums import Factor, FunctionKind, Term

# Drake evaluates their formulas with symbols for numbers.
CONES = (LorentzConeConstraint, RotatedLorentzConeConstraint, ExponentialConeConstraint)


@dataclass(frozen=True)
class ConstraintRow:
    """lower ≤ Σ terms ≤ upper, over the variables that the row reads.

    Attributes:
        terms: The sum's terms.
        lower: Its lower bound.
        upper: Its upper bound.
        formula: What the terms are the expansion of, for messages.
    """

    terms: tuple[Term, ...]
    lower: float
    upper: float
    formula: Expression | None = None

    def __str__(self) -> str:
        """Returns the formula, or the beginning of a long one."""
        return shown(" + ".join(map(str, self.terms)) if self.formula is None else self.formula)


def parse_rows(
    label: str, constraint: EvaluatorBase, copies: Sequence[Sequence[int]]
) -> Iterator[tuple[ConstraintRow, Ints]]:
    """Yields the rows of one constraint, each over the variables 0 … L−1 that it reads.

    Args:
        label: How messages call it.
        constraint: Linear, quadratic, or an `ExpressionConstraint` of sums of products of powers,
            sin, cos and exp of affine functions.
        copies: Which variables of the program it is bound to, K times.

    Yields:
        A row, and the program's variables that each copy of it reads, shape (K, L).

    Raises:
        UnsupportedTermError: It is another one, or a number is NaN.
    """
    sums = _row_sums(label, constraint)
    bound_to = np.array(copies, dtype=np.int64)
    is_symbolic = isinstance(constraint, ExpressionConstraint)
    formulas = constraint.expressions() if is_symbolic else [None] * len(sums)
    bounds = constraint.lower_bound(), constraint.upper_bound()
    for terms, lower, upper, formula in zip(sums, *bounds, formulas, strict=True):
        row = ConstraintRow(terms, float(lower), float(upper), formula)
        numbers = [term.coefficient for term in terms]
        if not np.all(np.isfinite(numbers)) or np.any(np.isnan([lower, upper])):
            raise UnsupportedTermError(
                f"{label} can't be compiled",
                got=f"a number that is NaN or infinite in {lower:g} ≤ {row} ≤ {upper:g}",
                expected="finite coefficients",
                remedy="Look for a parameter that was not set.",
            )
        read = sorted({factor.variable for term in terms for factor in term.factors})
        yield replace(row, terms=_renumbered(terms, read)), bound_to[:, read]


def _renumbered(terms: tuple[Term, ...], read: Sequence[int]) -> tuple[Term, ...]:
    """Returns the terms over the variables that they read, counted anew."""
    number = {variable: i for i, variable in enumerate(read)}
    if len(read) == max(read, default=-1) + 1:
        return terms
    return tuple(
        Term(
            term.coefficient,
            tuple(replace(factor, variable=number[factor.variable]) for factor in term.factors),
        )
        for term in terms
    )


def _row_sums(label: str, constraint: EvaluatorBase) -> list[tuple[Term, ...]]:
    """Returns the terms of each row."""
    if isinstance(constraint, BoundingBoxConstraint):
        return [
            (Term(1.0, (Factor(i, FunctionKind.POWER),)),) for i in range(constraint.num_vars())
        ]
    if isinstance(constraint, LinearConstraint):  # equalities among them
        return [affine_terms(a, 0.0) for a in constraint.GetDenseA()]
    if isinstance(constraint, QuadraticConstraint):
        return [quadratic_terms(np.asarray(constraint.Q()), constraint.b(), 0.0)]
    if isinstance(constraint, ExpressionConstraint):
        variables, formulas = constraint.vars(), constraint.expressions()
        return [expression_terms(label, each, variables, is_row=True) for each in formulas]
    raise UnsupportedTermError(
        f"{label} can't be compiled",
        got=f"a {type(constraint).__name__}",
        expected="bounds, or a linear, quadratic or expression constraint",
        remedy="Write it symbolically: prog.AddConstraint(expression == 0).",
    )


def as_bound(row: ConstraintRow) -> tuple[int, float, float] | None:
    """Returns the local variable and its bounds, if the row is scale · x + offset."""
    constant = sum(term.coefficient for term in row.terms if not term.factors)
    linear = [term for term in row.terms if term.factors]
    if len(linear) != 1 or len(linear[0].factors) != 1:
        return None
    factor, scale = linear[0].factors[0], linear[0].coefficient
    if factor.kind != FunctionKind.POWER or factor.exponent != 1 or scale == 0.0:
        return None
    low, high = sorted(((row.lower - constant) / scale, (row.upper - constant) / scale))
    return factor.variable, low, high
