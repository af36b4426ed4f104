"""Feedback along plans whose contacts last on rigid walls: what these leave of deviations."""

from __future__ import annotations

import dataclasses
import functools
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from marks import slow
from rubbing_worlds import RADIUS, make_discs

from drake_aigto import (
    ModelPredictiveController,
    Planner,
    PlanOptions,
    Scenario,
    TrackingController,
    World,
    plan,
)
from drake_aigto.arrays import Floats
from drake_aigto.contact import Mode
from drake_aigto.control import Disturbance, Horizon, PlannedMotion, make_horizon, run_in_loop
from drake_aigto.planning import Feedback, RigidMechanismTask, Sweep, lay_out, make_trajectory
from drake_aigto.simulation import (
    EVENT_DRIVEN,
    Controller,
    HeldControl,
    Replay,
    replay_event_driven,
)
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch

build = cache(lambda **options: World.from_diagram(make_discs(**options)))


def pose(q: Any, v: Any, **fields: Any) -> Scenario:
    """Returns a task from a state, between walls that return nothing, at 0.3 of friction."""
    count = len(q)
    task = {
        "goal_position": q,
        "goal_weight": np.arange(1.0, count + 1),
        "goal_velocity_weight": 0.1 * np.arange(1.0, count + 1),
        "control_weight": 1e-2,
        "restitution": 0.0,
    }
    return Scenario(initial_position=q, initial_velocity=v, **{**task, **fields})


def replay(world: World, scenario: Scenario, times: Any, controls: Any, x: Any = None) -> Replay:
    """Returns what a control does from the scenario's start, or from another state."""
    if x is not None:
        q, v = np.split(x, 2)
        scenario = dataclasses.replace(scenario, initial_position=q, initial_velocity=v)
    return replay_event_driven(world, scenario, times, np.array(controls)[:, np.newaxis])


def make_plan(world: World, scenario: Scenario, times: Any, controls: Any) -> Trajectory:
    """Returns a simulated motion as a plan, with a knot at each event."""
    found = replay(world, scenario, times, controls)
    lasting = [time for phase in found.contact_phases for time in (phase.start, phase.end)]
    events = [
        time
        for time in {*found.bounce_times, *lasting}
        if np.min(np.abs(np.array(times) - time)) > 1e-9
    ]
    knots = np.union1d(times, events)
    held = np.array(controls)[np.searchsorted(times, (knots[1:] + knots[:-1]) / 2) - 1]
    found = replay(world, scenario, knots, held)
    impulses = np.zeros((len(knots), world.num_contacts))
    for time, contact in zip(found.bounce_times, found.bounce_contacts, strict=True):
        impulses[np.argmin(np.abs(knots - time)), contact] = 1.0
    none = np.zeros((len(held), world.num_contacts))
    return Trajectory(knots, *found.states_at(knots), held[:, np.newaxis], impulses, none)


def end(found: Replay) -> Floats:
    return np.concatenate([found.positions[-1], found.velocities[-1]])


STICK, FORWARD, OPEN = Mode.STICK, Mode.FORWARD, Mode.OPEN
MOTIONS = {
    "lands and rolls": ([0.0, 0.15, 0.0], [1.0, -1.0, 10.0], [2.0] * 2, [OPEN, STICK]),
    "lands, slides and rolls": (
        *([0.0, 0.15, 0.0], [1.0, -1.0, -40.0]),
        *([2.0, 2.0], [OPEN, FORWARD, STICK]),
    ),
    "is pushed until it slips": (
        *([0.0, RADIUS, 0.0], [0.5, 0.0, 5.0]),
        *([5.0, 15.0], [STICK, FORWARD]),
    ),
    "rolls along a board that tilts": (
        *([0.05, RADIUS, 0.0, 0.0], [-0.2, 0.0, -2.0, 0.0]),
        *([0.5, 0.0], [STICK, FORWARD]),
    ),
}


@pytest.mark.parametrize(
    "name",
    [
        "is pushed until it slips",
        *slow(*(each for each in MOTIONS if each != "is pushed until it slips")),
    ],
)
def test_deviations_end_where_simulations_lead_them(name: str) -> None:
    q, v, pushes, modes = MOTIONS[name]
    world, scenario = build(tilts=len(q) == 4), pose(q, v)
    trajectory = make_plan(world, scenario, [0.0, 0.25, 0.5], pushes)
    sweep = Sweep(world, scenario, trajectory)
    assert [stretch.find_mode(0) for stretch in sweep.stretches] == modes
    times, x = trajectory.times, np.concatenate([q, v])
    left = sweep.stretches[0].calc_projection(x)
    whole = functools.reduce(lambda product, F: F @ product, sweep.calc_transitions(), left)
    controls, h = trajectory.controls[:, 0], 1e-4
    ends = [end(replay(world, scenario, times, controls, x + h * dx)) for dx in (*left.T, *-left.T)]
    slopes = np.subtract(*np.split(np.array(ends), 2)).T / (2 * h)
    np.testing.assert_allclose(slopes, whole, rtol=2e-3, atol=2e-4)


