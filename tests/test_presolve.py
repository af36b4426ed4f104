"""Presolve of `AigoSolver`: what is substituted, that nothing else changes, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from local_problems import Formula, add_cost, make_program
from marks import slow
from pydrake import symbolic
from pydrake.solvers import ExpressionCost, MathematicalProgram
from pydrake.symbolic import Polynomial, cos, exp, sin

from benchmarks.collections.constrained_programs import constrained_problems
from benchmarks.collections.known_optimum import ConstrainedProblem
from benchmarks.lifted_functions import lift, lifted_problems
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.solver import (
    AigoOptions,
    AigoProgram,
    AigoSolver,
    AigoStatus,
    ContradictionError,
    make_first_box,
    presolve,
    read_program,
    tighten,
)

SMALL = [problem for problem in lifted_problems() if problem.num_variables <= 3]


@given(st.sampled_from(SMALL), st.integers(0, 5), st.randoms(use_true_random=False))
def test_a_lifted_function_costs_what_it_does_without_lift_and_its_rows_hold(
    problem: Any, seed: int, random: Any
) -> None:
    prog = lift(problem, seed)
    program = presolve(read_program(prog))
    assume(not program.nlp.num_rows)
    low, high = program.nlp.lower, program.nlp.upper
    z = np.array([random.uniform(a, b) for a, b in zip(low, high, strict=True)])
    x = program.answer(z)
    scale = max(1.0, program.nlp.cost_magnitude(z))
    assert program.violation(x) <= 1e-9 * scale
    expected = problem.evaluate(x[: problem.num_variables])
    assert program.nlp.evaluate(z)[0] == pytest.approx(expected, abs=1e-9 * scale)


@pytest.mark.parametrize(
    "problem", [SMALL[0], *slow(*SMALL[8::8])], ids=lambda problem: str(problem.name)
)
def test_variables_of_a_lift_are_gone_and_back_in_the_answer(problem: Any) -> None:
    prog = lift(problem, 3)
    result = AigoSolver(AigoOptions(cells=0)).Solve(prog)
    details = result.get_solver_details()
    assert result.is_success()
    assert prog.num_vars() - len(details.substituted) <= problem.num_variables
    scale = max(1.0, float(np.max(np.abs(result.get_x_val()))))
    assert details.violation <= 1e-12 * scale**2
    assert result.get_optimal_cost() >= problem.minimum - 1e-6 * max(1.0, abs(problem.minimum))


def double_integrator(num_steps: int, most: float) -> MathematicalProgram:
    """Returns a chain of stages with a bounded control in its rows, from rest at 0 to rest at 1."""
    prog = MathematicalProgram()
    q, v = prog.NewContinuousVariables(2, num_steps + 1, "x")
    u, dt = prog.NewContinuousVariables(num_steps, "u"), 1.0 / num_steps
    for k in range(num_steps):
        prog.AddConstraint(q[k + 1] == q[k] + dt * v[k])
        prog.AddConstraint(v[k + 1] == v[k] + dt * u[k])
        add_cost(prog, dt * u[k] ** 2)
    prog.AddBoundingBoxConstraint(-most, most, u)
    for state, start, end in ((q, 0.0, 1.0), (v, 0.0, 0.0)):
        prog.AddBoundingBoxConstraint(start, start, state[:1])
        prog.AddBoundingBoxConstraint(end, end, state[-1:])
    return prog


@pytest.mark.parametrize("most", [*slow(20.0), 4.5])
def test_controls_of_a_chain_vanish_their_bounds_stay_and_so_does_the_optimum(most: float) -> None:
    prog = double_integrator(10, most)
    found = [
        AigoSolver(AigoOptions(cells=0, presolve=on, rounds=5)).Solve(prog) for on in (True, False)
    ]
    assert all(result.is_success() for result in found)
    costs = [result.get_optimal_cost() for result in found]
    assert costs[0] == pytest.approx(costs[1], rel=1e-6)
    assert len(found[0].get_solver_details().substituted) >= 10
    assert found[1].get_solver_details().substituted == ()
    assert np.max(np.abs(found[0].get_x_val()[22:])) <= most


def test_a_long_chain_keeps_its_states_coupled_to_neighbors_only() -> None:
    program = presolve(read_program(double_integrator(60, 20.0)))
    terms = [block.terms for block in program.costs.blocks]
    assert max(len({f.variable for term in each for f in term.factors}) for each in terms) <= 5


def reduced(
    *rows: Formula, cost: Formula = lambda x: x[0] ** 2 + x[1] ** 2, bounds: Any = ()
) -> AigoProgram:
    prog, x = make_program(3, cost, *rows)
    for i, low, high in bounds:
        prog.AddBoundingBoxConstraint(low, high, x[i])
    return presolve(read_program(prog))


def test_waves_of_an_affine_definition_stay_closed() -> None:
    program = reduced(lambda x: x[2] == 2 * x[0] - x[1] + 0.3, cost=lambda x: x[2] * cos(x[2]))
    assert program.nlp.num_rows == 0
    x = np.array([0.4, -1.1, 2.2])
    y = program.with_slacks(program.reduce(x))
    assert program.nlp.evaluate(y)[0] == pytest.approx(2.2 * np.cos(2.2))


def test_what_would_have_no_mean_is_not_substituted() -> None:
    program = reduced(lambda x: x[2] == x[0] ** 2 + x[1], cost=lambda x: sin(x[2]) + x[0] ** 4)
    # x₁ = x₂ − x₀² is fine, and x₂ in the sine is not.
    assert [each.variable for each in program.definitions] == [1]
    none = reduced(lambda x: x[2] == exp(x[1]) * x[0], cost=lambda x: sin(x[2]) + x[0] ** 2)
    assert none.definitions == () and none.nlp.num_rows == 1


def test_bounds_of_what_is_substituted_stay_unless_they_hold_anyway() -> None:
    square, box = (lambda x: x[2] == x[0] ** 2), [(0, -2.0, 2.0), (1, -1.0, 1.0)]
    for low, high, count in ((0.0, 4.0, 0), (-np.inf, 5.0, 0), (1.0, 4.0, 1), (0.0, 3.0, 1)):
        program = reduced(square, bounds=[*box, (2, low, high)])
        assert [each.variable for each in program.definitions] == [2]
        assert len(program.slack_rows) == program.nlp.num_rows == count


def test_a_definition_that_overflows_far_out_is_no_warning() -> None:
    prog, x = make_program(
        2, lambda x: (x[0] - 1) ** 2 + x[1] ** 2, lambda x: exp(x[0]) + x[1] == 20
    )
    result = AigoSolver(AigoOptions(cells=0)).Solve(prog)
    u, v = result.GetSolution(x)
    assert result.is_success() and np.exp(u) + v == pytest.approx(20)
    # There the slope along the row, v = 20 − exp(u), vanishes.
    assert u - 1 == pytest.approx(np.exp(u) * v, rel=1e-4)


def test_rows_that_contradict_each_other_by_substitution_are_told() -> None:
    with pytest.raises(ContradictionError):
        reduced(lambda x: x[2] == x[0] + x[1], lambda x: x[2] - x[0] - x[1] == 1)
    prog, _ = make_program(
        2, lambda x: x[0] ** 2, lambda x: x[0] == x[1] + 1, lambda x: x[0] == x[1] + 2
    )
    details = AigoSolver(AigoOptions(cells=0)).Solve(prog).get_solver_details()
    assert details.status is AigoStatus.CONTRADICTORY_BOUNDS


@pytest.mark.slow
def test_answers_are_polished_as_they_were_asked_where_multiplied_out_costs_are_rounded() -> None:
    (problem,) = (each for each in lifted_problems() if each.name == "Perm 1 n=5")
    result = AigoSolver(AigoOptions(cells=0, rounds=3)).Solve(lift(problem, 11))
    assert result.is_success() and result.get_solver_details().substituted
    assert result.get_optimal_cost() <= problem.minimum + 1e-6


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


INF = np.inf
NAN = np.full(2, np.nan)


def make_rows(
    *constraints: Callable[[Any], Any], cost: Callable[[Any], Any] = lambda x: x[0] ** 2 + x[1] ** 2
) -> MathematicalProgram:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    expression = ExpressionCost(cost(x))
    prog.AddCost(expression, vars=expression.vars())
    for constraint in constraints:
        add(prog, *constraint(x))
    return prog


def add(prog: MathematicalProgram, expression: Any, lower: float, upper: float) -> None:
    """Adds it as it stands; from formulas, Drake turns some round."""
    if expression.is_polynomial() and Polynomial(expression).TotalDegree() == 2:
        prog.AddQuadraticConstraint(expression, lower, upper)
    else:
        prog.AddConstraint(expression, lower, upper)


def test_inequalities_that_are_affine_in_one_variable_are_bounds() -> None:
    program = read_program(
        make_rows(
            lambda x: (2 * x[0] - 1, -INF, 3),
            lambda x: (-x[1], -INF, 4),
            lambda x: (x[1] + 0, -INF, 7),
        )
    )
    np.testing.assert_allclose(program.nlp.lower, [-np.inf, -4])
    np.testing.assert_allclose(program.nlp.upper, [2, 7])
    assert program.nlp.num_rows == 0 and program.slack_rows == []


def test_other_inequalities_get_a_slack_between_their_bounds() -> None:
    program = read_program(
        make_rows(
            lambda x: (x[0] * x[1], 1, INF),
            lambda x: (x[0] ** 2, -INF, 4),
            lambda x: (x[0] + x[1], 1, 1),
            lambda x: (x[0] ** 3 + x[1], 0, 0),
        )
    )
    assert program.nlp.num_rows == 4 and len(program.slack_rows) == 2
    np.testing.assert_array_equal(program.nlp.lower[2:], [1, -np.inf])
    np.testing.assert_array_equal(program.nlp.upper[2:], [np.inf, 4])
    x = np.array([2.0, -3.0])
    # Slacks are what they stand for, as far as their bounds let them.
    np.testing.assert_allclose(program.with_slacks(x), [2, -3, 1, 4])
    assert program.violation(x) == pytest.approx(7.0)  # x y ≥ 1
    assert program.cost(x) == pytest.approx(13.0)


def test_a_row_without_a_square_in_closed_form_is_refused_by_name() -> None:
    prog = make_rows()
    x = prog.decision_variables()
    prog.AddConstraint(exp(x[0]) + sin(x[0]) == x[1]).evaluator().set_description("mixed")
    with pytest.raises(
        UnsupportedTermError,
        match=r"the constraint 'mixed' of .* the row .*exp\(x\(0\)\).*, in whose square an "
        r"exponential and a sine .* Give one of the two functions a variable s of its own",
    ):
        assert read_program(prog).penalties
    # What it says works.
    prog = make_rows()
    x, (s,) = prog.decision_variables(), prog.NewContinuousVariables(1, "s")
    prog.AddConstraint(s == exp(x[0]))
    prog.AddConstraint(s + sin(x[0]) == x[1])
    assert len(read_program(prog).penalties.blocks) == 2


def test_a_square_of_too_many_terms_is_refused_by_name() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(1100, "x")
    prog.AddLinearEqualityConstraint(np.ones((1, x.size)), [1.0], x).evaluator().set_description(
        "long"
    )
    with pytest.raises(
        UnsupportedTermError, match=r"the constraint 'long' of .* has too many terms: got 1,213,"
    ):
        assert read_program(prog).penalties


def test_rows_that_are_constant_and_variables_that_are_not_continuous_are_refused() -> None:
    program = read_program(make_rows(lambda x: (sin(x[0]) ** 2 + cos(x[0]) ** 2, 1, 1)))
    assert program.nlp.num_rows == 0
    with pytest.raises(ContradictionError):
        read_program(make_rows(lambda x: (sin(x[0]) ** 2 + cos(x[0]) ** 2, 2, 3)))
    prog = make_rows()
    prog.NewBinaryVariables(1, "b")
    with pytest.raises(UnsupportedTermError, match=r"the variable b\(0\) .* got one of type BINAR"):
        read_program(prog)


def test_copies_of_a_constraint_share_a_table_and_have_slacks_of_their_own() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(3, "x")
    first = prog.AddConstraint(x[0] * x[1] >= 2).evaluator()
    prog.AddConstraint(first, vars=x[1:])
    prog.AddConstraint(first, vars=[x[2], x[2]])
    program = read_program(prog)
    assert program.nlp.num_rows == len(program.slack_rows) == 3
    y = program.with_slacks(np.array([2.0, 3.0, 5.0]))
    np.testing.assert_allclose(np.abs(y[3:]), [6, 15, 25])  # Drake may turn rows round
    np.testing.assert_allclose(program.nlp.evaluate(y)[1], 0, atol=1e-14)
    assert program.penalties(y) == pytest.approx(0, abs=1e-11)


def test_a_cost_that_is_named_like_a_row_keeps_its_weight() -> None:
    prog = make_rows(lambda x: (x[0] * x[1], 1, 1))
    prog.GetAllCosts()[0].evaluator().set_description("row 0")
    program = read_program(prog)
    assert set(program.costs.weights) == {"row 0"}
    assert not set(program.costs.weights) & set(program.penalties.weights)


@pytest.mark.parametrize(
    "constraints",
    [
        (lambda x: (x[0] + 0, -INF, 1), lambda x: (x[0] + 0, 2, INF)),
        (lambda x: (2 * x[1], 1, 1), lambda x: (x[1] + 0, 2, 2)),
    ],
)
def test_bounds_that_contradict_each_other_are_found_at_once(constraints: Any) -> None:
    with pytest.raises(ContradictionError):
        read_program(make_rows(*constraints))


def first_box(prog: MathematicalProgram, guess: Any = NAN, **options: Any) -> tuple[Any, Any]:
    box = make_first_box(read_program(prog), np.array(guess, dtype=float), AigoOptions(**options))
    return box.center, box.half_width


def test_the_first_box_is_all_between_bounds_and_cut_by_one() -> None:
    prog = make_rows(lambda x: (x[0] + 0, -1, 5), lambda x: (x[1] + 0, 3, 3))
    center, half_width = first_box(prog, [100.0, 100.0])
    np.testing.assert_allclose(center, [2, 3])
    np.testing.assert_allclose(half_width, [3, 0])
    center, half_width = first_box(make_rows(lambda x: (x[0] + 0, 0.5, INF)), [0.0, 0.0])
    assert center[0] - half_width[0] == 0.5 and half_width[0] >= 0.5
    _, half_width = first_box(make_rows(cost=lambda x: -x[0] + x[1] ** 2), max_doublings=4)
    np.testing.assert_allclose(half_width, [16, 1])


def test_where_exponentials_overflow_the_first_box_is_cut() -> None:
    prog = make_rows(lambda x: (exp(x[0]), 1, 4), lambda x: (x[0] + 0, -1e3, 1e3))
    _, half_width = first_box(prog)
    assert 1 < half_width[0] < 60 and half_width[1] == 1
    assert np.all(np.isfinite(read_program(prog).with_slacks(np.array([1e3, 0.0]))))
    # Not where that is no remedy.
    prog = make_rows(lambda x: (x[0] + 0, -3, 3), lambda x: (1e30 * x[1] + exp(x[0]), 0, 0))
    assert first_box(prog)[1][0] == 3
