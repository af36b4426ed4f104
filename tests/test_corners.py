"""Concave programs of many corners: answers are no worse than those of dozens of local solves."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.solvers import MathematicalProgram, SnoptSolver

from drake_aigto.solver import AigoSolver


def concave_program(num_variables: int, seed: int) -> tuple[MathematicalProgram, float, float]:
    """−Σ d (x − c)² in a box, which more rows than half the variables cut."""
    rng = np.random.default_rng([num_variables, seed])
    count = num_variables // 2 + 1
    rows = rng.uniform(-1.0, 1.0, (count, num_variables))
    most = rows.sum(axis=1) * 0.2 + rng.uniform(0.5, 1.5, count)
    weight, center = rng.uniform(0.5, 2.0, num_variables), rng.uniform(-0.6, 0.6, num_variables)
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(num_variables, "x")
    prog.AddQuadraticCost(-2 * np.diag(weight), 2 * weight * center, -weight @ center**2, x)
    prog.AddLinearConstraint(rows, np.full(count, -np.inf), most, x)
    prog.AddBoundingBoxConstraint(-1.1, 1.6, x)
    return prog, -1.1, 1.6


@pytest.mark.parametrize("seed", [0, 1])
def test_a_concave_program_ends_in_no_worse_corner_than_many_local_solves(seed: int) -> None:
    prog, lower, upper = concave_program(10, seed)
    rng, least = np.random.default_rng(seed), np.inf
    for _ in range(60):
        found = SnoptSolver().Solve(prog, rng.uniform(lower, upper, 10), None)
        if found.is_success():
            least = min(least, found.get_optimal_cost())
    result = AigoSolver().Solve(prog)
    assert result.is_success() and np.isfinite(least)
    assert result.get_optimal_cost() <= least + 1e-6 * abs(least)
