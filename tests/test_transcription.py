"""The literal transcription: what its rows say, and how users add to it."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from box_programs import compile_program, mean_by_block
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pydrake.solvers import (
    ExpressionCost,
    LinearCost,
    MathematicalProgram,
    QuadraticConstraint,
    QuadraticCost,
    SnoptSolver,
)
from pydrake.trajectories import PiecewisePolynomial
from rigid_worlds import AXIS, write_model

from drake_aigto import Scenario, World
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.paper import LiteralTranscription, LiteralWithForces
from drake_aigto.terms import read_bounds
from drake_aigto.transcription import cut_to, penalize

SCENARIO = Scenario(
    initial_position=1.0, initial_velocity=-2.0, goal_position=0.73, duration=0.5, time_step=0.05
)
REST = 0.4
SPRING = (
    f"{AXIS}<dynamics><spring_stiffness>3</spring_stiffness>"
    f"<spring_reference>{REST}</spring_reference></dynamics>"
)
MASS = "<mass>1.0</mass>"
# Text of the shipped model, what replaces it, the scenario's mass, and the physics by hand.
PLANTS: dict[str, tuple[str, str, float | None, dict[str, float]]] = {
    "shipped": (AXIS, AXIS, None, {}),
    "heavy": (MASS, "<mass>2.0</mass>", None, {"mass": 2.0}),
    "heavier by the scenario": (MASS, "<mass>2.0</mass>", 3.0, {"mass": 3.0}),
    "sprung": (AXIS, SPRING, None, {"spring": 3.0}),
    "shifted": ("<pose>-0.05 0 0 0 0 0</pose>", "<pose>0.15 0 0 0 0 0</pose>", None, {"wall": 0.2}),
}


def transcribe(scenario: Scenario = SCENARIO, **options: Any) -> LiteralTranscription:
    return LiteralTranscription(World.from_scenario(scenario), scenario, **options)


def euler(
    scenario: Scenario,
    controls: np.ndarray,
    mass: float = 1.0,
    spring: float = 0.0,
    wall: float = 0.0,
) -> np.ndarray:
    """Returns the decision variables of the paper's explicit Euler, written out by hand."""
    dt = scenario.time_step
    q, v = [scenario.initial_position[0]], [scenario.initial_velocity[0]]
    for u in controls:
        force = u - spring * (q[-1] - REST) + scenario.epsilon / (q[-1] - wall + scenario.delta)
        q.append(q[-1] + dt * v[-1])
        v.append(v[-1] + dt * force / mass)
    return np.concatenate([q, v, controls])


CONTROLS = st.lists(st.floats(-5, 5), min_size=10, max_size=10).map(np.array)


@pytest.fixture(scope="module", params=PLANTS)
def plant(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Scenario, dict[str, float]]:
    old, new, mass, physics = PLANTS[request.param]
    model = write_model(tmp_path_factory.mktemp("plant"), old, new)
    return dataclasses.replace(SCENARIO, model=model, mass=mass), physics


@pytest.mark.parametrize("kind", [LiteralTranscription, LiteralWithForces])
@settings(max_examples=3)
@given(controls=CONTROLS)
def test_rows_vanish_on_the_papers_euler_and_only_there(
    kind: type[LiteralTranscription], plant: tuple[Scenario, dict[str, float]], controls: np.ndarray
) -> None:
    scenario, physics = plant
    transcription = kind(World.from_scenario(scenario), scenario, nonpenetration=False)
    q, v, u = np.split(euler(scenario, controls, **physics)[:, np.newaxis], [11, 22])
    gaps = q[:-1] - physics.get("wall", 0.0) + scenario.delta
    assume(kind is LiteralTranscription or np.all(gaps > 0))  # Variables of forces pull nowhere.
    x = transcription.vector_of(q, v, u)
    law = scenario.time_step * scenario.epsilon / gaps
    np.testing.assert_allclose(transcription.impulses(x)[:-1], law)
    # λ is of size ε/δ at most: its rounding is what may be left, far below 1e-9.
    assert max(transcription.defects(x).values()) < 1e-9
    prog = transcription.prog()
    assert prog.CheckSatisfied(prog.GetAllConstraints(), x, 1e-9)
    wrong = x.copy()
    wrong[15] += 1e-3
    assert max(transcription.defects(wrong).values()) > 1e-4
    assert not prog.CheckSatisfied(prog.GetAllConstraints(), wrong, 1e-9)
    if isinstance(transcription, LiteralWithForces):
        x[transcription.impulse_indices()[3]] *= 1.01
        assert not prog.CheckSatisfied(prog.GetAllConstraints(), x, 1e-9)


