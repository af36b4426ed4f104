"""Costs, rows and bounds of a MathematicalProgram as data, and the bounds that rows leave."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.solvers import EvaluatorBase, MathematicalProgram
from pydrake.symbolic import Variable

from drake_aigto.arrays import Floats, Ints
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.kernels import kernel
from drake_aigto.local import PolynomialNlp
from drake_aigto.solver.ranges import LARGEST, Range, affine, power_range, product
from drake_aigto.terms import (
    ConstraintRow,
    FunctionKind,
    StackedTerms,
    TermBlock,
    as_bound,
    evaluator_name,
    parse_costs,
    parse_rows,
    shared_evaluators,
    stack_terms,
    term_blocks,
)

Bounds = tuple[Floats, Floats]

_POWER, _EXPONENTIAL = int(FunctionKind.POWER), int(FunctionKind.EXPONENTIAL)
_SINE, _COSINE = int(FunctionKind.SINE), int(FunctionKind.COSINE)

# A row of constants may miss its bounds by this.
_ROUNDING = 1e-9
# Rows whose terms are all below the first of these within the bounds are divided by the largest
# one, down to the second, and equalities to the third: smaller terms are nothing but rounding, and
# an equality that leaves next to nothing, as x² + y² = 0, is met the slower the closer.
_SMALL, _LEAST, _LEAST_EQUALITY = 0.01, 1e-18, 5e-9

_SWEEPS = 10
_LEAST_CUT = 1e-2  # a sweep that cuts no range by this part of it is the last
_DISTANCE = 1e-9  # of new bounds from those that rows leave, relative to their size


class ContradictionError(Exception):
    """Bounds or constants alone leave no feasible point."""


@dataclass(frozen=True, eq=False)
class ParsedRow:
    """Copies of lower ≤ Σ terms ≤ upper, each over its own variables.

    Attributes:
        label: name of it in messages.
        row: the terms and their bounds.
        block: the same terms, and the variables of each copy.
        origin: the constraint that it came from, and its number there; None after presolve.
    """

    label: str
    row: ConstraintRow
    block: TermBlock
    origin: tuple[EvaluatorBase, int] | None = None

    @property
    def is_equality(self) -> bool:
        """Whether both bounds are one."""
        return self.row.lower == self.row.upper

    def divided(self, size: float) -> ParsedRow:
        """Returns the row with all its numbers divided by a size."""
        if size == 1.0:
            return self
        row = _divided(self.row, size)
        own = self.block.with_coefficients([term.coefficient for term in row.terms])
        return replace(self, row=row, block=own)


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
        self.costs: tuple[TermBlock, ...] = ()
        self.rows: list[ParsedRow] = []
        self.row_sizes: dict[EvaluatorBase, Floats] = {}
        self.lower = np.full(num_variables, -np.inf)
        self.upper = np.full(num_variables, np.inf)

    @classmethod
    def of(cls, prog: MathematicalProgram) -> ParsedProgram:
        """Reads a program.

        Raises:
            UnsupportedTermError: a cost or row without a mean in closed form, or variables that
                are not continuous; by name.
            ContradictionError: bounds or constants alone leave no feasible point.
        """
        for variable in prog.decision_variables():
            if variable.get_type() != Variable.Type.CONTINUOUS:
                raise UnsupportedTermError(
                    f"the variable {variable} can't be solved for",
                    got=f"one of type {variable.get_type().name}",
                    expected="continuous variables",
                    remedy="Relax it, or use a mixed-integer solver.",
                )
        parsed = cls(prog.num_vars())
        for label, evaluator, copies in shared_evaluators(prog, prog.GetAllConstraints()):
            sizes = []
            for number, (row, variables) in enumerate(parse_rows(label, evaluator, copies)):
                largest = max((abs(t.coefficient) for t in row.terms if t.factors), default=1.0)
                sizes.append(min(1.0, largest) or 1.0)
                row = _divided(row, sizes[-1])
                for block in term_blocks(evaluator_name(evaluator), row.terms, variables.tolist()):
                    alike = ParsedRow(
                        label, replace(row, terms=block.terms), block, (evaluator, number)
                    )
                    parsed.add(alike)
            parsed.row_sizes[evaluator] = np.array(sizes)
        parsed.costs = parse_costs(prog)
        return parsed

    def scale_rows(self, lower: Floats, upper: Floats) -> bool:
        """Divides rows by their largest term within bounds of x (n,) that hold for feasible points.

        Returns:
            Whether a row was divided.
        """
        sizes: dict[tuple[EvaluatorBase, int] | None, float] = {}
        for each in self.rows:
            largest = _largest_term(each.block, lower, upper)
            least = _LEAST_EQUALITY if each.is_equality else _LEAST
            size = largest if largest >= least else 1.0
            sizes[each.origin] = max(size, sizes.get(each.origin, 0.0))
        small = {origin: size for origin, size in sizes.items() if size < _SMALL}
        for origin, size in small.items():
            if origin is not None:
                evaluator, number = origin
                self.row_sizes[evaluator][number] *= size
        self.rows = [each.divided(small.get(each.origin, 1.0)) for each in self.rows]
        return bool(small)

    def add(self, copies: ParsedRow) -> None:
        """Adds the copies of a row.

        Raises:
            ContradictionError: it leaves no feasible point.
        """
        row = copies.row
        if row.lower > row.upper or np.isposinf(row.lower) or np.isneginf(row.upper):
            raise ContradictionError
        if np.isneginf(row.lower) and np.isposinf(row.upper):
            return
        bound = as_bound(row)
        if bound is not None:
            local, low, high = bound
            index = copies.block.variables[:, local]
            np.maximum.at(self.lower, index, low)
            np.minimum.at(self.upper, index, high)
            lower, upper = self.lower[index], self.upper[index]
            if not np.all(lower <= upper) or np.any(np.isposinf(lower) | np.isneginf(upper)):
                raise ContradictionError
        elif any(term.factors for term in row.terms):
            self.rows.append(copies)
        else:
            value = sum(term.coefficient for term in row.terms)
            if not row.lower - _ROUNDING <= value <= row.upper + _ROUNDING:
                raise ContradictionError


def _divided(row: ConstraintRow, size: float) -> ConstraintRow:
    if size == 1.0:
        return row
    terms = tuple(replace(term, coefficient=term.coefficient / size) for term in row.terms)
    return replace(row, terms=terms, lower=row.lower / size, upper=row.upper / size)


def _largest_term(block: TermBlock, lower: Floats, upper: Floats) -> float:
    """Returns the largest size of a term of any copy within bounds of x (n,); waves swing fully."""
    ends = np.array([lower, upper])[:, block.variables]
    largest = 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        for term in block.terms:
            size = np.full(len(block.variables), abs(term.coefficient) if term.factors else 0.0)
            for factor in term.factors:
                x = ends[:, :, factor.variable]
                y = factor.scale * x + factor.offset
                base = np.max(np.abs(y if factor.kind == FunctionKind.POWER else x), axis=0)
                size *= base**factor.exponent
                if factor.kind == FunctionKind.EXPONENTIAL:
                    size *= np.exp(np.max(y, axis=0))
            largest = max(largest, float(np.max(np.where(np.isnan(size), np.inf, size))))
    return largest


def tighten(nlp: PolynomialNlp) -> Bounds:
    """Returns lower and upper bounds (n,) that hold for every feasible point.

    In a row Σ_m T_m = 0 with T_m = a_m ∏_i g_i(x_i), a term lies in minus the sum of the others'
    ranges, and a power of it in that over the range of its other factors. Sweeps over the rows go
    on while they cut (feasibility-based bounds tightening: Belotti, Lee, Liberti, Margot & Wächter
    2009, "Branching and bounds tightening techniques for non-convex MINLP", Optim. Methods Softw.
    24:597-634). Where rows leave no point at all, the bounds are those of the program.
    """
    return _sweep_rows(nlp) or (np.array(nlp.lower), np.array(nlp.upper))


def may_be_feasible(nlp: PolynomialNlp) -> bool:
    """Returns False if interval arithmetic, as in `tighten`, shows that no point meets all rows."""
    return _sweep_rows(nlp) is not None


def _sweep_rows(nlp: PolynomialNlp) -> Bounds | None:
    """Returns tightened bounds; None if they leave no point."""
    lower, upper = np.array(nlp.lower), np.array(nlp.upper)
    rows = nlp.blocks[len(nlp.costs) :]
    terms = stack_terms(rows)
    for _ in range(_SWEEPS if rows else 0):
        cut = _sweep(terms, lower, upper)
        if cut < 0.0:
            return None
        if cut < _LEAST_CUT:
            break
    return lower, upper


@kernel
def _sweep(stacked: StackedTerms, lower: Floats, upper: Floats) -> float:
    """Tightens the bounds by each row once, in place.

    Returns the largest part that was cut off a range; below 0 if a row leaves no point.
    """
    copies, copy_variables, sums, factors, terms, members = stacked
    low, high = np.empty(terms.size), np.empty(terms.size)
    behind_low, behind_high = np.empty(terms.size), np.empty(terms.size)
    most = 0.0
    for copy in range(copies.size):
        first = sums[copies[copy].sum_index].first_term
        last = sums[copies[copy].sum_index + 1].first_term
        table = factors[sums[copies[copy].sum_index].first_factor :]
        places = copy_variables[copies[copy].first_variable :]
        for m in range(first, last):
            low[m] = high[m] = terms[m].coefficient
            for member in members[terms[m].first_member : terms[m + 1].first_member]:
                i = places[table[member].variable]
                a, b = _factor_range(table[member], lower[i], upper[i])
                low[m], high[m] = product(low[m], high[m], a, b)
        behind_low[last - 1] = behind_high[last - 1] = 0.0
        for m in range(last - 1, first, -1):
            behind_low[m - 1] = behind_low[m] + low[m]
            behind_high[m - 1] = behind_high[m] + high[m]
        before_low = before_high = 0.0
        for m in range(first, last):
            # Minus the others' sum; the total less T_m would be NaN where that is infinite.
            ends = -(before_high + behind_high[m]), -(before_low + behind_low[m])
            before_low, before_high = before_low + low[m], before_high + high[m]
            cut = _tighten_factors(
                *(terms[m].coefficient, ends, table, places, lower, upper),
                members[terms[m].first_member : terms[m + 1].first_member],
            )
            if cut < 0.0:
                return -1.0
            most = max(most, cut)
    return most


@kernel
def _tighten_factors(
    coefficient: float,
    ends: Range,
    table: Any,
    places: Ints,
    lower: Floats,
    upper: Floats,
    members: Ints,
) -> float:
    """Tightens the bounds of a term's variables in place, whose ends are given."""
    most = 0.0
    for k, member in enumerate(members):
        factor = table[member]
        if factor.kind != _POWER:
            continue
        a = b = coefficient
        for j, other in enumerate(members):
            if j != k:
                v = places[table[other].variable]
                p, q = _factor_range(table[other], lower[v], upper[v])
                a, b = product(a, b, p, q)
        if a <= 0.0 <= b:
            continue
        i = places[factor.variable]
        a, b = product(ends[0], ends[1], 1.0 / b, 1.0 / a)
        y_low, y_high = affine(factor.scale, factor.offset, lower[i], upper[i])
        a, b = _root_range(a, b, factor.exponent, y_low, y_high)
        if not a <= b:
            return -1.0
        a, b = (a - factor.offset) / factor.scale, (b - factor.offset) / factor.scale
        a, b = min(a, b), max(a, b)
        if a > LARGEST or b < -LARGEST:
            continue  # An exponential overflows, which is no proof.
        a -= _DISTANCE * max(1.0, abs(a))
        b += _DISTANCE * max(1.0, abs(b))
        if a > upper[i] or b < lower[i]:
            return -1.0
        before = upper[i] - lower[i]
        lower[i], upper[i] = max(a, lower[i]), min(b, upper[i])
        after = upper[i] - lower[i]
        if after < before:
            most = max(most, 1.0 - after / before if math.isfinite(before) else 1.0)
    return most


