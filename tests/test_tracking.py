"""Plans that are tracked in Diagrams: whose bounces count, what feedback wins, what is refused."""

from __future__ import annotations

import dataclasses
import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy
from loops import Wrapper, close_loop, hold_samples, set_start
from marks import slow
from mechanisms import drop_ball
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from drake_aigto import Plan, Planner, PlanOptions, Scenario, TrackingController, World, plan
from drake_aigto.arrays import Floats
from drake_aigto.contact import contact_law, make_mechanism
from drake_aigto.control import Disturbance, run_in_loop
from drake_aigto.errors import ControlError, ModelError
from drake_aigto.planning import Feedback, FeedbackPhase, MechanismTask, Sweep, calc_divergence
from drake_aigto.shooting import ShootingProblem
from drake_aigto.show import format_plan
from drake_aigto.simulation import (
    EVENT_DRIVEN,
    MOST_GROWTH,
    NOTHING,
    calc_growth,
    make_simulator,
    replay_drake,
    replay_event_driven,
    replay_with,
)
from drake_aigto.trajectory import Trajectory

MASS: Any = "mass", "stiffness"
QUICK = PlanOptions(renewals=16, finalists=1, confirm=False)


@cache
def make_plan(name: str) -> Plan:
    scenario = Scenario.named(name)
    return Planner(scenario, QUICK if name.startswith("cart") else None).plan()


def track(plan: Plan, off: Any, feels: bool, period: float = 0.01) -> tuple[Any, tuple[int, ...]]:
    """Returns where a plant ends that starts off its plan, and the bounces that were counted."""
    controller = TrackingController(plan, period=period)
    diagram, plant = close_loop(plan.scenario.model, controller, feels)
    world = World.from_diagram(diagram)
    simulator = make_simulator(world, move(plan.scenario, off))
    simulator.AdvanceTo(plan.scenario.duration)
    root = simulator.get_context()
    x = plant.GetPositionsAndVelocities(plant.GetMyContextFromRoot(root))
    return x, controller.count_bounces(controller.GetMyContextFromRoot(root))


def move_among(
    plan: Plan, controller: TrackingController, disturbance: Disturbance, time: float
) -> tuple[Any, Any]:
    """Returns where a plant is by a time that is not the plan's, and the Diagram's context."""
    true, _ = disturbance.apply(plan.find_world(), plan.scenario)
    builder = DiagramBuilder()
    plant = builder.AddSystem(true.diagram.Clone())
    builder.AddSystem(controller)
    builder.Connect(plant.GetOutputPort("state"), controller.GetInputPort("estimated_state"))
    builder.Connect(controller.GetOutputPort("control"), plant.GetInputPort("actuation"))
    world = true.of_diagram(builder.Build())
    simulator = make_simulator(world, plan.scenario)
    simulator.AdvanceTo(time)
    root = simulator.get_context().Clone()
    return world.plant.GetPositionsAndVelocities(world.plant.GetMyContextFromRoot(root)), root


def end_among(plan: Plan, shift: float) -> tuple[Any, tuple[int, ...]]:
    """Returns the same as `track` in a plant whose walls stand nearer, and touches are inferred."""
    controller, nearer = TrackingController(plan, period=0.01), Disturbance(wall_shift=shift)
    x, root = move_among(plan, controller, nearer, plan.scenario.duration)
    return x, controller.count_bounces(controller.GetMyContextFromRoot(root))


@pytest.mark.parametrize("name", ["table1/1", *slow("room/bank_shot", "floor/lossy")])
@pytest.mark.parametrize("shift", [0.01, *slow(-0.01)])
def test_a_wall_that_stands_nearer_or_farther_is_bounced_off(name: str, shift: float) -> None:
    plan = make_plan(name)
    x, bounces = end_among(plan, shift)
    (contact,) = [each.index for each in plan.best.contacts]
    assert bounces[contact] == 1
    n = plan.trajectory.positions.shape[1]
    assert np.linalg.norm(x[:n] - plan.trajectory.positions[-1]) < 5e-3


