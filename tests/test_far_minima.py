"""Programs without bounds: minima far out are found, or it is said how far was searched."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydrake.solvers import ExpressionCost, MathematicalProgram, SolutionResult
from pydrake.symbolic import sin

from drake_aigto.solver import AigoOptions, AigoSolver, AigoStatus


def program(num_variables: int, cost: Callable[[Any], Any]) -> tuple[MathematicalProgram, Any]:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(num_variables, "x")
    formula = ExpressionCost(cost(x))
    prog.AddCost(formula, vars=formula.vars())
    return prog, x


def far_wells(x: Any, places: Any) -> Any:
    """A well near each place, lower by about as much as it is far, beyond a ridge."""
    return sum(
        1e-3 * (x_i - place) ** 2 * (x_i + 5) ** 2 - np.sign(place) * x_i
        for x_i, place in zip(x, places, strict=True)
    )


@pytest.mark.parametrize("places", [[1000], [-70_000], [1000, 2000, -300]])
def test_a_minimum_far_beyond_the_first_box_is_found(places: list[float]) -> None:
    prog, x = program(len(places), lambda x: far_wells(x, places))
    result = AigoSolver().Solve(prog)
    np.testing.assert_allclose(result.GetSolution(x), places, atol=0.1)
    lower, upper = result.get_solver_details().searched
    assert np.all(lower < np.array(places) - 1) and np.all(np.array(places) + 1 < upper)


def test_what_was_searched_is_told_unless_it_is_all() -> None:
    prog, x = program(2, lambda x: far_wells(x, [1000, 1000]))
    prog.AddConstraint(x[0] >= -20)
    result = AigoSolver(AigoOptions(rounds=5)).Solve(prog)
    details = result.get_solver_details()
    assert result.is_success() and details.status is AigoStatus.SOLVED_IN_PART
    (low, other), (high, _) = details.searched
    assert low == -20 and np.isfinite([other, high]).all()
    assert f"searched -20 ≤ x[0] ≤ {high:g}" in str(details)

    prog.AddConstraint(x[0] ** 2 + x[1] ** 2 <= 4)
    details = AigoSolver(AigoOptions(rounds=5)).Solve(prog).get_solver_details()
    assert details.status is AigoStatus.SOLVED and "searched" not in str(details)
    np.testing.assert_allclose(details.searched, [[-2, -2], [2, 2]], rtol=1e-6)


def test_without_points_far_out_the_first_box_is_the_part_that_was_searched() -> None:
    prog, _ = program(1, lambda x: far_wells(x, [1000]))
    details = AigoSolver(AigoOptions(decades=0)).Solve(prog).get_solver_details()
    first = details.first_center - details.first_half_width
    np.testing.assert_array_equal(details.searched[0], first)
    assert details.status is AigoStatus.SOLVED_IN_PART


@pytest.mark.parametrize("share", [1.0, 1e-3])
def test_a_cost_that_falls_through_oscillation_is_said_to_fall(share: float) -> None:
    prog, _ = program(2, lambda x: share * x[0] * sin(x[0]) + (x[1] - 1) ** 2)
    result = AigoSolver(AigoOptions(rounds=5)).Solve(prog)
    assert result.get_solution_result() == SolutionResult.kUnbounded
    assert result.get_solver_details().status is AigoStatus.FALLS_WITHOUT_END


def test_convex_quadratic_programs_are_searched_as_a_whole() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    prog.AddQuadraticErrorCost(np.eye(2), [3, -2], x)
    prog.AddLinearConstraint(x[0] + x[1] >= 2)
    result = AigoSolver(AigoOptions(rounds=5)).Solve(prog)
    assert result.get_solver_details().status is AigoStatus.SOLVED
    np.testing.assert_allclose(result.GetSolution(x), [3.5, -1.5], atol=1e-6)