@kernel
def _factor_range(factor: Any, low: float, high: float) -> Range:
    """Returns bounds of a factor over x in [low, high]; of a wave, those of its full swing."""
    y_low, y_high = affine(factor.scale, factor.offset, low, high)
    if factor.kind == _POWER:
        return power_range(y_low, y_high, factor.exponent)
    a, b = power_range(low, high, factor.exponent)
    if factor.kind == _EXPONENTIAL:
        return product(a, b, math.exp(y_low), math.exp(y_high))
    if factor.kind == _SINE or factor.kind == _COSINE:
        return product(a, b, -1.0, 1.0)
    return -np.inf, np.inf


@kernel
def _root_range(a: float, b: float, exponent: int, low: float, high: float) -> Range:
    """Returns bounds of the y in [low, high] with y^p in [a, b]; upside down if there is none."""
    if exponent == 0:
        return -np.inf, np.inf
    root_a, root_b = abs(a) ** (1.0 / exponent), abs(b) ** (1.0 / exponent)
    if exponent % 2 == 1:
        return math.copysign(root_a, a), math.copysign(root_b, b)
    if b < 0.0:
        return 1.0, -1.0
    inner = root_a if a > 0.0 else 0.0
    return (inner if low > -inner else -root_b), (-inner if high < inner else root_b)
