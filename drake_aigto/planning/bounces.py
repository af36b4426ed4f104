"""The trajectory of a held control between rigid walls, whose knots are where it bounces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.simulation.recording import find_impacts
from drake_aigto.simulation.replay import Replay, replay_event_driven
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scenario, World

# A bounce this near to a knot is at it, as a part of the duration; less than replays resolve.
_AT_KNOT = 1e-11
# A knot is moved to a bounce that is off by at most this part of the shorter step beside it; else
# one is added there.
_NEAR = 0.1
# Moving knots moves bounces, the square of that. So often at most.
_MOST_MOVES = 12


def replay_at_knots(
    world: World, scenario: Scenario, times: Floats, controls: Floats
) -> tuple[Floats, Floats, Replay]:
    """Returns times, controls and their replay, whose bounces are at knots.

    Knots that are nearly there are moved, and others added; a control changes by next to nothing.
    """
    replay = replay_event_driven(world, scenario, times, controls)
    for _ in range(_MOST_MOVES):
        moved = times, controls
        for bounce in replay.bounce_times:
            moved = _put_knot(*moved, bounce)
        if moved[0] is times:
            break
        times, controls = moved
        replay = replay_event_driven(world, scenario, times, controls)
    return times, controls, replay


def _put_knot(times: Floats, controls: Floats, bounce: float) -> tuple[Floats, Floats]:
    """Returns knots of which one is at a bounce; the same array if one was."""
    at = int(np.clip(np.searchsorted(times, bounce), 1, len(times) - 1))
    nearest = at if times[at] - bounce < bounce - times[at - 1] else at - 1
    off = abs(times[nearest] - bounce)
    if off <= _AT_KNOT * times[-1]:
        return times, controls
    is_inside = 0 < nearest < len(times) - 1
    if is_inside and off < _NEAR * min(np.diff(times)[nearest - 1 : nearest + 1]):
        times = times.copy()
        times[nearest] = bounce
        return times, controls
    return np.insert(times, at, bounce), np.insert(controls, at, controls[at - 1], axis=0)


def add_impulses(
    world: World, scenario: Scenario, replay: Replay, trajectory: Trajectory
) -> tuple[Trajectory, float]:
    """Returns a trajectory with a replay's impacts, which are at its knots.

    Also returns by how much the velocity after an impact is off at most [m/s]: it has to be what an
    impulse along the contact makes of that before, and the contact's speed be returned e times, or
    nothing of it where rest begins.
    """
    contacts = np.array(replay.bounce_contacts, dtype=np.int64)
    rows = find_impacts(replay.times, replay.velocities, len(contacts))
    impulses = trajectory.impulses.copy()
    if not len(rows):
        return trajectory, 0.0
    q, before, after = replay.positions[rows], replay.velocities[rows], replay.velocities[rows + 1]
    each = np.arange(len(rows))
    J = world.calc_contact_jacobian(q)[each, contacts]
    kicks = np.linalg.solve(world.calc_mass_matrix(q), J[..., np.newaxis])[..., 0]
    came, went = (np.einsum("bi,bi->b", J, v) for v in (before, after))
    pushes = (went - came) / np.einsum("bi,bi->b", J, kicks)
    misses = np.max(np.abs(after - before - kicks * pushes[:, np.newaxis]), axis=1)
    e = world.restitutions(scenario)[contacts]
    rebounds = np.minimum(np.abs(went + e * came), np.abs(went))
    knots = np.abs(trajectory.times[:, np.newaxis] - replay.times[rows]).argmin(axis=0)
    np.add.at(impulses, (knots, contacts), pushes)
    return replace(trajectory, impulses=impulses), float(max(misses.max(), rebounds.max()))