@pytest.mark.parametrize("spin", [0.0, *slow(5.0)])
def test_a_gain_of_one_period_is_the_best_answer_in_simulations(spin: float) -> None:
    q, v, push = [0.05, RADIUS, 0.0, 0.0], [0.5, 0.0, spin, 0.0], 2.0
    scenario = pose(q, v, duration=0.03, time_step=0.03)
    world, times = build(tilts=True), np.array([0.0, 0.03])
    trajectory = make_plan(world, scenario, times, [push])
    sweep, h = Sweep(world, scenario, trajectory), 1e-4
    (stretch,), (phase,) = sweep.stretches, sweep.run()
    assert stretch.closed.modes == (STICK if spin else FORWARD,)
    x = np.concatenate([scenario.initial_position, scenario.initial_velocity])
    left = stretch.calc_projection(x)
    ends = [
        end(replay(world, scenario, times, [push + h * du], x + h * dx))
        for sign in (1, -1)
        for dx, du in [*zip(sign * left.T, np.zeros(len(x)), strict=True), (0 * x, sign)]
    ]
    slopes = np.subtract(*np.split(np.array(ends), 2)).T / (2 * h)
    F, G = slopes[:, :-1], slopes[:, -1]
    Q = np.diag(np.concatenate([scenario.goal_weight, scenario.goal_velocity_weight]))
    gain = -(G @ Q @ F) / (0.03 * float(np.ravel(scenario.control_weight)[0]) + G @ Q @ G)
    np.testing.assert_allclose(phase.gains[0, 0], gain, atol=2e-4 * np.max(np.abs(gain)))


def run(
    world: World, scenario: Scenario, controller: Controller, off: Any = 0.0, **changes: Any
) -> Floats:
    true = dataclasses.replace(scenario, **changes)
    start = scenario.initial_position + off, scenario.initial_velocity
    return np.array(EVENT_DRIVEN.simulate(world, true, controller, start).positions[-1])


@pytest.mark.slow
def test_a_wheel_whose_motor_moves_it_through_friction_alone_is_brought_back() -> None:
    world = build(drives=True)
    scenario = pose([0.0, RADIUS, 0.0], [0.0] * 3, goal_weight=[100.0, 0.0, 0.0])
    times, torques = np.linspace(0.0, 1.0, 21), np.repeat([0.15, -0.15], 10)
    trajectory = make_plan(world, scenario, times, torques)
    feedback = Feedback(world, scenario, trajectory)
    planned, off = trajectory.positions[-1, 0], np.array([0.05, 0.0, 0.0])
    assert planned > 0.2
    missed = abs(run(world, scenario, feedback, off)[0] - planned)
    assert missed < 0.01 * off[0]
    # A motor that turns a wheel in the air moves it nowhere: so gains know of the floor.
    open_loop = HeldControl(times, torques[:, np.newaxis])
    assert abs(run(world, scenario, open_loop, off)[0] - planned) > 0.9 * off[0]


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.27, 0.33])
def test_a_block_that_lands_and_slides_gets_nearer_to_its_goal_than_in_open_loop(
    friction: float,
) -> None:
    world = build(turns=False)
    start = pose([0.0, 0.15], [1.0, 0.0], goal_weight=[100.0, 0.0], friction=0.3)
    times, pushes = np.linspace(0.0, 0.6, 13), np.repeat([6.0, 3.0], [6, 6])
    trajectory = make_plan(world, start, times, pushes)
    feedback = Feedback(world, start, trajectory)
    planned = trajectory.positions[-1, 0]
    open_loop = replay(world, dataclasses.replace(start, friction=friction), times, pushes)
    missed = abs(open_loop.positions[-1, 0] - planned)
    assert missed > 0.03
    assert abs(run(world, start, feedback, friction=friction)[0] - planned) < 0.2 * missed


