"""Drake's MathematicalProgram: read as a `PolynomialNlp`, or solved by Drake's gradient solvers."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.solvers import (
    ExpressionConstraint,
    ExpressionCost,
    IpoptSolver,
    MathematicalProgram,
    SnoptSolver,
    SolverOptions,
)
from pydrake.symbolic import Expression, MakeVectorVariable

from drake_aigto import terms
from drake_aigto.arrays import Floats
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.local.nlp import PolynomialNlp, check_bounds
from drake_aigto.progress import log_from

# Rows are multiplied by distances of 1e-4 m near the wall: asked this tight, the true defects end
# below 1e-8.
_FEASIBILITY = 1e-11
_OPTIMALITY = 1e-8
_ITERATIONS = 200  # major ones

# Solvers' names of these three.
_SOLVERS: dict[str, tuple[Any, str, str, str]] = {
    "snopt": (
        SnoptSolver,
        *("Major feasibility tolerance", "Major optimality tolerance", "Major iterations limit"),
    ),
    "ipopt": (IpoptSolver, "constr_viol_tol", "tol", "max_iter"),
}


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
    costs = terms.parse_costs(prog)
    lower, upper = np.full(prog.num_vars(), -np.inf), np.full(prog.num_vars(), np.inf)
    rows: list[terms.TermBlock] = []
    for label, evaluator, copies in terms.shared_evaluators(prog, prog.GetAllConstraints()):
        for row in terms.parse_rows(label, evaluator, copies):
            if not row.is_free and not row.tighten(lower, upper):
                rows.append(_equality(row))
    check_bounds(lower, upper, lambda i: str(prog.decision_variable(i)))
    return PolynomialNlp(prog.num_vars(), costs, tuple(rows), lower, upper, order)


def _equality(row: terms.ParsedRow) -> terms.TermBlock:
    """Returns row − value = 0."""
    if not row.is_equality:
        raise UnsupportedTermError(
            f"{row.label} can't be compiled",
            got=f"an inequality of several variables, or not affine: {row.lower:g} ≤ {row} ≤ "
            f"{row.upper:g}",
            expected="equalities, and bounds on single variables",
            remedy="Give the expression a variable s of its own: expression == s, s ≥ 0.",
        )
    rest = (terms.Term(-row.lower, ()),) if row.lower else ()
    return terms.TermBlock(row.block.name, (*row.block.terms, *rest), row.block.variables)


def as_program(nlp: PolynomialNlp) -> MathematicalProgram:
    """Returns a problem of powers, sines and cosines as Drake's, whose variables are x."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(nlp.num_variables, "x")
    prog.AddBoundingBoxConstraint(nlp.lower, nlp.upper, x)
    for number, block in enumerate(nlp.blocks):
        y = MakeVectorVariable(block.variables.shape[1], "y")
        # NumPy takes Drake's boxed constants for invalid numbers, and warns.
        with np.errstate(invalid="ignore"):
            formula = terms.evaluate(terms.from_terms(block.terms), y * Expression(1.0))
        is_cost = number < len(nlp.costs)
        each = ExpressionCost(formula) if is_cost else ExpressionConstraint([formula], [0.0], [0.0])
        places = {variable.get_id(): i for i, variable in enumerate(y)}
        read = [places[variable.get_id()] for variable in each.vars()]
        for copy in block.variables:
            add = prog.AddCost if is_cost else prog.AddConstraint
            add(each, vars=x[copy[read]])
    return prog


def solve_with_drake(prog: MathematicalProgram, guess: Floats, solver: str) -> Floats:
    """Returns the point (n,) where SNOPT or IPOPT ends; the guess if it is not finite.

    Args:
        prog: the constrained program.
        guess: all decision variables (n,).
        solver: "snopt" or "ipopt".
    """
    kind, *names = _SOLVERS[solver]
    options = SolverOptions()
    for name, value in zip(names, (_FEASIBILITY, _OPTIMALITY, _ITERATIONS), strict=True):
        options.SetOption(kind.id(), name, value)
    with log_from(logging.ERROR, "drake"):  # Solvers may run out of iterations: candidates fail.
        x: Floats = kind().Solve(prog, guess, options).get_x_val()
    return x if np.all(np.isfinite(x)) else guess
