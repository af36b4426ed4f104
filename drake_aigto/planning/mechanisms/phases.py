"""Motions between rigid walls: their touches, the modes of these, and their knots in phases."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.contact import RigidLaw
from drake_aigto.shooting import Phases, ShootingResult
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch, TouchSequence
from drake_aigto.world import World

# No phase starts out shorter than this part of the duration.
_SHORTEST = 1e-2
# Knots closer than this part of the duration count as the same.
SAME = 1e-6
# Slip below this part of the fastest slip counts as stick: on springs sticking contacts creep.
CREEP = 0.05
# A stretch shorter than this part of a sustained touch is joined to the one before.
_SHORT = 0.1
# Distances and speeds below this part of the largest coordinate, or 1, count as zero.
_STILL = 1e-9


def lay_out(
    touches: TouchSequence,
    num_steps: int,
    duration: float,
    total: tuple[float, float],
    num_contacts: int,
) -> tuple[Floats, Phases]:
    """Returns N + 1 knots, with one at each touch and release, and the phases between.

    The motion lasts for the duration [s], and its phases for a total within limits [s]. A contact,
    of m, is released at the next bounce at the latest; sustained touches may overlap. If there are
    not enough steps, the last touches are left out.
    """
    first, *joints = list(_find_joints(touches, duration))[:num_steps]
    ends = np.clip([joint.time for joint in joints], 0.0, duration)
    durations = np.maximum(np.diff(ends, prepend=0.0, append=duration), _SHORTEST * duration)
    durations *= duration / durations.sum()
    knots = np.rint(np.cumsum(durations[:-1]) / duration * num_steps).astype(np.int64)
    places = np.arange(len(knots))
    knots = np.maximum.accumulate(np.maximum(knots, places + 1) - places) + places
    knots = np.minimum(knots, num_steps - len(knots) + places)
    elapsed = np.concatenate([[0.0], np.cumsum(durations)])
    elapsed[-1] = duration
    times = np.interp(np.arange(num_steps + 1), [0, *knots, num_steps], elapsed)
    contacts = np.array([joint.contact for joint in joints], dtype=np.int64)
    closed = _find_closed([first, *joints], num_contacts)
    return times, Phases(contacts, knots, durations, total, *closed)


class _Joint(NamedTuple):
    """The start of a phase."""

    time: float  # [s]
    contact: int  # that is hit then, or −1
    held: list[int]  # contacts held from then on
    modes: dict[int, int]  # of these, and of the contact that is hit


def _find_closed(joints: Sequence[_Joint], num_contacts: int) -> tuple[Bools, Ints]:
    """Returns which contacts are held in each of the phases that start at joints, and the modes.

    Both have the shape (P, m).
    """
    held = np.zeros((len(joints), num_contacts), dtype=np.bool_)
    modes = np.zeros(held.shape, dtype=np.int64)
    for phase, joint in enumerate(joints):
        held[phase, joint.held] = True
        modes[phase, list(joint.modes)] = list(joint.modes.values())
    return held, modes


def lay_onto(touches: TouchSequence, times: Floats, num_contacts: int) -> tuple[Floats, Phases]:
    """Returns knots, those given and one at each touch and release, and the phases between.

    Given ones are from 0 on [s]; those that nearly are at a touch, of m contacts, are left out.
    """
    duration = float(times[-1])
    first, *joints = _find_joints(touches, duration)
    ends = np.array([joint.time for joint in joints])
    off = np.abs(times[1:-1, np.newaxis] - ends).min(axis=1, initial=np.inf)
    inside = times[1:-1][off > SAME * duration]
    knots = np.sort(np.concatenate([[0.0], inside, ends, [duration]]))
    held, modes = _find_closed([first, *joints], num_contacts)
    phases = Phases(
        contacts=np.array([joint.contact for joint in joints], dtype=np.int64),
        knots=np.searchsorted(knots, ends),
        durations=np.diff(ends, prepend=0.0, append=duration),
        total=(duration, duration),
        held=held,
        modes=modes,
    )
    return knots, phases


def _find_joints(touches: TouchSequence, duration: float) -> Iterator[_Joint]:
    """Yields the starts of phases."""
    begun = {(touch.contact, touch.start) for touch in touches if touch.lasts}
    ended = {(touch.contact, touch.end) for touch in touches if touch.lasts}

    def find_end(touch: Touch) -> float:
        """Returns when a sustained touch ends [s]; infinite if it continues in another mode."""
        return np.inf if (touch.contact, touch.end) in begun else touch.end

    def is_new(touch: Touch) -> bool:
        return not (touch.lasts and (touch.contact, touch.start) in ended)

    of_start = [touch for touch in touches if touch.lasts and touch.start <= 0]
    ends = {touch.contact: find_end(touch) for touch in of_start}
    modes = {touch.contact: touch.mode for touch in of_start}
    yield _Joint(0.0, -1, list(ends), dict(modes))
    later = [touch for touch in touches if touch not in of_start]
    later.sort(key=lambda touch: (touch.start, is_new(touch)))
    for touch, until in zip([None, *later], [*(t.start for t in later), duration], strict=True):
        if touch is not None:
            goes_on = ends.get(touch.contact) == np.inf and touch.lasts
            ends = {**ends, touch.contact: find_end(touch)} if touch.lasts else {}
            modes = {**{i: modes[i] for i in ends if i in modes}, touch.contact: touch.mode}
            if not (goes_on and touch.start == until):  # That is part of the impact then.
                yield _Joint(touch.start, -1 if goes_on else touch.contact, list(ends), modes)
        while ends and (end := min(ends.values())) < until:
            # Releases at about the same time are one.
            ends = {i: each for i, each in ends.items() if each > end + _SHORTEST * duration}
            modes = {i: modes[i] for i in ends}
            yield _Joint(end, -1, list(ends), modes)
        ends = {i: end for i, end in ends.items() if end > until}


def find_slopes(world: World, motion: ShootingResult) -> tuple[Floats, Floats]:
    """Returns the velocities at the start and the end of each step, shape (N, n) each.

    Before a bounce, that is the slope of a parabola.
    """
    n, h = world.num_positions, np.diff(motion.times)[:, np.newaxis]
    q, v = motion.states[:, :n], motion.states[:, n:]
    end = v[1:].copy()
    bounces = motion.hits - 1
    end[bounces] = 2 * (np.diff(q, axis=0) / h)[bounces] - v[:-1][bounces]
    return v[:-1], end


def make_trajectory(world: World, motion: ShootingResult) -> Trajectory:
    """Returns a motion with velocities before impacts, and their impulses.

    The velocity before an impact is the slope of a parabola, corrected along the impulse.
    """
    n, m, contacts = world.num_positions, world.num_contacts, motion.phases.contacts
    q, v = np.split(motion.states, [n], axis=1)
    v, impulses = v.copy(), np.zeros((len(q), m))
    _, slopes = find_slopes(world, motion)
    for knot, i in zip(motion.hits, contacts[contacts >= 0], strict=True):
        kick = world.calc_velocity_change(q[knot], np.eye(m)[i])
        J = world.calc_contact_jacobian(q[knot])[i]
        impulses[knot, i] = J @ (v[knot] - slopes[knot - 1]) / (J @ kick)
        v[knot] -= impulses[knot, i] * kick
    forces = np.zeros((len(motion.controls), m))
    return Trajectory(motion.times, q, v, motion.controls, impulses, forces)


def is_closed(world: World, q: Floats, v: Floats, still: float = _STILL) -> Bools:
    """Returns which contacts touch and are neither approached nor left, shape (…, m).

    Distances and speeds below this part of the largest coordinate of a state, or 1, count as zero.
    """
    sizes = (np.abs(each).max(axis=-1, keepdims=True) for each in (q, v))
    still = still * (1 + np.maximum(*sizes))
    distances, rates = world.calc_signed_distance(q), world.calc_contact_rate(q, v)
    return np.asarray((np.abs(distances) <= still) & (np.abs(rates) <= still))


def read_hold(
    world: World,
    law: RigidLaw,
    motion: ShootingResult,
    contact: int,
    ends: tuple[float, float],
    knots: Ints,
) -> Iterator[Touch]:
    """Yields the touches of a sustained contact, one for each mode of a motion.

    Args:
        world: the mechanism.
        law: of the walls.
        motion: between rigid or compliant walls.
        contact: its index.
        ends: from when to when [s].
        knots: those between.
    """
    if not law.friction[contact]:
        yield Touch(*ends, contact)
        return
    n, (start, end) = world.num_positions, ends
    q, v = np.split(motion.states, [n], axis=1)
    slips = world.rubbing.calc_slips(q, v)[:, contact]
    modes = np.where(np.abs(slips) <= CREEP * np.max(np.abs(slips)), 0, np.sign(slips))[knots]
    yield from split_hold(Touch(start, end, contact), motion.times[knots], modes.astype(np.int64))


def split_hold(touch: Touch, times: Floats, modes: Ints) -> list[Touch]:
    """Returns a sustained touch as one per mode; short ones are joined to the one before.

    Args:
        touch: in any mode.
        times: of knots in it, shape (K,) [s].
        modes: from these on, shape (K,).
    """
    begins = np.flatnonzero(np.diff(modes, prepend=np.iinfo(np.int64).max))
    ends = np.append(times[begins], touch.end)
    ends[0] = touch.start
    found: list[Touch] = []
    for first, begin, until in zip(begins, ends, ends[1:], strict=False):
        mode, is_short = int(modes[first]), until - begin < _SHORT * (touch.end - touch.start)
        if found and (is_short or found[-1].mode == mode):
            found[-1] = replace(found[-1], end=float(until))
        else:
            found.append(Touch(float(begin), float(until), touch.contact, mode))
    return found


def in_order(touches: Sequence[Touch]) -> TouchSequence:
    """Returns touches by their starts; those of one contact that adjoin in one mode are joined."""
    found: list[Touch] = []
    for touch in sorted(touches, key=lambda each: each.start):
        known = (i for i, each in enumerate(found) if each.contact == touch.contact)
        last = max(known, default=None)
        if last is not None and touch.lasts and found[last].lasts:
            before = found[last]
            if before.end == touch.start and before.mode == touch.mode:
                found[last] = replace(before, end=touch.end)
                continue
        found.append(touch)
    return tuple(found)
