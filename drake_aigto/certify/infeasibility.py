"""Whether rows leave no point within the bounds, and which few of them contradict each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydrake.solvers import MathematicalProgram

from drake_aigto.certify.certificate import Certificate, Certifier
from drake_aigto.certify.formulas import BoundedFormula, Formulas, Summand, read_formulas
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.terms import evaluator_label, shown

_MOST_TRIED = 10  # times the cells of one proof: subsets of rows that are tried, in all

Rows = tuple[BoundedFormula, ...]


def is_infeasible(prog: MathematicalProgram, cells: int = 0) -> bool:
    """Returns whether it is proven that no point within the bounds meets all rows.

    Args:
        prog: its cost counts for nothing.
        cells: the most that are bounded, until a point meets all rows; 0: ranges of rows decide.
    """
    try:
        return _bound(read_formulas(prog), cells).is_infeasible
    except UnsupportedTermError:
        return False


def explain_infeasibility(prog: MathematicalProgram, cells: int = 0) -> str:
    """Returns which rows contradict each other, one a line; empty if that is not proven.

    Each comes with what it is where the others hold. None of them may be left out, or as many cells
    no longer prove it; where cells are used up, some are not tried.

    Args:
        prog: as in `is_infeasible`.
        cells: as in `is_infeasible`, for each proof.
    """
    try:
        formulas = read_formulas(prog)
    except UnsupportedTermError:
        return ""
    crossed = np.flatnonzero(formulas.lower > formulas.upper).tolist()
    if crossed:
        i = crossed[0]
        low, high = formulas.lower[i], formulas.upper[i]
        return f"{formulas.names[i]} has to be at least {low:g}, and at most {high:g}"
    if not _bound(formulas, cells).is_infeasible:
        return ""
    rows = _fewest(formulas, cells)
    return "\n".join(_describe(row, replace(formulas, rows=rows), cells) for row in rows)


def _bound(formulas: Formulas, cells: int, cost: tuple[Summand, ...] = ()) -> Certificate:
    """Bounds a sum, or nothing, over all points that meet all rows."""
    certifier = Certifier(replace(formulas, summands=cost))
    return certifier.run(cells, certifier.check)


def _fewest(formulas: Formulas, cells: int) -> Rows:
    """Returns rows of which none may be left out; halves, quarters and so on are tried first."""
    rows, spent = formulas.rows, 0
    size = max(1, len(rows) // 2)
    while True:
        place = 0
        while place < len(rows) and spent <= _MOST_TRIED * cells:
            others = rows[:place] + rows[place + size :]
            found = _bound(replace(formulas, rows=others), cells)
            spent += found.cells
            rows, place = (others, place) if found.is_infeasible else (rows, place + size)
        if size == 1:
            return rows
        size //= 2


def _describe(row: BoundedFormula, formulas: Formulas, cells: int) -> str:
    """Returns what a row asks for, and what the other ones leave it."""
    others = replace(formulas, rows=tuple(each for each in formulas.rows if each is not row))
    low, high = (s * _bound(others, cells, tuple(row.parts(s))).lower_bound for s in (1.0, -1.0))
    asked = f"{shown(row.expression)} has to be in [{row.lower:g}, {row.upper:g}]"
    found = f", and is in [{low:g}, {high:g}] where the others hold" if low <= high else ""
    return f"{evaluator_label(row.binding)}: {asked}{found}"