def test_phases_end_as_walls_are_reached_and_slips_end_not_when_that_was_planned() -> None:
    world = build(turns=False)
    scenario = pose([0.0, 0.15], [1.0, 0.0])
    trajectory = make_plan(world, scenario, np.linspace(0.0, 0.8, 9), [0.0] * 8)
    feedback = Feedback(world, scenario, trajectory)
    land, stop = (stretch.last for stretch in Sweep(world, scenario, trajectory).stretches[:2])
    lands, stops = trajectory.times[[land, stop]]
    falls, slides = [0.1, 0.11, 1.0, -0.9], [0.2, RADIUS, 0.5, 0.0]
    slow, at_rest = [0.2, RADIUS, 0.1, 0.0], [0.2, RADIUS, 0.0, 0.0]
    soon = 0.02
    for time, state, phase in (
        (lands - soon, falls, 0),
        (lands + soon, falls, 0),
        (lands - soon, slides, 1),
        (stops + soon, slow, 1),
        (stops - soon, at_rest, 2),
        (stops + soon, at_rest, 2),
    ):
        assert feedback.find_phase(time, np.array(state), ()) == phase


@pytest.mark.slow
def test_a_plan_along_the_floor_is_tracked_where_masses_and_friction_are_others() -> None:
    options = PlanOptions(starts=3, renewals=0)
    found = plan(Scenario.named("sliding_block/to_rest"), options)
    controller = TrackingController(found)
    assert controller.feedback.feels_contact
    other = Disturbance(mass_factor=1.1, friction_factor=0.9)
    loop = run_in_loop(controller, found.scenario, found.find_world(), other)
    assert loop.replay.goal_error < 0.02


MODELS = Path(__file__).parents[1] / "models"


@pytest.mark.slow
def test_carts_are_pushed_apart_one_after_the_other() -> None:
    plan = Planner(Scenario.named("three_carts/apart"), PlanOptions(confirm=False)).plan()
    assert plan.holds
    assert plan.cost < 147.0
    assert sorted(contact.index for contact in plan.best.contacts) == [0, 1]
    for contact in plan.best.contacts:
        assert contact.last_time > contact.time + 0.05
    forces = plan.trajectory.forces
    assert forces is not None
    assert np.all(forces > -1e-6)
    assert np.max(forces) > 1.0


@pytest.mark.slow
def test_carts_in_a_row_press_both_contacts_at_once(tmp_path: Path) -> None:
    """The first one is driven: one cart at a time, plans cost 155."""
    model = (MODELS / "three_carts.sdf").read_text()
    driven, passive = "<effort>20</effort>", "<effort>0</effort>"
    (tmp_path / "row.sdf").write_text(model.replace(driven, passive).replace(passive, driven, 1))
    scenario = Scenario(
        model=str(tmp_path / "row.sdf"),
        initial_position=[-3.0, 0.0, 2.5],
        initial_velocity=[0.0, 0.0, 0.0],
        goal_position=[-1.0, 2.0, 4.5],
        duration=3.0,
        time_step=0.05,
        restitution=0.0,
        control_weight=0.1,
        velocity_weight=[0.1, 0.1, 0.1],
        goal_weight=[100.0, 100.0, 100.0],
        goal_velocity_weight=[10.0, 10.0, 10.0],
    )
    options = PlanOptions(renewals=0, starts=6, confirm=False)
    plan = Planner(scenario, options).plan()
    assert plan.holds
    assert plan.cost < 40.0
    forces = plan.trajectory.forces
    assert forces is not None
    assert np.any((forces > 0.1).all(axis=1))


def test_touches_that_last_are_held_until_they_end_or_another_one_begins() -> None:
    touches = (Touch(0.2, 0.5, 1), Touch.bounce(0.4, 0), Touch(0.6, 0.7, 1), Touch(0.8, 1.0, 0))
    times, phases = lay_out(touches, 20, 1.0, (1.0, 1.0), 2)
    np.testing.assert_array_equal(phases.contacts, [1, 0, 1, -1, 0])
    np.testing.assert_array_equal(phases.held[:, 0], [False] * 5 + [True])
    np.testing.assert_array_equal(phases.held[:, 1], [False, True, False, True, False, False])
    np.testing.assert_allclose(times[phases.knots], [0.2, 0.4, 0.6, 0.7, 0.8])
    assert times[-1] == pytest.approx(1.0)
    few, short = lay_out(touches, 3, 1.0, (1.0, 1.0), 2)
    assert len(short.contacts) == 2
    assert len(few) == 4


def test_touches_that_last_may_overlap_and_those_that_end_together_do_so_at_once() -> None:
    touches = (Touch(0.1, 0.8, 0), Touch(0.2, 0.4, 1), Touch(0.5, 0.805, 1))
    times, phases = lay_out(touches, 20, 1.0, (1.0, 1.0), 2)
    np.testing.assert_array_equal(phases.contacts, [0, 1, -1, 1, -1])
    np.testing.assert_array_equal(phases.held[:, 0], [False, True, True, True, True, False])
    np.testing.assert_array_equal(phases.held[:, 1], [False, False, True, False, True, False])
    np.testing.assert_allclose(times[phases.knots], [0.1, 0.2, 0.4, 0.5, 0.8])


