"""The literal transcription: what its rows say, and how users add to it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from box_programs import compile_program, mean_by_block
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from phase_solutions import free_flight_cost
from pydrake.solvers import (
    ExpressionCost,
    LinearCost,
    MathematicalProgram,
    QuadraticConstraint,
    QuadraticCost,
    SnoptSolver,
)
from pydrake.trajectories import PiecewisePolynomial
from replay_worlds import make_diagram, make_scenario, shipped_world
from rigid_worlds import AXIS, NAMES, Physics, indices, make_motion, physics_of, write_model
from scipy.linalg import expm

from drake_aigto import Scenario, World
from drake_aigto.box import BoxPolynomial
from drake_aigto.contact import JointImpact
from drake_aigto.dynamics import Contact
from drake_aigto.errors import ModelError, OptionsError, UnsupportedTermError
from drake_aigto.paper import LiteralTranscription, LiteralWithForces, RigidWithForces
from drake_aigto.planning import PhaseProblem
from drake_aigto.terms import read_bounds
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import (
    RigidTranscription,
    Transcription,
    cut_to,
    penalize,
    rigid_defects,
)

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


def test_guesses_and_results_are_drake_trajectories() -> None:
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
    ends = [0.0, SCENARIO.duration]
    transcription.SetInitialTrajectory(
        PiecewisePolynomial.FirstOrderHold(ends, np.array([[1.0, 3.0]])),
        PiecewisePolynomial.FirstOrderHold(ends, np.array([[1.0, 0.5], [-2.0, 2.0]])),
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


def test_every_bound_is_penalised_as_its_own_but_for_fixed_variables() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(1, "x")
    prog.AddBoundingBoxConstraint(-1.0, 2.0, x)
    f = compile_program(penalize(prog))
    assert [f(np.array([at])) for at in (-3.0, 0.0, 4.0)] == pytest.approx([4.0, 0.0, 4.0])
    # Drake hands out short-lived Python objects for evaluators, whose ids repeat.
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(20, "x")
    lower = np.linspace(1.0, 3.0, 20)
    for variable, bound in zip(x, lower, strict=True):
        prog.AddBoundingBoxConstraint(bound, np.inf, variable)
    f = compile_program(penalize(prog))
    assert f(np.zeros(20)) == pytest.approx(np.sum(lower**2))
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    prog.AddBoundingBoxConstraint(3.0, 3.0, x[1])
    penalized = penalize(prog)
    assert not penalized.GetAllCosts()
    center, half_width = cut_to(read_bounds(penalized), np.zeros(2), np.ones(2))
    np.testing.assert_array_equal(center, [0.0, 3.0])
    np.testing.assert_array_equal(half_width, [1.0, 0.0])
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


Array = npt.NDArray[np.float64]

RESTITUTIONS = [1.0, 0.8, 0.0]
# Exact motions meet the rows up to rounding: of 20 steps of numbers up to 100, divided by 0.05 s.
EXACT = 1e-9


@pytest.fixture(scope="module", params=NAMES)
def physics(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Physics:
    return physics_of(request.param, tmp_path_factory.getbasetemp())


def is_met(transcription: Transcription, x: Array, tolerance: float = EXACT) -> bool:
    prog = transcription.prog()
    return bool(prog.CheckSatisfied(prog.GetAllConstraints(), x, tolerance))


@pytest.mark.parametrize("kind", [RigidTranscription, RigidWithForces])
@pytest.mark.parametrize("e", RESTITUTIONS)
def test_rows_vanish_on_an_exact_motion(
    physics: Physics, kind: type[RigidTranscription], e: float
) -> None:
    scenario, motion = make_motion(physics, e, seed=0)
    transcription = kind(physics.world, scenario, relaxation=0.0)
    x = transcription.vector(motion)
    assert max(transcription.defects(x).values()) < EXACT
    assert is_met(transcription, x)
    # The vector says nothing of impulses: they come back with the trajectory.
    for impulses in (transcription.impulses(x), transcription.trajectory(x).impulses):
        np.testing.assert_allclose(impulses, motion.impulses, atol=EXACT)
    if isinstance(transcription, RigidWithForces):
        x[transcription.impulse_indices()] = 0.0
        assert not is_met(transcription, x)
        assert transcription.defects(x)["dynamics"] > 0.1


@pytest.mark.parametrize("e", RESTITUTIONS)
def test_rows_notice_any_number_that_is_changed(physics: Physics, e: float) -> None:
    scenario, motion = make_motion(physics, e, seed=4)
    transcription = RigidTranscription(physics.world, scenario, relaxation=0.0)
    x = transcription.vector(motion)
    # What is neither q, v nor u is a clearance, which a trajectory does not have.
    of_motion = np.concatenate(indices(transcription)[:3])
    for i in np.random.default_rng(0).choice(x.size, 12, replace=False):
        changed = x.copy()
        changed[i] += 0.1
        assert not is_met(transcription, changed, 1e-6)
        assert (max(transcription.defects(changed).values()) > 1e-6) == (i in of_motion)


STIFFNESS, REST, DAMPING = 30.0, 0.4, 0.7
SPRUNG = (
    f"{AXIS}<dynamics><damping>{DAMPING}</damping><spring_stiffness>{STIFFNESS}</spring_stiffness>"
    f"<spring_reference>{REST}</spring_reference></dynamics>"
)
# d/dt (q − rest, v) = A (q − rest, v) + (0, u), with a mass of 1 kg
A = np.array([[0.0, 1.0], [-STIFFNESS, -DAMPING]])


@pytest.fixture(scope="module")
def sprung(tmp_path_factory: pytest.TempPathFactory) -> World:
    model = write_model(tmp_path_factory.mktemp("sprung"), AXIS, SPRUNG)
    return World.from_scenario(make_scenario(1.0, 0.0, model=model))


def oscillate(steps: int, midpoint: bool, duration: float = 0.4) -> tuple[Scenario, Trajectory]:
    """Returns a flight under held controls, by the midpoint rule or exactly."""
    dt = duration / steps
    half = dt / 2 * A
    propagate, drive = expm(dt * A), np.linalg.solve(A, expm(dt * A) - np.eye(2))
    if midpoint:
        propagate = np.linalg.solve(np.eye(2) - half, np.eye(2) + half)
        drive = np.linalg.solve(np.eye(2) - half, dt * np.eye(2))
    times = np.arange(steps + 1) * np.float64(dt)
    # Two controls, whatever the number of steps.
    controls = np.where(times[:-1] < duration / 2 - dt / 2, 5.0, -3.0)
    states = [np.array([1.0 - REST, 0.3])]
    for u in controls:
        states.append(propagate @ states[-1] + drive @ [0.0, u])
    q, v = np.array(states).T
    none = np.zeros((steps + 1, 1))
    scenario = make_scenario(1.0, 0.3, duration=duration, time_step=dt)
    return scenario, Trajectory(
        times, q[:, None] + REST, v[:, None], controls[:, None], none, none[1:]
    )


def test_springs_and_dampers_follow_the_implicit_midpoint_rule(sprung: World) -> None:
    scenario, motion = oscillate(20, midpoint=True)
    transcription = RigidTranscription(sprung, scenario, relaxation=0.0)
    x = transcription.vector(motion)
    assert max(transcription.defects(x).values()) < EXACT
    assert is_met(transcription, x)
    assert not is_met(RigidTranscription(shipped_world(), scenario, relaxation=0.0), x, 1e-3)


def test_flight_with_a_spring_is_of_second_order(sprung: World) -> None:
    rates, ends = [], []
    for steps in (20, 40, 80):
        scenario, exact = oscillate(steps, midpoint=False)
        transcription = RigidTranscription(sprung, scenario)
        defects = transcription.defects(transcription.vector(exact))
        # What the rows miss in a step, per second: defects add up over N ∝ 1/dt steps.
        rates.append([defects[name] / scenario.time_step for name in ("flight", "restitution")])
        planned = oscillate(steps, midpoint=True)[1]
        ends.append(np.abs(planned.positions[-1] - exact.positions[-1]))
    for errors in (np.array(rates), np.array(ends)):
        np.testing.assert_allclose(errors[:-1] / errors[1:], 4.0, rtol=0.1)


ROWS = ("flight", "dynamics", "contact", "restitution", "nonpenetration", "clearance")


def weigh(transcription: Transcription) -> BoxPolynomial:
    """Returns the penalised cost with weights in the unit of costs, as the ladder has them."""
    f = compile_program(transcription.penalized(), transcription.elimination_order())
    names = [name for name in ROWS if name in f.weights]
    return f.with_weights({name: 30.0 * transcription.cost_scale() for name in names})


def rescale(scenario: Scenario, length: float, time: float, mass: float, price: float) -> Scenario:
    """Returns the scenario told in other units: metres, seconds, kilograms, and units of cost."""
    return dataclasses.replace(
        scenario,
        initial_position=length * scenario.initial_position,
        initial_velocity=length / time * scenario.initial_velocity,
        goal_position=length * scenario.goal_position,
        duration=time * scenario.duration,
        time_step=time * scenario.time_step,
        goal_weight=price / length**2 * scenario.goal_weight,
        control_weight=price * time**3 / (mass * length) ** 2 * scenario.control_weight,
    )


@pytest.mark.parametrize(("length", "time", "mass", "price"), [(10, 2, 3, 1), (0.1, 30, 3, 0.3)])
@pytest.mark.parametrize("num_joints", [1, 2])
def test_what_aigo_minimises_is_the_same_in_any_units(
    num_joints: int, length: float, time: float, mass: float, price: float
) -> None:
    start = ([0.3, 0.6], [-0.4, -1.0]) if num_joints == 2 else (0.9, -1.4)
    scenario = make_scenario(*start, time_step=0.1, restitution=0.8)
    worlds = [
        World.from_diagram(make_diagram(num_joints=num_joints, density=density))
        for density in (1, mass)
    ]
    scaled = rescale(scenario, length, time, mass, price)
    one, other = RigidTranscription(worlds[0], scenario), RigidTranscription(worlds[1], scaled)
    assert other.cost_scale() == pytest.approx(price * one.cost_scale(), rel=1e-12)
    unit = np.empty(one.prog().num_vars())
    units = length, length / time, mass * length / time**2, length  # of q, v, u, clearances
    for where, size in zip(indices(one), units, strict=True):
        unit[where] = size
    for mine, yours in zip(one.initial_box(), other.initial_box(), strict=True):
        np.testing.assert_allclose(yours, unit * mine, rtol=1e-12, atol=1e-12)
    rng = np.random.default_rng(0)
    center, half_width = rng.normal(size=unit.size), rng.uniform(size=unit.size)
    expected = weigh(one).mean(center, half_width) / one.cost_scale()
    found = weigh(other).mean(unit * center, unit * half_width) / other.cost_scale()
    assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("steps", "duration"), [(10, 1.0), (40, 1.0), (10, 3.0)])
def test_penalties_are_the_formulas_of_the_docstring(steps: int, duration: float) -> None:
    m, eps, e, T, N = 2.0, 0.01, 0.6, duration, steps
    scenario = make_scenario(
        1.5, -1.0, duration=T, time_step=T / N, mass=m, restitution=e, goal_weight=0.0
    )
    transcription = RigidTranscription(shipped_world(m), scenario, relaxation=eps)
    x = np.random.default_rng(steps).normal(size=transcription.prog().num_vars())
    f = compile_program(transcription.penalized(), transcription.elimination_order())
    shares = mean_by_block(f, x, 0.0)
    q, v, u = (part[:, 0] for part in transcription.split(x))
    dt, L, k = T / N, 1.5, slice(1, None)
    after = v[1:] - dt * u / m
    impulse = m * (after - v[:-1])
    flight = q[1:] - q[:-1] - dt * v[1:] + dt**2 / 2 * u / m
    contact = (q[:-1] * impulse - dt * eps * m * L**2 / T**2) / (m * L**2 / T)
    restitution = impulse * (after + e * v[:-1]) / (m * L**2 / T**2)
    contact[0] = impulse[0] / (m * L / T)
    assert shares["flight"] == pytest.approx(N * np.sum((flight / L) ** 2))
    assert shares["contact"] == pytest.approx(N * np.sum(contact**2))
    assert shares["restitution"] == pytest.approx(N * np.sum(restitution[k] ** 2))
    assert shares["nonpenetration"] == pytest.approx(N * np.sum(np.minimum(q[k] / L, 0) ** 2))
    assert shares["control effort"] == pytest.approx(transcription.scenario_cost(x))


@pytest.mark.parametrize("goal_weight", [0.0, 1e-3, 1.0, 1e3])
def test_the_unit_of_costs_is_what_the_way_costs_from_rest(goal_weight: float) -> None:
    scenario = make_scenario(0.4, 0.0, duration=2.0, time_step=0.01, goal_weight=goal_weight)
    transcription = RigidTranscription(shipped_world(3.0), scenario)
    assert transcription.length_scale() == scenario.goal_position[0]
    # Without a weight the goal has to be met.
    way = dataclasses.replace(scenario, initial_position=0.0, goal_weight=goal_weight or 1e9)
    cost = free_flight_cost(way, mass=3.0)
    assert transcription.cost_scale() == pytest.approx(cost, rel=1e-4)


@pytest.mark.parametrize("relaxation", [-1e-9, math.nan, math.inf])
def test_a_relaxation_that_is_no_size_is_refused(relaxation: float) -> None:
    with pytest.raises(OptionsError) as error:
        RigidTranscription(shipped_world(), make_scenario(), relaxation)
    assert str(error.value) == f"relaxation: got {relaxation}, expected a number, 0 or more."


@pytest.mark.parametrize("kind", [RigidTranscription, PhaseProblem])
def test_a_contact_that_turns_is_refused(kind: Callable[[World, Scenario], Transcription]) -> None:
    world = shipped_world()
    (q,) = world.positions
    bent = dataclasses.replace(world, contacts=(Contact("bent", q**2, np.array([2 * q])),))
    with pytest.raises(ModelError) as error:
        kind(bent, make_scenario())
    assert str(error.value) == (
        "∂φ/∂q of bent: got (2 * q(0)), expected a constant. Use the literal transcription."
    )


def push(
    speed: float, steps: int = 4, impulses: Any = (), forces: Any = (), start: float = 0.0
) -> Trajectory:
    """Returns how 1 kg moves that starts with φ̇ = speed and is pushed by the wall as told.

    Args:
        speed: before the impulse at knot 0 [m/s].
        steps: of 0.1 s.
        impulses: knot → size [N s].
        forces: step → size [N].
        start: φ at knot 0 [m].
    """
    dt = 0.1
    p, f = np.zeros((steps + 1, 1)), np.zeros((steps, 1))
    for knot, size in dict(impulses).items():
        p[knot] = size
    for step, size in dict(forces).items():
        f[step] = size
    q, v = np.full((steps + 1, 1), start), np.full((steps + 1, 1), speed)
    for k in range(steps):
        v[k + 1] = v[k] + p[k] + dt * f[k]
        q[k + 1] = q[k] + dt * (v[k] + p[k] + v[k + 1]) / 2
    return Trajectory(np.arange(steps + 1) * np.float64(dt), q, v, np.zeros((steps, 1)), p, f)


@pytest.mark.parametrize(
    ("motion", "expected"),
    [
        (push(-2.0, impulses={0: 3.0}), {}),  # e = 0.5
        (push(-2.0, impulses={0: 3.2}), {"restitution": 0.2}),
        (push(-2.0, impulses={0: 0.4}), {"restitution": 0.4}),  # rather no impact than this
        (push(2.0, impulses={0: -0.4}), {"restitution": 0.4}),  # a pull
        (push(2.0, impulses={0: -3.0}), {"restitution": 3.0}),  # an impact turned round
        (push(-2.0, impulses={0: 3.0}, start=0.02), {"contact": 0.02}),
        (push(-2.0, impulses={0: 3.0}, start=9.0), {"contact": 0.3}),  # what it moves in a step
        (push(0.0, forces={1: 5.0}), {"contact": 0.025}),  # it lifts while pushed
        (push(0.0, forces={1: 5.0}, start=0.3), {"contact": 0.325}),
        (push(0.0, forces={1: -5.0}), {"contact": 0.025, "restitution": 0.5}),
    ],
)
def test_what_a_rigid_wall_would_not_do_is_a_defect(
    motion: Trajectory, expected: dict[str, float]
) -> None:
    found = rigid_defects(shipped_world(), 0.5, motion)
    everything = dict.fromkeys(("flight", "dynamics", "contact", "restitution"), 0.0)
    assert found == pytest.approx({**everything, **expected}, abs=1e-12)


def test_a_force_that_carries_a_load_is_none() -> None:
    world = World.from_diagram(make_diagram(gravity=9.81))
    zeros, loads = np.zeros((5, 1)), np.array([[0.0], [3.0], [20.0], [-7.0]])
    carried = 1.5 * 9.81 - loads
    motion = Trajectory(np.array([0, 0.1, 0.3, 0.4, 0.7]), zeros, zeros, loads, zeros, carried)
    assert carried[2] < 0  # More than its weight lifts it: here the wall would have to pull.
    pull = -0.1 * carried[2, 0] / 1.5
    assert rigid_defects(world, 0.0, motion) == pytest.approx(
        {"flight": 0.0, "dynamics": 0.0, "contact": 0.0, "restitution": pull}, abs=1e-12
    )


def test_flight_and_dynamics_defects_have_their_units() -> None:
    exact = push(-2.0, impulses={0: 3.0})
    shifted = exact.positions + np.array([0, 0, 0, 0.004, 0.004])[:, None]
    found = rigid_defects(shipped_world(), 0.5, dataclasses.replace(exact, positions=shifted))
    assert found["flight"] == pytest.approx(0.004)  # [m]
    driven = dataclasses.replace(push(1.0), controls=np.array([[0], [0], [6.0], [0]]))
    found = rigid_defects(shipped_world(2.0), 0.5, driven)
    assert found["dynamics"] == pytest.approx(0.1 * 6.0 / 2.0)  # [m/s]


def test_the_impact_map_keeps_what_moves_along_the_wall(physics: Physics) -> None:
    inertia = physics.world.constant_inertia
    assert inertia.masses == pytest.approx(physics.contact_mass)
    np.testing.assert_allclose(inertia.lifts, [physics.lift])
    assert np.all(np.abs(inertia.lifts) > 0.1)  # An impulse moves all of them.
    before = np.random.default_rng(0).normal(size=physics.size)
    after = JointImpact.of(inertia, (0,), (0.6,)).velocities @ before
    assert physics.jacobian @ after == pytest.approx(-0.6 * (physics.jacobian @ before))
    # No impulse along the wall; and an elastic impact keeps the energy.
    jump = physics.mass @ (after - before)
    np.testing.assert_allclose(jump, physics.jacobian * (jump @ physics.lift), atol=1e-12)
    elastic = JointImpact.of(inertia, (0,), (1.0,)).velocities @ before
    assert elastic @ physics.mass @ elastic == pytest.approx(before @ physics.mass @ before)
