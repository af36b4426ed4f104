"""What `AigoSolver` makes of a program: rows, slacks, bounds, the first box, and its refusals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydrake.solvers import ExpressionCost, MathematicalProgram
from pydrake.symbolic import Polynomial, cos, exp, sin

from drake_aigto.errors import UnsupportedTermError
from drake_aigto.solver import AigoOptions, ContradictionError, make_first_box, read_program

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


def test_where_exponentials_overflow_the_first_box_is_cut() -> None:
    prog = make_program(lambda x: (exp(x[0]), 1, 4), lambda x: (x[0] + 0, -1e3, 1e3))
    _, half_width = first_box(prog)
    assert 1 < half_width[0] < 60 and half_width[1] == 1
    assert np.all(np.isfinite(read_program(prog).with_slacks(np.array([1e3, 0.0]))))
    # Not where that is no remedy.
    prog = make_program(lambda x: (x[0] + 0, -3, 3), lambda x: (1e30 * x[1] + exp(x[0]), 0, 0))
    assert first_box(prog)[1][0] == 3
