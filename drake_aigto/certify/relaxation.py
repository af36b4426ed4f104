"""Linear relaxations of cells: what is not linear is a column of its own, between lines.

HiGHS solves them (Huangfu & Hall 2018, Math. Program. Comput. 10:119); its answer is rounded, and
only its multipliers are used, by which bounds are proven (`relaxation_kernels`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.certify import relaxation_kernels as kernels
from drake_aigto.certify.contraction import middles
from drake_aigto.certify.formulas import Formulas, join
from drake_aigto.certify.tape import JointTape, Operation

_LEAVES = (Operation.NUMBER, Operation.VARIABLE)
_SUMS = (Operation.ADD, Operation.SHIFT, Operation.SCALE)
_OF_TWO = (Operation.MULTIPLY, Operation.MAX)
_MOST_ITERATIONS = 2000
_INNER = 0.2  # A side is cut at no less than this part of it.
# Beyond it the dual simplex of HiGHS may go on for ever from the basis of another cell.
_LARGE = 1e15

# Column ↦ coefficient, and lower and upper bound of a row.
_Sum = tuple[dict[int, float], tuple[float, float]]


def read_structure(formulas: Formulas) -> kernels.Structure:
    """Returns the columns and rows of a program's relaxation; the first root is the cost."""
    summands = [formulas.summands, *((row,) for row in formulas.rows)]
    joint = join(summands, formulas.lower.size, is_nested=False)
    sums, first, rows = _read_sums(joint), [0], []
    for k, (operation, a, b, _) in enumerate(zip(*joint.tape[:4], strict=True)):
        if operation in _OF_TWO and a != b:
            rows += [({k: 1.0, a: 0.0, b: 0.0}, (-math.inf, math.inf))] * kernels.ROWS_OF_TWO
        elif k in sums:
            rows.append(sums[k])
        elif operation not in (*_LEAVES, *_SUMS, *_OF_TWO):
            rows += [({k: 1.0, a: 0.0}, (-math.inf, math.inf))] * kernels.ROWS_OF_ONE
        first.append(len(rows))
    return kernels.Structure(
        joint=joint,
        first=np.array(first),
        starts=np.cumsum([0, *(len(row) for row, _ in rows)], dtype=np.int64),
        columns=np.array([column for row, _ in rows for column in row], dtype=np.int64),
        values=np.array([value for row, _ in rows for value in row.values()], dtype=float),
        lower=np.array([low for _, (low, _) in rows]),
        upper=np.array([high for _, (_, high) in rows]),
    )


def _read_sums(joint: JointTape) -> dict[int, _Sum]:
    """Returns w − Σ c w' and what it is, of every sum w that is no part of another one.

    Coefficients are exact: a part is taken in as it is, once.
    """
    operations, first, last, numbers, _ = joint.tape
    uses = np.bincount(joint.roots, minlength=operations.size) * 2
    for k, operation in enumerate(operations.tolist()):
        if operation not in _LEAVES:
            uses[first[k]] += 1
            if operation == Operation.ADD or operation in _OF_TWO:
                uses[last[k]] += 1
    sums: dict[int, _Sum] = {}
    for k, operation in enumerate(operations.tolist()):
        if operation not in _SUMS:
            continue
        p, own = float(numbers[k]), [int(first[k])]
        own += [int(last[k])] if operation == Operation.ADD else []
        scale, shift = (p, 0.0) if operation == Operation.SCALE else (1.0, p)
        terms, low, high = {k: 1.0}, shift, shift
        for j in own:
            part, ends = sums.get(j, ({}, (0.0, 0.0)))
            others = part.keys() - {j}
            is_part = bool(others) and uses[j] == 1 and scale == 1.0
            if is_part and not others & {*terms, *own}:
                terms |= {column: part[column] for column in others}
                low, high = (_sum(low, ends[0], -math.inf), _sum(high, ends[1], math.inf))
                del sums[j]
            else:
                terms[j] = terms.get(j, 0.0) - scale
        is_small = max(map(abs, terms.values())) <= kernels.LARGEST_COEFFICIENT
        sums[k] = (terms, (low, high)) if is_small else ({k: 1.0}, (-math.inf, math.inf))
    return sums


def _sum(a: float, b: float, towards: float) -> float:
    return math.nextafter(a + b, towards) if a and b else a + b