@settings(max_examples=3)
@given(controls=CONTROLS, seed=st.integers(0, 1000))
def test_closing_the_rows_takes_a_solvers_rounding_out_of_the_dynamics(
    plant: tuple[Scenario, dict[str, float]], controls: np.ndarray, seed: int
) -> None:
    scenario, physics = plant
    transcription = transcribe(scenario, nonpenetration=False)
    x = euler(scenario, controls, **physics)
    noise = np.zeros_like(x)
    noise[12:22] = 1e-7 * np.random.default_rng(seed).normal(size=10)  # velocities after the first
    closed = transcription.close_rows(x + noise)
    assert transcription.defects(closed)["dynamics"] < 1e-12
    np.testing.assert_array_equal(closed[:22], (x + noise)[:22])  # positions and velocities stay
    np.testing.assert_allclose(closed[22:], controls, atol=1e-4)


def test_stages_share_evaluators_of_the_most_special_kind() -> None:
    prog = transcribe().prog()
    kinds = {
        b.evaluator().get_description(): type(b.evaluator())
        for b in (*prog.GetAllCosts(), *prog.GetAllConstraints())
    }
    assert kinds["control effort"] is QuadraticCost
    assert kinds["goal"] is QuadraticCost
    assert kinds["dynamics"] is QuadraticConstraint
    dynamics = [b.evaluator() for b in prog.quadratic_constraints()]
    assert len(dynamics) == SCENARIO.num_steps
    assert len({id(evaluator) for evaluator in dynamics}) == 1


def test_nonpenetration_is_switched_on_and_off() -> None:
    names = {
        on: {
            b.evaluator().get_description()
            for b in transcribe(nonpenetration=on).prog().GetAllConstraints()
        }
        for on in (True, False)
    }
    assert names[True] - names[False] == {"nonpenetration"}
    x = euler(SCENARIO, np.full(10, -8.0))
    assert transcribe(nonpenetration=True).defects(x)["nonpenetration"] == pytest.approx(
        -min(x[:11])
    )


def test_a_running_cost_of_degree_4_keeps_its_formula() -> None:
    transcription = transcribe()
    transcription.AddRunningCost(transcription.state()[0] ** 4, "quartic")
    x = np.linspace(0.5, 1.5, transcription.prog().num_vars())
    quartic = [
        b
        for b in transcription.prog().GetAllCosts()
        if b.evaluator().get_description() == "quartic"
    ]
    assert all(isinstance(b.evaluator(), ExpressionCost) for b in quartic)
    total = sum(transcription.prog().EvalBinding(b, x)[0] for b in quartic)
    assert total == pytest.approx(SCENARIO.time_step * np.sum(x[:10] ** 4))
    f = compile_program(transcription.penalized(), transcription.elimination_order())
    assert mean_by_block(f, x, 0.0)["quartic"] == pytest.approx(total)


def test_results_are_reconstructed_as_drake_trajectories() -> None:
    transcription = transcribe()
    result = SnoptSolver().Solve(transcription.prog())
    x = result.get_x_val()
    q, v, u = transcription.split(x)
    times = transcription.GetSampleTimes()
    assert times[-1] == pytest.approx(SCENARIO.duration)
    control = transcription.ReconstructInputTrajectory(result)
    state = transcription.ReconstructStateTrajectory(result)
    assert control.value(times[3] + 0.01)[0, 0] == pytest.approx(u[3, 0])
    assert state.value(times[4])[0, 0] == pytest.approx(q[4, 0])
    np.testing.assert_allclose(transcription.GetStateSamples(result), np.hstack([q, v]).T)
    np.testing.assert_allclose(transcription.GetInputSamples(result), u.T)


