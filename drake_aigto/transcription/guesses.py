"""Where the local solver starts: a motion that flies from stop to stop of a contact sequence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Floats, interpolate
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription.timeline import Phase, Timeline
from drake_aigto.transcription.touch import Touch, joint_times
from drake_aigto.world import Scenario, World


def straight_path(
    world: World, scenario: Scenario, sequence: Sequence[Touch], through: ArrayLike | None = None
) -> tuple[Floats, Floats]:
    """Returns start, goal and the stops between, when and where: shapes (J+2,) [s], (J+2, nq) [m].

    There is a stop at each of a sequence's `joint_times`, on the straight way from start to goal
    unless it is given, (J, nq), and moved to the walls that are touched then.
    """
    times = np.array([0.0, *joint_times(sequence), scenario.duration])
    ends = scenario.initial_position, scenario.goal_position
    stops = ends[0] + np.outer(times / times[-1], ends[1] - ends[0])
    if through is not None:
        stops[1:-1] = np.reshape(through, (len(times) - 2, world.num_positions))
    for stop, time in zip(stops[1:-1], times[1:-1], strict=True):
        touched = [touch.contact for touch in sequence if touch.start <= time <= touch.end]
        stop[:] = world.move_onto(stop, touched)
    return times, stops


def make_guess(
    world: World, scenario: Scenario, timeline: Timeline, times: Floats, stops: Floats
) -> Trajectory:
    """Returns a motion at all knots; contacts that last go straight, pressed by what pulls.

    Flights are without control, bent as gravity bends them. After a rest, which leaves no speed to
    fly with, they are pushed by as much as it takes, and less and less:

        q(t) = q₀ + t w + t²/2 a + t²/2 (1 − t/(3τ)) p,    u(t) = G⁺ p (1 − t/τ),    G = M⁻¹ B

    with the speed w along the wall, the acceleration a without control, and p such that q(τ) is the
    next stop.

    Args:
        world: the plant, read.
        scenario: the task.
        timeline: of the sequence.
        times: of the stops, shape (J+2,) [s].
        stops: shape (J+2, nq) [m].
    """
    N, line, inertia = scenario.num_steps, timeline, world.constant_inertia
    knots = [0, *(phase.last for phase in line.phases)]
    t = np.interp(range(N + 1), knots, line.times)
    q = interpolate(t, times, stops)
    v = np.vstack([scenario.initial_velocity, np.diff(q, axis=0) / np.diff(t)[:, np.newaxis]])
    u, forces = np.zeros((N, world.num_actuators)), np.zeros((N, world.num_contacts))
    still, idle = np.zeros(world.num_velocities), np.zeros(world.num_actuators)
    rested: tuple[int, ...] = ()
    for phase in line.phases:
        middle = (q[phase.first] + q[phase.last]) / 2
        pull = world.calc_acceleration(middle, still, idle)
        if rested and not phase.rests:
            _jump(phase, pull, (t, q, v, u), inertia.inverse_mass @ world.actuation)
        elif not phase.rests:
            inside = slice(phase.first, phase.last + 1)
            since, left = t[inside] - t[phase.first], t[phase.last] - t[inside]
            q[inside] -= np.outer(since * left / 2, pull)
            v[inside][1:] += np.outer((since - left)[1:] / 2, pull)
        rested = phase.rests
        weights = np.maximum(-inertia.masses * (inertia.jacobian @ pull), 0.0)
        forces[phase.first : phase.last, rested] = weights[[*rested]]
    return Trajectory(t, q, v, u, np.zeros(line.held.shape), forces)


def _jump(
    phase: Phase, pull: Floats, motion: tuple[Floats, Floats, Floats, Floats], gain: Floats
) -> None:
    """Writes a flight that begins with no more speed than the phase before ends with.

    Args:
        phase: the flight.
        pull: a, shape (nv,) [m/s²].
        motion: t, q, v and u at all knots.
        gain: G, shape (nv, nu) [1/kg].
    """
    t, q, v, u = motion
    first, inside = phase.first, slice(phase.first, phase.last + 1)
    s, w = (t[inside] - t[first])[:, np.newaxis], v[first]
    whole = s[-1]
    push = 3 / whole**2 * (q[phase.last] - q[first] - whole * w - whole**2 / 2 * pull)
    q[inside] = q[first] + s * w + s**2 / 2 * (pull + (1 - s / (3 * whole)) * push)
    v[inside] = w + s * (pull + (1 - s / (2 * whole)) * push)
    middles = (s[1:] + s[:-1]) / 2
    u[first : phase.last] = (1 - middles / whole) * (np.linalg.pinv(gain) @ push)


def bend(path: tuple[Floats, Floats], times: Floats, stops: Floats) -> tuple[Floats, Floats]:
    """Returns a path moved to where it has to be at some times, and between them in proportion.

    Args:
        path: times and positions.
        times: from the path's first to its last, shape (K,) [s].
        stops: shape (K, nq) [m].
    """
    grid = np.unique([*path[0], *times])
    at = interpolate(grid, *path)
    return grid, at + interpolate(grid, times, stops - interpolate(times, grid, at))
