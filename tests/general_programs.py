"""Programs for `AigoSolver`, and calls of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from local_problems import add_cost
from pydrake.solvers import MathematicalProgram, MathematicalProgramResult

from drake_aigto.solver import AigoOptions, AigoSolver

Formula = Callable[[Any], Any]


def make_program(
    num_variables: int, cost: Formula, *rows: Formula, low: Any = None, high: Any = None
) -> tuple[MathematicalProgram, Any]:
    """Returns a program of a cost, rows and bounds, if there are any, and its variables x."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(num_variables, "x")
    add_cost(prog, cost(x))
    for row in rows:
        prog.AddConstraint(row(x))
    if low is not None:
        prog.AddBoundingBoxConstraint(low, high, x)
    return prog, x


def himmelblau(tilt: float = 1.0) -> tuple[MathematicalProgram, Any]:
    """Returns a function of four local minima; the tilt makes one of them the only global one."""

    def cost(x: Any) -> Any:
        return (x[0] ** 2 + x[1] - 11) ** 2 + (x[0] + x[1] ** 2 - 7) ** 2 + tilt * x[0]

    return make_program(2, cost, low=-5, high=5)


def solve(prog: MathematicalProgram, **options: Any) -> MathematicalProgramResult:
    return AigoSolver(AigoOptions(**options)).Solve(prog)
