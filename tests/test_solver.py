"""Answers of `AigoSolver`: optima, feasible points, minima far out, and honest statuses."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from local_problems import Formula, add_cost, himmelblau, make_program, solve
from marks import slow
from pydrake.solvers import ExpressionConstraint, MathematicalProgram, SnoptSolver, SolutionResult
from pydrake.symbolic import cos, exp, log, sin, sqrt

from benchmarks.random_programs import random_program
from drake_aigto.aigo import BoxSearch
from drake_aigto.solver import AigoOptions, AigoSolver, AigoStatus


def test_the_global_one_of_several_minima_is_found() -> None:
    for tilt, near in ((1.0, (-3.8, -3.3)), (-5.0, (3.6, -1.8))):
        prog, x = himmelblau(tilt)
        result = solve(prog)
        assert result.get_solution_result() == SolutionResult.kSolutionFound
        np.testing.assert_allclose(result.GetSolution(x), near, atol=0.1)
        value = prog.EvalBinding(prog.GetAllCosts()[0], result.get_x_val())[0]
        assert result.get_optimal_cost() == pytest.approx(value)


@pytest.mark.parametrize("polish", ["newton", *slow("ipopt", "snopt")])
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


@pytest.mark.slow
def test_multipliers_let_boxes_alone_meet_constraints() -> None:
    prog, _ = make_program(
        2,
        lambda x: x[0] ** 2 + 2 * x[1] ** 2 - 3 * x[0],
        lambda x: x[0] ** 2 + x[1] == 0.5,
        lambda x: x[0] + x[1] >= 0.6,
        low=-2,
        high=2,
    )
    exact = solve(prog).get_x_val()
    # By penalties alone, 2e-4 is left.
    alone = solve(prog, polish="none", feasibility=1e-5)
    assert alone.is_success() and alone.get_solver_details().polishes == 0
    np.testing.assert_allclose(alone.get_x_val(), exact, atol=1e-5)


@pytest.mark.slow
def test_constraints_cut_the_first_box_and_move_it_to_where_they_hold() -> None:
    cut, _ = make_program(
        2, lambda x: -x[0] * x[1], lambda x: x[0] ** 2 + x[1] ** 2 <= 8, low=0, high=1e6
    )
    result = solve(cut)
    np.testing.assert_allclose(result.get_x_val(), [2, 2], atol=1e-6)
    half_width = result.get_solver_details().first_half_width
    np.testing.assert_allclose(half_width, np.sqrt(2), atol=1e-6)
    moved, x = make_program(
        2, lambda x: (x[0] - 1) ** 2 + x[1] ** 2, lambda x: x[0] - x[1] ** 2 == 70
    )
    moved.AddBoundingBoxConstraint(-5, 5, x[1:])
    result = solve(moved)
    assert result.is_success()
    assert result.get_solver_details().first_center[0] > 65
    np.testing.assert_allclose(result.get_x_val(), [70, 0], atol=1e-4)


@pytest.mark.parametrize("reach", [4.0, *slow(None)])
@pytest.mark.parametrize(
    ("cost", "rows", "optimum"),
    [
        # Both elbows of an arm of two links; one takes smaller angles.
        (
            lambda x: x[0] ** 2 + x[1] ** 2,
            (
                lambda x: cos(x[0]) + cos(x[0] + x[1]) == 1,
                lambda x: sin(x[0]) + sin(x[0] + x[1]) == 1,
            ),
            np.pi**2 / 4,
        ),
        (lambda x: -x[0] - x[1], (lambda x: exp(x[0]) + exp(x[1]) <= 4,), -2 * np.log(2)),
        # x² + 4 cos² x where x = 2 sin 2x
        (lambda x: x[0] ** 2 + x[1] ** 2, (lambda x: x[1] == 2 * cos(x[0]),), 1.9595400123340820),
    ],
    ids=["arm", "exponentials", "cosine"],
)
def test_constraints_need_no_lifting_either(
    cost: Formula, rows: tuple[Formula, ...], optimum: float, reach: float | None
) -> None:
    ends = {} if reach is None else {"low": -reach, "high": reach}
    result = solve(make_program(2, cost, *rows, **ends)[0])
    assert result.is_success()
    assert result.get_optimal_cost() == pytest.approx(optimum, abs=1e-6)


@pytest.mark.slow
def test_the_lowest_of_many_valleys_of_a_constraint_is_found() -> None:
    prog, _ = make_program(
        2, lambda x: x[1], lambda x: x[1] >= sin(3 * x[0]) + x[0] / 2, low=-4.0, high=4.0
    )
    grid = np.linspace(-4, 4, 800_001)
    lowest = np.min(np.sin(3 * grid) + grid / 2)
    assert solve(prog).get_optimal_cost() == pytest.approx(lowest, abs=1e-6)


@pytest.mark.slow
def test_a_concave_program_ends_in_no_worse_corner_than_many_local_solves() -> None:
    """−Σ d (x − c)² in a box, which more rows than half the variables cut."""
    rng = np.random.default_rng([10, 0])
    rows = rng.uniform(-1.0, 1.0, (6, 10))
    most = rows.sum(axis=1) * 0.2 + rng.uniform(0.5, 1.5, 6)
    weight, center = rng.uniform(0.5, 2.0, 10), rng.uniform(-0.6, 0.6, 10)
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(10, "x")
    prog.AddQuadraticCost(-2 * np.diag(weight), 2 * weight * center, -weight @ center**2, x)
    prog.AddLinearConstraint(rows, np.full(6, -np.inf), most, x)
    prog.AddBoundingBoxConstraint(-1.1, 1.6, x)
    starts = np.random.default_rng(0).uniform(-1.1, 1.6, (60, 10))
    found = [SnoptSolver().Solve(prog, start, None) for start in starts]
    least = min(each.get_optimal_cost() for each in found if each.is_success())
    result = solve(prog)
    assert result.is_success() and result.get_optimal_cost() <= least + 1e-6 * abs(least)


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1e7, 1e-12])
def test_rows_count_whatever_units_they_are_in(unit: float) -> None:
    prog, x = himmelblau()
    prog.AddConstraint(unit * (x[0] ** 3 - 8 * x[1] - 6) == 0)
    prog.AddConstraint(unit * (x[0] * x[1]), unit, np.inf)
    prog.AddConstraint(unit * (log(7 + x[0]) / (x[1] + 8)) <= unit)  # It has no mean.
    result = solve(prog)
    u, v = result.GetSolution(x)
    assert result.is_success()
    assert u**3 - 8 * v == pytest.approx(6, abs=1e-6) and u * v >= 1 - 1e-6
    contrary = prog.Clone()
    contrary.AddConstraint(unit * (x[0] ** 2 + x[1] ** 2), -np.inf, unit)
    result = solve(contrary, rounds=3)
    assert not result.is_success() and result.get_solver_details().violation > 0.1


@pytest.mark.parametrize("size", [1e-4, *slow(1e-12)])
def test_rows_of_small_numbers_hold_to_their_own_size(size: float) -> None:
    prog, _ = make_program(
        2,
        lambda x: (x[0] - 1) ** 2 + (x[1] - 1) ** 2,
        lambda x: x[0] ** 2 + x[1] ** 2 <= size,
        low=-1,
        high=1,
    )
    result = solve(prog, rounds=6)
    assert result.is_success()
    assert np.sum(result.get_x_val() ** 2) == pytest.approx(size, rel=3e-6)


@pytest.mark.slow
def test_rows_of_huge_numbers_hold_to_rounding(capfd: pytest.CaptureFixture[str]) -> None:
    def least(unit: float) -> float:
        prog, _ = make_program(
            2,
            lambda x: x[1] ** 2 - x[0],
            lambda x: unit * (x[0] - np.pi * x[1] ** 2) == 0,
            lambda x: x[0] * x[1] <= 2,
            low=-5.0,
            high=5.0,
        )
        result = solve(prog, rounds=3)
        assert result.is_success()
        return result.get_optimal_cost()

    assert least(1.1e13) == pytest.approx(least(1.0), abs=1e-6)
    assert not capfd.readouterr().out  # SNOPT finds such rows singular, and would print so.


def test_rows_that_overflow_relative_to_their_size_are_not_met() -> None:
    prog, _ = make_program(
        2,
        lambda x: 1e-80 * x[0],
        lambda x: 1e-250 * x[0] ** 2 * x[1] ** 2 <= 1e71,
        low=1e80,
        high=1e81,
    )
    result = AigoSolver(AigoOptions(certify=True)).Solve(prog)
    assert result.get_optimal_cost() == pytest.approx(1.0)


@pytest.mark.slow
def test_points_where_a_row_has_no_slope_may_be_passed() -> None:
    prog, _ = make_program(
        2,
        lambda x: x[0] ** 2 + x[1] ** 2 + x[0],
        lambda x: sqrt(x[0] ** 2 + x[1] ** 2) >= 1,  # not met in the middle, where it has none
        low=-2.0,
        high=2.0,
    )
    result = solve(prog, rounds=1)
    assert result.is_success()
    assert result.get_optimal_cost() == pytest.approx(0.0, abs=1e-6)


def test_what_few_cells_prove_is_not_searched() -> None:
    found = AigoSolver().Solve(himmelblau()[0]).get_solver_details()
    searched = solve(himmelblau()[0]).get_solver_details()
    assert found.status is AigoStatus.PROVEN and found.boxes == 0 < searched.boxes
    assert searched.status is AigoStatus.SOLVED and searched.certificate is None
    assert found.cost == pytest.approx(searched.cost, abs=1e-9)


def test_bounds_hold_exactly() -> None:
    prog, x = make_program(3, lambda x: (x[2] - 0.3) ** 2, low=[-1, 2, 0.1], high=[1, 3, 0.1])
    prog.AddLinearCost(-x[0] + x[1])
    np.testing.assert_array_equal(solve(prog).get_x_val(), [1, 2, 0.1])


@pytest.mark.parametrize("guess", [-1e3, *slow(None)])
def test_without_bounds_it_is_found_from_any_guess(guess: float | None) -> None:
    prog, x = make_program(1, lambda x: (x[0] - 3) ** 2 * (x[0] + 2) ** 2 + 0.1 * x[0])
    result = AigoSolver(AigoOptions(cells=0)).Solve(prog, None if guess is None else [guess])
    assert result.GetSolution(x[0]) == pytest.approx(-2, abs=0.01)


def test_where_rounding_hides_which_point_is_better_the_formula_decides() -> None:
    # Multiplied out, (x − 1000)⁶ is known to 1e-14 of 1000⁶ only: to 1e4.
    prog, x = make_program(1, lambda x: (x[0] - 1000) ** 6, low=990, high=1010.5)
    result = AigoSolver(AigoOptions(cells=0, rounds=5)).Solve(prog, [1000.0])
    assert result.get_optimal_cost() == (result.GetSolution(x[0]) - 1000) ** 6
    assert result.get_optimal_cost() <= 1e-12


@pytest.mark.slow
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


def far_wells(x: Any, places: Any) -> Any:
    """A well near each place, lower by about as much as it is far, beyond a ridge."""
    return sum(
        1e-3 * (x_i - place) ** 2 * (x_i + 5) ** 2 - np.sign(place) * x_i
        for x_i, place in zip(x, places, strict=True)
    )


@pytest.mark.parametrize("places", [[-70_000], *slow([1000, 2000, -300])])
def test_a_minimum_far_beyond_the_first_box_is_found(places: list[float]) -> None:
    prog, x = make_program(len(places), lambda x: far_wells(x, places))
    result = solve(prog)
    np.testing.assert_allclose(result.GetSolution(x), places, atol=0.1)
    lower, upper = result.get_solver_details().searched
    assert np.all(lower < np.array(places) - 1) and np.all(np.array(places) + 1 < upper)


@pytest.mark.slow
def test_the_part_that_was_searched_is_reported_unless_it_is_all() -> None:
    prog, x = make_program(
        2, lambda x: far_wells(x, [1000, 1000]), low=[-20, -np.inf], high=[np.inf, np.inf]
    )
    result = solve(prog, rounds=5)
    details = result.get_solver_details()
    assert result.is_success() and details.status is AigoStatus.SOLVED_IN_PART
    (low, other), (high, _) = details.searched
    assert low == -20 and np.isfinite([other, high]).all()
    assert f"searched -20 ≤ x[0] ≤ {high:g}" in str(details)

    prog.AddConstraint(x[0] ** 2 + x[1] ** 2 <= 4)
    details = solve(prog, rounds=5).get_solver_details()
    assert details.status is AigoStatus.SOLVED and "searched" not in str(details)
    np.testing.assert_allclose(details.searched, [[-2, -2], [2, 2]], rtol=1e-6)


def test_without_points_far_out_the_first_box_is_the_part_that_was_searched() -> None:
    details = solve(
        make_program(1, lambda x: far_wells(x, [1000]))[0], decades=0
    ).get_solver_details()
    first = details.first_center - details.first_half_width
    np.testing.assert_array_equal(details.searched[0], first)
    assert details.status is AigoStatus.SOLVED_IN_PART


@pytest.mark.slow
def test_convex_quadratic_programs_are_searched_as_a_whole() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    prog.AddLinearConstraint(x[0] + x[1] >= 2)
    prog.AddQuadraticErrorCost(np.eye(2), [3, -2], x)
    result = solve(prog, rounds=5)
    assert result.get_solver_details().status is AigoStatus.SOLVED
    np.testing.assert_allclose(result.GetSolution(x), [3.5, -1.5], atol=1e-6)


@pytest.mark.parametrize(
    "falling",
    [
        *(lambda x: x, lambda x: x**3, lambda x: -exp(-x), lambda x: x**2 - exp(x)),
        lambda x: 1e-3 * x * sin(x),
    ],
)
def test_a_cost_that_falls_without_end_is_said_to_be_so(falling: Formula) -> None:
    prog, _ = make_program(2, lambda x: falling(x[0]) + (x[1] - 1) ** 2)
    result = solve(prog, rounds=5)
    assert result.get_solution_result() == SolutionResult.kUnbounded
    assert result.get_solver_details().status is AigoStatus.FALLS_WITHOUT_END


@pytest.mark.slow
@pytest.mark.parametrize("certify", [False, True])
def test_a_cost_that_falls_along_a_bent_row_is_said_to_be_so(certify: bool) -> None:
    """So far out that local solves lose the row, which leaves |y| = 8.5^¼ there."""
    prog, (x, y) = make_program(2, lambda x: 4.9 * x[0] * x[1] ** 2 - 16.4 * x[0] ** 4)
    prog.AddConstraint(0.5 + x + 0.25 * x**2 * y**4 - 2.1 * x**2 == 0.0)
    prog.AddBoundingBoxConstraint(-np.inf, 4.6, x)
    result = solve(prog, rounds=4, certify=certify, cells=500)
    assert result.get_solver_details().status is AigoStatus.FALLS_WITHOUT_END


@pytest.mark.slow
def test_cancelled_residuals_far_out_are_no_fall() -> None:
    """x = 1e20, y = −1e-20 leaves exponentials of 1, and of both terms with x nothing."""
    data = ((8, 0.49), (10, 0.475), (14, 0.45), (20, 0.42), (26, 0.405), (32, 0.405), (40, 0.4))
    prog = MathematicalProgram()
    x, y = prog.NewContinuousVariables(2, "x")
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


@pytest.mark.parametrize(
    ("rows", "status", "outcome"),
    [
        (
            (lambda x: x[0] >= 6,),
            AigoStatus.CONTRADICTORY_BOUNDS,
            SolutionResult.kInfeasibleConstraints,
        ),
        *slow(
            (
                (lambda x: sin(x[0]) >= 2,),
                AigoStatus.INFEASIBLE,
                SolutionResult.kInfeasibleConstraints,
            ),
            (
                (lambda x: x[0] ** 2 + x[1] ** 2 <= 1, lambda x: x[0] * x[1] >= 1),
                AigoStatus.NO_FEASIBLE_POINT,
                SolutionResult.kIterationLimit,
            ),
        ),
    ],
)
def test_constraints_that_can_not_hold_are_no_success(
    rows: tuple[Formula, ...], status: AigoStatus, outcome: SolutionResult
) -> None:
    prog, x = himmelblau()
    for row in rows:
        prog.AddConstraint(row(x))
    result = solve(prog, rounds=1)
    details = result.get_solver_details()
    assert (details.status, result.get_solution_result()) == (status, outcome)
    assert details.violation > 0.1 and not result.is_success()
    assert ("no proof" in details.status.value) == (status is AigoStatus.NO_FEASIBLE_POINT)


def test_a_power_of_0_is_not_called_a_contradiction() -> None:
    prog, (x,) = make_program(1, lambda x: x[0])
    prog.AddBoundingBoxConstraint(0.0, 0.0, x)
    row = ExpressionConstraint([x**0.3], [-1e-15], [1e-15])
    prog.AddConstraint(row, vars=row.vars())
    assert solve(prog).get_solver_details().status is AigoStatus.NO_FEASIBLE_POINT


def test_a_quotient_of_what_is_alike_is_a_number() -> None:
    prog, _ = make_program(1, lambda x: exp((2.0 * x[0]) / x[0]) * x[0], lambda x: x[0] >= 1.0)
    assert solve(prog).get_optimal_cost() == pytest.approx(np.exp(2.0))


def test_rows_that_hold_where_an_exponential_overflows_are_no_success() -> None:
    prog, _ = make_program(
        1,
        lambda x: x[0] ** 2,
        lambda x: exp(x[0]) >= 1e200,
        lambda x: x[0] >= 800,
        low=-1e3,
        high=1e3,
    )
    result = solve(prog, rounds=1)
    assert not result.is_success()
    assert result.get_solver_details().status == AigoStatus.NO_FEASIBLE_POINT


def test_ctrl_c_ends_all_penalties_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    prog, _ = make_program(
        2, lambda x: (x[0] - 1) ** 4 + x[1] ** 2, lambda x: x[0] * x[1] == 0.25, low=-2, high=2
    )
    stages: list[int] = []
    run = BoxSearch.run

    def interrupted(self: BoxSearch, *arguments: Any, **named: Any) -> Any:
        stages.append(1)
        return dataclasses.replace(run(self, *arguments, **named), was_interrupted=True)

    monkeypatch.setattr(BoxSearch, "run", interrupted)
    details = solve(prog).get_solver_details()
    assert details.status is AigoStatus.INTERRUPTED
    assert len(stages) == 1


def test_a_search_that_is_interrupted_before_any_point_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("drake_aigto.solver.solve.Solve._search", interrupt)
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(1)
    prog.AddBoundingBoxConstraint(-1.0, 1.0, x)
    prog.AddCost(x[0] ** 4 - x[0])
    result = AigoSolver().Solve(prog)
    assert not result.is_success()
    assert result.get_solver_details().status is AigoStatus.INTERRUPTED
