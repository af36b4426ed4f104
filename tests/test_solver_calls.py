"""`AigoSolver` as Drake users call it: results, options, callbacks, refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from general_programs import himmelblau, solve
from pydrake.solvers import CommonSolverOption, MathematicalProgramResult, SolverOptions

from drake_aigto import UnsupportedTermError
from drake_aigto.errors import OptionsError
from drake_aigto.solver import AigoDetails, AigoOptions, AigoSolver, AigoStatus


def test_both_ways_to_call_it() -> None:
    prog, x = himmelblau()
    returned = AigoSolver().Solve(prog)
    filled = MathematicalProgramResult()
    assert AigoSolver().Solve(prog, np.zeros(2), SolverOptions(), filled) is None
    np.testing.assert_array_equal(returned.GetSolution(x), filled.GetSolution(x))
    assert filled.is_success() and filled.get_optimal_cost() == returned.get_optimal_cost()
    assert returned.get_solver_id() is AigoSolver.id() and AigoSolver.id().name() == "AIGO"
    assert AigoSolver().solver_id() is AigoSolver.id()
    assert AigoSolver().available() and AigoSolver().enabled()


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


def test_visualization_callbacks_see_the_answer_last() -> None:
    prog, x = himmelblau()
    seen: list[Any] = []
    prog.AddVisualizationCallback(lambda values: seen.append(np.array(values)), x)
    result = solve(prog)
    np.testing.assert_array_equal(seen[-1], result.get_x_val())
    assert len(seen) >= 2


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
    with pytest.raises(UnsupportedTermError, match="got a PositiveSemidefiniteConstraint"):
        AigoSolver().Solve(prog)