BLOCK = Scenario.named("sliding_block/to_rest")
STEP = BLOCK.time_step
find_world = cache(lambda: World.from_scenario(BLOCK))


@cache
def find_plan() -> PlannedMotion:
    """Returns the cheapest push over a meter, which slides to rest."""
    problem = RigidMechanismTask(find_world(), BLOCK, PlanOptions())
    slides, lies = Touch(0.0, 1.0, 0, -1), Touch(1.0, 2.0, 0, 0)
    found = problem.polish(problem.bounce((slides, lies), problem.idle_motion))
    return PlannedMotion(make_trajectory(find_world(), found), found.cost, found.touches)


@cache
def find_horizon(is_receding: bool = False) -> Horizon:
    return make_horizon(Planner(BLOCK, PlanOptions(), find_world()), is_receding, 15, STEP)


def push(now: float, x: Floats, control: Floats, friction: float) -> Floats:
    """Returns the state a time step later, of a block with other friction."""
    true = dataclasses.replace(BLOCK, friction=friction)
    held, (q, v) = HeldControl(np.array([now, now + STEP]), control[np.newaxis]), np.split(x, 2)
    recording = EVENT_DRIVEN.simulate(find_world(), true, held, (q, v))
    return np.concatenate([recording.positions[-1], recording.velocities[-1]])


@pytest.mark.slow
def test_a_block_is_pushed_to_its_goal_on_a_floor_with_other_friction() -> None:
    horizon, motion, friction = find_horizon(), find_plan(), 0.33
    times, controls = motion.trajectory.times, motion.trajectory.controls
    true = dataclasses.replace(BLOCK, friction=friction)
    open_loop = replay_event_driven(find_world(), true, times, controls)
    x, now = np.concatenate([BLOCK.initial_position, BLOCK.initial_velocity]), 0.0
    while not horizon.is_over(now):
        assert not horizon.is_inside(x)
        found = horizon.advance(motion, now, x)
        assert found is not None
        motion = found
        x, now = push(now, x, motion.calc_control(now), friction), now + STEP
    assert np.linalg.norm(x - [1.0, 0.15, 0.0, 0.0]) < 0.05 * open_loop.goal_error
    assert [touch.mode for touch in motion.touches] == [0]


def test_what_slides_where_it_was_to_stick_does_so_first() -> None:
    horizon, x = find_horizon(), np.array([0.97, 0.15, 0.3, 0.0])
    found = horizon.advance(find_plan(), 1.6, x)
    assert found is not None
    first, second = found.touches
    # Slip is that of the floor against the block.
    assert (first.mode, second.mode) == (-1, 0)
    assert (first.start, first.end) == pytest.approx((1.6, second.start))


def test_what_lies_to_the_end_of_a_plan_lies_on_as_the_horizon_recedes() -> None:
    x = np.array([1.0, 0.15, 0.0, 0.0])
    found = find_horizon(is_receding=True).advance(find_plan(), 1.8, x)
    assert found is not None
    (touch,) = found.touches
    assert touch.end == pytest.approx(found.trajectory.times[-1])
    assert touch.end > 3.5
    assert found.trajectory.positions[-1] == pytest.approx([1.0, 0.15], abs=1e-6)


@pytest.mark.parametrize(
    ("height", "speed", "is_inside"),
    [(-1e-7, 0.0, False), (1e-7, -1e-4, False), (-1e-7, -0.5, True), (-0.01, 0.0, True)],
)
def test_what_lies_at_a_wall_is_not_inside_of_it(
    height: float, speed: float, is_inside: bool
) -> None:
    x = np.array([0.3, 0.15 + height, 0.5, speed])
    assert find_horizon().is_inside(x) == is_inside


@pytest.mark.slow
def test_a_block_is_planned_for_again_in_drake_where_masses_and_friction_are_others() -> None:
    options = PlanOptions(starts=3, renewals=0)
    planner = Planner(BLOCK, options)
    for other in (Disturbance(mass_factor=1.1, friction_factor=0.9), Disturbance(mass_factor=0.9)):
        controller = ModelPredictiveController(
            planner, STEP, "shrinking", iterations=15, surprise=np.inf
        )
        loop = run_in_loop(controller, BLOCK, planner.world, other)
        assert loop.replay.goal_error < 3e-3
        assert all(tick.reason == "warm" for tick in loop.ticks[1:])
