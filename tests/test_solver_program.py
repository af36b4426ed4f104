"""What `AigoSolver` makes of a program: rows, slacks, bounds, the first box, and its refusals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from local_problems import make_program as general_program
from pydrake.solvers import ExpressionCost, MathematicalProgram
from pydrake.symbolic import Polynomial, cos, exp, sin

from drake_aigto.aigo import Box
from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.local import InteriorPoint, PolynomialNlp, compile_nlp
from drake_aigto.solver import (
    AigoOptions,
    AigoProgram,
    AugmentedLagrangian,
    ContradictionError,
    make_first_box,
    read_program,
)

INF = np.inf
NAN = np.full(2, np.nan)


def make_program(
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
        make_program(
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
        make_program(
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


@pytest.mark.parametrize("seed", range(2))
def test_rows_with_waves_have_penalties_and_slacks_too(seed: int) -> None:
    program = read_program(
        make_program(
            lambda x: (cos(x[0] + 2 * x[1]) + x[0] * sin(x[0]), -1, 1),
            lambda x: (x[0] * exp(2 * x[0] - 1) + x[1], 0.5, 0.5),
        )
    )
    y = np.random.default_rng(seed).uniform(-2, 2, 3)
    (u, v), s = y[:2], y[2]
    wave, growth = np.cos(u + 2 * v) + u * np.sin(u), u * np.exp(2 * u - 1) + v
    residuals = [wave - s, growth - 0.5]
    assert sorted(program.nlp.evaluate(y)[1]) == pytest.approx(sorted(residuals))
    assert program.penalties(y) == pytest.approx(sum(r**2 for r in residuals), rel=1e-9)
    assert program.with_slacks(y[:2])[2] == pytest.approx(np.clip(wave, -1, 1))
    # The penalty's mean over a box is that of many points in it.
    half_width = np.array([0.3, 0.5, 0.2])
    grid = np.polynomial.legendre.leggauss(24)
    points = np.stack(np.meshgrid(*[grid[0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    weights = np.einsum("i,j,k->ijk", *[grid[1] / 2] * 3).ravel()
    u, v, s = (y + half_width * points).T
    rows = (np.cos(u + 2 * v) + u * np.sin(u) - s, u * np.exp(2 * u - 1) + v - 0.5)
    assert program.penalties.mean(y, half_width) == pytest.approx(
        sum(weights @ row**2 for row in rows), rel=1e-9
    )


def test_a_row_without_a_square_in_closed_form_is_refused_by_name() -> None:
    prog = make_program()
    x = prog.decision_variables()
    prog.AddConstraint(exp(x[0]) + sin(x[0]) == x[1]).evaluator().set_description("mixed")
    with pytest.raises(
        UnsupportedTermError,
        match=r"the constraint 'mixed' of .* the row .*exp\(x\(0\)\).*, in whose square an "
        r"exponential and a sine .* Give one of the two functions a variable s of its own",
    ):
        assert read_program(prog).penalties
    # What it says works.
    prog = make_program()
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


def test_rows_that_are_constant_once_multiplied_out_are_checked() -> None:
    program = read_program(make_program(lambda x: (sin(x[0]) ** 2 + cos(x[0]) ** 2, 1, 1)))
    assert program.nlp.num_rows == 0
    with pytest.raises(ContradictionError):
        read_program(make_program(lambda x: (sin(x[0]) ** 2 + cos(x[0]) ** 2, 2, 3)))


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
    prog = make_program(lambda x: (x[0] * x[1], 1, 1))
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
        read_program(make_program(*constraints))


def test_variables_that_are_not_continuous_are_refused_by_name() -> None:
    prog = make_program()
    prog.NewBinaryVariables(1, "b")
    with pytest.raises(UnsupportedTermError, match=r"the variable b\(0\) .* got one of type BINAR"):
        read_program(prog)


def first_box(prog: MathematicalProgram, guess: Any = NAN, **options: Any) -> tuple[Any, Any]:
    box = make_first_box(read_program(prog), np.array(guess, dtype=float), AigoOptions(**options))
    return box.center, box.half_width


def test_the_first_box_is_all_between_bounds_and_cut_by_one() -> None:
    prog = make_program(lambda x: (x[0] + 0, -1, 5), lambda x: (x[1] + 0, 3, 3))
    center, half_width = first_box(prog, [100.0, 100.0])
    np.testing.assert_allclose(center, [2, 3])
    np.testing.assert_allclose(half_width, [3, 0])
    center, half_width = first_box(make_program(lambda x: (x[0] + 0, 0.5, INF)), [0.0, 0.0])
    assert center[0] - half_width[0] == 0.5 and half_width[0] >= 0.5
    _, half_width = first_box(make_program(cost=lambda x: -x[0] + x[1] ** 2), max_doublings=4)
    np.testing.assert_allclose(half_width, [16, 1])


@pytest.mark.parametrize("middle", [0.0, 5.0, -300.0])
def test_without_bounds_the_first_box_grows_until_outside_is_worse(middle: float) -> None:
    prog = make_program(cost=lambda x: (x[0] - middle) ** 2 + x[1] ** 4)
    center, half_width = first_box(prog)
    np.testing.assert_array_equal(center, 0)
    assert half_width[0] > abs(middle)
    assert half_width[0] <= 8 * max(1, abs(middle))
    assert half_width[1] == 1
    guessed, narrow = first_box(prog, [middle, 0.0])
    assert guessed[0] == middle and narrow[0] == max(1, abs(middle))


def test_slacks_start_with_the_range_of_what_they_stand_for() -> None:
    prog = make_program(
        lambda x: (x[0] + 0, -1, 2),
        lambda x: (x[1] + 0, 1, 3),
        lambda x: (x[0] ** 2 * x[1] - x[0], -7, INF),  # −2 … 4·3 + 1 over the box
        lambda x: (x[0] * x[1], 50, INF),  # Not in this box, but it gets some room.
    )
    center, half_width = first_box(prog)
    np.testing.assert_allclose([center[2] - half_width[2], center[2] + half_width[2]], [-7, 13])
    np.testing.assert_allclose([center[3] - half_width[3], center[3] + half_width[3]], [50, 100])


@given(
    st.sampled_from(
        [lambda u, v: cos(2 * u + v), lambda u, v: u**2 * sin(u) - v, lambda u, v: u * exp(-v)]
    ),
    st.lists(st.floats(-4, 4), min_size=4, max_size=4),
)
def test_slacks_of_waves_get_all_that_they_can_be(function: Any, ends: list[float]) -> None:
    low, high = np.minimum(ends[:2], ends[2:]), np.maximum(ends[:2], ends[2:])
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    (row,) = [function(*x)]
    prog.AddConstraint(row, -1e9, 1e9)
    ((least, most),) = read_program(prog).slack_ranges(low, high)
    grid = np.stack(np.meshgrid(*np.linspace(low, high, 9).T), axis=-1).reshape(-1, 2)
    values = [row.Evaluate(dict(zip(x, point, strict=True))) for point in grid]
    room = 1e-9 * (1 + np.max(np.abs(values)))
    assert least - room <= min(values) and max(values) <= most + room


def test_ranges_of_waves_are_tight() -> None:
    prog = make_program(lambda x: (cos(x[0]), 0, 2), lambda x: (exp(x[1]), 0, 9))
    program = read_program(prog)
    low, high = np.full(2, 0.5), np.ones(2)
    ranges = list(program.slack_ranges(low, high))
    np.testing.assert_allclose(ranges, [[np.cos(1), np.cos(0.5)], [np.exp(0.5), np.exp(1)]])
    around = [next(program.slack_ranges(low, high + width)) for width in (3, 6)]
    np.testing.assert_allclose(around, [[-1, np.cos(0.5)], [-1, 1]])


def test_where_exponentials_overflow_the_first_box_is_cut() -> None:
    prog = make_program(lambda x: (exp(x[0]), 1, 4), lambda x: (x[0] + 0, -1e3, 1e3))
    _, half_width = first_box(prog)
    assert 1 < half_width[0] < 60 and half_width[1] == 1
    assert np.all(np.isfinite(read_program(prog).with_slacks(np.array([1e3, 0.0]))))
    # Not where that is no remedy.
    prog = make_program(lambda x: (x[0] + 0, -3, 3), lambda x: (1e30 * x[1] + exp(x[0]), 0, 0))
    assert first_box(prog)[1][0] == 3


def two_rows() -> tuple[AigoProgram, Box]:
    """Returns min x₀⁴ + x₁² + x₂²  s.t.  x₀ + x₁ = 3,  x₁ x₂ = 1, each with a λ of its own."""
    prog, _ = general_program(
        3,
        lambda x: x[0] ** 4 + x[1] ** 2 + x[2] ** 2,
        lambda x: x[0] + x[1] == 3,
        lambda x: x[1] * x[2] == 1,
    )
    return read_program(prog), Box(np.ones(3), np.full(3, 2.0))


def minimize(f: BoxPolynomial, y: np.ndarray) -> np.ndarray:
    n = y.size
    nlp = PolynomialNlp(n, f.blocks, (), np.full(n, -np.inf), np.full(n, np.inf))
    return InteriorPoint().solve(nlp, y).x


def test_multipliers_make_constraints_hold_where_a_penalty_alone_does_not() -> None:
    program, first = two_rows()
    lagrangian = AugmentedLagrangian(program, first)
    y, residuals = np.array([1.0, 2.0, 0.5]), []
    for _ in range(12):
        y = minimize(lagrangian.function(1.0), y)
        residuals.append(np.max(np.abs(program.nlp.evaluate(y)[1])))
        lagrangian.update(1.0, y)
    assert residuals[0] > 1e-2 and residuals[-1] < 1e-4 * residuals[0]
    exact = InteriorPoint().solve(compile_nlp(program.source), y)
    np.testing.assert_allclose(y, exact.x, atol=1e-4)
    np.testing.assert_allclose(lagrangian.multipliers, exact.multipliers, atol=1e-3)


def test_an_augmented_lagrangians_value_and_mean_are_those_of_the_sum() -> None:
    program, first = two_rows()
    lagrangian = AugmentedLagrangian(program, first)
    y = np.array([0.3, -1.0, 2.0])
    plain = lagrangian.function(2.0)(y)
    lagrangian.update(2.0, y)
    residuals = program.nlp.evaluate(y)[1]
    moved = lagrangian.function(2.0)
    assert np.isclose(moved(y) - plain, lagrangian.multipliers @ residuals, rtol=1e-9)
    points = np.random.default_rng(0).uniform(y - 0.5, y + 0.5, (4000, 3))
    values = [moved(point) for point in points]
    error = np.std(values) / np.sqrt(len(values))
    assert abs(np.mean(values) - moved.mean(y, 0.5)) < 5 * error


def test_multipliers_stay_where_residuals_are_not_finite() -> None:
    program, first = two_rows()
    lagrangian = AugmentedLagrangian(program, first)
    lagrangian.update(1.0, np.full(3, np.inf))
    np.testing.assert_array_equal(lagrangian.multipliers, [0, 0])
