"""What a MathematicalProgram asks: costs, rows and bounds as data."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pydrake.solvers import EvaluatorBase, MathematicalProgram
from pydrake.symbolic import Variable

from drake_aigto.arrays import Floats, Ints
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.terms import (
    ConstraintRow,
    FunctionKind,
    TermBlock,
    as_bound,
    evaluator_name,
    parse_costs,
    parse_rows,
    shared_evaluators,
    term_blocks,
)

# A row of constants may miss its bounds by this.
_ROUNDING = 1e-9
# Rows whose terms are all below the first of these within the bounds are divided by the largest
# one, down to the second, and equalities to the third: what is smaller is nothing but rounding, and
# an equality that leaves next to nothing, as x² + y² = 0, is met the slower the closer.
_SMALL, _LEAST, _LEAST_EQUALITY = 0.01, 1e-18, 5e-9


class ContradictionError(Exception):
    """Bounds or constants alone leave no feasible point."""


@dataclass(frozen=True, eq=False)
class Row:
    """Copies of lower ≤ Σ terms ≤ upper, each over its own variables.

    Attributes:
        label: how messages call it.
        row: the terms and their bounds.
        block: the same terms, and which variables each copy is of.
        origin: the constraint that it came from, and its number there; None after presolve.
    """

    label: str
    row: ConstraintRow
    block: TermBlock
    origin: tuple[EvaluatorBase, int] | None = None


class Question:
    """Minimize Σ costs subject to rows, lower ≤ x ≤ upper.

    Rows that are affine in one variable are bounds. Those whose coefficients, or whose terms within
    the bounds, are all below 1 are divided by the largest one: units of their own are no reason to
    hold them less.

    Attributes:
        costs: f.
        rows: all others.
        row_sizes: what the rows of each constraint were divided by, shape (m,) each.
        lower: bounds of x, shape (n,).
        upper: shape (n,).
    """

    def __init__(self, num_variables: int) -> None:
        """Starts with nothing."""
        self.costs: tuple[TermBlock, ...] = ()
        self.rows: list[Row] = []
        self.row_sizes: dict[EvaluatorBase, Floats] = {}
        self.lower = np.full(num_variables, -np.inf)
        self.upper = np.full(num_variables, np.inf)

    @classmethod
    def of(cls, prog: MathematicalProgram) -> Question:
        """Returns what a program asks.

        Raises:
            UnsupportedTermError: a cost or row without a mean in closed form, or variables that
                are not continuous; by name.
            ContradictionError: bounds or constants alone leave no feasible point.
        """
        _check_variables(prog)
        question = cls(prog.num_vars())
        for label, evaluator, copies in shared_evaluators(prog, prog.GetAllConstraints()):
            sizes = []
            for number, (given, variables) in enumerate(parse_rows(label, evaluator, copies)):
                row, size = _in_own_units(given)
                sizes.append(size)
                for block in term_blocks(evaluator_name(evaluator), row.terms, variables.tolist()):
                    alike = Row(label, replace(row, terms=block.terms), block, (evaluator, number))
                    question.add(alike)
            question.row_sizes[evaluator] = np.array(sizes)
        question.costs = parse_costs(prog)
        return question

    def scale_rows(self, lower: Floats, upper: Floats) -> bool:
        """Divides rows by their largest term within bounds of x (n,) that hold for feasible points.

        Returns:
            Whether a row was divided.
        """
        sizes: dict[tuple[EvaluatorBase, int] | None, float] = {}
        for each in self.rows:
            largest = _largest_term(each.block, lower, upper)
            least = _LEAST_EQUALITY if each.row.lower == each.row.upper else _LEAST
            size = largest if largest >= least else 1.0
            sizes[each.origin] = max(size, sizes.get(each.origin, 0.0))
        small = {origin: size for origin, size in sizes.items() if size < _SMALL}
        for origin, size in small.items():
            if origin is not None:
                evaluator, number = origin
                self.row_sizes[evaluator][number] *= size
        self.rows = [_divided(each, small.get(each.origin, 1.0)) for each in self.rows]
        return bool(small)

    def add(self, copies: Row) -> None:
        """Adds the copies of a row.

        Raises:
            ContradictionError: it leaves no feasible point.
        """
        row, block = copies.row, copies.block
        if row.lower > row.upper or np.isposinf(row.lower) or np.isneginf(row.upper):
            raise ContradictionError
        if np.isneginf(row.lower) and np.isposinf(row.upper):
            return
        bound = as_bound(row)
        if bound is not None:
            local, low, high = bound
            self._bound(block.variables[:, local], low, high)
        elif not any(term.factors for term in row.terms):
            _check_constant(row)
        else:
            self.rows.append(copies)

    def _bound(self, index: Ints, low: float, high: float) -> None:
        np.maximum.at(self.lower, index, low)
        np.minimum.at(self.upper, index, high)
        lower, upper = self.lower[index], self.upper[index]
        if not np.all(lower <= upper) or np.any(np.isposinf(lower) | np.isneginf(upper)):
            raise ContradictionError


def _check_variables(prog: MathematicalProgram) -> None:
    for variable in prog.decision_variables():
        if variable.get_type() != Variable.Type.CONTINUOUS:
            raise UnsupportedTermError(
                f"the variable {variable} can't be solved for",
                got=f"one of type {variable.get_type().name}",
                expected="continuous variables",
                remedy="Relax it, or use a mixed-integer solver.",
            )


def _in_own_units(row: ConstraintRow) -> tuple[ConstraintRow, float]:
    """Returns a row divided by a size, and it: the largest coefficient, or 1 if that is less."""
    largest = max((abs(term.coefficient) for term in row.terms if term.factors), default=1.0)
    size = min(1.0, largest) or 1.0
    return _scaled(row, size), size


def _scaled(row: ConstraintRow, size: float) -> ConstraintRow:
    if size == 1.0:
        return row
    terms = tuple(replace(term, coefficient=term.coefficient / size) for term in row.terms)
    return replace(row, terms=terms, lower=row.lower / size, upper=row.upper / size)


def _divided(copies: Row, size: float) -> Row:
    if size == 1.0:
        return copies
    row, block = _scaled(copies.row, size), copies.block
    own = block.with_coefficients([term.coefficient for term in row.terms])
    return replace(copies, row=row, block=own)


def _largest_term(block: TermBlock, lower: Floats, upper: Floats) -> float:
    """Returns how large a term of any copy may be within bounds of x (n,); waves swing fully."""
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


def _check_constant(row: ConstraintRow) -> None:
    value = sum(term.coefficient for term in row.terms)
    if not row.lower - _ROUNDING <= value <= row.upper + _ROUNDING:
        raise ContradictionError
