"""Contact sequences read off the impulses of AIGO's boxes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

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


class _Pushes(NamedTuple):
    """The impulses of one contact that count."""

    contact: int
    times: npt.NDArray[np.float64]  # [s]
    sizes: npt.NDArray[np.float64]  # [N s]

    def bounce(self) -> Touch:
        """Returns a bounce at the mean time of the impulses."""
        return Touch.bounce(np.average(self.times, weights=self.sizes), self.contact)

    def split(self, gap: float) -> Iterator[_Pushes]:
        """Yields runs of impulses that follow each other sooner than this [s]."""
        ends = np.flatnonzero(np.diff(self.times) >= gap) + 1
        for times, sizes in zip(
            np.split(self.times, ends), np.split(self.sizes, ends), strict=True
        ):
            yield _Pushes(self.contact, times, sizes)


def read_sequences(
    transcription: RigidTranscription, x: npt.NDArray[np.float64]
) -> list[TouchSequence]:
    """Returns the contact sequences that a box center may stand for, the most literal first.

    A contact is a cluster of one wall's impulses. Boxes also split one contact in several, and do
    not tell a bounce from a contact that lasts. So this reads: every cluster a bounce; all clusters
    of a wall together one bounce, at the mean time of their impulses; and if a wall pushes knot
    after knot, one contact that lasts instead of that wall's bounces.

    Args:
        transcription: whose decision variables these are.
        x: the box center, shape (n,); the rows need not hold.
    """
    pushes = _read_impulses(transcription, x)
    if not pushes:
        return [()]
    T, dt = transcription.scenario.duration, transcription.time_step()
    bounces = [run.bounce() for one in pushes for run in one.split(_GAP * T)]
    sequences = [bounces, [one.bounce() for one in pushes]]
    runs = [run for one in pushes for run in one.split(1.5 * dt)]
    longest = max(runs, key=lambda run: run.times.size)
    if longest.times.size >= _LASTING:
        first, last = map(float, longest.times[[0, -1]])
        others = [touch for touch in bounces if touch.contact != longest.contact]
        sequences.append([*others, Touch(first, last, longest.contact)])
    return [tuple(sorted(sequence, key=lambda touch: touch.start)) for sequence in sequences]


def is_same(one: TouchSequence, other: TouchSequence, near: float) -> bool:
    """Returns whether both have the same contacts, at times that `are_near` [s]."""
    return _kinds(one) == _kinds(other) and all(
        are_near(mine.start, yours.start, near) and are_near(mine.end, yours.end, near)
        for mine, yours in zip(one, other, strict=True)
    )


def are_near(one: float, other: float, near: float) -> bool:
    """Returns whether times differ by at most `near`, and soon after the start by a quarter [s]."""
    return abs(one - other) <= min(near, max(one, other) / 4)


def _kinds(sequence: TouchSequence) -> list[tuple[int, bool]]:
    return [(touch.contact, touch.lasts) for touch in sequence]


def _read_impulses(transcription: RigidTranscription, x: npt.NDArray[np.float64]) -> list[_Pushes]:
    """Returns the impulses that belong to contacts, after the start, of every wall that has any."""
    world, q0 = transcription.world, transcription.scenario.initial_position
    impulses = transcription.impulses(x)
    kicks = [
        np.linalg.norm(world.calc_velocity_change(q0, one)) for one in np.eye(world.num_contacts)
    ]
    velocities = transcription.split(x)[1]
    least = _SHARE * np.max(np.linalg.norm(velocities, axis=1)) / np.array(kicks)
    times, found = transcription.GetSampleTimes(), []
    for contact, sizes in enumerate(impulses.T):
        pushed = np.flatnonzero(sizes[1:] > least[contact]) + 1
        if pushed.size:
            found.append(_Pushes(contact, times[pushed], sizes[pushed]))
    return found
