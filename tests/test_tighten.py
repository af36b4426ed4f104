"""Bounds that rows leave: sound for every feasible point, and as narrow as intervals allow."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydrake import symbolic
from pydrake.solvers import MathematicalProgram

from benchmarks.collections.constrained_programs import constrained_problems
from benchmarks.collections.known_optimum import ConstrainedProblem
from drake_aigto.solver import read_program, tighten

# Rows of x, with exp and sin from NumPy or from Drake.
ROWS: tuple[Callable[[Any, Any], Any], ...] = (
    lambda x, _: x[0] + 2 * x[1] - 0.5 * x[2],
    lambda x, _: x[0] * x[1] * x[2] + x[0],
    lambda x, _: x[0] ** 3 + x[1] ** 2 - x[2],
    lambda x, _: x[0] ** 2 * x[1] - 3 * x[2] ** 4,
    lambda x, library: library.exp(x[0]) * x[1] + x[2],
    lambda x, library: x[0] ** 2 * library.sin(3 * x[1]) - x[2] ** 3,
)


def tight_bounds(row: Any, lower: Any, upper: Any) -> tuple[Any, Any]:
    """Returns the bounds of the variables of a formula, and of its slack."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(3, "x")
    prog.AddBoundingBoxConstraint(lower, upper, x)
    prog.AddConstraint(row(x))
    return tighten(read_program(prog).nlp)


@pytest.mark.parametrize("problem", constrained_problems(), ids=lambda p: p.name)
def test_no_known_minimizer_is_cut_off(problem: ConstrainedProblem) -> None:
    program = read_program(problem.prog())
    lower, upper = tighten(program.nlp)
    assert np.all(program.nlp.lower <= lower) and np.all(upper <= program.nlp.upper)
    for x in problem.minimizers:
        y = program.with_slacks(program.reduce(x))
        assert np.all(lower - 1e-7 <= y) and np.all(y <= upper + 1e-7)


@pytest.mark.parametrize("row", ROWS)
def test_no_feasible_point_is_cut_off(row: Any) -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        lower, upper = np.sort(rng.uniform(-3, 3, (2, 3)), axis=0)
        point = rng.uniform(lower, upper)
        for i in np.flatnonzero(rng.random(3) < 0.2):
            lower[i] = -np.inf
        value = float(row(point, np))
        low, high = tight_bounds(lambda x, v=value: row(x, symbolic) == v, lower, upper)
        assert np.all(low <= point) and np.all(point <= high)


def test_rows_bound_what_nothing_else_does() -> None:
    low, high = tight_bounds(lambda x: x[0] ** 2 + x[1] ** 4 + x[2] ** 2 <= 16, -np.inf, np.inf)
    np.testing.assert_allclose(low, [-4, -2, -4, 0], atol=1e-6)
    np.testing.assert_allclose(high, [4, 2, 4, 16], atol=1e-6)


def test_signs_and_roots() -> None:
    # x₀² x₁ = x₂ in [8, 16], x₁ in [0.5, 2]: x₀² in [4, 32], and x₀ is not positive.
    low, high = tight_bounds(lambda x: x[0] ** 2 * x[1] == x[2], [-9, 0.5, 8], [1, 2, 16])
    np.testing.assert_allclose(low[0], -np.sqrt(32), atol=1e-6)
    np.testing.assert_allclose(high[0], -2, atol=1e-6)
    # −x₀³ = x₁ + x₂ in [1, 27]
    low, high = tight_bounds(lambda x: -(x[0] ** 3) == x[1] + x[2], [-9, 1, 0], [9, 20, 7])
    np.testing.assert_allclose([low[0], high[0]], [-3, -1], atol=1e-6)


def test_where_no_point_is_left_the_bounds_stay() -> None:
    low, high = tight_bounds(lambda x: x[0] * x[1] * x[2] == 9, [0, 0, 0], [2, 2, 2])
    np.testing.assert_array_equal(low, [0, 0, 0])
    np.testing.assert_array_equal(high, [2, 2, 2])
