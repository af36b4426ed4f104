"""Drake's MathematicalProgram → `PolynomialNlp`: costs, equality rows and bounds."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.solvers import MathematicalProgram

from drake_aigto.errors import UnsupportedTermError
from drake_aigto.local.nlp import PolynomialNlp, check_bounds
from drake_aigto.terms import (
    ConstraintRow,
    Term,
    TermBlock,
    affine_terms,
    as_bound,
    evaluator_name,
    parse_costs,
    parse_rows,
    shared_evaluators,
    term_blocks,
)


def compile_nlp(prog: MathematicalProgram, order: ArrayLike | None = None) -> PolynomialNlp:
    """Compiles costs, equality constraints and bounds of a program; a shared evaluator once.

    Rows that are affine in one variable become bounds, and equal bounds hold their variable.

    Args:
        prog: Costs as in `parse_costs`; constraints as in `parse_rows`, and equalities unless
            they are affine in one variable.
        order: Elimination order of the decision variables, as in `BoxPolynomial`. Default:
            reverse Cuthill-McKee.

    Raises:
        UnsupportedTermError: A cost or constraint without such a form (it is named), or bounds that
            contradict each other.
    """
    costs = parse_costs(prog)
    lower, upper = np.full(prog.num_vars(), -np.inf), np.full(prog.num_vars(), np.inf)
    rows: list[TermBlock] = []
    for label, evaluator, copies in shared_evaluators(prog, prog.GetAllConstraints()):
        for row, variables in parse_rows(label, evaluator, copies):
            if np.isneginf(row.lower) and np.isposinf(row.upper):
                continue
            bound = as_bound(row)
            if bound is not None:
                local, low, high = bound
                np.maximum.at(lower, variables[:, local], low)
                np.minimum.at(upper, variables[:, local], high)
            else:
                terms = _equality_terms(label, row)
                rows.extend(term_blocks(evaluator_name(evaluator), terms, variables.tolist()))
    check_bounds(lower, upper, lambda i: str(prog.decision_variable(i)))
    return PolynomialNlp(prog.num_vars(), costs, tuple(rows), lower, upper, order)


def _equality_terms(label: str, row: ConstraintRow) -> tuple[Term, ...]:
    """Returns the terms of row − value = 0."""
    if row.lower != row.upper:
        raise UnsupportedTermError(
            f"{label} can't be compiled",
            got=f"an inequality of several variables, or not affine: {row.lower:g} ≤ {row} ≤ "
            f"{row.upper:g}",
            expected="equalities, and bounds on single variables",
            remedy="Give the expression a variable s of its own: expression == s, s ≥ 0.",
        )
    return (*row.terms, *affine_terms((), -row.lower))
