"""Random small programs of every kind that `AigoSolver` takes, to break it with."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.solvers import ExpressionCost, MathematicalProgram
from pydrake.symbolic import Expression, abs, cos, exp, log, max, min, sqrt, tan


def random_program(generator: np.random.Generator) -> MathematicalProgram:
    """Returns a program of 1 to 3 variables: a polynomial, and in three of ten a function more.

    Coefficients span four decades. Some programs have a cost that grows in all directions, some may
    fall without end; bounds may be on one side, on both or none, and contradict the rows.
    """
    prog = MathematicalProgram()
    n = int(generator.integers(1, 4))
    x = prog.NewContinuousVariables(n, "x")
    growth = sum((x_i**8 for x_i in x), Expression(0.0)) if generator.random() < 0.7 else 0.0
    cost = ExpressionCost(_random_polynomial(generator, x, 4) + growth + x[0])
    prog.AddCost(cost, vars=cost.vars())
    for x_i in x:
        if generator.random() < 0.6:
            ends = np.sort(generator.normal(size=2) * 3)
            low, high = np.where(generator.random(2) < 0.3, [-np.inf, np.inf], ends)
            prog.AddBoundingBoxConstraint(low, high, x_i)
    for _ in range(int(generator.integers(0, 3))):
        row, level = _random_polynomial(generator, x, 2) + x[0], generator.normal()
        prog.AddConstraint(row == level if generator.random() < 0.4 else row <= level)
    if generator.random() < 0.3:
        extra = ExpressionCost(_random_function(generator, x))
        prog.AddCost(extra, vars=extra.vars())
    return prog


def _random_function(generator: np.random.Generator, x: Any) -> Expression:
    """Returns a function that has a value everywhere, or the tangent within its branch."""
    u, v = x[0], x[-1]
    functions = (
        lambda: u / (1.0 + v**2),
        lambda: sqrt(1.0 + u**2),
        lambda: (2.0 + u**2) ** 1.5,
        lambda: log(1.0 + u**2 + v**2),
        lambda: (1.0 + u**2) * log(1.0 + u**2),
        lambda: abs(u - v**2),
        lambda: max(u, 1.0 - v),
        lambda: min(u**2, 3.0 + v),
        lambda: tan(0.5 * cos(u)),
        lambda: exp(-(u**2) / (1.0 + v**2)),
    )
    return generator.normal() * functions[int(generator.integers(len(functions)))]()


def _random_polynomial(generator: np.random.Generator, x: Any, num_terms: int) -> Expression:
    """Returns a sum of terms of degree 0 to 6."""
    total = Expression(generator.normal())
    for _ in range(num_terms):
        term = Expression(generator.normal() * 10 ** generator.uniform(-2, 2))
        for i in generator.integers(0, x.size, 3):
            term *= x[i] ** int(generator.integers(0, 3))
        total += term
    return total
