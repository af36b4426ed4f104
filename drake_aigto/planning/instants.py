"""Touches beside times that users bound something to: before or after is for the polish to find."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.transcription import PhaseTranscription, Touch, TouchSequence

# Parts of the duration: touches start no nearer to an instant than this, and are held up by it if
# the polish leaves them within that.
_APART, _HELD = 1e-3, 1e-5


def keep_apart(sequence: TouchSequence, instants: Floats, duration: float) -> TouchSequence:
    """Returns a sequence off the instants, shape (I,), I > 0 [s]: what is at one comes after it."""
    gap = min([_APART * duration, *(np.diff(instants) / 4)])

    def move(time: float) -> float:
        nearest = float(instants[np.argmin(np.abs(instants - time))])
        is_near = abs(time - nearest) < gap
        return nearest + (gap if time >= nearest else -gap) if is_near else time

    return _in_order([_with_joints(touch, *map(move, touch.joints)) for touch in sequence])


def moved_past(phases: PhaseTranscription, x: Floats) -> Iterator[TouchSequence]:
    """Yields the sequence with each touch that an instant holds up on its other side.

    Args:
        phases: the multi-phase problem.
        x: its solution.
    """
    sequence, T = phases.contact_sequence(x), phases.scenario.duration
    for place, touch in enumerate(sequence):
        for joint, time in enumerate(touch.joints):
            for instant in phases.timeline.instants:
                if abs(time - instant) <= _HELD * T:
                    joints = [*touch.joints]
                    joints[joint] = instant - np.copysign(_APART * T, time - instant)
                    moved = _with_joints(touch, *joints)
                    yield _in_order([*sequence[:place], moved, *sequence[place + 1 :]])


def _with_joints(touch: Touch, *joints: float) -> Touch:
    return dataclasses.replace(touch, start=float(joints[0]), end=float(joints[-1]))


def _in_order(touches: list[Touch]) -> TouchSequence:
    return tuple(sorted(touches, key=lambda touch: touch.start))
