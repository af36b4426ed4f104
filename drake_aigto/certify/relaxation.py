"""Linear relaxations of cells: what is not linear is a column of its own, between lines.

HiGHS solves them (Huangfu & Hall 2018, Math. Program. Comput. 10:119); its answer is rounded, and
only its multipliers are used, by which bounds are proven (`relaxation_kernels`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.certify.expansions import middles
from drake_aigto.certify.formulas import Formulas, JointTape, Operation, join
from drake_aigto.certify.intervals import LARGEST, UNIT
from drake_aigto.certify.relaxation_kernels import (
    ROWS_OF_ONE,
    ROWS_OF_TWO,
    LinearProgram,
    Structure,
    cut_by_residuals,
    relax,
    safe_bound,
    violations,
)

_OF_TWO = (Operation.MULTIPLY, Operation.MAX, Operation.MIN)
_MOST_ITERATIONS = 2000
_MOST_ROUNDS = 4  # over all sides
_INNER = 0.2  # A side is cut at no less than this part of it.
_SPENT = 0.1  # of a side: a round over all sides that cuts off less is the last one
_TINY = 1e-300
# Beyond it the dual simplex of HiGHS may go on for ever from the basis of another cell.
_LARGE = 1e15

# Σ c_j w_j as column ↦ c_j, and a number.
_Linear = tuple[dict[int, Fraction], Fraction]


@dataclass
class _RowLists:
    """Rows as they are read: columns, coefficients and their errors, and bounds."""

    columns: list[list[int]] = field(default_factory=list)
    values: list[list[float]] = field(default_factory=list)
    errors: list[list[float]] = field(default_factory=list)
    bounds: list[tuple[float, float]] = field(default_factory=list)

    def add(self, linear: _Linear, lower: float, upper: float) -> None:
        """Adds lower ≤ Σ c_j w_j + constant ≤ upper."""
        terms, constant = linear
        try:
            values, errors = [float(c) for c in terms.values()], [_error(c) for c in terms.values()]
            ends = [_shifted(end, constant) for end in (lower, upper)]
        except OverflowError:  # Without a number in range, the row says nothing.
            terms, values, errors, ends = {}, [], [], [-math.inf, math.inf]
        self.columns.append(list(terms))
        self.values.append(values)
        self.errors.append(errors)
        self.bounds.append((_below(ends[0]), -_below(-ends[1])))


def _shifted(end: float, constant: Fraction) -> float:
    return float(Fraction(end) - constant) if math.isfinite(end) else end


def _below(x: float) -> float:
    return float(np.nextafter(x, -np.inf)) if math.isfinite(x) and x else x


def _error(c: Fraction) -> float:
    """Returns what a coefficient is off by as a floating number, at most."""
    return 0.0 if Fraction(float(c)) == c else abs(float(c)) * UNIT + _TINY


class _StructureReader:
    """Reads the linear structure of formulas that share their entries.

    Args:
        joint: the formulas.
        num_variables: n.
    """

    def __init__(self, joint: JointTape, num_variables: int) -> None:
        self.entries = list(range(num_variables))
        self.functions: list[tuple[int, int, int, int]] = []
        self.rows = _RowLists()
        self._joint = joint
        self._linear: list[_Linear] = []
        self._columns: dict[int, int] = {}
        for entry in range(joint.tape.operations.size):
            self._linear.append(self._read(entry))

    def form(self, entry: int) -> _Linear:
        """Returns an entry in terms of columns."""
        return self._linear[entry]

    def _read(self, entry: int) -> _Linear:
        tape = self._joint.tape
        operation, a, b = Operation(tape.operations[entry]), int(tape.a[entry]), int(tape.b[entry])
        p = Fraction(float(tape.numbers[entry]))
        match operation:
            case Operation.NUMBER:
                return {}, p
            case Operation.VARIABLE:
                return {a: Fraction(1)}, Fraction(0)
            case Operation.SHIFT:
                terms, constant = self.form(a)
                return terms, constant + p
            case Operation.SCALE:
                return _sum(({}, Fraction(0)), self.form(a), p)
            case Operation.ADD:
                return _sum(self.form(a), self.form(b), Fraction(1))
            case Operation.POWER if b == 1:
                return self.form(a)
            case Operation.MULTIPLY if not self.form(a)[0]:
                return _sum(({}, Fraction(0)), self.form(b), self.form(a)[1])
            case Operation.MULTIPLY if not self.form(b)[0]:
                return _sum(({}, Fraction(0)), self.form(a), self.form(b)[1])
        first = self._column(a)
        second = self._column(b) if operation in _OF_TWO else -1
        column = self._new_column(entry)
        self.functions.append((entry, column, first, second))
        return {column: Fraction(1)}, Fraction(0)

    def _new_column(self, entry: int) -> int:
        self.entries.append(entry)
        return len(self.entries) - 1

    def _column(self, entry: int) -> int:
        """Returns the column of an entry, with a row that defines it if it is a new one."""
        terms, constant = self.form(entry)
        if len(terms) == 1 and not constant and next(iter(terms.values())) == 1:
            return next(iter(terms))
        if entry not in self._columns:
            column = self._columns[entry] = self._new_column(entry)
            self.rows.add(({**terms, column: Fraction(-1)}, constant), 0.0, 0.0)
        return self._columns[entry]


def _sum(one: _Linear, other: _Linear, factor: Fraction) -> _Linear:
    """Returns one + factor · other."""
    terms = dict(one[0])
    for column, c in other[0].items():
        terms[column] = terms.get(column, Fraction(0)) + factor * c
    return {i: c for i, c in terms.items() if c}, one[1] + factor * other[1]


def read_structure(formulas: Formulas) -> Structure:
    """Returns the columns and rows of a program's relaxation; row 0 is the cost."""
    size = formulas.lower.size
    joint = join([formulas.summands, *((row,) for row in formulas.rows)], size, is_nested=False)
    reader = _StructureReader(joint, size)
    rows, cost = reader.rows, reader.form(joint.roots[0])
    own = _RowLists()
    is_in_range = max(map(abs, (*cost[0].values(), cost[1]))) < Fraction(LARGEST)
    own.add(cost, -np.inf, np.inf)
    for row, root in zip(formulas.rows, joint.roots[1:], strict=True):
        own.add(reader.form(root), row.lower, row.upper)
    bounds = own.bounds + rows.bounds
    columns, values = own.columns + rows.columns, own.values + rows.values
    errors, functions = own.errors + rows.errors, []
    for entry, column, first, second in reader.functions:
        functions.append((entry, column, first, second, len(columns)))
        read = [column, first] if second < 0 else [column, first, second]
        count = ROWS_OF_ONE if second < 0 else ROWS_OF_TWO
        columns += [read] * count
        values += [[0.0] * len(read)] * count
        errors += [[0.0] * len(read)] * count
        bounds += [(-np.inf, np.inf)] * count
    enclosed = np.zeros((len(reader.entries), 2))
    for column, value, error in zip(own.columns[0], own.values[0], own.errors[0], strict=True):
        enclosed[column] = value - error, value + error
    return Structure(
        joint=joint,
        entries=np.array(reader.entries, dtype=np.int64),
        functions=np.array(functions, dtype=np.int64).reshape(-1, 5),
        starts=np.cumsum([0, *map(len, columns)], dtype=np.int64),
        columns=np.array([c for row in columns for c in row], dtype=np.int64),
        values=np.array([v for row in values for v in row], dtype=float),
        errors=np.array([e for row in errors for e in row], dtype=float),
        lower=np.array([low for low, _ in bounds]),
        upper=np.array([high for _, high in bounds]),
        cost=enclosed,
        constant=_below(float(cost[1])) if is_in_range else -math.inf,
    )


