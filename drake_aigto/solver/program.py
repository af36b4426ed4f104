"""A MathematicalProgram as AIGO needs it: costs with means, equality rows, and bounds."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from pydrake.solvers import MathematicalProgram
from pydrake.symbolic import Variable

from drake_aigto.arrays import Floats, Ints
from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.local import PolynomialNlp
from drake_aigto.solver.ranges import LARGEST
from drake_aigto.terms import (
    ConstraintRow,
    Factor,
    FunctionKind,
    NoClosedFormError,
    Term,
    TermBlock,
    TooManyTermsError,
    as_bound,
    evaluator_name,
    from_terms,
    parse_costs,
    parse_rows,
    power,
    shared_evaluators,
    term_blocks,
    to_terms,
)

# A row of constants may miss its bounds by this.
_ROUNDING = 1e-9


class ContradictionError(Exception):
    """Bounds or constants alone leave no feasible point."""


@dataclass(frozen=True)
class Slack:
    """A variable s of its own for an inequality's g(x).

    Attributes:
        row: number of the row g(x) − s = 0.
        terms: g, over its own variables.
        variables: which of x these are.
    """

    row: int
    terms: tuple[Term, ...]
    variables: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class AigoProgram:
    """Minimize f(x) subject to r(y) = 0, lower ≤ y ≤ upper, over y = (x, s).

    An inequality of several variables, or one that is not affine, has a slack s of its own: lower ≤
    g(x) ≤ upper becomes g(x) − s = 0 with s between the bounds. Inequalities that are affine in one
    variable are bounds.

    Attributes:
        source: the program that was asked, over x.
        nlp: f, r and bounds over y, for a local solver.
        costs: f over y.
        penalties: Σ r_i², named unlike all costs.
        slacks: what each s_i stands for.
    """

    source: MathematicalProgram
    nlp: PolynomialNlp
    costs: BoxPolynomial
    penalties: BoxPolynomial
    slacks: tuple[Slack, ...]

    @property
    def num_rows(self) -> int:
        """Number of equality rows r."""
        return self.nlp.num_rows

    def cost(self, x: Floats) -> float:
        """Returns f at x (n,)."""
        values = [self.source.EvalBinding(cost, x)[0] for cost in self.source.GetAllCosts()]
        return float(sum(values))

    def violation(self, x: Floats) -> float:
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

    def with_slacks(self, x: Floats) -> Floats:
        """Returns y = (x, s) with s = g(x), moved within the bounds."""
        y = np.concatenate([x, np.zeros(len(self.slacks))])
        if self.slacks:
            values = self.nlp.evaluate(y)[1][[slack.row for slack in self.slacks]]
            y[x.size :] = np.nan_to_num(values, posinf=LARGEST, neginf=-LARGEST)
        return np.clip(y, self.nlp.lower, self.nlp.upper)


def read_program(prog: MathematicalProgram) -> AigoProgram:
    """Returns a program with slacks.

    Raises:
        UnsupportedTermError: a cost or a row's square without a mean in closed form, or variables
            that are not continuous; by name.
        ContradictionError: bounds or constants alone leave no feasible point.
    """
    _check_variables(prog)
    rows = _Rows(prog)
    for label, evaluator, copies in shared_evaluators(prog, prog.GetAllConstraints()):
        for row, variables in parse_rows(label, evaluator, copies):
            rows.add(label, evaluator_name(evaluator), row, variables.tolist())
    return rows.finish()


@dataclass
class _Rows:
    """Collects equality rows, their squares, bounds and slacks of a program."""

    source: MathematicalProgram
    blocks: list[TermBlock] = field(default_factory=list)
    squares: list[TermBlock] = field(default_factory=list)
    slacks: list[Slack] = field(default_factory=list)

    def __post_init__(self) -> None:
        n = self.source.num_vars()
        self._lower, self._upper = np.full(n, -np.inf), np.full(n, np.inf)
        self._prefix = self._row_prefix()
        self._num_rows = 0

    def _row_prefix(self) -> str:
        """Returns how rows' names begin, as no cost's does: weights are given by name."""
        costs = [evaluator_name(cost.evaluator()) for cost in self.source.GetAllCosts()]
        prefix = "row "
        while any(name.startswith(prefix) for name in costs):
            prefix = f"constraint {prefix}"
        return prefix

    def add(self, label: str, name: str, row: ConstraintRow, copies: list[list[int]]) -> None:
        """Adds the copies of a row as bounds, equalities, or with slacks."""
        if row.lower > row.upper or np.isposinf(row.lower) or np.isneginf(row.upper):
            raise ContradictionError
        if np.isneginf(row.lower) and np.isposinf(row.upper):
            return
        for block in term_blocks(name, row.terms, copies):
            alike = replace(row, terms=block.terms)
            bound = as_bound(alike)
            if bound is not None:
                local, low, high = bound
                self._bound(block.variables[:, local], low, high)
            elif not any(term.factors for term in block.terms):
                _check_constant(alike)
            else:
                self._add_rows(label, alike, block)

    def _bound(self, index: Ints, low: float, high: float) -> None:
        np.maximum.at(self._lower, index, low)
        np.minimum.at(self._upper, index, high)
        lower, upper = self._lower[index], self._upper[index]
        if not np.all(lower <= upper) or np.any(np.isposinf(lower) | np.isneginf(upper)):
            raise ContradictionError

    def _add_rows(self, label: str, row: ConstraintRow, block: TermBlock) -> None:
        """Adds copies of an equality, or of an inequality with a slack each."""
        variables, count = block.variables, len(block.variables)
        if row.lower == row.upper:
            rest = Term(-row.lower, ())
        else:
            first = self._lower.size
            rest = Term(-1.0, (Factor(variables.shape[1], FunctionKind.POWER),))
            for number, copy in enumerate(variables.tolist(), self._num_rows):
                self.slacks.append(Slack(number, row.terms, tuple(copy)))
            own = np.arange(first, first + count)
            variables = np.column_stack([variables, own])
            self._lower = np.append(self._lower, np.full(count, row.lower))
            self._upper = np.append(self._upper, np.full(count, row.upper))
        terms = (*row.terms, rest)
        self.blocks.append(TermBlock(block.name, terms, variables))
        self.squares.append(
            TermBlock(f"{self._prefix}{self._num_rows}", _square(label, row, terms), variables)
        )
        self._num_rows += count

    def finish(self) -> AigoProgram:
        """Returns the program."""
        size = self._lower.size
        costs = parse_costs(self.source)
        return AigoProgram(
            source=self.source,
            nlp=PolynomialNlp(size, costs, tuple(self.blocks), self._lower, self._upper),
            costs=BoxPolynomial(size, costs),
            penalties=BoxPolynomial(size, tuple(self.squares)),
            slacks=tuple(self.slacks),
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


def _check_constant(row: ConstraintRow) -> None:
    value = sum(term.coefficient for term in row.terms)
    if not row.lower - _ROUNDING <= value <= row.upper + _ROUNDING:
        raise ContradictionError


def _square(label: str, row: ConstraintRow, terms: tuple[Term, ...]) -> tuple[Term, ...]:
    """Returns the terms of a row's square, the row's penalty."""
    try:
        return to_terms(power(from_terms(terms), 2))
    except NoClosedFormError as error:
        raise UnsupportedTermError(
            f"{label} can't be penalized",
            got=f"the row {row}, in whose square {error}",
            expected="rows whose square has a mean in closed form",
            remedy="Give one of the two functions a variable s of its own: s == exp(x).",
        ) from None
    except TooManyTermsError as error:
        raise error.refusal(label, f"in the square of the row {row}") from None
