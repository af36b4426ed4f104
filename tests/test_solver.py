"""What `AigoSolver` answers: optima, feasible points, and honest statuses."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from general_programs import himmelblau, solve
from local_problems import add_cost
from pydrake.solvers import (
    MathematicalProgram,
    SolutionResult,
)
from pydrake.symbolic import cos, exp, log, sin, sqrt

from benchmarks.collections.random_programs import random_program
from drake_aigto.aigo import BoxSearch
from drake_aigto.solver import AigoOptions, AigoSolver, AigoStatus

# The answer.


def test_the_global_one_of_several_minima_is_found() -> None:
    for tilt, near in ((1.0, (-3.8, -3.3)), (-5.0, (3.6, -1.8))):
        prog, x = himmelblau(tilt)
        result = solve(prog)
        assert result.is_success()
        assert result.get_solution_result() == SolutionResult.kSolutionFound
        np.testing.assert_allclose(result.GetSolution(x), near, atol=0.1)
        value = prog.EvalBinding(prog.GetAllCosts()[0], result.get_x_val())[0]
        assert result.get_optimal_cost() == pytest.approx(value)


@pytest.mark.parametrize("polish", ["newton", "ipopt", "snopt"])
def test_constraints_hold_in_the_answer_and_decide_it(polish: Any) -> None:
    prog, x = himmelblau()
    prog.AddConstraint(x[0] * x[1] >= 1)
    prog.AddConstraint(x[0] ** 2 + x[1] ** 2 <= 9)
    prog.AddConstraint(x[0] ** 3 - 8 * x[1] == 6)
    result = solve(prog, polish=polish)
    assert result.is_success()
    u, v = result.GetSolution(x)
    assert u * v >= 1 - 1e-6 and u**2 + v**2 <= 9 + 1e-6
    assert u**3 - 8 * v == pytest.approx(6, abs=1e-6)
    # On the curve v = (u³ − 6)/8 within the disc there is one variable left.
    grid = np.linspace(-3, 3, 600_001)
    curve = (grid**3 - 6) / 8
    allowed = (grid * curve >= 1) & (grid**2 + curve**2 <= 9)
    costs = (grid**2 + curve - 11) ** 2 + (grid + curve**2 - 7) ** 2 + grid
    assert result.get_optimal_cost() == pytest.approx(np.min(costs[allowed]), abs=1e-3)


def test_multipliers_let_boxes_alone_meet_constraints() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    add_cost(prog, x[0] ** 2 + 2 * x[1] ** 2 - 3 * x[0])
    prog.AddConstraint(x[0] ** 2 + x[1] == 0.5)
    prog.AddConstraint(x[0] + x[1] >= 0.6)
    prog.AddBoundingBoxConstraint(-2, 2, x)
    exact = solve(prog).get_x_val()
    # By penalties alone, 2e-4 is left.
    alone = solve(prog, polish="none", feasibility=1e-5)
    assert alone.is_success() and alone.get_solver_details().polishes == 0
    np.testing.assert_allclose(alone.get_x_val(), exact, atol=1e-5)


def test_constraints_cut_the_first_box() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    add_cost(prog, -x[0] * x[1])
    prog.AddConstraint(x[0] ** 2 + x[1] ** 2 <= 8)
    prog.AddBoundingBoxConstraint(0, 1e6, x)
    result = solve(prog)
    np.testing.assert_allclose(result.get_x_val(), [2, 2], atol=1e-6)
    details = result.get_solver_details()
    np.testing.assert_allclose(details.first_half_width, np.sqrt(2), atol=1e-6)


def test_constraints_move_the_first_box_to_where_they_hold() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    add_cost(prog, (x[0] - 1) ** 2 + x[1] ** 2)
    prog.AddConstraint(x[0] - x[1] ** 2 == 70)
    prog.AddBoundingBoxConstraint(-5, 5, x[1:])
    result = solve(prog)
    assert result.is_success()
    assert result.get_solver_details().first_center[0] > 65
    np.testing.assert_allclose(result.get_x_val(), [70, 0], atol=1e-4)


def test_sines_and_cosines_need_no_lifting() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(3, "x")
    for x_i in x:
        add_cost(prog, x_i**2 - 10 * cos(2 * np.pi * x_i) + 10)
    prog.AddBoundingBoxConstraint(-4.1, 5.3, x)
    result = solve(prog)
    np.testing.assert_allclose(result.GetSolution(x), 0, atol=1e-7)


def constrained(
    num_variables: int, cost: Any, constraints: Any, reach: float | None
) -> MathematicalProgram:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(num_variables, "x")
    add_cost(prog, cost(x))
    for constraint in constraints(x):
        prog.AddConstraint(constraint)
    if reach is not None:
        prog.AddBoundingBoxConstraint(-reach, reach, x)
    return prog


@pytest.mark.parametrize("reach", [4.0, 20.0, None])
@pytest.mark.parametrize(
    ("cost", "constraints", "optimum"),
    [
        # Both elbows of an arm of two links; one takes smaller angles.
        (
            lambda x: x[0] ** 2 + x[1] ** 2,
            lambda x: [
                cos(x[0]) + cos(x[0] + x[1]) == 1,
                sin(x[0]) + sin(x[0] + x[1]) == 1,
            ],
            np.pi**2 / 4,
        ),
        (lambda x: -x[0] - x[1], lambda x: [exp(x[0]) + exp(x[1]) <= 4], -2 * np.log(2)),
        # x² + 4 cos² x where x = 2 sin 2x
        (
            lambda x: x[0] ** 2 + x[1] ** 2,
            lambda x: [x[1] == 2 * cos(x[0])],
            1.9595400123340820,
        ),
    ],
    ids=["arm", "exponentials", "cosine"],
)
def test_constraints_need_no_lifting_either(
    cost: Any, constraints: Any, optimum: float, reach: float | None
) -> None:
    result = solve(constrained(2, cost, constraints, reach))
    assert result.is_success()
    assert result.get_optimal_cost() == pytest.approx(optimum, abs=1e-6)


def test_the_lowest_of_many_valleys_of_a_constraint_is_found() -> None:
    prog = constrained(
        2, lambda x: x[1] + 0 * x[0], lambda x: [x[1] >= sin(3 * x[0]) + x[0] / 2], 4.0
    )
    grid = np.linspace(-4, 4, 800_001)
    lowest = np.min(np.sin(3 * grid) + grid / 2)
    assert solve(prog).get_optimal_cost() == pytest.approx(lowest, abs=1e-6)


@pytest.mark.parametrize(
    ("constraints", "status"),
    [
        (lambda x: [sin(x[0]) >= 2], AigoStatus.INFEASIBLE),
        # They hold, where an exponential overflows.
        (lambda x: [exp(x[0]) >= 1e200, x[0] >= 800], AigoStatus.NO_FEASIBLE_POINT),
    ],
)
def test_constraints_that_can_not_hold_or_overflow_are_no_success(
    constraints: Any, status: AigoStatus
) -> None:
    result = solve(constrained(1, lambda x: x[0] ** 2, constraints, 1e3), rounds=3)
    assert not result.is_success()
    assert result.get_solver_details().status == status


@pytest.mark.parametrize("unit", [1e7, 1e-7, 1e-12])
def test_rows_count_whatever_units_they_are_in(unit: float) -> None:
    prog, x = himmelblau()
    prog.AddConstraint(unit * (x[0] ** 3 - 8 * x[1] - 6) == 0)
    prog.AddConstraint(unit * (x[0] * x[1]), unit, np.inf)
    prog.AddConstraint(unit * (log(7 + x[0]) / (x[1] + 8)) <= unit)  # what has no mean
    result = solve(prog)
    u, v = result.GetSolution(x)
    assert result.is_success()
    assert u**3 - 8 * v == pytest.approx(6, abs=1e-6) and u * v >= 1 - 1e-6
    contrary = prog.Clone()
    contrary.AddConstraint(unit * (x[0] ** 2 + x[1] ** 2), -np.inf, unit)
    result = solve(contrary, rounds=3)
    assert not result.is_success() and result.get_solver_details().violation > 0.1


@pytest.mark.parametrize("size", [1e-4, 1e-12])
def test_rows_of_small_numbers_hold_to_their_own_size(size: float) -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    prog.AddBoundingBoxConstraint(-1, 1, x)
    add_cost(prog, (x[0] - 1) ** 2 + (x[1] - 1) ** 2)
    prog.AddConstraint(x[0] ** 2 + x[1] ** 2 <= size)
    result = solve(prog, rounds=6)
    assert result.is_success()
    assert np.sum(result.get_x_val() ** 2) == pytest.approx(size, rel=3e-6)


@pytest.mark.parametrize("unit", [1e10, 1.1e13])
def test_rows_of_huge_numbers_hold_to_rounding(
    unit: float, capfd: pytest.CaptureFixture[str]
) -> None:
    def least(unit: float) -> float:
        prog = constrained(
            2,
            lambda x: x[1] ** 2 - x[0],
            lambda x: [unit * (x[0] - np.pi * x[1] ** 2) == 0, x[0] * x[1] <= 2],
            5.0,
        )
        result = solve(prog, rounds=3)
        assert result.is_success()
        return result.get_optimal_cost()

    assert least(unit) == pytest.approx(least(1.0), abs=1e-6)
    assert not capfd.readouterr().out  # SNOPT finds such rows singular, and would print so.


def test_points_where_a_row_has_no_slope_may_be_passed() -> None:
    def row(x: Any) -> Any:
        return [sqrt(x[0] ** 2 + x[1] ** 2) >= 1]  # not met in the middle, where it has none

    result = solve(constrained(2, lambda x: x[0] ** 2 + x[1] ** 2 + x[0], row, 2.0), rounds=3)
    assert result.is_success()
    assert result.get_optimal_cost() == pytest.approx(0.0, abs=1e-6)


def test_bounds_hold_exactly() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(3, "x")
    prog.AddLinearCost(-x[0] + x[1])
    add_cost(prog, (x[2] - 0.3) ** 2)
    prog.AddBoundingBoxConstraint([-1, 2, 0.1], [1, 3, 0.1], x)
    np.testing.assert_array_equal(solve(prog).get_x_val(), [1, 2, 0.1])


@pytest.mark.parametrize("guess", [None, 40.0, -1e3])
def test_without_bounds_it_is_found_from_any_guess(guess: float | None) -> None:
    prog = MathematicalProgram()
    (x,) = prog.NewContinuousVariables(1, "x")
    add_cost(prog, (x - 3) ** 2 * (x + 2) ** 2 + 0.1 * x)
    start = None if guess is None else [guess]
    result = AigoSolver().Solve(prog, start)
    assert result.GetSolution(x) == pytest.approx(-2, abs=0.01)


def test_the_same_program_gives_the_same_bits() -> None:
    first, again = (solve(himmelblau()[0]).get_x_val() for _ in range(2))
    assert first.tobytes() == again.tobytes()


# No solution.


def test_contradictory_bounds_are_infeasible() -> None:
    prog, x = himmelblau()
    prog.AddConstraint(x[0] >= 6)
    result = solve(prog)
    assert result.get_solution_result() == SolutionResult.kInfeasibleConstraints
    assert result.get_solver_details().status is AigoStatus.CONTRADICTORY_BOUNDS


def test_no_feasible_point_is_said_to_be_no_proof() -> None:
    prog, x = himmelblau()
    prog.AddConstraint(x[0] ** 2 + x[1] ** 2 <= 1)
    prog.AddConstraint(x[0] * x[1] >= 1)
    result = solve(prog)
    assert not result.is_success()
    assert result.get_solution_result() == SolutionResult.kIterationLimit
    details = result.get_solver_details()
    assert details.status is AigoStatus.NO_FEASIBLE_POINT and "no proof" in details.status.value
    assert details.violation > 0.1


@pytest.mark.parametrize(
    "falling", [lambda x: x, lambda x: x**3, lambda x: -exp(-x), lambda x: x**2 - exp(x)]
)
def test_a_cost_that_falls_without_end_is_said_to_be_so(falling: Callable[[Any], Any]) -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    add_cost(prog, falling(x[0]) + (x[1] - 1) ** 2)
    result = solve(prog)
    assert result.get_solution_result() == SolutionResult.kUnbounded
    assert result.get_solver_details().status is AigoStatus.FALLS_WITHOUT_END


def test_cancelled_residuals_far_out_are_no_fall() -> None:
    """x = 1e20, y = −1e-20 leaves exponentials of 1, and of both terms with x nothing."""
    prog = MathematicalProgram()
    x, y = prog.NewContinuousVariables(2, "x")
    data = ((8, 0.49), (10, 0.475), (14, 0.45), (20, 0.42), (26, 0.405), (32, 0.405), (40, 0.4))
    for time, value in data:
        add_cost(prog, (value - x - (0.49 - x) * exp(-y * (time - 7))) ** 2)
    prog.AddBoundingBoxConstraint([0.4, -4.0], [np.inf, np.inf], [x, y])
    prog.AddConstraint((0.49 - x) * y >= 0.09)
    result = solve(prog)
    assert result.is_success()
    # The row binds: y = 0.09/(0.49 − x), and x is found on a line.
    line = np.linspace(0.4, 0.489, 100_000)
    fit = [(v - line - (0.49 - line) * np.exp(-0.09 * (t - 7) / (0.49 - line))) for t, v in data]
    assert result.get_optimal_cost() <= np.min(np.sum(np.square(fit), axis=0)) + 1e-9


def test_programs_without_costs_or_variables_are_solved_too() -> None:
    prog = MathematicalProgram()
    assert solve(prog).is_success()
    x = prog.NewContinuousVariables(2, "x")
    assert solve(prog).is_success()
    prog.AddConstraint(x[0] ** 2 + x[1] == 2)
    prog.AddConstraint(x[0] + x[1] ** 2 == 2)
    result = solve(prog)
    u, v = result.GetSolution(x)
    assert result.is_success() and u**2 + v == pytest.approx(2) and u + v**2 == pytest.approx(2)


@pytest.mark.slow
def test_random_programs_never_crash_and_never_lie() -> None:
    generator = np.random.default_rng(0)
    for _ in range(5):
        prog = random_program(generator)
        result = solve(prog, rounds=2)
        x = result.get_x_val()
        if result.is_success():
            assert np.all(np.isfinite(x)) and np.isfinite(result.get_optimal_cost())
            assert not result.GetInfeasibleConstraints(prog, 1e-5)


def test_where_rounding_hides_which_point_is_better_the_formula_decides() -> None:
    # Multiplied out, (x − 1000)⁶ is known to 1e-14 of 1000⁶ only: to 1e4.
    prog = MathematicalProgram()
    (x,) = prog.NewContinuousVariables(1, "x")
    add_cost(prog, (x - 1000) ** 6)
    prog.AddBoundingBoxConstraint(990, 1010.5, [x])
    result = AigoSolver(AigoOptions(rounds=5)).Solve(prog, [1000.0])
    assert result.get_optimal_cost() == (result.GetSolution(x) - 1000) ** 6
    assert result.get_optimal_cost() <= 1e-12


def test_ctrl_c_ends_all_penalties_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    prog.AddBoundingBoxConstraint(-2, 2, x)
    add_cost(prog, (x[0] - 1) ** 4 + x[1] ** 2)
    prog.AddConstraint(x[0] * x[1] == 0.25)
    stages: list[int] = []
    run = BoxSearch.run

    def interrupted(self: BoxSearch, *arguments: Any, **named: Any) -> Any:
        stages.append(1)
        return dataclasses.replace(run(self, *arguments, **named), was_interrupted=True)

    monkeypatch.setattr(BoxSearch, "run", interrupted)
    details = AigoSolver().Solve(prog).get_solver_details()
    assert details.status is AigoStatus.INTERRUPTED
    assert len(stages) == 1
