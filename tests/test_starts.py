"""Where AIGO starts: boxes around the straight line, and around the coasting motion."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from drake_aigto import PlanOptions, Scenario, World
from drake_aigto.errors import OptionsError
from drake_aigto.planning import BALL_LADDER, BallTask, Rung, make_ball_task, read_sequences
from drake_aigto.simulation import replay_event_driven

COASTING = [rung for rung in BALL_LADDER if rung.start == "coast"]


def problem_of(name: str) -> BallTask:
    scenario = Scenario.named(name)
    problem = make_ball_task(World.from_scenario(scenario), scenario, PlanOptions())
    return problem


def test_an_unknown_start_is_refused() -> None:
    with pytest.raises(OptionsError, match=r"start: got 'corner', expected one of .*line.*coast"):
        Rung(1.0, {}, start="corner")  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["corridor/three_bounces", "floor/rebound", "room/two_walls"])
def test_the_coasting_box_is_around_the_simulated_motion(name: str) -> None:
    problem = problem_of(name)
    start = problem.start("coast")
    assert start.transcription is problem.transcription
    q, v, u = start.transcription.split(start.box.center)
    widths = start.transcription.split(start.box.half_width)
    times = start.transcription.GetSampleTimes()
    world, scenario = start.transcription.world, start.transcription.scenario
    coast = replay_event_driven(world, scenario, times, u)
    np.testing.assert_array_equal(u, 0.0)
    for k, t in enumerate(times):
        near = np.flatnonzero(np.abs(coast.times - t) < 1e-9)[0]
        # At a wall the box is cut to what is in front of it, and still holds the motion.
        assert np.all(np.abs(q[k] - coast.positions[near]) <= widths[0][k] + 1e-9)
        np.testing.assert_allclose(v[k], coast.velocities[near], atol=1e-9)
    # The start is known; what follows is less and less.
    np.testing.assert_array_equal(widths[0][0], 0.0)
    assert np.all(np.diff(widths[1], axis=0) >= -1e-12)
    assert 0 < widths[0][-1, 0] < problem.transcription.split(problem.box.half_width)[0][-1, 0]


def test_around_a_block_other_faces_are_in_force_where_the_coast_goes() -> None:
    problem = problem_of("room_with_block/off_the_block")
    line, coast = problem.start("line"), problem.start("coast")
    assert coast.transcription is not line.transcription
    assert coast.transcription.prog().num_vars() == line.transcription.prog().num_vars()
    # Outside at every knot, by the faces that are in force there.
    costs = coast.polynomial.with_weights(
        {name: float(name == "nonpenetration") for name in coast.polynomial.weights}
    )
    still = np.zeros_like(coast.box.center)
    assert costs.mean(coast.box.center, still) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("restitution", [1.0, 0.8])
@pytest.mark.parametrize("velocity", [3.1, -2.2, 0.7])
def test_cool_boxes_around_the_coast_keep_its_bounces(velocity: float, restitution: float) -> None:
    scenario = dataclasses.replace(
        Scenario.named("corridor/three_bounces"),
        initial_position=0.4,
        initial_velocity=velocity,
        duration=1.5,
        restitution=restitution,
    )
    world = World.from_scenario(scenario)
    times = np.linspace(0.0, scenario.duration, 301)
    coast = replay_event_driven(world, scenario, times, np.zeros((300, 1)))
    # What costs nothing is the best plan.
    scenario = dataclasses.replace(scenario, goal_position=coast.positions[-1])
    problem = make_ball_task(world, scenario, PlanOptions())
    rung = COASTING[0]
    sequences = problem.find_sequences(problem.run_aigo(rung), rung)
    assert list(coast.bounce_contacts) in [[t.contact for t in s] for s in sequences]


def test_impulses_of_each_wall_are_clusters_of_their_own() -> None:
    problem = problem_of("room/two_walls")
    transcription = problem.transcription
    q, v, u = transcription.split(problem.start("coast").box.center)
    q[:], v[:], u[:] = 0.5, 1.0, 0.0
    dt = transcription.time_step()
    # The walls give back at knots 10, 11 and 30 in x, and at 12 in y, what the control takes.
    for k, axis, size in ((10, 0, 1.0), (11, 0, 3.0), (12, 1, 1.0), (30, 0, -1.0)):
        u[k, axis] = -size / dt
    read = read_sequences(transcription, transcription.vector_of(q, v, u))[0]
    jacobians = transcription.world.calc_contact_jacobian(np.full(2, 0.5))
    normals = [tuple(jacobians[touch.contact].round(6).tolist()) for touch in read]
    assert normals == [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)]
    assert [touch.start for touch in read] == pytest.approx([10.75 * dt, 12 * dt, 30 * dt])


def test_bounces_of_two_walls_at_one_knot_come_one_after_the_other() -> None:
    transcription = problem_of("room/two_walls").transcription
    N, dt = transcription.scenario.num_steps, transcription.time_step()
    q, v, u = np.full((N + 1, 2), 0.5), np.ones((N + 1, 2)), np.zeros((N, 2))
    u[20] = -2.0 / dt
    (first, second) = read_sequences(transcription, transcription.vector_of(q, v, u))[0]
    assert first.start == pytest.approx(20 * dt)
    assert 0 < second.start - first.start < dt / 10
    assert first.contact != second.contact
