"""Small programs with known optima, for the tests of the local solver."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from pydrake.solvers import (
    ExpressionCost,
    MathematicalProgram,
)
from pydrake.symbolic import Expression, cos, exp, log, sin

from drake_aigto.local import InteriorPoint, LocalResult, compile_nlp

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


# "HS n": W. Hock and K. Schittkowski (1981), "Test Examples for Nonlinear Programming Codes".
PROBLEMS = {
    "HS6": Problem(
        lambda x: (1 - x[0]) ** 2, lambda x: [10 * (x[1] - x[0] ** 2)], [-1.2, 1.0], 0.0
    ),
    "HS27": Problem(
        lambda x: 0.01 * (x[0] - 1) ** 2 + (x[1] - x[0] ** 2) ** 2,
        lambda x: [x[0] + x[2] ** 2 + 1],
        [2.0, 2.0, 2.0],
        0.04,
    ),
    "HS39": Problem(
        lambda x: -x[0],
        lambda x: [x[1] - x[0] ** 3 - x[2] ** 2, x[0] ** 2 - x[1] - x[3] ** 2],
        [2.0] * 4,
        -1.0,
    ),
    "HS40": Problem(
        lambda x: -x[0] * x[1] * x[2] * x[3],
        lambda x: [x[0] ** 3 + x[1] ** 2 - 1, x[0] ** 2 * x[3] - x[2], x[3] ** 2 - x[1]],
        [0.8] * 4,
        -0.25,
    ),
    "HS42": Problem(
        lambda x: sum((x[i] - i - 1) ** 2 for i in range(4)),
        lambda x: [x[0] - 2, x[2] ** 2 + x[3] ** 2 - 2],
        [1.0] * 4,
        28 - 10 * math.sqrt(2),
    ),
    "HS52": Problem(
        lambda x: (
            (4 * x[0] - x[1]) ** 2 + (x[1] + x[2] - 2) ** 2 + (x[3] - 1) ** 2 + (x[4] - 1) ** 2
        ),
        lambda x: [x[0] + 3 * x[1], x[2] + x[3] - 2 * x[4], x[1] - x[4]],
        [2.0] * 5,
        1859 / 349,
    ),
    "HS53, no bound active": Problem(
        lambda x: (x[0] - x[1]) ** 2 + (x[1] + x[2] - 2) ** 2 + (x[3] - 1) ** 2 + (x[4] - 1) ** 2,
        lambda x: [x[0] + 3 * x[1], x[2] + x[3] - 2 * x[4], x[1] - x[4]],
        [2.0] * 5,
        176 / 43,
        [-10.0] * 5,
        [10.0] * 5,
    ),
    "HS63": Problem(
        lambda x: 1000 - x[0] ** 2 - 2 * x[1] ** 2 - x[2] ** 2 - x[0] * x[1] - x[0] * x[2],
        lambda x: [
            8 * x[0] + 14 * x[1] + 7 * x[2] - 56,
            x[0] ** 2 + x[1] ** 2 + x[2] ** 2 - 25,
        ],
        [2.0] * 3,
        961.7151721,
        [0.0] * 3,
        [INF] * 3,
    ),
    "HS71, two bounds active": Problem(
        lambda x: x[0] * x[3] * (x[0] + x[1] + x[2]) + x[2],
        lambda x: [x[0] * x[1] * x[2] * x[3] - 25 - x[4], sum(x[i] ** 2 for i in range(4)) - 40],
        [1.0, 5.0, 5.0, 1.0, 0.0],
        17.0140173,
        [1.0, 1.0, 1.0, 1.0, 0.0],
        [5.0, 5.0, 5.0, 5.0, INF],
    ),
    "HS78": Problem(
        lambda x: x[0] * x[1] * x[2] * x[3] * x[4],
        lambda x: [
            sum(v**2 for v in x) - 10,
            x[1] * x[2] - 5 * x[3] * x[4],
            x[0] ** 3 + x[1] ** 3 + 1,
        ],
        [-2.0, 1.5, 2.0, -1.0, -1.0],
        -2.91970041,
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
