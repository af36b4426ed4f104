"""Small programs with known optima, for the tests of the local solver."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from pydrake.solvers import ExpressionCost, MathematicalProgram, MathematicalProgramResult
from pydrake.symbolic import Expression, cos, exp, log, sin

from benchmarks.collections.constrained_programs import constrained_problems
from drake_aigto.local import InteriorPoint, LocalResult, compile_nlp
from drake_aigto.solver import AigoOptions, AigoSolver

INF = math.inf
Formula = Callable[[Any], Any]


@dataclass(frozen=True)
class Problem:
    """A small program: cost, rows that are to be 0, start, bounds, and the optimal cost."""

    cost: Formula
    rows: Callable[[Any], Sequence[Any]]
    start: Sequence[float]
    optimum: float = math.nan
    lower: Sequence[float] | None = None
    upper: Sequence[float] | None = None

    def program(self) -> MathematicalProgram:
        prog = MathematicalProgram()
        x = prog.NewContinuousVariables(len(self.start), "x")
        add_cost(prog, self.cost(x))
        for row in self.rows(x):
            prog.AddConstraint(row == 0)
        if self.lower is not None and self.upper is not None:
            prog.AddBoundingBoxConstraint(self.lower, self.upper, x)
        return prog

    def solve(self, **options: Any) -> LocalResult:
        return InteriorPoint(**options).solve(compile_nlp(self.program()), self.start)


def add_cost(prog: MathematicalProgram, formula: Any) -> None:
    cost = ExpressionCost(Expression(0.0) + formula)
    prog.AddCost(cost, vars=cost.vars())


def collected(
    name: str, start: Sequence[float], lower: float = -INF, upper: float = INF
) -> Problem:
    """Returns a program of the collection, whose rows are equalities, within these bounds only."""
    (found,) = (each for each in constrained_problems() if each.name == name)
    ends = [lower] * len(start), [upper] * len(start)
    return Problem(
        found.evaluate, lambda x: found.equalities(*x), start, float(found.minimum), *ends
    )


# "HS n": W. Hock and K. Schittkowski (1981), "Test Examples for Nonlinear Programming Codes".
PROBLEMS = {
    "HS 6": collected("HS 6", [-1.2, 1.0]),
    "HS 27": collected("HS 27", [2.0, 2.0, 2.0]),
    "HS 39": collected("HS 39", [2.0] * 4),
    "HS 40": collected("HS 40", [0.8] * 4),
    "HS 42": collected("HS 42", [1.0] * 4),
    "HS 52": collected("HS 52", [2.0] * 5),
    "HS 53, no bound active": collected("HS 53", [2.0] * 5, -10.0, 10.0),
    "HS 63": collected("HS 63", [2.0] * 3, 0.0),
    "HS 78": collected("HS 78", [-2.0, 1.5, 2.0, -1.0, -1.0]),
    "HS 71, two bounds active": Problem(
        lambda x: x[0] * x[3] * (x[0] + x[1] + x[2]) + x[2],
        lambda x: [x[0] * x[1] * x[2] * x[3] - 25 - x[4], sum(x[i] ** 2 for i in range(4)) - 40],
        [1.0, 5.0, 5.0, 1.0, 0.0],
        17.0140173,
        [1.0, 1.0, 1.0, 1.0, 0.0],
        [5.0, 5.0, 5.0, 5.0, INF],
    ),
    # Interior point methods that only ever take a share of the Newton step never get there.
    "Wächter and Biegler's": Problem(
        lambda x: x[0],
        lambda x: [x[0] ** 2 - x[1] - 1, x[0] - x[2] - 0.5],
        [-2.0, 1.0, 1.0],
        1.0,
        [-INF, 0.0, 0.0],
        [INF] * 3,
    ),
    "a linear program": Problem(
        lambda x: x[0] + 2 * x[1],
        lambda x: [x[0] + x[1] - 1],
        [5.0, 1.0],
        1.0,
        [0.0] * 2,
        [INF] * 2,
    ),
    "rows that depend on each other": Problem(
        lambda x: x[0] ** 2 + x[1] ** 2,
        lambda x: [x[0] + x[1] - 1, 2 * x[0] + 2 * x[1] - 2, x[0] + x[1] - 1],
        [3.0, -1.0],
        0.5,
    ),
    # x² + 4 cos² x is least where x = 2 sin 2x.
    "a cosine row": Problem(
        lambda x: x[0] ** 2 + x[1] ** 2,
        lambda x: [x[1] - 2 * cos(x[0])],
        [1.5, 0.0],
        1.9595400123340820,
    ),
    "an exponential row": Problem(
        lambda x: x[0] + x[1],
        lambda x: [exp(x[0]) * x[1] - 1],
        [2.0, 3.0],
        1.0,
        [-5.0] * 2,
        [5.0] * 2,
    ),
    "a power times an exponential": Problem(  # Lambert's W(1) = 0.567…
        lambda x: (x[1] - 1) ** 2 + x[0],
        lambda x: [x[0] * exp(x[0]) - 1],
        [1.0, 3.0],
        0.5671432904098,
    ),
    "an arm of two links": Problem(
        lambda x: x[0] ** 2 + x[1] ** 2,
        lambda x: [cos(x[0]) + cos(x[0] + x[1]) - 1, sin(x[0]) + sin(x[0] + x[1]) - 1],
        [0.3, 1.0],
        math.pi**2 / 4,
    ),
    "no rows": Problem(lambda x: (x[0] - 1) ** 2 + (x[1] - 3) ** 4, lambda x: [], [5.0, 1.0], 0.0),
    "a log barrier": Problem(
        lambda x: 2 * x[0] - log(x[0] - 3), lambda x: [], [9.0], 7.0 + math.log(2.0)
    ),
}


def make_program(
    num_variables: int, cost: Formula, *rows: Formula, low: Any = None, high: Any = None
) -> tuple[MathematicalProgram, Any]:
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
    """Searches, unless options have it proven at once."""
    return AigoSolver(AigoOptions(**{"cells": 0, **options})).Solve(prog)