def test_a_guess_is_sampled_from_trajectories() -> None:
    transcription = transcribe()
    times = [0.0, SCENARIO.duration]
    transcription.SetInitialTrajectory(
        PiecewisePolynomial.FirstOrderHold(times, np.array([[1.0, 3.0]])),
        PiecewisePolynomial.FirstOrderHold(times, np.array([[1.0, 0.5], [-2.0, 2.0]])),
    )
    q, v, u = transcription.split(transcription.prog().initial_guess())
    np.testing.assert_allclose(q[:, 0], np.linspace(1, 0.5, 11))
    np.testing.assert_allclose(v[:, 0], np.linspace(-2, 2, 11))
    np.testing.assert_allclose(u[:, 0], np.linspace(1, 3, 11)[:-1])


def test_penalised_cost_is_cost_plus_weighted_squares() -> None:
    transcription = transcribe()
    x = euler(SCENARIO, np.full(10, -8.0))
    x[15] += 0.1
    f = compile_program(transcription.penalized(), transcription.elimination_order())
    shares = mean_by_block(f, x, 0.0)
    q, v, u = (part[:, 0] for part in transcription.split(x))
    dt, eps, delta = SCENARIO.time_step, SCENARIO.epsilon, SCENARIO.delta
    row = (q[:-1] + delta) * (np.diff(v) - dt * u) - dt * eps
    assert shares["dynamics"] == pytest.approx(np.sum(row**2) / dt)
    assert shares["kinematics"] == pytest.approx(np.sum((np.diff(q) - dt * v[:-1]) ** 2) / dt)
    assert shares["nonpenetration"] == pytest.approx(np.sum(np.minimum(q[1:], 0) ** 2) / dt)
    assert shares["control effort"] + shares["goal"] == pytest.approx(
        transcription.scenario_cost(x)
    )
    assert f(x) == pytest.approx(sum(shares.values()))


def test_both_sides_of_an_interval_are_penalised() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(1, "x")
    prog.AddBoundingBoxConstraint(-1.0, 2.0, x)
    f = compile_program(penalize(prog))
    assert [f(np.array([at])) for at in (-3.0, 0.0, 4.0)] == pytest.approx([4.0, 0.0, 4.0])


def test_every_bound_of_many_is_penalised_as_its_own() -> None:
    # Drake hands out short-lived Python objects for evaluators, whose ids repeat.
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(20, "x")
    lower = np.linspace(1.0, 3.0, 20)
    for variable, bound in zip(x, lower, strict=True):
        prog.AddBoundingBoxConstraint(bound, np.inf, variable)
    f = compile_program(penalize(prog))
    assert f(np.zeros(20)) == pytest.approx(np.sum(lower**2))


def test_fixed_variables_keep_their_bounds_instead_of_a_penalty() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    prog.AddBoundingBoxConstraint(3.0, 3.0, x[1])
    penalized = penalize(prog)
    assert not penalized.GetAllCosts()
    center, half_width = cut_to(read_bounds(penalized), np.zeros(2), np.ones(2))
    np.testing.assert_array_equal(center, [0.0, 3.0])
    np.testing.assert_array_equal(half_width, [1.0, 0.0])


def test_an_inequality_of_several_variables_is_refused_by_name() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    prog.AddConstraint(x[0] + x[1] <= 1.0).evaluator().set_description("budget")
    with pytest.raises(UnsupportedTermError, match=r"'budget' can't be penalized.*one variable"):
        penalize(prog)


def test_a_linear_cost_stays_linear() -> None:
    transcription = transcribe()
    transcription.AddFinalCost(2.0 * transcription.state()[0], "closer")
    (cost,) = (
        b.evaluator()
        for b in transcription.prog().GetAllCosts()
        if b.evaluator().get_description() == "closer"
    )
    assert isinstance(cost, LinearCost)
