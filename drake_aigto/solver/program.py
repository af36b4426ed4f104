"""A MathematicalProgram as AIGO needs it: costs with means, equality rows, and bounds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.solvers import Binding, EvaluatorBase, MathematicalProgram

from drake_aigto.arrays import Floats
from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.local import PolynomialNlp
from drake_aigto.solver.lift import Lifted, lift
from drake_aigto.solver.parsed import ParsedProgram, ParsedRow, tighten
from drake_aigto.solver.presolve import Reduced, keep_all, substitute
from drake_aigto.solver.ranges import LARGEST
from drake_aigto.terms import (
    Factor,
    FunctionKind,
    NoClosedFormError,
    Term,
    TermBlock,
    TooManyTermsError,
    evaluator_name,
    from_terms,
    power,
    to_terms,
)

# Violations below it are far below the tolerance of an answer.
_NOTICED = 1e-9


@dataclass(frozen=True)
class Slack:
    """A variable s of its own for an inequality's g(z).

    Attributes:
        row: number of the row g(z) − s = 0.
        terms: g, over its own variables.
        variables: which of z these are.
    """

    row: int
    terms: tuple[Term, ...]
    variables: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class PenalizedRow:
    """Copies of an equality row r(y) = 0.

    Attributes:
        source: the row that it came from.
        name: of its square, unlike all costs'.
        block: r, and the variables of each copy.
    """

    source: ParsedRow
    name: str
    block: TermBlock

    def square(self) -> TermBlock:
        """Returns r² of all copies.

        Raises:
            UnsupportedTermError: it has no mean in closed form; by name.
        """
        label, row = self.source.label, self.source.row
        try:
            terms = to_terms(power(from_terms(self.block.terms), 2))
        except NoClosedFormError as error:
            raise UnsupportedTermError(
                f"{label} can't be penalized",
                got=f"the row {row}, in whose square {error}",
                expected="rows whose square has a mean in closed form",
                remedy="Give one of the two functions a variable s of its own: s == exp(x).",
            ) from None
        except TooManyTermsError as error:
            raise error.refusal(label, f"in the square of the row {row}") from None
        return TermBlock(self.name, terms, self.block.variables)


@dataclass(frozen=True, eq=False)
class AigoProgram:
    """Minimize f(x) subject to r(y) = 0, lower ≤ y ≤ upper, over y = (z, s).

    Variables z are those of x, and of functions that have no mean (`lift`), which presolve leaves:
    all of them without it. An inequality of several variables, or one that is not affine, has a
    slack s of its own: lower ≤ g(z) ≤ upper becomes g(z) − s = 0 with s between the bounds.
    Inequalities that are affine in one variable are bounds.

    Attributes:
        source: the program as it was given, over x.
        lifted: the same with variables of their own for functions that have no mean.
        reduced: the same after presolve.
        nlp: f, r and bounds over y, for a local solver.
        costs: f over y.
        rows: r over y.
        slacks: the function that each s_i stands for.
    """

    source: MathematicalProgram
    lifted: Lifted
    reduced: Reduced
    nlp: PolynomialNlp
    costs: BoxPolynomial
    rows: tuple[PenalizedRow, ...]
    slacks: tuple[Slack, ...]

    @cached_property
    def penalties(self) -> BoxPolynomial:
        """Σ r_i², named unlike all costs.

        Raises:
            UnsupportedTermError: a row's square has no mean in closed form; by name.
        """
        return BoxPolynomial(self.nlp.num_variables, tuple(row.square() for row in self.rows))

    @cached_property
    def largest_coefficient(self) -> float:
        """The largest one of all rows, in absolute value; 0 without rows."""
        terms = (term for row in self.rows for term in row.source.row.terms)
        return max((abs(term.coefficient) for term in terms), default=0.0)

    def presolved(self) -> AigoProgram:
        """Returns the program without variables that rows define.

        Raises:
            ContradictionError: constants alone leave no feasible point.
        """
        reduced = substitute(self.reduced.parsed)
        if reduced.parsed is self.reduced.parsed:
            return self
        return _assemble(self.source, self.lifted, reduced)

    def cost(self, x: Floats) -> float:
        """Returns f at x (n,); infinite where a formula has no value."""
        values = [self._value(cost, x)[0] for cost in self.source.GetAllCosts()]
        return float(sum(values))

    def _value(self, binding: Binding, x: Floats) -> Floats:
        """Returns a cost or constraint at x (n,): √y has no value where y is −1e-9."""
        try:
            return np.asarray(self.source.EvalBinding(binding, x))
        except (RuntimeError, ValueError):
            return np.full(binding.evaluator().num_outputs(), np.inf)

    def violation(self, x: Floats) -> float:
        """Returns the largest violation of the source's constraints at x (n,); 0 without any.

        It is relative to a row's size where that is below 1 (`ParsedProgram.row_sizes`), and
        without the change of a row that rounding of x alone may lead to.
        """
        worst = 0.0
        sizes = self.reduced.parsed.row_sizes
        for binding, rows in zip(self.source.GetAllConstraints(), self.lifted.rows, strict=True):
            evaluator = binding.evaluator()
            value = self._value(binding, x)
            if not np.all(np.isfinite(value)):
                return np.inf
            excess = np.maximum(evaluator.lower_bound() - value, value - evaluator.upper_bound())
            if np.any(excess > _NOTICED):
                read = x[self.source.FindDecisionVariableIndices(binding.variables())]
                excess -= _rounding(evaluator, read)
            excess /= np.concatenate([sizes[row] for row in rows])
            worst = max(worst, float(np.max(excess, initial=0.0)))
        return worst

    def reduce(self, x: Floats) -> Floats:
        """Returns z of x (n,)."""
        return self.lifted.extend(x)[self.reduced.kept]

    def answer(self, y: Floats) -> Floats:
        """Returns x (n,) of z or y, within its bounds."""
        return self.reduced.restore(y[: self.reduced.kept.size])[: self.source.num_vars()]

    def with_slacks(self, z: Floats) -> Floats:
        """Returns y = (z, s) with s = g(z), moved within the bounds; z may be a y already."""
        z = z[: self.reduced.kept.size]
        y = np.concatenate([z, np.zeros(len(self.slacks))])
        if self.slacks:
            values = self.nlp.evaluate(y)[1][[slack.row for slack in self.slacks]]
            y[z.size :] = np.nan_to_num(values, posinf=LARGEST, neginf=-LARGEST)
        return np.clip(y, self.nlp.lower, self.nlp.upper)


def read_program(prog: MathematicalProgram) -> AigoProgram:
    """Returns a program with slacks, and all its variables.

    Raises:
        UnsupportedTermError: a cost or a row without a mean in closed form, or variables that are
            not continuous; by name.
        ContradictionError: bounds or constants alone leave no feasible point.
    """
    lifted = Lifted(prog, tuple((each.evaluator(),) for each in prog.GetAllConstraints()))
    try:
        parsed = ParsedProgram.of(prog)
    except UnsupportedTermError:
        lifted = lift(prog)
        parsed = ParsedProgram.of(lifted.prog)
    program = _assemble(prog, lifted, keep_all(parsed))
    if program.rows:
        bounds = (side[: parsed.lower.size] for side in tighten(program.nlp))
        if parsed.scale_rows(*bounds):
            return _assemble(prog, lifted, keep_all(parsed))
    return program


def _rounding(evaluator: EvaluatorBase, x: Floats) -> Floats:
    """Returns the change of rows g (m,) that rounding of x (n,) may make: 4 ε Σ_j |∂g/∂x_j x_j|."""
    try:
        slopes = ExtractGradient(evaluator.Eval(InitializeAutoDiff(x)))
    except (RuntimeError, ValueError):  # A slope has no value there, as that of √x at 0.
        return np.zeros(evaluator.num_constraints())
    with np.errstate(invalid="ignore"):  # An infinite slope at 0: no bound of its change.
        changes = 4 * np.finfo(float).eps * np.sum(np.abs(slopes * x), axis=1)
    return np.where(np.isfinite(changes), changes, 0.0)


def _assemble(source: MathematicalProgram, lifted: Lifted, reduced: Reduced) -> AigoProgram:
    """Returns the program with equality rows, and slacks for inequalities."""
    parsed = reduced.parsed
    rows: list[PenalizedRow] = []
    slacks: list[Slack] = []
    lower, upper = [parsed.lower], [parsed.upper]
    prefix, size, number = _row_prefix(source), parsed.lower.size, 0
    for each in parsed.rows:
        row, variables, count = each.row, each.block.variables, len(each.block.variables)
        rest = Term(-row.lower, ())
        if not each.is_equality:
            rest = Term(-1.0, (Factor(variables.shape[1], FunctionKind.POWER),))
            copies = enumerate(variables.tolist(), number)
            slacks += [Slack(place, row.terms, tuple(copy)) for place, copy in copies]
            variables = np.column_stack([variables, np.arange(size, size + count)])
            size += count
            lower.append(np.full(count, row.lower))
            upper.append(np.full(count, row.upper))
        block = TermBlock(each.block.name, (*row.terms, rest), variables)
        rows.append(PenalizedRow(each, f"{prefix}{number}", block))
        number += count
    bounds = np.concatenate(lower), np.concatenate(upper)
    blocks = tuple(row.block for row in rows)
    return AigoProgram(
        source=source,
        lifted=lifted,
        reduced=reduced,
        nlp=PolynomialNlp(size, parsed.costs, blocks, *bounds),
        costs=BoxPolynomial(size, parsed.costs),
        rows=tuple(rows),
        slacks=tuple(slacks),
    )


def _row_prefix(source: MathematicalProgram) -> str:
    """Returns the first part of rows' names, which no cost's has: weights are given by name."""
    costs = [evaluator_name(cost.evaluator()) for cost in source.GetAllCosts()]
    prefix = "row "
    while any(name.startswith(prefix) for name in costs):
        prefix = f"constraint {prefix}"
    return prefix
