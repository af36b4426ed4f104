"""Complementarities in programs: recognized however written, and solved; and alike variables."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from marks import slow
from pydrake.solvers import MathematicalProgram, SnoptSolver
from pydrake.symbolic import sin

from benchmarks.collections.peer_programs import payload, payload_tasks, push_box
from benchmarks.collections.staged_programs import Form, push_bot
from drake_aigto import AigoOptions, AigoSolver
from drake_aigto.local import InteriorPoint
from drake_aigto.solver import (
    StagedProgram,
    are_shared,
    find_complementarities,
    find_quantities,
    read_program,
)

Add = Callable[[MathematicalProgram, Any, Any, Any], object]


def two_pushes(*adds: Add) -> MathematicalProgram:
    """Returns a program of x in [−3, 5] and λ in [0, 4], to which constraints are added."""
    prog = MathematicalProgram()
    x, other, push = prog.NewContinuousVariables(3, "x")
    prog.AddBoundingBoxConstraint([-3.0, -3.0, 0.0], [5.0, 5.0, 4.0], [x, other, push])
    for add in adds:
        add(prog, x, other, push)
    prog.AddQuadraticCost((x - 2) ** 2 + (other - 1.5) ** 2 + (push - 3) ** 2)
    return prog


GAP_ROW: Add = lambda prog, x, y, _: prog.AddConstraint(x + sin(y) >= -1)  # noqa: E731
GAP_TWICE: Add = lambda prog, x, y, _: prog.AddConstraint(2 * x + 2 * sin(y) + 2 >= 0)  # noqa: E731
GAP_ABOVE: Add = lambda prog, x, y, _: prog.AddConstraint(-1 - x - sin(y) <= 0)  # noqa: E731


@pytest.mark.parametrize(
    "adds",
    [
        (GAP_ROW, lambda prog, x, y, p: prog.AddConstraint(p * (x + sin(y) + 1) == 0)),
        (GAP_ROW, lambda prog, x, y, p: prog.AddConstraint(p * (x + sin(y) + 1) <= 0)),
        (GAP_ROW, lambda prog, x, y, p: prog.AddConstraint(p * (x + sin(y) + 1) <= 1e-5)),
        (GAP_ROW, lambda prog, x, y, p: prog.AddConstraint(-3 * p * (x + sin(y) + 1) >= 0)),
        (GAP_TWICE, lambda prog, x, y, p: prog.AddConstraint(p * (x + sin(y) + 1) == 0)),
        (GAP_ABOVE, lambda prog, x, y, p: prog.AddConstraint(p * (x + sin(y) + 1) == 0)),
        (lambda prog, x, y, p: prog.AddConstraint(p * (x + 3) == 0),),
        (lambda prog, x, y, p: prog.AddConstraint(p * (5 - x) <= 0),),
        (lambda prog, x, y, p: prog.AddConstraint(p * (x + y + 6) == 0),),
    ],
)
def test_a_complementarity_is_recognized_however_it_is_written(adds: tuple[Add, ...]) -> None:
    program = read_program(two_pushes(*adds))
    (found,) = find_complementarities(program)
    staged = StagedProgram(program, 1e-6)
    rng = np.random.default_rng(3)
    for _ in range(5):
        y = program.with_slacks(rng.uniform([-3, -3, 0], [5, 5, 4]))
        x, other, push = y[:3]
        (row,) = staged.nlp.evaluate(y)[1][staged.relaxed]
        gap = row / push + max(1e-7, found.allowed) / push
        assert gap >= -1e-9 or x + np.sin(other) < -1.0
        assert row != pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    "adds",
    [
        # Nothing says that the other factor is not negative.
        (lambda prog, x, y, p: prog.AddConstraint(p * (x + sin(y) + 1) == 0),),
        # Their product may be large.
        (GAP_ROW, lambda prog, x, y, p: prog.AddConstraint(p * (x + sin(y) + 1) <= 2.0)),
        # It says that the product is not below 0, which it never is.
        (GAP_ROW, lambda prog, x, y, p: prog.AddConstraint(p * (x + sin(y) + 1) >= 0)),
        # The gap is another one.
        (GAP_ROW, lambda prog, x, y, p: prog.AddConstraint(p * (x + sin(y) + 1.5) == 0)),
        # A sum that is not a product.
        (GAP_ROW, lambda prog, x, y, p: prog.AddConstraint(p * (x + sin(y) + 1) + y == 0)),
        # A factor that may have either sign.
        (GAP_ROW, lambda prog, x, y, p: prog.AddConstraint(y * (x + sin(y) + 1) == 0)),
    ],
)
def test_other_rows_are_none(adds: tuple[Add, ...]) -> None:
    assert find_complementarities(read_program(two_pushes(*adds))) == ()


def ten_pairs(is_equality: bool, sign: float) -> tuple[MathematicalProgram, np.ndarray]:
    """Returns a program of ten pairs, and what each of (λ, s) is best at, shape (10, 2)."""
    goals = np.random.default_rng(5).uniform(0.5, 3.0, (10, 2))
    prog = MathematicalProgram()
    x, s = (prog.NewContinuousVariables(10, name) for name in "xs")
    prog.AddBoundingBoxConstraint(min(0.0, 5.0 * sign), max(0.0, 5.0 * sign), x)
    prog.AddBoundingBoxConstraint(0.0, 5.0, s)
    for a, b, (first, last) in zip(x, s, goals, strict=True):
        row = sign * a * b
        prog.AddConstraint(row == 0 if is_equality else row <= 0)
        prog.AddQuadraticCost((sign * a - first) ** 2 + (b - last) ** 2)
    return prog, goals


@pytest.mark.slow
@pytest.mark.parametrize(("is_equality", "sign"), [(True, 1.0), (False, -1.0)])
def test_small_programs_with_corners_are_solved_to_the_better_branch(
    is_equality: bool, sign: float
) -> None:
    prog, goals = ten_pairs(is_equality, sign)
    result = AigoSolver().Solve(prog)
    assert result.is_success()
    assert result.get_solver_details().complementarities == 10
    assert result.get_optimal_cost() == pytest.approx(np.sum(goals.min(axis=1) ** 2), rel=1e-5)
    found = result.get_x_val()
    assert np.max(np.abs(found[:10] * found[10:])) <= 1e-6


@pytest.mark.parametrize("is_equality", [True, False])
def test_at_corners_the_smaller_of_each_pair_is_zero(is_equality: bool) -> None:
    prog, goals = ten_pairs(is_equality, 1.0)
    program = read_program(prog)
    values = np.random.default_rng(6).uniform(0.1, 2.0, (2, 10))
    start = program.with_slacks(values.ravel())
    nlp = StagedProgram(program, 1e-6).at_corners(start)
    found = InteriorPoint.warm().solve(nlp, start)
    assert found.is_success
    pairs = found.x[:20].reshape(2, 10)
    expected = np.where(values == values.max(axis=0), goals.T, 0.0)
    np.testing.assert_allclose(pairs, expected, atol=1e-6)


@pytest.mark.parametrize("form", ["variables", *slow("equalities", "inequalities")])
def test_a_push_bot_swings_up_between_soft_walls_however_it_is_written(form: Form) -> None:
    # SPOT's fourth start; the least cost that hundreds of local solves know is 40.084188.
    prog = push_bot((0.8677, -0.0292, 0.6817, -2.7230), 1.0, form)
    result = AigoSolver(AigoOptions(rounds=25)).Solve(prog)
    details = result.get_solver_details()
    assert result.is_success() and details.violation <= 1e-6
    assert details.complementarities == 60
    assert 0 < details.repeats <= details.ladders <= 25
    assert result.get_optimal_cost() == pytest.approx(40.0842, rel=1e-4)


def test_complementarities_that_share_a_side_are_told_from_others() -> None:
    bot = read_program(push_bot((0.8677, -0.0292, 0.6817, -2.7230), 1.0, "inequalities"))
    assert not np.any(are_shared(find_complementarities(bot)))
    *_, (start, goal) = payload_tasks()
    sliding = find_complementarities(read_program(payload(start, goal, 5)))
    # At the last four knots, v ⊥ w, v ⊥ f + m, w ⊥ m − f: v and w are of two each.
    assert are_shared(sliding).tolist() == [True] * 12
    # The equation of a choice between 0 and 1 leaves two points.
    choice: Add = lambda prog, x, y, p: prog.AddConstraint(p * (4 - p) == 0)  # noqa: E731
    assert are_shared(find_complementarities(read_program(two_pushes(choice)))).tolist() == [True]


@pytest.mark.parametrize("relaxation", [1.0, 1e-2])
def test_tightened_products_stay_below_their_bound_and_reach_it(relaxation: float) -> None:
    program = read_program(push_box((0.3, 0.1, 0.2), 4))
    staged = StagedProgram(program, 1e-6)
    assert staged.tightened is not None
    start = program.with_slacks(np.full(program.source.num_vars(), 0.1))
    found = staged.tightened.solve(InteriorPoint(), start, relaxation)
    assert found.is_success
    products = staged.nlp.evaluate(found.x[: start.size])[1][staged.relaxed] + 1e-7
    assert np.min(products) >= -1e-9
    assert np.max(products) == pytest.approx(relaxation, rel=1e-3)


@pytest.mark.slow
def test_a_payload_slides_to_its_goal_where_friction_alone_does_not_get_it_there() -> None:
    start, goal = np.array([0.02, 0.0, 0.0, 0.0]), np.zeros(4)
    result = AigoSolver(AigoOptions(rounds=20)).Solve(payload(start, goal, 12))
    details = result.get_solver_details()
    assert result.is_success() and details.violation <= 1e-6
    assert details.complementarities == 33
    held = payload(start, goal, 12)
    slips = held.decision_variables()[-24:]
    held.AddBoundingBoxConstraint(0.0, 0.0, slips)
    assert result.get_optimal_cost() < 0.99 * SnoptSolver().Solve(held).get_optimal_cost()


def test_variables_of_alike_stages_are_one_quantity() -> None:
    prog = MathematicalProgram()
    x = np.array([prog.NewContinuousVariables(2, "x") for _ in range(8)])
    prog.AddBoundingBoxConstraint(-1.0, 1.0, x)
    for before, after in itertools.pairwise(x):
        prog.AddConstraint(after[0] - before[0] - 0.1 * before[1] ** 3 == 0)
        prog.AddQuadraticCost(before[1] ** 2)
    staged = StagedProgram(read_program(prog), 1e-6)
    found = find_quantities(staged.nlp, staged.tables.places)
    inner = [members for members in found if members.size > 1]
    by_kind = {int(members[0]) % 2: np.sort(members) // 2 for members in inner}
    np.testing.assert_array_equal(by_kind[0], range(1, 7))
    np.testing.assert_array_equal(by_kind[1], range(7))
