"""Drake's gradient solvers on a transcription's constraints."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from pydrake.solvers import IpoptSolver, MathematicalProgram, SnoptSolver, SolverOptions

from drake_aigto.arrays import Floats

# Rows are multiplied by distances of 1e-4 m near the wall: asked this tight, the true defects end
# below 1e-8.
_FEASIBILITY = 1e-11
_OPTIMALITY = 1e-8


@dataclass(frozen=True)
class DrakeSolution:
    """What a gradient solver ended with.

    Attributes:
        x: all decision variables.
        is_success: the solver's own word.
        status: the solver's status, in words.
    """

    x: Floats
    is_success: bool
    status: str


def solve_with_drake(
    prog: MathematicalProgram, guess: Floats, solver: str, max_iterations: int = 200
) -> DrakeSolution:
    """Runs SNOPT or IPOPT through Drake from a guess.

    Args:
        prog: the constrained program.
        guess: all decision variables.
        solver: "snopt" or "ipopt".
        max_iterations: the solver's major iterations.
    """
    chosen = SnoptSolver() if solver == "snopt" else IpoptSolver()
    with _quiet():
        result = chosen.Solve(prog, guess, _options(solver, max_iterations))
    x = result.get_x_val()
    is_finite = bool(np.all(np.isfinite(x)))
    status = result.get_solution_result().name
    return DrakeSolution(x if is_finite else guess, result.is_success() and is_finite, status)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keeps Drake from logging that a solver ran out of iterations: candidates may fail."""
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)


def _options(solver: str, max_iterations: int) -> SolverOptions:
    options = SolverOptions()
    if solver == "snopt":
        for name, value in (
            ("Major feasibility tolerance", _FEASIBILITY),
            ("Major optimality tolerance", _OPTIMALITY),
            ("Major iterations limit", max_iterations),
        ):
            options.SetOption(SnoptSolver.id(), name, value)
    else:
        for name, value in (
            ("constr_viol_tol", _FEASIBILITY),
            ("tol", _OPTIMALITY),
            ("max_iter", max_iterations),
        ):
            options.SetOption(IpoptSolver.id(), name, value)
    return options
