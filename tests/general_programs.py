"""Programs for `AigoSolver`, and calls of it."""

from __future__ import annotations

from typing import Any

from local_problems import add_cost
from pydrake.solvers import MathematicalProgram, MathematicalProgramResult

from drake_aigto.solver import AigoOptions, AigoSolver


def himmelblau(tilt: float = 1.0) -> tuple[MathematicalProgram, Any]:
    """Returns a function of four local minima; the tilt makes one of them the only global one."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    add_cost(prog, (x[0] ** 2 + x[1] - 11) ** 2 + (x[0] + x[1] ** 2 - 7) ** 2 + tilt * x[0])
    prog.AddBoundingBoxConstraint(-5, 5, x)
    return prog, x


def solve(prog: MathematicalProgram, **options: Any) -> MathematicalProgramResult:
    return AigoSolver(AigoOptions(**options)).Solve(prog)
