"""Sequences of touches: those of replays, and those near a motion's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.contact import Closed, Mode, RigidLaw, find_other_mode, read_mode
from drake_aigto.planning.candidate import ChangeName
from drake_aigto.planning.mechanisms.phased_task import Dip
from drake_aigto.planning.mechanisms.phases import (
    CREEP,
    find_slopes,
    in_order,
    is_closed,
    split_hold,
)
from drake_aigto.planning.sequence_search import swapped
from drake_aigto.shooting import ShootingResult
from drake_aigto.simulation import Replay, find_impacts
from drake_aigto.transcription import Touch, TouchSequence
from drake_aigto.world import Scenario, World

# A sticking contact is at the edge if it takes this part of the available friction.
_EDGE = 0.98
# A contact that penetrates its wall again within this many search steps was released too early.
_SOON = 2
# Touches closer than this part of the duration may be swapped.
NEAR = 0.05

# Which contacts are touched, how the impacts end, and roughly when and for how long.
RoundedTouches: TypeAlias = tuple[tuple[int, int, int, int], ...]


def round_touches(touches: TouchSequence, duration: float) -> RoundedTouches:
    """Returns what sequences that are near each other have in common, of a duration [s]."""
    near = NEAR * duration
    return tuple(
        (t.contact, t.mode, round(t.start / near), round((t.end - t.start) / near)) for t in touches
    )


def find_neighbors(
    world: World, law: RigidLaw, motion: ShootingResult, lasting: Floats, near: float
) -> Iterator[tuple[ChangeName, TouchSequence]]:
    """Yields sequences with one touch fewer, two swapped, one more, and in another mode.

    Args:
        world: the mechanism.
        law: of its rigid walls.
        motion: in phases.
        lasting: the shortest sustained touch of each contact, shape (m,) [s].
        near: touches closer than this may be swapped [s].
    """
    touches = motion.touches
    for place in range(len(touches)):
        yield "dropped", drop(touches, place)
    for other in swapped(touches, near):
        yield "swapped", other
    for place, added in _find_additions(world, law, motion, lasting):
        yield "added", (*touches[:place], added, *touches[place:])
    for other in list_mode_changes(law, touches):
        yield "mode", other


def read_replay(world: World, law: RigidLaw, replay: Replay, lasting: Floats) -> TouchSequence:
    """Returns a replay's touches; sustained ones without friction last until the next.

    Args:
        world: the mechanism.
        law: of its rigid walls.
        replay: a simulation between them.
        lasting: the shortest sustained touch of each contact, shape (m,) [s].
    """
    contacts, starts = np.array(replay.bounce_contacts, dtype=np.int64), replay.bounce_times
    rows = find_impacts(replay.times, replay.velocities, len(starts))
    ends = [*starts, float(replay.times[-1])][1:]
    held = [
        Touch(phase.start, phase.end, phase.contact, int(Mode[phase.mode.upper()]))
        for phase in replay.contact_phases
    ]
    begins = {(touch.start, touch.contact) for touch in held}
    bounces = []
    for start, end, i, row in zip(starts, ends, contacts.tolist(), rows, strict=True):
        if (start, i) not in begins:
            mode = read_mode(world, law, i, replay.positions[row], replay.velocities[row])
            bounces.append(Touch(start, start if lasting[i] or law.friction[i] else end, i, mode))
    return in_order([*bounces, *held])


def rests_early(world: World, law: RigidLaw, scenario: Scenario) -> bool:
    """Returns whether contacts with friction may rest early: on springs they sink and creep."""
    closed = is_closed(world, scenario.initial_position, scenario.initial_velocity)
    return bool(np.any(((law.restitution == 0) | closed) & (law.friction > 0)))


def with_dip(
    world: World, law: RigidLaw, motion: ShootingResult, dip: Dip, lasting: Floats, step: float
) -> TouchSequence:
    """Returns the touches of a motion and its dip: a new touch, or a prolonged one.

    A contact with zero restitution that penetrates a wall soon after its release, within a step of
    the search [s], was released too early: added bounces would become ever smaller, without end.
    """
    contact, touches = dip.touch.contact, list(motion.touches)
    if not (law.restitution[contact] or law.friction[contact]):
        for place, touch in enumerate(touches):
            if touch.contact == contact and 0 <= dip.start - touch.end <= _SOON * step:
                touches[place] = replace(touch, end=dip.end)
                return tuple(touches)
    return in_order((*touches, *dip.as_touches(world, law, lasting, motion)))


def drop(touches: TouchSequence, place: int) -> TouchSequence:
    """Returns a sequence without a touch; an adjoining one of its contact takes its time."""
    touch, rest = touches[place], [*touches[:place], *touches[place + 1 :]]
    for i, other in enumerate(rest if touch.lasts else ()):
        if other.contact == touch.contact and other.lasts:
            if other.end == touch.start:
                rest[i] = replace(other, end=touch.end)
                break
            if other.start == touch.end:
                rest[i] = replace(other, start=touch.start)
                break
    return in_order(rest)


def _find_additions(
    world: World, law: RigidLaw, motion: ShootingResult, lasting: Floats
) -> Iterator[tuple[int, Touch]]:
    """Yields touches of each contact in each phase: at its smallest distance and half-way."""
    times, (q, v) = motion.times, np.split(motion.states, 2, axis=1)
    distances, closed = world.calc_signed_distance(q), is_closed(world, q[0], v[0])
    ends = [0, *motion.phases.knots.tolist(), len(times) - 1]
    starts = [touch.start for touch in motion.touches]
    for (first, last), held in zip(pairwise(ends), motion.phases.held, strict=True):
        place = int(np.searchsorted(starts, times[first], side="right"))
        for contact in np.flatnonzero(~held).tolist() if last - first > 1 else []:
            if first == 0 and closed[contact]:
                yield 0, Touch(0.0, float(times[last]), contact)
            nearest = first + 1 + int(np.argmin(distances[first + 1 : last, contact]))
            mode = read_mode(world, law, contact, q[nearest], v[nearest])
            for time in (times[nearest], (times[first] + times[last]) / 2):
                end = time if lasting[contact] else (time + times[last]) / 2
                yield place, Touch(float(time), float(end), contact, mode)


def list_mode_changes(law: RigidLaw, touches: TouchSequence) -> Iterator[TouchSequence]:
    """Yields sequences in which a touch with friction is in another mode, then one half of it.

    That is the first half or the second, if it is sustained.
    """
    changes = [
        (place, touch, replace(touch, mode=mode))
        for place, touch in enumerate(touches)
        for mode in ((-1, 0, 1) if law.friction[touch.contact] else ())
        if mode != touch.mode
    ]
    for place, _, changed in changes:
        yield in_order((*touches[:place], changed, *touches[place + 1 :]))
    for place, touch, changed in changes:
        middle = (touch.start + touch.end) / 2
        for first, second in ((touch, changed), (changed, touch)) if touch.lasts else ():
            halves = replace(first, end=middle), replace(second, start=middle)
            yield in_order((*touches[:place], *halves, *touches[place + 1 :]))


def switch_modes(world: World, law: RigidLaw, motion: ShootingResult) -> TouchSequence | None:
    """Returns a motion's touches, with bounces at an edge in the mode beyond it; None if none is.

    Beyond an edge the cost may fall further, as stick becomes slip there, or slip ends.
    """
    n, (_, before) = world.num_positions, find_slopes(world, motion)
    touches = []
    for touch, knot in motion.starts:
        other = None
        if knot is not None and not touch.lasts:
            state = motion.states[knot, :n], before[knot - 1]
            other = find_other_mode(world, law, touch.contact, touch.mode, *state)
        touches.append(touch if other is None else replace(touch, mode=other))
    return tuple(touches) if tuple(touches) != motion.touches else None


def lead_over_edges(world: World, law: RigidLaw, motion: ShootingResult) -> TouchSequence | None:
    """Returns a motion's touches, with sustained ones led over edges of modes; None if none is.

    Contacts that stick with all available friction slip, and contacts that hardly slip stick.
    """
    touches = in_order(
        [part for touch in motion.touches for part in _split(world, law, motion, touch)]
    )
    return touches if touches != motion.touches else None


def _split(world: World, law: RigidLaw, motion: ShootingResult, touch: Touch) -> Iterator[Touch]:
    """Yields the parts of a touch, each in the mode that it is at the edge to."""
    starts = motion.times[:-1]
    knots = np.flatnonzero((starts >= touch.start) & (starts < touch.end))
    if not (touch.lasts and law.friction[touch.contact] and len(knots)):
        yield touch
        return
    modes = np.full(len(knots), touch.mode, dtype=np.int64)
    if touch.mode:
        q, v = np.split(motion.states, 2, axis=1)
        slips = world.rubbing.calc_slips(q, v)[:, touch.contact]
        modes[np.abs(slips[knots]) <= CREEP * np.max(np.abs(slips))] = 0
        modes[0] = touch.mode  # It may begin at rest.
    else:
        normal, tangent = _calc_forces(world, law, motion, touch.contact, knots)
        is_at_edge = np.abs(tangent) >= _EDGE * law.friction[touch.contact] * normal
        modes[is_at_edge & (normal > 0)] = -np.sign(tangent[is_at_edge & (normal > 0)])
    yield from split_hold(touch, starts[knots], modes)


def _calc_forces(
    world: World, law: RigidLaw, motion: ShootingResult, contact: int, knots: Ints
) -> tuple[Floats, Floats]:
    """Returns f_n and f_t of a contact that is held from knots on, shape (K,) each [N]."""
    found = np.zeros((2, len(knots)))
    for row, knot in enumerate(knots.tolist()):
        phase = int(np.searchsorted(motion.phases.knots, knot, side="right"))
        held, of_phase = np.flatnonzero(motion.phases.held[phase]), motion.phases.modes[phase]
        modes = tuple(Mode(int(of_phase[i]) if law.friction[i] else Mode.FORWARD) for i in held)
        state, control = motion.states[knot], motion.controls[knot]
        push = Closed(world, held, modes, law.friction[held]).calc_push(state, control)
        found[:, row] = push.normal[held == contact][0], push.tangent[held == contact][0]
    return found[0], found[1]
