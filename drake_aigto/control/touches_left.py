"""Motions over a horizon: which of their touches may still come, and which motion is taken."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch, TouchSequence

# Touches that are planned within so many periods of now may have happened, or not yet.
_NEAR = 2.0
# What costs so much more than the last plan, as a share of that, is dearer: noise makes less of it.
_DEARER = 0.05
# Touches are kept this part of the time that is left apart, and away from both ends.
_APART = 1e-4


@dataclass(frozen=True, eq=False)
class PlannedMotion:
    """A motion over a horizon.

    Attributes:
        trajectory: states and controls at knots, in the context's time.
        cost: J from the first knot on.
        touches: the contacts that are come into, by time, which is the context's.
    """

    trajectory: Trajectory
    cost: float
    touches: TouchSequence

    def calc_control(self, time: float) -> Floats:
        """Returns u at a time, shape (nu,); before and after the horizon its first and last."""
        times, controls = self.trajectory.times, self.trajectory.controls
        k = int(np.searchsorted(times, time, side="right")) - 1
        return np.array(controls[min(max(k, 0), len(controls) - 1)])

    def calc_state(self, time: float) -> Floats:
        """Returns q and v at a time, shape (2n,); beyond the horizon its first and last."""
        times = self.trajectory.times
        state, _ = self.trajectory.to_piecewise()
        return np.array(state.value(min(max(time, times[0]), times[-1]))[:, 0])

    def later(self, by: float) -> PlannedMotion:
        """Returns the same motion, later by a duration [s]."""
        touches = (replace(each, start=each.start + by, end=each.end + by) for each in self.touches)
        return PlannedMotion(self.trajectory.later(by), self.cost, tuple(touches))


def find_left(
    touches: Sequence[Touch],
    now: float,
    left: float,
    period: float,
    rates: Floats,
    bounced: int | None = None,
    slips: Mapping[int, int] | None = None,
) -> Iterator[TouchSequence]:
    """Yields the touches of a plan that may be left, as times from now on, the likelier ones first.

    Which these are, a state does not tell for sure: a bounce may come sooner or later than it was
    planned. What leaves a wall may have been there; what comes to it has not.

    Args:
        touches: of the plan.
        now: the time [s].
        left: how long it goes on [s].
        period: between ticks [s].
        rates: φ̇ of each contact, shape (m,) [m/s].
        bounced: the contact that was just seen to bounce, if one was.
        slips: of each contact that lies at its wall, the sign of its slip, 0 where it sticks.
    """
    near, lying = _NEAR * period, slips or {}
    for sequence in _list_left(touches, now, left, near, rates, bounced, lying):
        yield _begin(sequence, lying, near)


def _list_left(
    touches: Sequence[Touch],
    now: float,
    left: float,
    near: float,
    rates: Floats,
    bounced: int | None,
    lying: Mapping[int, int],
) -> Iterator[TouchSequence]:
    """Yields the touches that may be left, wherever contacts lie now."""
    coming = [touch for touch in touches if touch.end > now]
    late = [touch for touch in touches if now - near < touch.end <= now]
    if late and late[-1].contact not in lying and rates[late[-1].contact] < 0:
        yield keep_apart([late[-1], *coming], now, left)
    whole, fewer = keep_apart(coming, now, left), keep_apart(coming[1:], now, left)
    if not coming:
        yield whole
        return
    comes = rates[coming[0].contact] < 0 or (coming[0].lasts and coming[0].contact in lying)
    is_near = coming[0].start < now + near or coming[0].contact == bounced
    if is_near and not comes:
        yield from (fewer, whole)
    else:
        yield from (whole, fewer) if is_near or not comes else (whole,)


def choose(tried: Iterable[PlannedMotion | None], last: float) -> PlannedMotion | None:
    """Returns the first motion that is no dearer than the last plan, or else the cheapest one.

    Args:
        tried: motions, the likelier ones first.
        last: what the last plan costs.
    """
    found: list[PlannedMotion] = []
    for motion in tried:
        found += [motion] if motion else []
        if motion and motion.cost <= (1 + _DEARER) * last:
            break
    return min(found, key=lambda each: each.cost, default=None)


def keep_apart(touches: Sequence[Touch], now: float, left: float) -> TouchSequence:
    """Returns touches as times from now on, in order and apart, of what is left [s].

    Those that last may overlap, go on from each other in another mode, and last to the end.
    """
    least = _APART * left
    found: list[Touch] = []
    ends: dict[tuple[int, float], float] = {}  # of contacts that last, where they were planned
    for touch in touches:
        start = max(touch.start - now, least + _find_last(found, touch))
        if touch.lasts:
            start = ends.get((touch.contact, touch.start), start)
        end = min(max(touch.end - now, start + least), left) if touch.lasts else start
        if start < left - least:
            found.append(replace(touch, start=start, end=end))
            ends[touch.contact, touch.end] = end
    return tuple(found)


def _find_last(found: Sequence[Touch], touch: Touch) -> float:
    """Returns what a touch has to come after: the last one, or, if that lasts, its start [s]."""
    if not found:
        return 0.0
    overlaps = found[-1].lasts and found[-1].contact != touch.contact
    return found[-1].start if overlaps else found[-1].end


def _begin(sequence: TouchSequence, lying: Mapping[int, int], near: float) -> TouchSequence:
    """Returns touches of which those last from now on that begin soon, where contacts lie.

    What slips otherwise than the plan says does so for a while before.
    """
    found, seen = list[Touch](), set[int]()
    for touch in sequence:
        lies = touch.contact in lying and touch.contact not in seen
        seen.add(touch.contact)
        if not (lies and touch.lasts and touch.start <= near):
            found.append(touch)
            continue
        slip = lying[touch.contact]
        if slip in (0, touch.mode):
            found.append(replace(touch, start=0.0))
            continue
        until = min(near, touch.end) / 2
        found += [Touch(0.0, until, touch.contact, slip), replace(touch, start=until)]
    return tuple(found)
