"""Modes of a motion's contacts with friction, and changes of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.contact import RigidLaw
from drake_aigto.shooting import ShootingResult
from drake_aigto.transcription import Touch, TouchSequence
from drake_aigto.world import World

# Slip below this part of the fastest slip counts as stick: on springs sticking contacts creep.
CREEP = 0.05
# A stretch shorter than this part of a sustained touch is joined to the one before.
_SHORT = 0.1
# Distances and speeds below this part of the largest coordinate, or 1, count as zero.
_STILL = 1e-9


def is_closed(world: World, q: Floats, v: Floats) -> Bools:
    """Returns which contacts touch and are neither approached nor left, shape (m,)."""
    still = _STILL * (1 + max(np.max(np.abs(q)), np.max(np.abs(v))))
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


def list_mode_changes(law: RigidLaw, touches: TouchSequence) -> Iterator[TouchSequence]:
    """Yields sequences in which one touch with friction is in another mode."""
    for place, touch in enumerate(touches):
        for mode in (-1, 0, 1) if law.friction[touch.contact] else ():
            if mode != touch.mode:
                changed = replace(touch, mode=mode)
                yield in_order((*touches[:place], changed, *touches[place + 1 :]))


def list_hold_changes(law: RigidLaw, touches: TouchSequence) -> Iterator[TouchSequence]:
    """Yields sequences in which half of a sustained touch with friction is in another mode.

    That is its first half or its second.
    """
    for place, touch in enumerate(touches):
        middle = (touch.start + touch.end) / 2
        for mode in (-1, 0, 1) if touch.lasts and law.friction[touch.contact] else ():
            if mode == touch.mode:
                continue
            one, other = replace(touch, end=middle), replace(touch, start=middle)
            for pair in ((one, replace(other, mode=mode)), (replace(one, mode=mode), other)):
                yield in_order((*touches[:place], *pair, *touches[place + 1 :]))


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
