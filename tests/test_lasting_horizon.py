"""Planning again from where something lies at a rigid wall: modes are kept, and what is seen."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest

from drake_aigto import ModelPredictiveController, Planner, PlanOptions, Scenario, World
from drake_aigto.arrays import Floats
from drake_aigto.control import Disturbance, Horizon, PlannedMotion, make_horizon, run_in_loop
from drake_aigto.planning import RigidMechanismTask, make_trajectory
from drake_aigto.simulation import EVENT_DRIVEN, HeldControl, replay_event_driven
from drake_aigto.transcription import Touch

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
    """Returns the state a time step later, of a block that rubs otherwise."""
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
