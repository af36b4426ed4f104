"""Motions are drawn as they are: rows are kept, gaps filled on the curve, impacts are jumps."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drake_aigto import Scenario, World
from drake_aigto.planning.replay import Replay, replay_drake, replay_event_driven
from drake_aigto.show.motion import PALETTE, PLAN_LABEL, Motion, color_of, motions_of_plan
from drake_aigto.trajectory import Trajectory

SIMULATE = (replay_event_driven, replay_drake)

# At −2 m/s from 1 m, without control, the ball is at the wall at 0.5 s.
BOUNCE = Trajectory(
    times=np.array([0.0, 0.5, 1.0]),
    positions=np.array([[1.0], [0.0], [1.0]]),
    velocities=np.array([[-2.0], [-2.0], [2.0]]),
    controls=np.zeros((2, 1)),
    impulses=np.array([[0.0], [4.0], [0.0]]),
    forces=np.zeros((2, 1)),
)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return Scenario(initial_position=1.0, initial_velocity=-2.0, goal_position=1.0)


@pytest.fixture(scope="module")
def world(scenario: Scenario) -> World:
    return World.from_scenario(scenario)


def replay_of(times: Any, positions: Any, velocities: Any) -> Replay:
    """Returns a replay with these rows, and nothing else of interest."""
    nothing: dict[str, Any] = {
        **dict.fromkeys(("cost", "goal_error", "max_penetration"), 0.0),
        **dict.fromkeys(("bounce_times", "energies_before", "energies_after"), ()),
        "matched_speed": None,
    }
    rows = {"times": times, "positions": positions, "velocities": velocities}
    return Replay(simulator="event-driven", **rows, **nothing)


coefficients = st.lists(st.floats(-3, 3), min_size=4, max_size=4)
knots = st.lists(st.floats(1e-4, 0.3), min_size=1, max_size=4)


@given(coefficients, knots)
def test_gaps_are_filled_on_the_cubic_of_both_ends(cubic: list[float], steps: list[float]) -> None:
    times = np.cumsum([0.0, *steps])
    position = np.polynomial.Polynomial(cubic)
    velocity = position.deriv()
    replay = replay_of(times, position(times)[:, None], velocity(times)[:, None])
    motion = Motion.from_replay(replay)
    assert np.max(np.diff(motion.times)) < 0.0101
    assert set(times) <= set(motion.times)
    # A rise over the shortest step loses four digits of sixteen.
    np.testing.assert_allclose(motion.positions[:, 0], position(motion.times), atol=1e-12)
    np.testing.assert_allclose(motion.velocities[:, 0], velocity(motion.times), atol=1e-10)


def test_a_planned_impact_is_a_jump_of_velocity_at_one_time(world: World) -> None:
    motion = Motion.from_trajectory(BOUNCE, world)
    np.testing.assert_allclose(motion.positions[:, 0], np.abs(1 - 2 * motion.times), atol=1e-12)
    at_wall = motion.times == 0.5
    assert sorted(set(motion.velocities[at_wall, 0])) == [-2.0, 2.0]
    np.testing.assert_allclose(motion.velocities[motion.times > 0.5], 2.0)
    assert motion.label == PLAN_LABEL == "plan (not a simulation)"


def test_a_heavier_mass_jumps_less(scenario: Scenario) -> None:
    heavy = World.from_diagram(World.from_scenario(scenario).diagram, mass=4.0)
    motion = Motion.from_trajectory(BOUNCE, heavy)
    jumps = motion.velocities[motion.times == 0.5, 0]
    assert np.ptp(jumps) == pytest.approx(4.0 / 4.0)


def test_a_plan_is_shown_with_its_simulations_each_labelled(
    world: World, scenario: Scenario
) -> None:
    control = BOUNCE.times, BOUNCE.controls
    replays = [simulate(world, scenario, *control) for simulate in SIMULATE]
    plan: Any = SimpleNamespace(trajectory=BOUNCE, replay=replays)
    motions = motions_of_plan(plan, world)
    assert [motion.label for motion in motions] == [
        "plan (not a simulation)",
        "simulation: exactly rigid wall",
        "simulation: Drake, compliant wall",
    ]
    for motion in motions:
        q = np.interp([0.25, 0.75], motion.times, motion.positions[:, 0])
        # Drake's wall turns the ball round 0.1 ms late.
        np.testing.assert_allclose(q, 0.5, atol=3e-4)
    assert [motion.controls is None for motion in motions] == [False, True, True]


def test_arrays_are_locked(world: World) -> None:
    motion = Motion.from_trajectory(BOUNCE, world)
    with pytest.raises(ValueError, match="read-only"):
        motion.positions[0, 0] = 3.0


def test_colors_differ_and_repeat_in_the_same_order() -> None:
    assert len(set(PALETTE)) == len(PALETTE) >= 6
    assert [color_of(i) for i in range(2 * len(PALETTE))] == [*PALETTE, *PALETTE]
