"""A MathematicalProgram as AIGO needs it: costs with means, equality rows, and bounds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.solvers import Binding, EvaluatorBase, MathematicalProgram

from drake_aigto import terms
from drake_aigto.arrays import Floats, Ints
from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.local import PolynomialNlp
from drake_aigto.solver.lift import Lifted, lift
from drake_aigto.solver.ranges import LARGEST, Range, largest_term, sum_range, tighten

# A row of constants may miss its bounds by this; violations below it are far below the tolerance of
# an answer.
_NOTICED = 1e-9
# Rows whose terms are all below the first of these within the bounds are divided by the largest
# one, down to the second, and equalities to the third: smaller terms are nothing but rounding, and
# an equality that leaves next to nothing, as x² + y² = 0, is met the slower the closer.
_SMALL, _LEAST, _LEAST_EQUALITY = 0.01, 1e-18, 5e-9


class ContradictionError(Exception):
    """Bounds or constants alone leave no feasible point."""


class ParsedProgram:
    """Minimize Σ costs subject to rows, lower ≤ x ≤ upper.

    Rows that are affine in one variable are bounds. Those whose coefficients, or whose terms within
    the bounds, are all below 1 are divided by the largest one: units of their own are no reason to
    hold them less.

    Attributes:
        costs: f.
        rows: all others.
        row_sizes: divisors of the rows of each constraint, shape (m,) each.
        lower: bounds of x, shape (n,).
        upper: shape (n,).
    """

    def __init__(self, num_variables: int) -> None:
        """Starts with nothing."""
        self.costs: tuple[terms.TermBlock, ...] = ()
        self.rows: list[terms.ParsedRow] = []
        self.row_sizes: dict[EvaluatorBase, Floats] = {}
        self.lower = np.full(num_variables, -np.inf)
        self.upper = np.full(num_variables, np.inf)

    @classmethod
    def of(cls, prog: MathematicalProgram) -> ParsedProgram:
        """Reads a program."""
        terms.check_continuous(prog)
        parsed = cls(prog.num_vars())
        for label, evaluator, copies in terms.shared_evaluators(prog, prog.GetAllConstraints()):
            parsed.rows += terms.parse_rows(label, evaluator, copies)
            parsed.row_sizes[evaluator] = np.ones(evaluator.num_constraints())
        parsed._divide_rows(_row_size)
        rows, parsed.rows = parsed.rows, []
        for row in rows:
            parsed.add(row)
        parsed.costs = terms.parse_costs(prog)
        return parsed

    def scale_rows(self, lower: Floats, upper: Floats) -> bool:
        """Divides rows by their largest term within bounds of x (n,) that hold for feasible points.

        Returns:
            Whether a row was divided.
        """

        def measure(row: terms.ParsedRow) -> float:
            copies, own = row.block.variables, row.block.terms
            largest = max(largest_term(own, lower[copy], upper[copy]) for copy in copies)
            return largest if largest >= (_LEAST_EQUALITY if row.is_equality else _LEAST) else 1.0

        return self._divide_rows(measure, _SMALL)

    def _divide_rows(self, measure: Callable[[terms.ParsedRow], float], least: float = 1.0) -> bool:
        """Divides rows by their sizes that are below the least; copies by the largest of theirs."""
        sizes: dict[Any, float] = {}
        for row in self.rows:
            sizes[row.origin] = max(measure(row), sizes.get(row.origin, 0.0))
        small = {origin: size for origin, size in sizes.items() if size < least}
        for (evaluator, number), size in small.items():
            self.row_sizes[evaluator][number] *= size
        self.rows = [row.divided(small.get(row.origin, 1.0)) for row in self.rows]
        return bool(small)

    def add(self, row: terms.ParsedRow) -> None:
        """Adds the copies of a row."""
        if row.lower > row.upper or np.isposinf(row.lower) or np.isneginf(row.upper):
            raise ContradictionError
        if row.is_free:
            return
        if row.tighten(self.lower, self.upper):
            ends = [side[row.block.variables] for side in (self.lower, self.upper)]
            if not np.all(ends[0] <= ends[1]) or np.any(
                np.isposinf(ends[0]) | np.isneginf(ends[1])
            ):
                raise ContradictionError
        elif any(term.factors for term in row.block.terms):
            self.rows.append(row)
        else:
            value = sum(term.coefficient for term in row.block.terms)
            if not row.lower - _NOTICED <= value <= row.upper + _NOTICED:
                raise ContradictionError


def _row_size(row: terms.ParsedRow) -> float:
    """Returns the largest coefficient of a row."""
    sizes = (abs(term.coefficient) for term in row.block.terms if term.factors)
    return max(sizes, default=1.0) or 1.0


class Definition(NamedTuple):
    """x_j = Σ terms of other variables."""

    variable: int  # j
    total: terms.Sum  # the terms over x


class AigoProgram:
    """Minimize f(x) subject to r(y) = 0, lower ≤ y ≤ upper, over y = (z, s).

    Variables z are those of x, and of functions that have no mean (`lift`), which presolve leaves:
    all of them without it. An inequality of several variables, or one that is not affine, has a
    slack s of its own: lower ≤ g(z) ≤ upper becomes g(z) − s = 0 with s between the bounds.
    Inequalities that are affine in one variable are bounds.

    Attributes:
        source: the program as it was given, over x.
        lifted: the same with variables of their own for functions that have no mean.
        given: the same as data.
        parsed: the same after presolve.
        definitions: of variables that presolve left out, in the order of their making, each over
            variables that were there by then.
        kept: indices of z among those of `given`.
        nlp: f, r and bounds over y, for a local solver.
        slack_rows: row of each s_i.
    """

    def __init__(
        self,
        source: MathematicalProgram,
        lifted: Lifted,
        given: ParsedProgram,
        parsed: ParsedProgram | None = None,
        definitions: tuple[Definition, ...] = (),
    ) -> None:
        """Adds slacks; nothing was presolved if there is nothing parsed but what was given."""
        self.source, self.lifted, self.given = source, lifted, given
        self.parsed, self.definitions = parsed or given, definitions
        self.kept = np.delete(np.arange(given.lower.size), [j for j, _ in definitions])
        parsed = self.parsed
        blocks: list[terms.TermBlock] = []
        self.slack_rows: list[int] = []
        lower, upper = [parsed.lower], [parsed.upper]
        costs = [terms.evaluator_name(cost.evaluator()) for cost in source.GetAllCosts()]
        # Rows' names begin as no cost's does: weights are given by name.
        prefix, size, number = "row ", parsed.lower.size, 0
        while any(name.startswith(prefix) for name in costs):
            prefix = f"constraint {prefix}"
        for row in parsed.rows:
            rest, variables = terms.Term(-row.lower, ()), row.block.variables
            count = len(variables)
            if not row.is_equality:
                rest = terms.Term(
                    -1.0, (terms.Factor(variables.shape[1], terms.FunctionKind.POWER),)
                )
                variables = np.column_stack([variables, np.arange(size, size + count)])
                self.slack_rows += range(number, number + count)
                size += count
                lower.append(np.full(count, row.lower))
                upper.append(np.full(count, row.upper))
            blocks.append(terms.TermBlock(f"{prefix}{number}", (*row.block.terms, rest), variables))
            number += count
        bounds = np.concatenate(lower), np.concatenate(upper)
        self.nlp = PolynomialNlp(size, parsed.costs, tuple(blocks), *bounds)

    @cached_property
    def costs(self) -> BoxPolynomial:
        """The costs f over y."""
        return BoxPolynomial(self.nlp.num_variables, self.parsed.costs)

    @cached_property
    def penalties(self) -> BoxPolynomial:
        """Σ r_i², named unlike all costs.

        Raises:
            UnsupportedTermError: a row's square has no mean in closed form; by name.
        """
        squares = map(_square, self.parsed.rows, self.nlp.blocks[len(self.nlp.costs) :])
        return BoxPolynomial(self.nlp.num_variables, tuple(squares))

    @cached_property
    def largest_coefficient(self) -> float:
        """The largest one of all rows, in absolute value; 0 without rows."""
        own = (term for row in self.parsed.rows for term in row.block.terms)
        return max((abs(term.coefficient) for term in own), default=0.0)

    def slack_ranges(self, low: Floats, high: Floats) -> Iterator[Range]:
        """Yields bounds of the g that each s_i stands for, over low ≤ z ≤ high (n,)."""
        for row in self.parsed.rows:
            for copy in () if row.is_equality else row.block.variables:
                yield sum_range(row.block.terms, low[copy], high[copy])

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
        bindings, owners, lower, upper, sizes = self._source_rows
        value = np.concatenate([np.empty(0), *(self._value(each, x) for each in bindings)])
        if not np.all(np.isfinite(value)):
            return np.inf
        excess = np.maximum(lower - value, value - upper)
        for number in np.unique(owners[excess > _NOTICED]).tolist():
            binding, own = bindings[number], owners == number
            read = x[self.source.FindDecisionVariableIndices(binding.variables())]
            excess[own] -= _rounding(binding.evaluator(), read)
        with np.errstate(over="ignore"):
            return float(np.max(excess / sizes, initial=0.0))

    @cached_property
    def _source_rows(self) -> tuple[list[Binding], Ints, Floats, Floats, Floats]:
        """The source's constraints; of all their R rows: whose, lower and upper bounds, sizes."""
        bindings = self.source.GetAllConstraints()
        evaluators = [binding.evaluator() for binding in bindings]
        sizes = (self.given.row_sizes[row] for rows in self.lifted.rows for row in rows)
        return (
            bindings,
            np.repeat(np.arange(len(bindings)), [each.num_constraints() for each in evaluators]),
            np.concatenate([np.empty(0), *(each.lower_bound() for each in evaluators)]),
            np.concatenate([np.empty(0), *(each.upper_bound() for each in evaluators)]),
            np.concatenate([np.empty(0), *sizes]),
        )

    def reduce(self, x: Floats) -> Floats:
        """Returns z of x (n,)."""
        return self.lifted.extend(x)[self.kept]

    def answer(self, y: Floats) -> Floats:
        """Returns x (n,) of z or y, within its bounds, with the variables that were left out."""
        lower, upper = self.given.lower, self.given.upper
        x = np.zeros(lower.size)
        x[self.kept] = y[: self.kept.size]
        x = np.clip(x, lower, upper)
        for j, total in reversed(self.definitions):
            with np.errstate(over="ignore", invalid="ignore"):  # Far out a definition may overflow.
                x[j] = min(max(float(terms.evaluate(total, x)), lower[j]), upper[j])
        return x[: self.source.num_vars()]

    def with_slacks(self, z: Floats) -> Floats:
        """Returns y = (z, s) with s = g(z), moved within the bounds; z may be a y already."""
        y = np.zeros(self.nlp.num_variables)
        y[: self.kept.size] = z[: self.kept.size]
        if self.slack_rows:
            values = self.nlp.evaluate(y)[1][self.slack_rows]
            y[self.kept.size :] = np.nan_to_num(values, posinf=LARGEST, neginf=-LARGEST)
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
    program = AigoProgram(prog, lifted, parsed)
    if parsed.rows:
        bounds = (side[: parsed.lower.size] for side in tighten(program.nlp))
        if parsed.scale_rows(*bounds):
            return AigoProgram(prog, lifted, parsed)
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


def _square(row: terms.ParsedRow, block: terms.TermBlock) -> terms.TermBlock:
    """Returns r² of all copies of an equality r(y) = 0, which stands for a row."""
    try:
        square = terms.to_terms(terms.power(terms.from_terms(block.terms), 2))
    except terms.NoClosedFormError as error:
        raise UnsupportedTermError(
            f"{row.label} can't be penalized",
            got=f"the row {row}, in whose square {error}",
            expected="rows whose square has a mean in closed form",
            remedy="Give one of the two functions a variable s of its own: s == exp(x).",
        ) from None
    except terms.TooManyTermsError as error:
        raise error.refusal(row.label, f"in the square of the row {row}") from None
    return terms.TermBlock(block.name, square, block.variables)
