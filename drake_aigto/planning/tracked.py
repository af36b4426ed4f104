"""Replays of unstable motions, which their own feedback judges, beside the control alone."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.errors import ProgramError, TrajectoryError
from drake_aigto.planning.feedback import Feedback
from drake_aigto.simulation import (
    DRAKE,
    EVENT_DRIVEN,
    Growth,
    Replay,
    replay_drake,
    replay_event_driven,
    replay_with,
    summarize,
)
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scenario, World

# Starts are off by this part of the scales.
_OFF = 1e-3


def make_feedback(
    world: World, scenario: Scenario, trajectory: Trajectory, **known: Any
) -> Feedback | None:
    """Returns the feedback about a motion, None if none is known for its contacts.

    Arguments are those of `Feedback`.
    """
    try:
        return Feedback(world, scenario, trajectory, **known)
    except (TrajectoryError, ProgramError):
        return None


def follow(world: World, scenario: Scenario, feedback: Feedback) -> tuple[Replay, Floats, Floats]:
    """Returns the replay of feedback from a scenario's start, times (K + 1,) and controls (K, nu).

    Raises:
        TrajectoryError: it runs away.
    """
    recording = EVENT_DRIVEN.simulate(world, scenario, feedback)
    times, controls = np.append(recording.control_times, feedback.end), np.array(recording.controls)
    lasts = np.diff(times) > 0
    replay = summarize(world, scenario, recording, feedback.end)
    return replay, np.append(times[:-1][lasts], times[-1]), controls[lasts]


def perturb(
    world: World, scenario: Scenario, feedback: Feedback, growth: Growth
) -> tuple[Replay, ...]:
    """Returns replays from starts that are off by 1e-3 of the scales, where errors grow most.

    They are on both sides, within bounds of positions and velocities, but for those in a rigid
    wall. To first order the start itself changes cost and end, even under the best control, by half
    of what both differ in: that judges nothing.

    Raises:
        TrajectoryError: one runs away.
    """
    found, bounds = [], world.bounds(scenario)
    for sign in (1.0, -1.0):
        moved, change = np.split(sign * _OFF * growth.worst, 2)
        q = np.clip(world.add(scenario.initial_position, moved), *bounds.position)
        v = np.clip(scenario.initial_velocity + change, *bounds.velocity)
        if scenario.contact == "rigid" and np.any(world.calc_clearance(q) < 0):
            continue
        off = dataclasses.replace(scenario, initial_position=q, initial_velocity=v)
        found.append(replay_with(EVENT_DRIVEN, world, off, feedback))
    if len(found) < 2:
        return tuple(found)
    one, other = found
    cost, error = (one.cost - other.cost) / 2, (one.goal_error - other.goal_error) / 2
    one = dataclasses.replace(one, offset_cost=cost, offset_error=error)
    return one, dataclasses.replace(other, offset_cost=-cost, offset_error=-error)


def replay_alone(world: World, scenario: Scenario, trajectory: Trajectory) -> Replay | None:
    """Returns the replay of a motion's control alone, None if it runs away."""
    try:
        return replay_event_driven(world, scenario, trajectory.times, trajectory.controls)
    except TrajectoryError:
        return None


def replay_own(
    world: World, scenario: Scenario, trajectory: Trajectory, feedback: Feedback | None
) -> list[Replay]:
    """Returns our replays: with feedback, if there is any, and of the control alone."""
    t = trajectory
    if feedback is None:
        return [replay_event_driven(world, scenario, t.times, t.controls)]
    alone = replay_alone(world, scenario, t)
    return [follow(world, scenario, feedback)[0], *filter(None, [alone])]


def confirm_in_drake(
    world: World, scenario: Scenario, trajectory: Trajectory, feedback: Feedback | None
) -> list[Replay]:
    """Returns Drake's replays: with feedback, if there is any, and of the control alone."""
    alone = replay_drake(world, scenario, trajectory.times, trajectory.controls)
    return [alone] if feedback is None else [replay_with(DRAKE, world, scenario, feedback), alone]