@pytest.mark.slow
def test_the_plan_plays_until_a_sampled_estimate_has_its_first_sample() -> None:
    plan = make_plan("floor/lossy")
    controller = TrackingController(plan, period=0.01)
    size = controller.GetInputPort("estimated_state").size()
    hold = hold_samples(0.005, size)
    diagram, plant = close_loop(plan.scenario.model, controller, estimator=hold)
    simulator = make_simulator(World.from_diagram(diagram), plan.scenario)
    own = controller.GetMyContextFromRoot(simulator.get_context())
    simulator.Initialize()
    planned = plan.trajectory.controls[0]
    np.testing.assert_allclose(controller.GetOutputPort("control").Eval(own), planned)
    simulator.AdvanceTo(plan.scenario.duration)
    assert controller.count_bounces(own) == (1,)
    q = plant.GetPositions(plant.GetMyContextFromRoot(simulator.get_context()))
    np.testing.assert_allclose(q, plan.trajectory.positions[-1], atol=5e-3)


@pytest.mark.slow
def test_an_estimator_that_wraps_angles_changes_nothing() -> None:
    plan = make_plan("cart_pole/soft_06")
    world, off = plan.find_world(), move(plan.scenario, np.array([0.0, 0.01]))
    ends = []
    for estimator in (None, Wrapper(world)):
        controller = TrackingController(plan, period=0.01)
        diagram, plant = close_loop(plan.scenario.model, controller, estimator=estimator)
        simulator = make_simulator(World.from_diagram(diagram), off)
        simulator.AdvanceTo(plan.scenario.duration)
        context = plant.GetMyContextFromRoot(simulator.get_context())
        ends.append(plant.GetPositionsAndVelocities(context))
    assert np.max(np.abs(plan.trajectory.positions[:, 1])) > np.pi
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-6)


def move(scenario: Scenario, off: Any) -> Scenario:
    return dataclasses.replace(scenario, initial_position=scenario.initial_position + off)


