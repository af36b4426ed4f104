"""Drake's gradient solvers on a transcription's constraints."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.solvers import IpoptSolver, MathematicalProgram, SnoptSolver, SolverOptions

from drake_aigto.arrays import Floats

# Rows are multiplied by distances of 1e-4 m near the wall: asked this tight, the true defects end
# below 1e-8.
_FEASIBILITY = 1e-11
_OPTIMALITY = 1e-8

# What solvers call these two, and the number of iterations.
_SOLVERS: dict[str, tuple[Any, str, str, str]] = {
    "snopt": (
        SnoptSolver,
        *("Major feasibility tolerance", "Major optimality tolerance", "Major iterations limit"),
    ),
    "ipopt": (IpoptSolver, "constr_viol_tol", "tol", "max_iter"),
}


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
    kind, *names = _SOLVERS[solver]
    options = SolverOptions()
    for name, value in zip(names, (_FEASIBILITY, _OPTIMALITY, max_iterations), strict=True):
        options.SetOption(kind.id(), name, value)
    with _quiet():
        result = kind().Solve(prog, guess, options)
    x, status = result.get_x_val(), result.get_solution_result().name
    is_finite = bool(np.all(np.isfinite(x)))
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
