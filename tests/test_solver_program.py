"""What `AigoSolver` makes of a program: rows, slacks, bounds, the first box, and its refusals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydrake.solvers import ExpressionCost, MathematicalProgram
from pydrake.symbolic import Polynomial, cos

from drake_aigto import UnsupportedTermError
from drake_aigto.solver import AigoOptions
from drake_aigto.solver.first_box import make_first_box
from drake_aigto.solver.program import ContradictionError, read_program

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
    assert program.nlp.num_rows == 0 and program.slack_rows == ()


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


@pytest.mark.parametrize("seed", range(5))
def test_penalties_are_the_squared_rows(seed: int) -> None:
    program = read_program(
        make_program(lambda x: (x[0] * x[1], 1, INF), lambda x: (x[0] ** 3 - 2 * x[1], 0.5, 0.5))
    )
    y = np.random.default_rng(seed).uniform(-2, 2, 3)
    x, s = y[:2], y[2]
    residuals = sorted([x[0] * x[1] - s, x[0] ** 3 - 2 * x[1] - 0.5], key=abs)
    assert sorted(program.nlp.evaluate(y)[1], key=abs) == pytest.approx(residuals)
    assert program.penalties(y) == pytest.approx(sum(r**2 for r in residuals))
    assert program.costs(y) == pytest.approx(x @ x)


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


def test_what_can_not_be_read_is_refused_by_name() -> None:
    prog = make_program()
    x = prog.decision_variables()
    prog.AddConstraint(cos(x[0]) <= x[1]).evaluator().set_description("shadow")
    with pytest.raises(UnsupportedTermError, match=r"the constraint 'shadow' can't be solved for"):
        read_program(prog)
    prog = make_program()
    prog.AddPositiveSemidefiniteConstraint(prog.NewSymmetricContinuousVariables(2))
    with pytest.raises(UnsupportedTermError, match=r"got a \w+, expected bounds, or a linear"):
        read_program(prog)
    prog = make_program()
    prog.NewBinaryVariables(1, "b")
    with pytest.raises(
        UnsupportedTermError, match=r"the variable b\(0\) .* got one of type BINARY"
    ):
        read_program(prog)
    prog = make_program()
    prog.AddCost(prog.decision_variables()[0] ** 4)
    with pytest.raises(UnsupportedTermError, match=r"PolynomialCost.*ExpressionCost\(expression\)"):
        read_program(prog)


# The first box.


def first_box(prog: MathematicalProgram, guess: Any = NAN, **options: Any) -> tuple[Any, Any]:
    box = make_first_box(read_program(prog), np.array(guess, dtype=float), AigoOptions(**options))
    return box.center, box.half_width


def test_between_bounds_the_first_box_is_all_of_them() -> None:
    prog = make_program(lambda x: (x[0] + 0, -1, 5), lambda x: (x[1] + 0, 3, 3))
    center, half_width = first_box(prog, [100.0, 100.0])
    np.testing.assert_allclose(center, [2, 3])
    np.testing.assert_allclose(half_width, [3, 0])


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


def test_a_bound_on_one_side_cuts_the_first_box() -> None:
    center, half_width = first_box(make_program(lambda x: (x[0] + 0, 0.5, INF)), [0.0, 0.0])
    assert center[0] - half_width[0] == 0.5 and half_width[0] >= 0.5


def test_a_cost_that_falls_without_end_stops_the_growth() -> None:
    _, half_width = first_box(make_program(cost=lambda x: -x[0] + x[1] ** 2), max_doublings=4)
    np.testing.assert_allclose(half_width, [16, 1])


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