@dataclass(frozen=True, eq=False)
class Relaxed:
    """What a relaxation says of a cell.

    Attributes:
        bound: of the cost; ∞ if there is no feasible point that costs less than the cutoff.
        x: the variables where the relaxation is least (n,).
        cut: the variable to cut, and where; −1: none stands out.
    """

    bound: float
    x: Floats
    cut: tuple[int, float] = (-1, 0.0)


class Relaxation:
    """Linear programs that bound a program over cells, each started from the last one's basis.

    Args:
        formulas: the program.

    Attributes:
        structure: its columns and rows.
        effort: of one of them, in cells.
    """

    def __init__(self, formulas: Formulas) -> None:
        """Makes the rows."""
        self.structure = structure = read_structure(formulas)
        self._lower = np.array([-np.inf, *(row.lower for row in formulas.rows)])
        self._upper = np.array([np.inf, *(row.upper for row in formulas.rows)])
        num_rows, num_columns = structure.lower.size, structure.entries.size
        size, entries = formulas.lower.size, structure.joint.tape.operations.size
        self._cell = LinearProgram(
            structure.values.copy(),
            np.empty(num_rows),
            np.empty(num_rows),
            np.empty((2, num_columns)),
            np.empty((entries, 1, 2)),
            np.empty((2, size)),
        )
        self._residuals = np.empty((num_columns, 2))
        self._scores = np.empty(len(structure.functions))
        self._reads = _readers(structure, size)
        self._starts = structure.starts.astype(np.int32)
        self._columns = structure.columns.astype(np.int32)
        self._sides = sides_of(formulas)
        self._integrality = np.zeros(num_columns, dtype=np.int32)
        # SciPy's own binding: `linprog` takes fifteen times as long for programs of this size. It
        # takes a while to load, and most who plan need no bounds.
        from scipy.optimize._highspy import _core as highs

        self._core, self._highs = highs, highs._Highs()
        for name, value in (
            ("output_flag", False),
            ("presolve", "off"),
            ("solver", "simplex"),
            ("threads", 1),
            ("simplex_iteration_limit", _MOST_ITERATIONS),
        ):
            self._highs.setOptionValue(name, value)
        self._basis: Any = None
        self.effort = 1 + num_columns // 4

    @property
    def linear_program(self) -> tuple[Structure, LinearProgram]:
        """Columns and rows, and those of the last cell."""
        return self.structure, self._cell

    def bound(self, low: Floats, high: Floats, cutoff: float) -> Relaxed:
        """Bounds the cost over a cell, which is narrowed in place.

        Args:
            low: its lower ends (n,).
            high: its upper ends.
            cutoff: a known value of the cost, above which a bound is of no interest.
        """
        structure, nothing = self.structure, Relaxed(np.inf, np.clip(0.0, low, high))
        if not self._fill(low, high, cutoff):
            return nothing
        bound, w, y = self._solve(structure.cost, structure.constant)
        bound = max(bound, float(self._cell.ranges[structure.joint.roots[0], 0, 0]))
        if bound == np.inf:
            return nothing
        if math.isfinite(cutoff - bound):
            cut_by_residuals(bound, cutoff, self._residuals, low, high)
            if np.any(low > high):
                return nothing
        x = np.clip(w[: low.size], low, high)
        return Relaxed(bound, x, self._choose_cut(w, y, x, low, high))

    def tighten(self, low: Floats, high: Floats, cutoff: float) -> bool:
        """Narrows a cell, in place, to the ends of each variable; returns if anything is left."""
        for _ in range(_MOST_ROUNDS):
            before = high - low
            for i in np.flatnonzero(low < high):
                for side in (low, high):
                    if not self._move(side, int(i), low, high, cutoff):
                        return False
            with np.errstate(invalid="ignore"):
                if not np.any(before - (high - low) > _SPENT * before):
                    break
        return True

    def _move(self, side: Floats, i: int, low: Floats, high: Floats, cutoff: float) -> bool:
        """Moves one end of a cell, low or high; returns if anything is left."""
        structure = self.structure
        structure.upper[0] = -_below(structure.constant - cutoff)
        is_left = self._fill(low, high, cutoff)
        structure.upper[0] = np.inf
        if not is_left:
            return False
        cost = np.zeros_like(structure.cost)
        cost[i] = 1.0 if side is low else -1.0
        bound, *_ = self._solve(cost, 0.0)
        side[i] = max(low[i], bound) if side is low else min(high[i], -bound)
        return bool(bound < np.inf and low[i] <= high[i])

    def _fill(self, low: Floats, high: Floats, cutoff: float) -> bool:
        self._upper[0] = cutoff
        return bool(relax(self.structure, self._lower, self._upper, low, high, self._cell))

    def _solve(self, cost: Floats, constant: float) -> tuple[float, Floats, Floats]:
        """Returns a bound of a cost, the point where the relaxation is least, and multipliers."""
        cell, solver, highs = self._cell, self._highs, self._core
        box = cell.box
        solver.passModel(
            box.shape[1],
            cell.lower.size,
            cell.values.size,
            int(highs.MatrixFormat.kRowwise),
            int(highs.ObjSense.kMinimize),
            0.0,
            np.ascontiguousarray(0.5 * cost[:, 0] + 0.5 * cost[:, 1]),
            box[0],
            box[1],
            cell.lower,
            cell.upper,
            self._starts,
            self._columns,
            cell.values,
            self._integrality,
        )
        numbers = np.concatenate((box[0], box[1], cell.lower, cell.upper))
        is_moderate = np.max(np.abs(numbers), where=np.isfinite(numbers), initial=0.0) < _LARGE
        if self._basis is not None and is_moderate:
            solver.setBasis(self._basis)
        solver.run()
        solution = solver.getSolution()
        status = solver.getModelStatus()
        if status == highs.HighsModelStatus.kInfeasible:
            _, is_known, ray = solver.getDualRay()
            if is_known and self._bound(np.zeros_like(cost), 0.0, np.array(ray)) > 0.0:
                return np.inf, np.empty(0), np.empty(0)
        elif status == highs.HighsModelStatus.kOptimal:
            self._basis = solver.getBasis()
        y, w = np.array(solution.row_dual), np.array(solution.col_value)
        if y.size != cell.lower.size:
            y = np.zeros(cell.lower.size)
        if w.size != box.shape[1] or not np.all(np.isfinite(w)):
            with np.errstate(invalid="ignore"):
                w = np.nan_to_num(0.5 * box[0] + 0.5 * box[1])
        return self._bound(cost, constant, y), w, y

    def _bound(self, cost: Floats, constant: float, y: Floats) -> float:
        return float(safe_bound(self.structure, self._cell, cost, constant, y, self._residuals))

    def _choose_cut(
        self, w: Floats, y: Floats, x: Floats, low: Floats, high: Floats
    ) -> tuple[int, float]:
        """Returns the variable that the functions farthest from their columns read, and where."""
        violations(self.structure, self._cell, w, y, self._scores)
        width = high - low
        shares = self._reads * np.where(np.isfinite(width), width, 1.0)
        total = np.sum(shares, axis=1)
        parts = np.divide(self._scores, total, out=np.zeros_like(total), where=total > 0.0)
        scores = parts @ shares
        widest = int(np.argmax(width / self._sides))
        i = int(np.argmax(scores)) if np.any(scores > 0.0) else widest
        place = float(middles(low[i : i + 1], high[i : i + 1])[0])
        if math.isfinite(width[i]):
            inner = _INNER * width[i]
            place = min(max(float(x[i]), low[i] + inner), high[i] - inner)
        if low[i] < place < high[i]:
            return i, place
        place = float(middles(low[widest : widest + 1], high[widest : widest + 1])[0])
        return (widest, place) if low[widest] < place < high[widest] else (-1, place)


def sides_of(formulas: Formulas) -> Floats:
    """Returns the sides of a program's box, 1 where it has no such side (n,)."""
    sides = formulas.upper - formulas.lower
    return np.where((sides > 0.0) & np.isfinite(sides), sides, 1.0)


def _readers(structure: Structure, size: int) -> Floats:
    """Returns 1 where a function reads a variable, else 0 (K, n)."""
    tape = structure.joint.tape
    reads = np.zeros((tape.operations.size, size), dtype=bool)
    for entry, operation in enumerate(tape.operations.tolist()):
        a, b = tape.a[entry], tape.b[entry]
        if operation == Operation.VARIABLE:
            reads[entry, a] = True
        elif operation != Operation.NUMBER:
            reads[entry] = reads[a]
            if operation == Operation.ADD or operation in _OF_TWO:
                reads[entry] |= reads[b]
    return reads[structure.functions[:, 0]].astype(float).reshape(-1, size)
