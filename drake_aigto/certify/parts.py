"""Formulas of a program, as each way to bound it needs them."""

from __future__ import annotations

import numpy as np

from drake_aigto.certify.cell_kernels import Rows
from drake_aigto.certify.cliques import CliqueProgram
from drake_aigto.certify.few_variables import CellProgram
from drake_aigto.certify.program import Formulas, formula_of
from drake_aigto.certify.tape import make_tape
from drake_aigto.certify.values import group


def cell_program(formulas: Formulas) -> CellProgram:
    """Returns the cost and every row as formulas of all variables."""
    everything = range(formulas.lower.size)
    sums = [formulas.summands, *((row.formula,) for row in formulas.rows)]
    bounds = [
        np.array([getattr(row, side) for row in formulas.rows]) for side in ("lower", "upper")
    ]
    tape = make_tape(formula_of(each, everything) for each in sums)
    return CellProgram(tape, Rows(*bounds), formulas.lower, formulas.upper)


def clique_program(formulas: Formulas) -> CliqueProgram:
    """Returns a formula for every set of variables, those of one variable first, and every row."""
    size = formulas.lower.size
    groups = group(formulas.summands)
    groups[(0,)] = groups.get((0,), []) + groups.pop((), [])
    alone = [(i,) for i in range(size)]
    several = [variables for variables in groups if len(variables) > 1]
    sums = [formula_of(groups.get(each, []), each) for each in (*alone, *several)]
    rows = [row for row in formulas.rows if row.formula.variables]
    sums += [formula_of((row.formula,), row.formula.variables) for row in rows]
    free = [-np.inf] * (size + len(several)), [np.inf] * (size + len(several))
    return CliqueProgram(
        tape=make_tape(sums),
        variables=(*alone, *several, *(row.formula.variables for row in rows)),
        lower_rows=np.array([*free[0], *(row.lower for row in rows)]),
        upper_rows=np.array([*free[1], *(row.upper for row in rows)]),
        is_row=np.array([0] * (size + len(several)) + [1] * len(rows)),
        lower=formulas.lower,
        upper=formulas.upper,
    )
