"""Drake's MathematicalProgram → `PolynomialNlp`: costs, equality rows and bounds as flat tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.solvers import (
    BoundingBoxConstraint,
    EvaluatorBase,
    ExpressionConstraint,
    LinearConstraint,
    MathematicalProgram,
    QuadraticConstraint,
)
from pydrake.symbolic import Expression

from drake_aigto.box import Factor, FunctionKind, Term, TermBlock, compile_program
from drake_aigto.box.compile import (
    affine_terms,
    evaluator_name,
    quadratic_terms,
    shared_evaluators,
    term_blocks,
)
from drake_aigto.box.expressions import expression_terms
from drake_aigto.box.kernels import NO_SYSTEM, add_means
from drake_aigto.box.lanes import Lanes, make_lanes
from drake_aigto.box.polynomial import as_order
from drake_aigto.box.tables import stack_terms
from drake_aigto.box.tapes import Order
from drake_aigto.errors import OptionsError, UnsupportedTermError
from drake_aigto.local.kkt import KktStructure

Floats = NDArray[np.float64]

_LONGEST_SHOWN = 300  # characters of a row in a message


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
        """The formula, or the beginning of a long one."""
        text = " + ".join(map(str, self.terms)) if self.formula is None else str(self.formula)
        return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]} …"


def compile_nlp(prog: MathematicalProgram, order: ArrayLike | None = None) -> PolynomialNlp:
    """Compile costs, equality constraints and bounds of a program; a shared evaluator once.

    Rows that are affine in one variable become bounds, and equal bounds hold their variable.

    Args:
        prog: Costs as in `compile_program`; constraints as in `parse_rows`, and equalities unless
            they are affine in one variable.
        order: Elimination order of the decision variables, as in `compile_program`. Default:
            reverse Cuthill-McKee.

    Raises:
        UnsupportedTermError: A cost or constraint without such a form (it is named), or bounds that
            contradict each other.
    """
    costs = compile_program(prog, range(prog.num_vars())).blocks
    lower, upper = np.full(prog.num_vars(), -np.inf), np.full(prog.num_vars(), np.inf)
    rows: list[TermBlock] = []
    for label, evaluator, copies in shared_evaluators(prog, prog.GetAllConstraints()):
        for row, variables in parse_rows(label, evaluator, copies):
            if np.isneginf(row.lower) and np.isposinf(row.upper):
                continue
            bound = as_bound(row)
            if bound is not None:
                local, low, high = bound
                np.maximum.at(lower, variables[:, local], low)
                np.minimum.at(upper, variables[:, local], high)
            else:
                terms = _equality_terms(label, row)
                rows.extend(term_blocks(evaluator_name(evaluator), terms, variables.tolist()))
    check_bounds(lower, upper, lambda i: str(prog.decision_variable(i)))
    return PolynomialNlp(prog.num_vars(), costs, tuple(rows), lower, upper, order)


def parse_rows(
    label: str, constraint: EvaluatorBase, copies: Sequence[Sequence[int]]
) -> Iterator[tuple[ConstraintRow, NDArray[np.int64]]]:
    """The rows of one constraint, each over the variables 0 … L−1 that it reads.

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
    """The terms over the variables that they read, counted anew."""
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
    """The terms of each row."""
    if isinstance(constraint, BoundingBoxConstraint):
        return [
            (Term(1.0, (Factor(i, FunctionKind.POWER),)),) for i in range(constraint.num_vars())
        ]
    if isinstance(constraint, LinearConstraint):  # equalities among them
        return [affine_terms(a, 0.0) for a in constraint.GetDenseA()]
    if isinstance(constraint, QuadraticConstraint):
        return [quadratic_terms(np.asarray(constraint.Q()), constraint.b(), 0.0)]
    if isinstance(constraint, ExpressionConstraint):
        index = {v.get_id(): i for i, v in enumerate(constraint.vars())}
        return [
            expression_terms(label, formula, lambda v: index[v.get_id()], is_row=True)
            for formula in constraint.expressions()
        ]
    raise UnsupportedTermError(
        f"{label} can't be compiled",
        got=f"a {type(constraint).__name__}",
        expected="bounds, or a linear, quadratic or expression constraint",
        remedy="Write it symbolically: prog.AddConstraint(expression == 0).",
    )


def as_bound(row: ConstraintRow) -> tuple[int, float, float] | None:
    """The local variable and its bounds, if the row is scale · x + offset."""
    constant = sum(term.coefficient for term in row.terms if not term.factors)
    linear = [term for term in row.terms if term.factors]
    if len(linear) != 1 or len(linear[0].factors) != 1:
        return None
    factor, scale = linear[0].factors[0], linear[0].coefficient
    if factor.kind != FunctionKind.POWER or factor.exponent != 1 or scale == 0.0:
        return None
    low, high = sorted(((row.lower - constant) / scale, (row.upper - constant) / scale))
    return factor.variable, low, high


