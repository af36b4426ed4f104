"""Functions without a mean in `AigoSolver`: quotients, roots, logarithms, |x|, max, and others."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pydrake.symbolic as sym
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from local_problems import Formula, himmelblau, make_program, solve
from marks import slow
from pydrake.solvers import (
    Binding,
    CommonSolverOption,
    Cost,
    ExpressionConstraint,
    ExpressionCost,
    L1NormCost,
    L2NormCost,
    LInfNormCost,
    MathematicalProgram,
    MathematicalProgramResult,
    PerspectiveQuadraticCost,
    SolverOptions,
)
from pydrake.symbolic import Expression, Variable

from drake_aigto.errors import OptionsError, UnsupportedTermError
from drake_aigto.solver import (
    AigoDetails,
    AigoOptions,
    AigoSolver,
    AigoStatus,
    interval,
    is_above,
    lift,
    read_program,
)

# Name, formula of two variables, and their bounds.
FORMULAS: dict[str, tuple[Formula, float, float]] = {
    "a quotient": (lambda x: (x[0] + x[1]) / (x[0] ** 2 + x[1] ** 2 + 1), -3.0, 2.0),
    "sin over a square": (lambda x: sym.sin(3 * x[0]) / (x[1] ** 2 + 1) + 0.1 * x[0], -3.0, 2.0),
    "x log x": (lambda x: x[0] * sym.log(x[0]) + (x[1] - x[0]) ** 2, 0.01, 3.0),
    "roots": (lambda x: sym.sqrt(x[0] ** 2 + 1) + sym.cos(3 * x[1]) * (x[1] + 4) ** 0.5, -3.0, 2.0),
    "powers": (lambda x: x[0] ** 1.5 - 2 * x[0] + x[1] ** -0.37 + x[1], 0.1, 3.0),
    "|x|, less is better": (
        lambda x: sym.abs(x[0] - 1) + 2 * sym.abs(x[1] + x[0]) + 0.1 * x[0],
        *(-3.0, 2.0),
    ),
    "|x|, more is": (lambda x: (x[0] - 1) ** 2 + x[1] ** 2 - sym.abs(x[0] - x[1]), -3.0, 2.0),
    "max": (lambda x: sym.max(x[0] + x[1], x[0] - 2 * x[1]) + x[0] ** 2, -3.0, 2.0),
    "min": (lambda x: sym.min(x[0] ** 2 + x[1], (x[0] - 2) ** 2 - 0.3) + x[1] ** 2, -3.0, 2.5),
    "tan": (lambda x: sym.tan(x[0]) - 3 * x[0] + x[1] ** 2, -1.2, 1.0),
    "atan": (lambda x: sym.atan(x[0] * x[1] + 1) - 0.3 * x[0] + 0.1 * x[1] ** 2, -3.0, 2.0),
    "asin and acos": (lambda x: sym.asin(x[0] * x[1]) + sym.acos(x[0]) ** 2, -0.9, 0.8),
    "tanh": (lambda x: sym.tanh(2 * x[0] - 1) ** 2 + 0.1 * x[0] + x[1] ** 2 - x[1], -3.0, 2.0),
    "sinh and cosh": (
        lambda x: sym.cosh(x[0] * x[1]) - sym.sinh(x[1]) + x[0] + x[1] ** 4,
        *(-2.0, 1.5),
    ),
    "exp of a quotient": (
        lambda x: sym.exp(-x[0] / (1 + x[0] ** 2)) + 0.1 * sym.sin(5 * x[0]) * x[1],
        *(-3.0, 2.0),
    ),
    "exp times sin": (lambda x: sym.exp(0.5 * x[0]) * sym.sin(4 * x[0]) + x[1] ** 2, -3.0, 2.0),
    "of products": (
        lambda x: sym.sin(x[0] * x[1]) * sym.exp(-(x[0] ** 2)) + 0.05 * x[1] ** 2,
        *(-3.0, 2.0),
    ),
    "powers of one another": (lambda x: x[0] ** x[1] - 2 * x[0] * x[1], 0.2, 2.0),
}
NAMES = [*FORMULAS]


def in_box(
    formula: Formula, low: float, high: float, *rows: Formula
) -> tuple[MathematicalProgram, Any]:
    return make_program(2, formula, *rows, low=low, high=high)


def least_on_grid(prog: MathematicalProgram, low: float, high: float, count: int = 61) -> float:
    """Returns the least value on a grid that is fine enough for these."""
    axis = np.linspace(low, high, count)
    (cost,) = prog.GetAllCosts()
    return min(prog.EvalBinding(cost, np.array([a, b]))[0] for a in axis for b in axis)


@pytest.mark.parametrize("name", [*NAMES[::3], *slow(*NAMES[1::3], *NAMES[2::3])])
def test_functions_by_rows_reach_what_a_grid_of_them_does(name: str) -> None:
    formula, low, high = FORMULAS[name]
    prog, _ = in_box(formula, low, high)
    result = AigoSolver().Solve(prog)
    assert result.is_success() and result.get_solver_details().lifted
    assert result.get_optimal_cost() <= least_on_grid(prog, low, high) + 1e-9
    (cost,) = prog.GetAllCosts()
    assert result.get_optimal_cost() == prog.EvalBinding(cost, result.get_x_val())[0]


@given(st.sampled_from(sorted(FORMULAS)), st.floats(0, 1), st.floats(0, 1))
def test_rows_hold_for_what_their_formulas_are_and_within_their_ranges(
    name: str, a: float, b: float
) -> None:
    formula, low, high = FORMULAS[name]
    prog, _ = in_box(formula, low, high)
    lifted = lift(prog)
    x = low + (high - low) * np.array([a, b])
    values = lifted.extend(x)
    assert lifted.prog.num_vars() == 2 + len(lifted.formulas)
    (cost,), (own,) = lifted.prog.GetAllCosts(), prog.GetAllCosts()
    expected = prog.EvalBinding(own, x)[0]
    assert lifted.prog.EvalBinding(cost, values)[0] == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert all(
        np.all(found >= each.evaluator().lower_bound() - 1e-9)
        and np.all(found <= each.evaluator().upper_bound() + 1e-9)
        for each in lifted.prog.GetAllConstraints()
        for found in [lifted.prog.EvalBinding(each, values)]
    )


def test_programs_whose_functions_have_means_stay_as_they_are() -> None:
    prog, _ = in_box(lambda x: sym.sin(x[0]) * sym.exp(x[1]), -1.0, 2.0)
    program = read_program(prog)
    assert program.lifted.prog is prog and program.lifted.formulas == ()


def test_constraints_may_have_such_functions_too() -> None:
    prog, x = in_box(
        lambda x: x[0] ** 2 + (x[1] - 3) ** 2,
        -4.0,
        4.0,
        lambda x: sym.abs(x[0]) + sym.abs(x[1]) <= 1,
    )
    np.testing.assert_allclose(AigoSolver().Solve(prog).GetSolution(x), [0, 1], atol=1e-5)
    prog, x = in_box(
        lambda x: (x[0] - 1) ** 2 + x[1] ** 2, -4.0, 4.0, lambda x: sym.max(x[0], x[1]) == 0.5
    )
    np.testing.assert_allclose(AigoSolver().Solve(prog).GetSolution(x), [0.5, 0], atol=1e-5)
    shares = MathematicalProgram()
    p = shares.NewContinuousVariables(3, "p")
    cost = ExpressionCost(sum(each * sym.log(each) for each in p))
    shares.AddCost(cost, vars=cost.vars())
    shares.AddBoundingBoxConstraint(1e-3, 1, p)
    shares.AddConstraint(p[0] + p[1] + p[2] == 1)
    assert AigoSolver().Solve(shares).get_optimal_cost() == pytest.approx(-math.log(3), abs=1e-6)


def test_entropy_is_minimized_down_to_bounds_of_0() -> None:
    prog = MathematicalProgram()
    p = prog.NewContinuousVariables(2, "p")
    prog.AddBoundingBoxConstraint(0.0, 1.0, p)
    cost = ExpressionCost(sum(each * sym.log(each) for each in p))
    prog.AddCost(cost, vars=cost.vars())
    assert AigoSolver().Solve(prog).get_optimal_cost() == pytest.approx(-2.0 / math.e, abs=1e-6)


@pytest.mark.parametrize(
    ("formula", "message"),
    [
        (lambda x: sym.log(x[0]) + x[1], r"log\(x\(0\)\), where x\(0\) is in \[-1, 2\].*>= 0"),
        (lambda x: sym.sqrt(x[0] + x[1]), r"sqrt.* is in \[-2, 4\] .* >= 0"),
        (lambda x: x[1] / x[0], r"\(x\(1\) / x\(0\)\), where x\(0\) is in .*divisor that is not 0"),
        (lambda x: sym.tan(2 * x[0]), r"cos\(\(2 \* x\(0\)\)\) is in .*divisor that is not 0"),
        (lambda x: sym.atan2(x[0], x[1]), r"atan2\(x\(0\), x\(1\)\), which has no equation"),
        (lambda x: sym.ceil(x[0]), r"ceil\(x\(0\)\), which has no equation"),
    ],
)
def test_functions_without_a_value_within_the_bounds_are_refused_by_name(
    formula: Formula, message: str
) -> None:
    prog, _ = in_box(formula, -1.0, 2.0)
    prog.GetAllCosts()[0].evaluator().set_description("shadow")
    with pytest.raises(UnsupportedTermError, match=f"cost 'shadow' of x.* can't .*{message}"):
        AigoSolver().Solve(prog)


def test_a_constraint_or_halved_ranges_may_show_that_a_function_has_a_value() -> None:
    root = lambda x: sym.sqrt(x[0] + x[1]) + x[0] ** 2  # noqa: E731
    prog, x = in_box(root, -3.0, 3.0, lambda x: x[0] + x[1] >= 0.25)
    result = AigoSolver().Solve(prog)
    assert result.is_success() and result.GetSolution(x)[0] == pytest.approx(0.0, abs=1e-4)
    assert result.get_optimal_cost() == pytest.approx(0.5, abs=1e-6)
    # Drake multiplies (−x)^0.3 out to (−1)^0.3 x^0.3, and raises.
    prog, x = in_box(root, -3.0, 0.0, lambda x: x[0] + x[1] >= -0.25)
    power = ExpressionConstraint([sym.pow(-x[0], 0.3)], [0.0], [0.8])
    prog.AddConstraint(power, vars=power.vars())
    with pytest.raises(UnsupportedTermError, match=r"sqrt.* >= 0"):
        AigoSolver().Solve(prog)
    # By terms alone, the divisor might be as low as −5.
    prog, _ = in_box(lambda x: 1 / (x[0] ** 2 - 2 * x[0] + 2) + x[1] ** 2, -1.0, 3.0)
    assert AigoSolver().Solve(prog).get_optimal_cost() == pytest.approx(0.2, abs=1e-6)


@pytest.mark.slow
def test_factors_that_keep_their_signs_show_that_a_function_has_a_value() -> None:
    # Bounds alone leave the argument anything between −2.4 and 2.4.
    formula: Formula = lambda x: (  # noqa: E731
        sym.pow(0.4 * (x[1] - x[0]) / (2.5 - x[1]), 0.6) + (x[0] - 1) ** 2 + (x[1] - 0.5) ** 2
    )
    prog, _ = in_box(formula, -1.0, 2.0, lambda x: x[1] - x[0] >= 0)
    result = AigoSolver().Solve(prog)
    # Where the row binds, which rounding breaks, the root may have no value: no crash.
    assert result.is_success() and result.get_optimal_cost() == pytest.approx(0.125, abs=1e-4)
    with pytest.raises(UnsupportedTermError, match=r"pow.* >= 0"):
        AigoSolver().Solve(in_box(formula, -1.0, 2.0)[0])


def test_a_norm_of_what_is_not_a_number_is_refused_by_name() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    prog.AddL2NormCost(np.diag([np.nan, 1.0]), np.zeros(2), x)
    with pytest.raises(UnsupportedTermError, match=r"L2NormCost.*NaN.*expected finite numbers"):
        AigoSolver().Solve(prog)


@settings(max_examples=6)
@given(
    st.sampled_from(sorted(FORMULAS)),
    st.tuples(st.floats(0, 1), st.floats(0, 1)),
    st.tuples(st.floats(0, 1), st.floats(0, 1)),
    st.tuples(st.floats(0, 1), st.floats(0, 1)),
)
def test_ranges_hold_every_value(name: str, a: Any, b: Any, at: Any) -> None:
    formula, low, high = FORMULAS[name]
    variables = [Variable("x"), Variable("y")]
    e = Expression(1.0) * formula(variables)
    ends = low + (high - low) * np.sort([a, b], axis=0)
    x = ends[0] + np.array(at) * (ends[1] - ends[0])
    ranges = {v.get_id(): (p, q) for v, p, q in zip(variables, *ends.tolist(), strict=True)}
    found = interval(e, ranges)
    value = e.Evaluate(dict(zip(variables, x.tolist(), strict=True)))
    slack = 1e-9 * max(1.0, abs(value))
    assert found[0] - slack <= value <= found[1] + slack
    assert not is_above(e, value + slack, ranges, is_strict=False)


@pytest.mark.slow
def test_functions_of_bounded_variables_leave_nothing_open_however_large_they_are() -> None:
    prog, x = in_box(
        lambda x: sym.sqrt(sym.exp(x[0]) + 1) - 3 * x[0] + (x[1] - 1) ** 2, -90.0, 90.0
    )
    result = AigoSolver(AigoOptions(cells=0, rounds=5)).Solve(prog)
    assert result.get_solver_details().status is AigoStatus.SOLVED
    # With u = exp x: u = 6 √(u + 1).
    best = math.log(18 + math.sqrt(360))
    np.testing.assert_allclose(result.GetSolution(x), [best, 1], atol=1e-5)


@pytest.mark.parametrize("norm", [L1NormCost, L2NormCost, LInfNormCost])
def test_norms_of_drake_are_taken_by_their_formulas(norm: Any) -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    prog.AddBoundingBoxConstraint(-5.0, 0.0, x)
    prog.AddCost(Binding[Cost](norm(np.eye(2), np.array([-1.0, 2.0])), x))
    assert AigoSolver().Solve(prog).get_optimal_cost() == pytest.approx(1.0, abs=1e-6)
    certified = AigoSolver(AigoOptions(certify=True)).Solve(prog)
    assert 1.0 - 1e-5 <= certified.get_solver_details().lower_bound <= 1.0 + 1e-12


def test_a_perspective_of_drake_is_a_quotient() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    prog.AddBoundingBoxConstraint([0.5, 1.0], [3.0, 2.0], x)
    prog.AddCost(Binding[Cost](PerspectiveQuadraticCost(np.eye(2), np.zeros(2)), x))
    prog.AddLinearCost(x[0] * 1.0)  # x₁²/x₀ + x₀, least where x₀ = x₁ = 1
    result = AigoSolver().Solve(prog)
    assert result.get_optimal_cost() == pytest.approx(2.0, abs=1e-6)


def test_cones_of_drake_are_rows() -> None:
    lorentz = MathematicalProgram()
    x = lorentz.NewContinuousVariables(3, "x")
    lorentz.AddBoundingBoxConstraint(-5.0, 1.0, x)
    lorentz.AddLinearCost(x[0] + 2.0 * x[1])
    lorentz.AddLorentzConeConstraint(np.array([x[2], x[0], x[1]]))
    rotated = MathematicalProgram()
    y = rotated.NewContinuousVariables(3, "y")
    rotated.AddBoundingBoxConstraint([0, 0, 2], [9, 9, 2], y)
    rotated.AddLinearCost(y[0] + y[1])
    rotated.AddRotatedLorentzConeConstraint(y)
    exponential = MathematicalProgram()
    z = exponential.NewContinuousVariables(3, "z")
    exponential.AddBoundingBoxConstraint([0.01, 1, -3], [5, 1, 2], z)
    exponential.AddLinearCost(z[0] + z[2])
    exponential.AddExponentialConeConstraint(np.eye(3), np.zeros(3), z)
    least = {lorentz: -math.sqrt(5.0), rotated: 4.0, exponential: math.exp(-3.0) - 3.0}
    for prog, cost in least.items():
        assert AigoSolver().AreProgramAttributesSatisfied(prog)
        result = AigoSolver().Solve(prog)
        assert result.is_success()
        assert result.get_optimal_cost() == pytest.approx(cost, abs=1e-5)


def test_a_polynomial_that_drake_hides_is_solved_and_not_certified() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    prog.AddBoundingBoxConstraint(-5.0, 4.0, x)
    prog.AddCost((1 - x[0]) ** 2 + 100 * (x[1] - x[0] ** 2) ** 2)
    result = AigoSolver().Solve(prog)
    np.testing.assert_allclose(result.get_x_val(), 1.0, atol=1e-6)
    # Its values tell the formula but for rounding: a bound of it would not be one of the cost.
    with pytest.raises(UnsupportedTermError, match=r"got a PolynomialCost.*ExpressionCost\("):
        AigoSolver(AigoOptions(certify=True)).Solve(prog)


def test_options_and_guesses_work_with_functions_by_rows() -> None:
    prog, _ = in_box(*FORMULAS["a quotient"])
    prog.SetInitialGuessForAllVariables(np.array([0.5, -0.5]))
    for options in (
        AigoOptions(presolve=False),
        AigoOptions(polish="snopt"),
        AigoOptions(rounds=0),
    ):
        result = AigoSolver(options).Solve(prog)
        assert result.is_success()
        assert result.get_optimal_cost() == pytest.approx(-math.sqrt(0.5), abs=1e-6)


def test_both_ways_to_call_it_agree_and_callbacks_see_the_answer_last() -> None:
    prog, x = himmelblau()
    returned = AigoSolver().Solve(prog)
    filled = MathematicalProgramResult()
    assert AigoSolver().Solve(prog, np.zeros(2), SolverOptions(), filled) is None
    np.testing.assert_array_equal(returned.GetSolution(x), filled.GetSolution(x))
    assert filled.is_success() and filled.get_optimal_cost() == returned.get_optimal_cost()
    assert returned.get_solver_id() is AigoSolver.id() and AigoSolver.id().name() == "AIGO"
    assert AigoSolver().solver_id() is AigoSolver.id()
    assert AigoSolver().available() and AigoSolver().enabled()
    seen: list[Any] = []
    prog.AddVisualizationCallback(lambda values: seen.append(np.array(values)), x)
    result = solve(prog)
    np.testing.assert_array_equal(seen[-1], result.get_x_val())
    assert len(seen) >= 2


def test_details_say_what_it_took() -> None:
    details = solve(himmelblau()[0]).get_solver_details()
    assert isinstance(details, AigoDetails)
    assert details.status is AigoStatus.SOLVED and details.violation == 0
    assert details.boxes >= 1 and details.iterations > details.boxes and details.polishes >= 1
    np.testing.assert_array_equal(details.first_half_width, [5, 5])
    ((flow, *others),) = details.widths
    assert list(flow) == sorted(flow, reverse=True)
    for widths in (flow, *others):
        assert widths[0] == pytest.approx(5) and widths[-1] < 0.1


def test_options_come_from_program_call_and_constructor(capsys: Any) -> None:
    prog, _ = himmelblau()
    solver = AigoSolver(AigoOptions(polish="none", rounds=0))
    assert solver.Solve(prog).get_solver_details().polishes == 0
    prog.SetSolverOption(AigoSolver.id(), "polish", "newton")
    assert solver.Solve(prog).get_solver_details().polishes >= 1
    options = SolverOptions()
    options.SetOption(AigoSolver.id(), "polish", "none")
    assert solver.Solve(prog, None, options).get_solver_details().polishes == 0
    assert capsys.readouterr().out == ""
    options.SetOption(CommonSolverOption.kPrintToConsole, 1)
    solver.Solve(prog, None, options)
    assert capsys.readouterr().out.startswith("cost ")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("speed", 3, "unknown option 'speed' of AigoSolver, expected|unknown option 'speed'"),
        ("polish", "luck", "polish: got 'luck', expected one of newton, ipopt, snopt, none"),
        ("rounds", -1, "rounds: got -1, expected 0 or more"),
        ("rounds", 1.5, "rounds: got 1.5, expected a whole number"),
        ("feasibility", 0.0, "feasibility: got 0, expected a number above 0"),
    ],
)
def test_bad_options_are_refused(name: str, value: Any, message: str) -> None:
    options = SolverOptions()
    options.SetOption(AigoSolver.id(), name, value)
    with pytest.raises(OptionsError, match=message):
        AigoSolver().Solve(himmelblau()[0], None, options)


def test_a_guess_of_another_size_is_refused() -> None:
    with pytest.raises(OptionsError, match=r"initial_guess: got shape \(3,\), expected \(2,\)"):
        AigoSolver().Solve(himmelblau()[0], np.zeros(3))


def test_what_it_can_not_solve_is_said_before_and_named_when_asked() -> None:
    prog, _ = himmelblau()
    assert AigoSolver().AreProgramAttributesSatisfied(prog)
    assert AigoSolver().ExplainUnsatisfiedProgramAttributes(prog) == ""
    prog.AddPositiveSemidefiniteConstraint(prog.NewSymmetricContinuousVariables(2))
    assert not AigoSolver().AreProgramAttributesSatisfied(prog)
    assert AigoSolver().ExplainUnsatisfiedProgramAttributes(prog) == (
        "AigoSolver can't solve programs with PositiveSemidefiniteConstraint."
    )
    message = r"got a PositiveSemidefiniteConstraint, expected bounds, or a linear"
    with pytest.raises(UnsupportedTermError, match=message):
        AigoSolver().Solve(prog)
