"""Rows that contradict each other: few of them, with numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from pydrake.solvers import MathematicalProgram

from drake_aigto.certify.contraction import contract_all
from drake_aigto.certify.enclosures import SumOfFormulas
from drake_aigto.certify.formulas import (
    BoundedFormula,
    Formulas,
    formula_of,
    join,
    make_tape,
    read_formulas,
)
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.terms import evaluator_label, shown

Rows = tuple[BoundedFormula, ...]


def narrowed(formulas: Formulas) -> tuple[Formulas, bool]:
    """Returns formulas with bounds that rows leave something of, and whether they leave any."""
    lower, upper = formulas.lower.copy(), formulas.upper.copy()
    joint = join([(row,) for row in formulas.rows], lower.size)
    low, high = formulas.row_bounds
    is_left = bool(np.all(lower <= upper))
    is_left = is_left and bool(contract_all(joint, low, high, lower[None], upper[None])[0])
    return (replace(formulas, lower=lower, upper=upper) if is_left else formulas), is_left


def is_infeasible(prog: MathematicalProgram) -> bool:
    """Returns whether ranges of rows prove that no point within the bounds meets them all."""
    try:
        return not narrowed(read_formulas(prog))[1]
    except UnsupportedTermError:
        return False


def explain_infeasibility(
    prog: MathematicalProgram, is_proven: Callable[[Formulas], bool] | None = None
) -> str:
    """Returns which rows contradict each other, one a line; empty if that is not proven.

    None of them may be left out, or the others are no longer known to contradict each other.

    Args:
        prog: the program.
        is_proven: whether there is no feasible point; by ranges of rows if None.
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
    proves = is_proven or (lambda some: not narrowed(some)[1])
    if not proves(formulas):
        return ""
    rows = _fewest(formulas.rows, lambda rows: proves(replace(formulas, rows=rows)))
    lines = [_describe(row, formulas, rows) for row in rows]
    return "\n".join(lines)


def _fewest(rows: Rows, contradict: Callable[[Rows], bool]) -> Rows:
    """Returns rows of which none may be left out; halves, quarters and so on are tried first."""
    size = max(1, len(rows) // 2)
    while True:
        place = 0
        while place < len(rows):
            others = rows[:place] + rows[place + size :]
            rows, place = (others, place) if contradict(others) else (rows, place + size)
        if size == 1:
            return rows
        size //= 2


def _describe(row: BoundedFormula, formulas: Formulas, rows: Sequence[BoundedFormula]) -> str:
    """Returns what a row asks for, and what the other ones leave it."""
    asked = f"{shown(row.expression)} has to be in [{row.lower:g}, {row.upper:g}]"
    others = tuple(each for each in rows if each is not row)
    left, is_left = narrowed(replace(formulas, rows=others))
    everything = range(formulas.lower.size)
    tape = make_tape([formula_of((row,), everything)])
    low, high = SumOfFormulas(tape, [everything]).range(left.lower, left.upper)
    found = f", and is in [{low:g}, {high:g}] where the others hold" if is_left else ""
    return f"{evaluator_label(row.binding)}: {asked}{found}"
