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


class ContradictionError(Exception):
    """Bounds or constants alone leave no feasible point."""


@dataclass(frozen=True, eq=False)
class Row:
    """Copies of lower ≤ Σ terms ≤ upper, each over its own variables.

    Attributes:
        label: how messages call it.
        row: the terms and their bounds.
        block: the same terms, and which variables each copy is of.
    """

    label: str
    row: ConstraintRow
    block: TermBlock


class Question:
    """Minimize Σ costs subject to rows, lower ≤ x ≤ upper.

    Rows that are affine in one variable are bounds. Those whose coefficients are all below 1 are
    divided by the largest one: units of their own are no reason to hold them less.

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
            for given, variables in parse_rows(label, evaluator, copies):
                row, size = _in_own_units(given)
                sizes.append(size)
                for block in term_blocks(evaluator_name(evaluator), row.terms, variables.tolist()):
                    question.add(label, replace(row, terms=block.terms), block)
            question.row_sizes[evaluator] = np.array(sizes)
        question.costs = parse_costs(prog)
        return question

    def add(self, label: str, row: ConstraintRow, block: TermBlock) -> None:
        """Adds the copies of a row.

        Raises:
            ContradictionError: it leaves no feasible point.
        """
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
            self.rows.append(Row(label, row, block))

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
    """Returns a row divided by its size, and the size: its largest coefficient, or 1 if larger."""
    largest = max((abs(term.coefficient) for term in row.terms if term.factors), default=1.0)
    size = min(1.0, largest) or 1.0
    if size == 1.0:
        return row, size
    terms = tuple(replace(term, coefficient=term.coefficient / size) for term in row.terms)
    return replace(row, terms=terms, lower=row.lower / size, upper=row.upper / size), size


def _check_constant(row: ConstraintRow) -> None:
    value = sum(term.coefficient for term in row.terms)
    if not row.lower - _ROUNDING <= value <= row.upper + _ROUNDING:
        raise ContradictionError