@pytest.mark.parametrize("feels", [False, *slow(True)])
@pytest.mark.parametrize("off", [0.03, *slow(-0.03)])
def test_a_ball_is_brought_to_its_goal_off_the_wall(off: float, feels: bool) -> None:
    plan = make_plan("table1/1")
    x, bounces = track(plan, off, feels)
    open_loop = replay_drake(
        plan.find_world(), move(plan.scenario, off), plan.trajectory.times, plan.trajectory.controls
    )
    planned = plan.trajectory.positions[-1, 0]
    assert bounces == (1,)
    assert abs(x[0] - planned) < max(0.05 * abs(open_loop.positions[-1, 0] - planned), 2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("feels", [False, True])
def test_bounces_are_counted_at_any_period(feels: bool) -> None:
    plan = make_plan("table1/1")
    for period in (0.0007, 0.03):
        x, bounces = track(plan, 0.0, feels, period=period)
        assert bounces == (1,)
        assert x[0] == pytest.approx(plan.trajectory.positions[-1, 0], abs=5e-3)


def test_a_pole_that_starts_elsewhere_stands_up_off_a_soft_wall() -> None:
    plan = make_plan("cart_pole/soft_06")
    assert plan.best.contacts
    off, motion = np.array([0.02, -0.05]), plan.trajectory
    alone = replay_drake(plan.find_world(), move(plan.scenario, off), motion.times, motion.controls)
    x, _ = track(plan, off, feels=False)
    missed = np.abs(alone.positions[-1] - motion.positions[-1])
    assert np.all(np.abs(x[:2] - motion.positions[-1]) < 0.3 * missed)


def test_a_sample_in_a_soft_wall_is_answered_as_any_other() -> None:
    plan = make_plan("cart_pole/soft_06")
    controller = TrackingController(plan, period=plan.scenario.time_step)
    context, motion = controller.CreateDefaultContext(), plan.trajectory
    assert np.min(plan.find_world().calc_signed_distance(motion.positions)) < 0
    commands = []
    for time, q, v in zip(motion.times[:-1], motion.positions, motion.velocities, strict=False):
        context.SetTime(time)
        controller.get_input_port_estimated_state().FixValue(context, np.concatenate([q, v]))
        controller.update(context)
        commands.append(controller.get_output_port_control().Eval(context))
    np.testing.assert_allclose(commands, motion.controls, atol=1e-6)


def solve_riccati(h: float, steps: int, mass: float, weights: dict[str, Any]) -> Any:
    """Returns the gains of held forces on a mass, by exact integrals and the discrete equation."""
    nodes, shares = np.polynomial.legendre.leggauss(4)
    stage = np.zeros((3, 3))
    for t, share in zip(h / 2 * (1 + nodes), h / 2 * shares, strict=True):
        rows = np.array([[1, t, t**2 / 2 / mass], [0, 1, t / mass], [0, 0, 1]])
        effort = [weights["position_weight"], weights["velocity_weight"], weights["control_weight"]]
        stage += share * rows.T @ np.diag(effort) @ rows
    F = np.array([[1, h, h**2 / 2 / mass], [0, 1, h / mass]])
    V = np.diag([weights["goal_weight"], weights["goal_velocity_weight"]])
    gains = []
    for _ in range(steps):
        H = stage + F.T @ V @ F
        gains.append(-H[2:, :2] / H[2, 2])
        V = H[:2, :2] + H[:2, 2:] @ gains[-1]
    return np.array(gains[::-1])


def test_gains_are_those_of_the_discrete_riccati_equation() -> None:
    weights: dict[str, Any] = {
        "position_weight": 3.0,
        "velocity_weight": 0.4,
        "control_weight": 0.1,
        "goal_weight": 20.0,
        "goal_velocity_weight": 2.0,
    }
    scenario = Scenario(
        initial_position=0.9, initial_velocity=0.0, goal_position=1.0, duration=0.8, time_step=0.1
    )
    scenario = dataclasses.replace(scenario, **weights)
    task = MechanismTask(drop_ball(), scenario, PlanOptions()).shooting(8)
    expected = solve_riccati(0.1, 8, 2.0, weights)
    # A descent's first damping is a millionth of the curvature.
    np.testing.assert_allclose(task.linearize(np.zeros((8, 1)), 8).gains, expected, rtol=2e-6)
    # A control at its bound answers, too: what leads away from there is not cut.
    bounds = np.array([[-0.5], [0.0]])
    clamped = dataclasses.replace(task, control_bounds=bounds).linearize(np.zeros((8, 1)), 8).gains
    np.testing.assert_allclose(clamped, expected, rtol=2e-6)
    # Phases of what touches nothing have the same, but for what runs.
    weights |= {"position_weight": 0.0, "velocity_weight": 0.0}
    none, scenario = np.zeros((9, 1)), dataclasses.replace(scenario, **weights)
    still = Trajectory(np.linspace(0, 0.8, 9), none + 0.9, none, none[1:], none, none[1:])
    (phase,) = Sweep(drop_ball(), scenario, still).run()
    np.testing.assert_allclose(phase.gains, solve_riccati(0.1, 8, 2.0, weights), rtol=1e-6)


@pytest.mark.slow
def test_gains_of_friction_are_those_of_the_motion_whatever_steps_a_plan_is_made_in() -> None:
    scenario = Scenario.named("hopper/hop")
    world, n = World.from_scenario(scenario), 4
    told = json.loads(Path(__file__).with_name("shipped_motions.json").read_text("utf-8"))
    times, controls = (np.array(told["hopper/hop"][key]) for key in ("control_times", "controls"))
    mechanism = make_mechanism(world, contact_law(world, scenario))
    problem = ShootingProblem.of(world, scenario, mechanism, times)
    states = problem.simulate(controls, 128).states
    none = np.zeros((len(times), world.num_contacts))
    motion = Trajectory(times, states[:, :n], states[:, n:], controls, none, none[1:])
    period = float(np.max(np.diff(times)))
    (phase,) = Feedback(world, scenario, motion, period=period).phases
    exact = problem.linearize(controls, 1024, 1e-4, states).gains
    off, size = (np.linalg.norm(each, axis=(1, 2)) for each in (phase.gains - exact, exact))
    assert np.max(off / size) < 0.1


@pytest.mark.slow
def test_off_its_plan_tracking_costs_no_more_than_any_gains_that_know_of_other_walls() -> None:
    scenario = Scenario.named("cart_pole/soft_06")
    world = World.from_scenario(scenario)
    told = json.loads(Path(__file__).with_name("shipped_motions.json").read_text("utf-8"))
    times, controls = (
        np.array(told["cart_pole/soft_06"][key]) for key in ("control_times", "controls")
    )
    mechanism = make_mechanism(world, contact_law(world, scenario))
    states = ShootingProblem.of(world, scenario, mechanism, times).simulate(controls, 16).states
    none = np.zeros((len(times), world.num_contacts))
    motion = Trajectory(times, states[:, :2], states[:, 2:], controls, none, none[1:])
    tracking = Feedback(world, scenario, motion, period=0.005)
    (phase,) = tracking.phases
    problem = ShootingProblem.of(world, scenario, mechanism, phase.times)
    laws = [tracking]
    for smoothing in (0.0, 1e-2, 1e-1):
        gains = problem.linearize(phase.controls, 2, smoothing, phase.states).gains
        alone = FeedbackPhase(phase.times, phase.states, phase.controls, gains)
        laws.append(Feedback(world, scenario, motion, [alone]))
    for push in (0.4, -0.8, 1.2):
        start = scenario.initial_velocity + np.array([push, 0.0])
        pushed = dataclasses.replace(scenario, initial_velocity=start)
        cost, *others = [replay_with(EVENT_DRIVEN, world, pushed, each).cost for each in laws]
        assert cost <= 1.01 * min(others)


def test_laws_are_judged_by_what_is_learned_of_a_model_and_that_is_in_the_context() -> None:
    plan, heavy, unknown = make_plan("cart_pole/soft_06"), Disturbance(mass_factor=1.2), MASS[:1]
    controllers = [TrackingController(plan, estimate=each) for each in (unknown, unknown, ())]
    x, root = move_among(plan, controllers[0], heavy, 0.4)
    learned = controllers[0].GetMyContextFromRoot(root)
    (mass,) = controllers[0].read_status(learned).estimated
    assert mass == pytest.approx(1.2, abs=0.01)
    answers = list[Any]()
    for k in range(12):  # Each 5 ms on, as if it were held there: off the plan, more and more.
        answers.append([])
        for controller in controllers:
            context = controller.CreateDefaultContext()
            if controller.estimated:
                context.SetTimeStateAndParametersFrom(learned)
            context.SetTime(0.405 + 0.005 * k)
            controller.get_input_port_estimated_state().FixValue(context, x)
            controller.update(context)
            answers[-1].append(controller.get_output_port_control().Eval(context).item())
    learns, copied, believes = np.array(answers).T
    np.testing.assert_array_equal(learns, copied)
    assert np.any(learns != believes)


def test_a_tracker_with_one_law_at_a_time_learns_nothing_of_its_model() -> None:
    with pytest.raises(ControlError, match=r"one law at a time"):
        TrackingController(make_plan("table1/1"), estimate=MASS[:1])


def test_a_plant_that_is_heavier_is_tracked_by_the_model_that_explains_it() -> None:
    plan, heavy = make_plan("cart_pole/soft_06"), Disturbance(mass_factor=1.3)
    costs = [
        run_in_loop(TrackingController(plan, estimate=unknown), plan.scenario, disturbance=heavy)
        for unknown in ((), MASS)
    ]
    assert costs[1].cost < 0.95 * costs[0].cost


@pytest.mark.parametrize("feels", [*slow(False), True])
def test_a_simulator_that_is_initialized_again_on_its_way_remembers_bounces(feels: bool) -> None:
    plan = make_plan("table1/1")
    controller = TrackingController(plan, period=0.01)
    diagram, _ = close_loop(plan.scenario.model, controller, feels)
    simulator = make_simulator(World.from_diagram(diagram), plan.scenario)
    simulator.AdvanceTo(plan.best.contacts[0].time + 0.01)
    context = controller.GetMyContextFromRoot(simulator.get_context())
    assert controller.count_bounces(context) == (1,)
    simulator.Initialize()
    assert controller.count_bounces(context) == (1,)
    # From the start on it has happened no more.
    simulator.get_mutable_context().SetTime(0.0)
    simulator.Initialize()
    assert controller.count_bounces(context) == (0,)


def test_bounces_are_felt_in_a_plant_that_has_other_bodies_before_the_model() -> None:
    plan, controller = make_plan("table1/1"), TrackingController(make_plan("table1/1"))
    diagram, plant = close_loop(plan.scenario.model, controller, feels=True, has_camera=True)
    simulator = Simulator(diagram)
    context = set_start(plant, simulator.get_mutable_context(), plan.scenario)
    plant.SetPositions(context, [1e-3])
    plant.SetVelocities(context, [-1.0])
    simulator.get_mutable_integrator().set_maximum_step_size(1e-5)
    simulator.get_mutable_integrator().request_initial_step_size_target(1e-5)
    simulator.AdvanceTo(0.01)
    assert plant.GetVelocities(context)[0] > 0
    own = controller.GetMyContextFromRoot(simulator.get_context())
    assert controller.count_bounces(own) == (1,)


def test_what_can_not_be_tracked_is_refused_before_it_runs() -> None:
    plan = make_plan("table1/1")
    for period in (0.0, -1.0, np.nan, "1"):
        with pytest.raises(ControlError, match=r"^period: got .*, expected seconds above zero"):
            TrackingController(plan, period=period)  # type: ignore[arg-type]
    with pytest.raises(ModelError, match="the world"):
        TrackingController(plan, drop_ball())
    assert TrackingController(plan, period=np.float32(0.5)).period == 0.5  # type: ignore[arg-type]
    with pytest.raises(ControlError, match=r"estimated_state of TrackingController: got nothing"):
        Simulator(TrackingController(plan)).Initialize()


@pytest.mark.slow
def test_a_mechanism_that_bounces_is_brought_back_to_its_plan() -> None:
    options = PlanOptions(renewals=0, confirm=False)
    swing = Planner(Scenario.named("pendulum/off_the_wall"), options).plan()
    world, scenario = swing.find_world(), swing.scenario
    assert len(TrackingController(swing).feedback.phases) == 2
    assert len(swing.best.contacts) == 1 and not world.has_constant_inertia
    control, goal = (swing.trajectory.times, swing.trajectory.controls), scenario.goal_position
    moved = Disturbance(start_offset=np.array([0.1]))
    run = run_in_loop(TrackingController(swing, period=0.01), scenario, world, moved)
    # It bounces late or early, and each phase goes on until then.
    assert run.replay.bounce_times[0] > swing.best.contacts[0].time + 5e-3
    open_loop = replay_event_driven(world, move(scenario, moved.start_offset), *control)
    assert run.replay.goal_error < 0.05 * open_loop.goal_error
    x, bounces = track(swing, np.array([-0.1]), feels=False)
    open_loop = replay_event_driven(world, move(scenario, np.array([-0.1])), *control)
    assert bounces[0] == 1
    assert abs(x[0] - goal[0]) < 0.05 * open_loop.goal_error


@pytest.mark.parametrize("spin", [*slow(-40.0), -0.5])  # It slips, it sticks.
def test_a_bounce_with_friction_does_to_deviations_what_simulations_show(spin: float) -> None:
    scenario = dataclasses.replace(
        Scenario.named("billiard/spin_shot"), initial_velocity=[0.2, 1.0, spin]
    )
    world, none = World.from_scenario(scenario), np.zeros((2, 3))

    def roll(x: Any) -> Any:
        q, v = np.split(x, 2)
        start = dataclasses.replace(scenario, initial_position=q, initial_velocity=v)
        return replay_event_driven(world, start, [0.0, 0.5, 1.0], none)

    def end(x: Any) -> Any:
        replay = roll(x)
        return np.concatenate([replay.positions[-1], replay.velocities[-1]])

    x = np.concatenate([scenario.initial_position, scenario.initial_velocity])
    replay = roll(x)
    (time,), (contact,) = replay.bounce_times, replay.bounce_contacts
    q, v = np.split(x, 2)
    trajectory = Trajectory(
        times=np.array([0.0, time, 1.0]),
        positions=np.array([q, q + time * v, replay.positions[-1]]),
        velocities=np.array([v, v, replay.velocities[-1]]),
        controls=none,
        impulses=np.eye(world.num_contacts)[contact] * [[0.0], [1.0], [0.0]],
        forces=np.zeros((2, world.num_contacts)),
    )
    saltation = Sweep(world, scenario, trajectory).calc_saltation(1)
    before, after = (np.kron([[1.0, t], [0.0, 1.0]], np.eye(3)) for t in (time, 1.0 - time))
    h = 1e-4
    slopes = np.column_stack([(end(x + dx) - end(x - dx)) / (2 * h) for dx in h * np.eye(6)])
    np.testing.assert_allclose(slopes, after @ saltation @ before, atol=1e-4)


# A pole of 1 kg at the end of a rod of 1 m without mass, which a motor turns at its foot.
POLE = """<robot name="pole">
  <link name="pole">
    <inertial>
      <origin xyz="0 0 1"/> <mass value="1"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="foot" type="continuous">
    <parent link="world"/> <child link="pole"/> <axis xyz="0 1 0"/>
  </joint>
  <transmission>
    <type>transmission_interface/SimpleTransmission</type>
    <joint name="foot"/>
    <actuator name="motor"/>
  </transmission>
</robot>"""
INERTIA, GRAVITY = 1.01, 9.81
PACE = np.sqrt(GRAVITY / INERTIA)  # λ of errors upright, e^(λ t) [1/s].


def linear(pace: float, step: float) -> Floats:
    return np.asarray(scipy.linalg.expm(step * np.array([[0.0, 1.0], [pace**2, 0.0]])))


@pytest.mark.parametrize("count", [5, 200])
def test_errors_grow_as_the_exact_flow_says_from_any_time_to_any_other(count: int) -> None:
    pace, step = 3.0, 4.0 / count
    grow, scales = linear(pace, step), np.array([1.0, pace])
    found = calc_growth(np.array([grow] * count), scales)
    assert found.factor == pytest.approx(np.exp(pace * 4.0), rel=1e-9)
    # Along the direction that grows: v = λ q, in units of the scales.
    assert np.abs(found.worst) == pytest.approx(np.array([1.0, pace]) / np.sqrt(2), rel=1e-6)
    # What shrinks before, and after, changes nothing.
    shrink = np.linalg.inv(grow)
    around = np.array([*[shrink] * count, *[grow] * count, *[shrink] * count])
    parts = calc_growth(around, scales)
    assert parts.factor == pytest.approx(found.factor, rel=0.3)


@pytest.mark.parametrize("seed", range(20))
def test_whether_errors_grow_by_more_takes_singular_values_of_the_few_that_may(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng, scales = np.random.default_rng(seed), np.array([1.0, 3.0])
    transitions = np.eye(2) + 0.1 * rng.normal(size=(100, 2, 2))
    factor = calc_growth(transitions, scales).factor
    assert calc_growth(transitions, scales, 0.99 * factor).factor > 0.99 * factor
    assert not calc_growth(transitions, scales, 1.01 * factor).factor > 1.01 * factor
    monkeypatch.setattr(np.linalg, "svd", None)
    assert calc_growth(transitions, scales, 2 * factor).factor == 2 * factor


def test_errors_of_a_motion_that_runs_away_grow_beyond_all_numbers() -> None:
    assert calc_growth(np.full((400, 2, 2), 1e10), np.ones(2)).factor == np.inf


def ask(folder: Path, duration: float, start: float = 0.3) -> Scenario:
    path = folder / "pole.urdf"
    path.write_text(POLE)
    return Scenario(
        model=str(path),
        initial_position=[start],
        initial_velocity=[0.0],
        goal_position=[0.0],
        goal_velocity=[0.0],
        duration=duration,
        time_step=0.1,
        control_weight=0.01,
        position_weight=[0.1],
        goal_weight=10.0,
        goal_velocity_weight=1.0,
        contact="compliant",
    )


def bound_growth(duration: float) -> float:
    """Returns how errors grow upright all the time, with velocities in parts of 1 rad in T."""
    turn = PACE * duration
    return float(np.sinh(turn) * max(turn, 1 / turn))


@cache
def balance(folder: Path) -> Plan:
    return plan(ask(folder, 7.0), PlanOptions(renewals=0, starts=4))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pole")


def test_a_pole_that_balances_for_long_is_judged_with_its_own_feedback(folder: Path) -> None:
    found = balance(folder)
    growth = found.best.growth
    assert growth is not None
    # Beyond what the control alone could hold.
    assert MOST_GROWTH < growth.factor == pytest.approx(bound_growth(7.0), rel=0.1)
    assert found.holds
    assert found.best.gains
    assert not any(map(found.best.is_confirmed_by, found.replay.alone[:1]))
    for replay in found.replay:
        assert replay.feedback is not None
        assert replay.cost == pytest.approx(found.cost, rel=1e-3)
        assert replay.goal_error <= NOTHING
    assert len(found.replay.perturbed) == 2
    for replay in found.replay.perturbed:
        assert (replay.feedback or 0.0) > (found.replay.event_driven.feedback or 0.0)
        assert np.abs(replay.positions[0] - found.replay.event_driven.positions[0]) <= 1e-3
    one, other = found.replay.perturbed
    assert one.offset_cost == -other.offset_cost == (one.cost - other.cost) / 2
    assert one.offset_error == -other.offset_error == (one.goal_error - other.goal_error) / 2


@pytest.mark.parametrize(("slope", "both", "holds"), [(0.5, 0.01, True), (0.0, 0.1, False)])
def test_what_a_start_that_is_off_costs_to_first_order_is_not_held_against_a_plan(
    folder: Path, slope: float, both: float, holds: bool
) -> None:
    best = balance(folder).best
    off = [
        dataclasses.replace(
            each, cost=(1 + both + sign * slope) * best.cost, offset_cost=sign * slope * best.cost
        )
        for each, sign in zip(best.perturbed, (1, -1), strict=True)
    ]
    assert dataclasses.replace(best, perturbed=tuple(off)).is_confirmed is holds


def test_a_plan_file_has_the_gains_and_replays_to_the_same_bits(folder: Path) -> None:
    found, path = balance(folder), folder / "plan.json"
    found.save(path)
    loaded = Plan.load(path)
    assert loaded.best.gains == found.best.gains
    again = loaded.replayed(confirm=False)
    assert again.replay.event_driven == found.replay.event_driven
    assert again.replay.perturbed == found.replay.perturbed
    assert again.holds
    # Who tracks it samples more often, and has gains of shorter holds.
    (phase,) = TrackingController(loaded).feedback.phases
    step = loaded.scenario.time_step / 5
    np.testing.assert_allclose(np.diff(phase.times), step, rtol=1e-6)


def test_what_judges_is_said_first_and_the_control_alone_is_reported(folder: Path) -> None:
    text = format_plan(balance(folder))
    assert text.startswith("verdict     holds: the control with its feedback keeps the plan's")
    assert "growth      errors grow" in text
    assert "its own feedback judges it, not the control alone" in " ".join(text.split())
    assert "alone       by integration: contradicts the plan" in text
    assert "perturbed   from starts 1e-3 of the scales off" in text
    assert "with feedback: errors grow" in repr(balance(folder))


def test_a_short_balance_is_judged_by_its_control_alone(folder: Path) -> None:
    found = plan(ask(folder, 1.0), PlanOptions(renewals=0, starts=2))
    growth = found.best.growth
    assert growth is not None
    assert 1.0 < growth.factor == pytest.approx(bound_growth(1.0), rel=0.1)
    assert not found.best.gains
    assert all(replay.feedback is None for replay in found.replay)
    assert "the control alone keeps the plan's promise" in format_plan(found)


def test_a_goal_that_is_an_unstable_equilibrium_is_named_with_its_pace(folder: Path) -> None:
    scenario = ask(folder, 1.0)
    world = World.from_scenario(scenario)
    assert calc_divergence(world, scenario) == pytest.approx(PACE, rel=1e-6)
    hanging = dataclasses.replace(scenario, goal_position=[np.pi])
    assert calc_divergence(world, hanging) == 0.0
    passing = dataclasses.replace(scenario, goal_velocity=[1.0])
    assert calc_divergence(world, passing) == 0.0
    # The motor holds it anywhere, and errors grow where it leans upwards.
    leaning = dataclasses.replace(scenario, goal_position=[0.5])
    assert calc_divergence(world, leaning) == pytest.approx(PACE * np.sqrt(np.cos(0.5)), rel=1e-6)
    text = " ".join(format_plan(balance(folder)).split())
    assert (
        "the goal, q = (0), is at an unstable equilibrium, where errors grow e-fold in 0.32 s"
        in text
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "duration", "time_step", "most"),
    [("acrobot/swing_up", 6.0, 0.05, 95.0), ("cart_pole/rigid_06", 4.5, 0.0375, 82.0)],
)
def test_a_longer_horizon_is_no_worse(
    name: str, duration: float, time_step: float, most: float
) -> None:
    scenario = dataclasses.replace(Scenario.named(name), duration=duration, time_step=time_step)
    found = plan(scenario)
    assert found.holds
    assert found.cost < most
    for replay in found.replay:
        assert replay.cost == pytest.approx(found.cost, rel=1e-3)
