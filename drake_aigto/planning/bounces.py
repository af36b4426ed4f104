"""The trajectory of a held control between rigid walls, whose knots are where it bounces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy  # Not scipy.optimize, which takes a tenth of a second and few need.

from drake_aigto.arrays import Floats, Ints
from drake_aigto.simulation import PlannedContact, Replay, find_impacts, replay_event_driven
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
    impulse ≥ 0 along the contact, and one of at most μ times it along its tangent, make of that
    before, and the contact's speed be returned e times, or nothing of it where rest begins. Several
    contacts at one instant hit each other in turns: there impulses are the sums of all turns, and
    no contact is approached after the last.
    """
    impulses, missed = trajectory.impulses.copy(), 0.0
    for time, contacts, q, before, after in _list_events(replay):
        each = np.unique(contacts)
        J, e = world.calc_contact_jacobian(q)[each], world.restitutions(scenario)[each]
        friction, T = world.friction_coefficients(scenario)[each], J[:0]
        if friction.any():
            T = friction[:, np.newaxis] * world.rubbing.calc_tangent_jacobian(q)[each]
        # Along a cone's edges: impulses within it are sums of both.
        rows = np.vstack([J + T, J - T]) if len(T) else J
        kicks = np.linalg.solve(world.calc_mass_matrix(q), rows.T)
        pushes, off = scipy.optimize.nnls(kicks, after - before)
        pushes = pushes.reshape(-1, len(each)).sum(axis=0)
        knot = np.abs(trajectory.times - time).argmin()
        impulses[knot, each] += pushes
        came, went = J @ before, J @ after
        rebound = np.abs(went + e * came) if len(each) == 1 else np.maximum(-went, 0.0)
        missed = max(missed, off, float(np.max(np.minimum(rebound, np.abs(went)))))
    return replace(trajectory, impulses=impulses), missed


def with_losses(contacts: tuple[PlannedContact, ...], replay: Replay) -> tuple[PlannedContact, ...]:
    """Returns contacts with the energy ratios of a replay's impacts, which are at their knots.

    A trajectory holds no impulses of friction, which take or give kinetic energy, too. What lasts
    from the start on has no impact.
    """
    seen = list(zip(replay.bounce_times, replay.bounce_contacts, strict=True))
    found = []
    for contact in contacts:
        away = [
            abs(time - contact.time) if index == contact.index else np.inf for time, index in seen
        ]
        nearest = int(np.argmin(away)) if away else 0
        is_hit = bool(away) and away[nearest] <= _AT_KNOT * replay.times[-1]
        ratio = replay.energy_ratios[nearest] if is_hit else contact.energy_ratio
        found.append(replace(contact, energy_ratio=ratio))
    return tuple(found)


def _list_events(replay: Replay) -> Iterator[tuple[float, Ints, Floats, Floats, Floats]]:
    """Yields when impacts are, of which contacts, q then, and v before and after them all."""
    contacts = np.array(replay.bounce_contacts, dtype=np.int64)
    rows = find_impacts(replay.times, replay.velocities, len(contacts))
    for time in np.unique(replay.times[rows]):
        at_once = replay.times[rows] == time
        first, last = rows[at_once][0], rows[at_once][-1] + 1
        if len(np.unique(contacts[at_once])) > 1:  # Touches too slow for impacts are among them.
            last = np.searchsorted(replay.times, time, side="right") - 1
        v = replay.velocities
        yield time, contacts[at_once], replay.positions[first], v[first], v[last]