def _equality_terms(label: str, row: ConstraintRow) -> tuple[Term, ...]:
    """The terms of row − value = 0."""
    if row.lower != row.upper:
        raise UnsupportedTermError(
            f"{label} can't be compiled",
            got=f"an inequality of several variables, or not affine: {row.lower:g} ≤ {row} ≤ "
            f"{row.upper:g}",
            expected="equalities, and bounds on single variables",
            remedy="Give the expression a variable s of its own: expression == s, s ≥ 0.",
        )
    return (*row.terms, *affine_terms((), -row.lower))


def check_bounds(lower: Floats, upper: Floats, name: Callable[[int], str]) -> None:
    """Refuse bounds (n,) that contradict each other; messages call a variable by its name.

    Raises:
        UnsupportedTermError: A variable has no value.
    """
    bad = np.flatnonzero((lower > upper) | np.isposinf(lower) | np.isneginf(upper))
    if bad.size:
        i = int(bad[0])
        raise UnsupportedTermError(
            f"the bounds of {name(i)} leave it no value",
            got=f"[{lower[i]:g}, {upper[i]:g}]",
            expected="lower ≤ upper",
            remedy="Relax one of the constraints on it.",
        )


class PolynomialNlp:
    """A program with equality constraints and bounds, of sums of products.

        minimise f(x)    subject to    c(x) = 0,    lower ≤ x ≤ upper

    with n variables and m rows. f and every c_i are sums of terms a ∏_j g_j(x_j) as in
    `BoxPolynomial`; copies of one sum share one table.

    Args:
        num_variables: n.
        costs: Blocks whose copies sum up to f.
        rows: Blocks each copy of which is one c_i.
        lower: Lower bounds (n,), −∞ where there is none.
        upper: Upper bounds (n,).
        order: Elimination order of the variables for banded systems; None leaves it to the solver.

    Attributes:
        costs: As given.
        row_names: Name of the constraint that each row came from (m,).
    """

    def __init__(
        self,
        num_variables: int,
        costs: tuple[TermBlock, ...],
        rows: tuple[TermBlock, ...],
        lower: Floats,
        upper: Floats,
        order: ArrayLike | None = None,
    ) -> None:
        """Stack the blocks."""
        self.num_variables = num_variables
        self.lower, self.upper = lower, upper
        self.order = None if order is None else as_order(order, num_variables)
        self.costs = costs
        self.blocks = (*costs, *rows)
        self.terms = stack_terms(self.blocks)
        self.copy_weights = np.repeat(
            np.array([block.weight for block in self.blocks], dtype=float),
            [len(block.variables) for block in self.blocks],
        )
        self.num_costs = sum(len(block.variables) for block in costs)
        self.row_names = tuple(block.name for block in rows for _ in block.variables)
        for array in (self.lower, self.upper, self.copy_weights):
            array.setflags(write=False)

    @cached_property
    def kkt_structure(self) -> KktStructure:
        """Where its unknowns stand in KKT matrices, found once."""
        return KktStructure(self)

    @cached_property
    def _lanes(self) -> Lanes:
        return make_lanes(self.terms, Order.MEAN)

    @cached_property
    def _magnitude_lanes(self) -> Lanes:
        return self._lanes._replace(are_magnitudes=True)

    @property
    def num_rows(self) -> int:
        """Number of equality rows m."""
        return len(self.row_names)

    def evaluate(self, x: ArrayLike) -> tuple[float, Floats]:
        """f(x) and c(x) (m,)."""
        costs, rows = self._sums(x)
        return float(np.sum(costs)), rows

    def cost_magnitude(self, x: ArrayLike) -> float:
        """Σ |terms| of f at x: f(x) is known to some roundings of it, whatever cancels."""
        return float(np.sum(self._sums(x, are_magnitudes=True)[0]))

    def row_magnitudes(self, x: ArrayLike) -> Floats:
        """Σ |terms| of every row at x (m,)."""
        return self._sums(x, are_magnitudes=True)[1]

    def _sums(self, x: ArrayLike, are_magnitudes: bool = False) -> tuple[Floats, Floats]:
        """The weighted costs, and the rows (m,), of terms or of their absolute values."""
        x, weights = self._checked(x), self.copy_weights.copy()
        values = np.empty(weights.size)
        lanes = self._magnitude_lanes if are_magnitudes else self._lanes
        add_means(lanes, weights, x, np.zeros(x.size), values, NO_SYSTEM)
        return values[: self.num_costs], values[self.num_costs :]

    def _checked(self, x: ArrayLike) -> Floats:
        # Copied, as the weights, for Numba would compile once more for arrays that are read-only.
        x = np.array(x, dtype=float, order="C")
        if x.shape != (self.num_variables,):
            raise OptionsError(
                "the point", got=f"shape {x.shape}", expected=f"({self.num_variables},)"
            )
        return x
