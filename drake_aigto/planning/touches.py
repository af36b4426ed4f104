"""Contact sequences read off the impulses of AIGO's boxes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from drake_aigto.transcription import RigidTranscription, Touch, TouchSequence

if TYPE_CHECKING:
    import numpy.typing as npt

# An impulse in a box belongs to a contact if it changes the velocity by this part of the largest
# one: with ε > 0 the wall pushes a little at every knot.
_SHARE = 0.05
# Impulses that follow each other sooner than this part of the duration are one contact: boxes smear
# a bounce over several knots.
_GAP = 0.1
# So many knots in a row that the wall pushes at may be a contact that lasts.
_LASTING = 4


def read_sequences(
    transcription: RigidTranscription, x: npt.NDArray[np.float64]
) -> list[TouchSequence]:
    """Returns the contact sequences that a box center may stand for, the most literal first.

    A contact is a cluster of impulses. Boxes also split one contact in several, and do not tell a
    bounce from a contact that lasts. So this reads: every cluster a bounce; all clusters together
    one bounce, at the mean time of their impulses; and if the wall pushes knot after knot, one
    contact that lasts.

    Args:
        transcription: whose decision variables these are.
        x: the box center, shape (n,); the rows need not hold.
    """
    times, sizes = _read_impulses(transcription, x)
    if not times.size:
        return [()]
    T, dt = transcription.scenario.duration, transcription.time_step()
    starts = np.flatnonzero(np.diff(times) >= _GAP * T) + 1
    clusters = zip(np.split(times, starts), np.split(sizes, starts), strict=True)
    bounces = tuple(Touch.bounce(np.average(t, weights=p)) for t, p in clusters)
    sequences = [bounces, (Touch.bounce(np.average(times, weights=sizes)),)]
    runs = np.split(times, np.flatnonzero(np.diff(times) > 1.5 * dt) + 1)
    longest = max(runs, key=len)
    if len(longest) >= _LASTING:
        sequences.append((Touch(float(longest[0]), float(longest[-1])),))
    return sequences


def is_same(one: TouchSequence, other: TouchSequence, near: float) -> bool:
    """Returns whether both have the same contacts, at times that `are_near` [s]."""
    return [touch.lasts for touch in one] == [touch.lasts for touch in other] and all(
        are_near(mine.start, yours.start, near) and are_near(mine.end, yours.end, near)
        for mine, yours in zip(one, other, strict=True)
    )


def are_near(one: float, other: float, near: float) -> bool:
    """Returns whether times differ by at most `near`, and soon after the start by a quarter [s]."""
    return abs(one - other) <= min(near, max(one, other) / 4)


def _read_impulses(
    transcription: RigidTranscription, x: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Returns the times and sizes of the impulses that belong to contacts, after the start."""
    world, scenario = transcription.world, transcription.scenario
    impulses = transcription.impulses(x)[:, 0]
    kick = np.linalg.norm(world.calc_velocity_change(scenario.initial_position, np.ones(1)))
    velocities = transcription.split(x)[1]
    least = _SHARE * np.max(np.linalg.norm(velocities, axis=1)) / kick
    pushed = np.flatnonzero(impulses[1:] > least) + 1
    return transcription.GetSampleTimes()[pushed], impulses[pushed]
