"""Neighbors of contact sequences: one more bounce, a rest, a touch moved past an instant."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.planning.balls.phases import PhaseMotion
from drake_aigto.transcription import Touch, TouchSequence
from drake_aigto.world import World

# A wall is grazed within this part of the length scale.
_GRAZE = 1e-5
# Distance of a new touch to those before and after it, as a part of the time between them.
_ROOM = 0.2
# The same of a touch that comes soon before the next.
_LATE = 0.05
# Shortest time between touches with room for another, as a part of the duration.
_LEAST_GAP = 1e-3
# Contacts are coupled if J M⁻¹ Jᵀ is more than this.
_FELT = 1e-9


def find_insertions(motion: PhaseMotion) -> list[Touch]:
    """Returns one more bounce for each wall and each gap between touches coupled to it.

    Contacts are not coupled if no impulse of one changes the other's speed, J_i M⁻¹ J_jᵀ = 0; their
    order makes no difference. The wall of the last or next touch is left out, unless something
    pulls towards it. Each bounce is where the motion comes nearest to the wall; with such a pull
    there is another one soon before the next touch, high and late.
    """
    world, T = motion.phases.world, motion.phases.scenario.duration
    times, distances = motion.trajectory.times, motion.distances
    felt = np.abs(world.constant_inertia.delassus) > _FELT
    pulls = find_pulls(world, motion.trajectory.positions[-1])
    sequence, found = motion.sequence, []
    for contact in range(world.num_contacts):
        touches = [t for t in sequence if felt[contact, t.contact]]
        starts, ends = [0.0, *(t.end for t in touches)], [*(t.start for t in touches), T]
        walls = [None, *(t.contact for t in touches), None]
        for gap, (start, end) in enumerate(zip(starts, ends, strict=True)):
            is_next_to_itself = contact in walls[gap : gap + 2] and pulls[contact] <= 0
            if is_next_to_itself or end - start < _LEAST_GAP * T:
                continue
            margin = _ROOM * (end - start)
            inside = np.flatnonzero((times > start + margin) & (times < end - margin))
            nearest = inside[np.argmin(distances[inside, contact])] if inside.size else None
            time = (start + end) / 2 if nearest is None else float(times[nearest])
            found.append(Touch.bounce(time, contact))
            if pulls[contact] > 0:
                found.append(Touch.bounce(end - _LATE * (end - start), contact))
    return found


def find_grazes(motion: PhaseMotion) -> list[Touch]:
    """Returns bounces where the motion keeps off a wall at φ = 0 by its control alone.

    A touch may pay there. There is one bounce per run of such knots.
    """
    times, length = motion.trajectory.times, motion.phases.scales.length
    near = motion.phases.timeline.apart & (motion.distances < _GRAZE * length)
    found = []
    for contact, knots in enumerate(near[1:-1].T):
        where = np.flatnonzero(knots) + 1
        runs = np.split(where, np.flatnonzero(np.diff(where) > 1) + 1) if where.size else []
        found += [Touch.bounce(float(np.mean(times[run])), contact) for run in runs]
    return found


def find_pulls(world: World, q: Floats) -> Floats:
    """Returns the acceleration towards each contact at rest and without control, (m,) [m/s²]."""
    still = np.zeros(world.num_velocities), np.zeros(world.num_actuators)
    return -world.constant_inertia.jacobian @ world.calc_acceleration(q, *still)


# Rests are tried that last at least this part of the duration, and end as long before its end.
_LEAST_REST = 0.02


def find_rests(motion: PhaseMotion) -> list[TouchSequence]:
    """Returns sequences with one touch sustained, and no later touches of its wall.

    Off an elastic wall no bounce ends in rest. The contact is left in time for the cheapest
    jump to the goal's distance d from the wall, against the acceleration a towards it: from rest,
    of all durations √(6 d/a) takes the least effort, 3 (d + a τ²/2)²/τ³.
    """
    world, scenario = motion.phases.world, motion.phases.scenario
    T, restitutions = scenario.duration, motion.phases.restitutions
    pulls = find_pulls(world, scenario.goal_position)
    heights = world.calc_signed_distance(scenario.goal_position)
    sequence, found = motion.sequence, []
    for place, touch in enumerate(sequence):
        i = touch.contact
        if pulls[i] <= 0 or restitutions[i] == 1:
            continue
        left = min(T - touch.start, math.sqrt(6 * max(heights[i], 0.0) / pulls[i]))
        end = min(max(T - left, touch.start + _LEAST_REST * T), (1 - _LEAST_REST) * T)
        if end > touch.start:
            after = (other for other in sequence[place + 1 :] if other.contact != i)
            rest = dataclasses.replace(touch, end=end)
            found.append((*sequence[:place], rest, *after))
    return found


# Parts of the duration: the least distance of first touches to an instant; and the distance at
# which a polished touch is blocked by it.
_APART, _HELD = 1e-3, 1e-5


def keep_apart(sequence: TouchSequence, instants: Floats, duration: float) -> TouchSequence:
    """Returns a sequence off the instants, shape (I,), I > 0 [s]; touches at one come later."""
    gap = min([_APART * duration, *(np.diff(instants) / 4)])

    def move(time: float) -> float:
        nearest = float(instants[np.argmin(np.abs(instants - time))])
        is_near = abs(time - nearest) < gap
        return nearest + (gap if time >= nearest else -gap) if is_near else time

    return _by_start([_with_joints(touch, *map(move, touch.joints)) for touch in sequence])


def moved_past(motion: PhaseMotion) -> Iterator[TouchSequence]:
    """Yields the sequence with each touch that an instant blocks on its other side."""
    sequence, T = motion.sequence, motion.phases.scenario.duration
    for place, touch in enumerate(sequence):
        for joint, time in enumerate(touch.joints):
            for instant in motion.phases.timeline.instants:
                if abs(time - instant) <= _HELD * T:
                    joints = [*touch.joints]
                    joints[joint] = instant - np.copysign(_APART * T, time - instant)
                    moved = _with_joints(touch, *joints)
                    yield _by_start([*sequence[:place], moved, *sequence[place + 1 :]])


def _with_joints(touch: Touch, *joints: float) -> Touch:
    return dataclasses.replace(touch, start=float(joints[0]), end=float(joints[-1]))


def _by_start(touches: list[Touch]) -> TouchSequence:
    return tuple(sorted(touches, key=lambda touch: touch.start))