class Relaxation:
    """Linear programs that bound a program over cells, each started from the last one's basis.

    Args:
        formulas: the program.

    Attributes:
        structure: its columns and rows.
        cell: those of the last cell.
        effort: of one of them, in cells.
    """

    def __init__(self, formulas: Formulas) -> None:
        """Makes the rows."""
        self.structure = structure = read_structure(formulas)
        low, high = formulas.row_bounds
        self._lower, self._upper = np.append(-np.inf, low), np.append(np.inf, high)
        size, num_columns = formulas.lower.size, structure.first.size - 1
        self.cell = kernels.LinearProgram(
            structure.values.copy(),
            structure.lower.copy(),
            structure.upper.copy(),
            np.empty((2, num_columns)),
            np.empty((num_columns, 1, 2)),
        )
        self._functions = np.flatnonzero(np.diff(structure.first) > 1)
        self._reads = _readers(structure, size)[self._functions]
        self._starts = structure.starts.astype(np.int32)
        self._columns = structure.columns.astype(np.int32)
        self._integrality = np.zeros(num_columns, dtype=np.int32)
        # SciPy's own binding: `linprog` takes fifteen times as long for programs of this size. It
        # takes a while to load, and most who plan need no bounds.
        from scipy.optimize._highspy import _core as highs

        self._core, self._highs = highs, highs._Highs()
        options = {"output_flag": False, "presolve": "off", "solver": "simplex", "threads": 1}
        options |= {"simplex_iteration_limit": _MOST_ITERATIONS}
        for name, value in options.items():
            self._highs.setOptionValue(name, value)
        self._basis: Any = None
        self.effort = 1 + self._functions.size // 4 + size // 4

    def bound(
        self, low: Floats, high: Floats, cutoff: float
    ) -> tuple[float, Floats, tuple[int, float]]:
        """Bounds the cost over a cell, which is narrowed in place.

        Args:
            low: its lower ends (n,).
            high: its upper ends.
            cutoff: a known value of the cost, above which a bound is of no interest.

        Returns:
            The bound, ∞ if there is no feasible point that costs less than the cutoff; where the
            relaxation is least (n,); the variable to cut, −1 if none stands out, and where.
        """
        nothing, root = (np.inf, np.clip(0.0, low, high), (-1, 0.0)), self.structure.joint.roots[0]
        if not self._fill(low, high, cutoff):
            return nothing
        bound, w, y = self._solve(root, 1.0)
        if bound == np.inf:
            return nothing
        x = np.clip(w[: low.size], low, high)
        bound = max(bound, float(self.cell.ranges[root, 0, 0]))
        return bound, x, self._choose_cut(w, y, x, low, high)

    def tighten(self, i: int, low: Floats, high: Floats, cutoff: float) -> bool:
        """Narrows a cell, in place, to the ends of a variable; returns if anything is left."""
        for side in (low, high):
            if not self._fill(low, high, cutoff):
                return False
            bound, *_ = self._solve(i, 1.0 if side is low else -1.0)
            side[i] = max(low[i], bound) if side is low else min(high[i], -bound)
            if not (bound < np.inf and low[i] <= high[i]):
                return False
        return True

    def _fill(self, low: Floats, high: Floats, cutoff: float) -> bool:
        self._upper[0] = cutoff
        return bool(kernels.relax(self.structure, self._lower, self._upper, low, high, self.cell))

    def _solve(self, column: int, sign: float) -> tuple[float, Floats, Floats]:
        """Returns a bound of ± a column, the point where that is least, and multipliers."""
        cell, solver, highs = self.cell, self._highs, self._core
        box, cost = cell.box, np.zeros(cell.box.shape[1])
        cost[column] = sign
        sizes = box.shape[1], cell.lower.size, cell.values.size
        kinds = int(highs.MatrixFormat.kRowwise), int(highs.ObjSense.kMinimize)
        matrix = self._starts, self._columns, cell.values
        ends = *box, cell.lower, cell.upper
        solver.passModel(*sizes, *kinds, 0.0, cost, *ends, *matrix, self._integrality)
        numbers = np.concatenate(ends)
        is_moderate = np.max(np.abs(numbers), where=np.isfinite(numbers), initial=0.0) < _LARGE
        if self._basis is not None and is_moderate:
            solver.setBasis(self._basis)
        solver.run()
        solution = solver.getSolution()
        status = solver.getModelStatus()
        if status == highs.HighsModelStatus.kInfeasible:
            _, is_known, ray = solver.getDualRay()
            if is_known and self._bound(column, 0.0, np.array(ray)) > 0.0:
                return np.inf, np.empty(0), np.empty(0)
        elif status == highs.HighsModelStatus.kOptimal:
            self._basis = solver.getBasis()
        y, w = np.array(solution.row_dual), np.array(solution.col_value)
        if y.size != cell.lower.size:
            y = np.zeros(cell.lower.size)
        if w.size != box.shape[1] or not np.all(np.isfinite(w)):
            with np.errstate(invalid="ignore"):
                w = np.nan_to_num(0.5 * box[0] + 0.5 * box[1])
        return self._bound(column, sign, y), w, y

    def _bound(self, column: int, sign: float, y: Floats) -> float:
        return float(kernels.safe_bound(self.structure, self.cell, (column, sign), y))

    def _choose_cut(
        self, w: Floats, y: Floats, x: Floats, low: Floats, high: Floats
    ) -> tuple[int, float]:
        """Returns the variable that the functions farthest from their columns read, and where."""
        y = y if np.any(y) else np.ones_like(y)  # Of a cost that does not vary, all rows matter.
        own = kernels.violations(self.structure, self.cell, self._functions, w, y)
        width = high - low
        shares = self._reads * np.where(np.isfinite(width), width, 1.0)
        total = np.sum(shares, axis=1)
        with np.errstate(over="ignore", invalid="ignore"):
            scores = np.divide(own, total, out=np.zeros_like(total), where=total > 0.0) @ shares
        i = int(np.argmax(scores))
        if not scores[i] > 0.0:
            return -1, 0.0
        place = float(middles(low[i : i + 1], high[i : i + 1])[0])
        if math.isfinite(width[i]):
            inner = _INNER * width[i]
            place = min(max(float(x[i]), low[i] + inner), high[i] - inner)
        return (i if low[i] < place < high[i] else -1), place


def _readers(structure: kernels.Structure, size: int) -> Floats:
    """Returns 1 where an entry reads a variable, else 0 (E, n)."""
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
    return reads.astype(float)
