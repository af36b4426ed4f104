"""Where motions between rigid walls dip into these between knots, and by how much they are off."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import RigidLaw, read_mode
from drake_aigto.planning.mechanisms.phases import SAME, find_slopes, is_closed, read_hold
from drake_aigto.shooting import ShootingProblem, ShootingResult
from drake_aigto.transcription import Touch, TouchSequence
from drake_aigto.world import World

# Times between two knots at which distances of walls are checked, as parts of a step.
_LOOKS = np.linspace(0.0, 1.0, 9)[1:-1]


class Dip(NamedTuple):
    """A stretch of a motion inside of a wall."""

    depth: float  # −φ at most [m]
    touch: Touch  # then, and through that face
    start: float  # the first time that it is inside [s]
    end: float  # the last one [s]

    def as_touches(
        self, world: World, law: RigidLaw, lasting: Floats, motion: ShootingResult
    ) -> Iterator[Touch]:
        """Yields the touch of a motion's dip, in the mode that follows from the state before it.

        If the dip lasts longer than its contact's threshold, it is sustained, with one touch for
        each mode of the motion.
        """
        n, contact = world.num_positions, self.touch.contact
        first = max(0, int(np.searchsorted(motion.times, self.start)) - 1)
        if self.end - self.start > lasting[contact]:
            times = motion.times
            inside = np.flatnonzero((times >= self.start) & (times <= self.end))
            start = max(self.start, SAME * float(times[-1]))
            if first == 0 and is_closed(world, motion.states[0, :n], motion.states[0, n:])[contact]:
                start = 0.0
            knots = inside if len(inside) else np.array([first])
            yield from read_hold(world, law, motion, contact, (start, self.end), knots)
            return
        mode = read_mode(world, law, contact, *np.split(motion.states[first], [n]))
        yield Touch(self.touch.start, self.touch.end, contact, mode)


@np.errstate(over="ignore", invalid="ignore")  # Of motions that diverge, slips may overflow.
def read_touches(
    world: World, law: RigidLaw, motion: ShootingResult, lasting: Floats
) -> TouchSequence:
    """Returns the touches of a motion between compliant walls, by time.

    Args:
        world: the mechanism.
        law: of the rigid walls that the compliant ones replace.
        motion: its motion.
        lasting: the shortest sustained touch of each contact, shape (m,) [s].
    """
    q = motion.states[:, : world.num_positions]
    touches = (
        touch
        for dip in _find_dips(world, motion.times, q)
        for touch in dip.as_touches(world, law, lasting, motion)
    )
    return tuple(sorted(touches, key=lambda touch: touch.start))


def find_deepest(world: World, motion: ShootingResult) -> Dip | None:
    """Returns the deepest penetration of a motion in phases between its knots, if any."""
    times, positions = _look_between(world, motion)
    flat = positions.reshape(-1, positions.shape[-1])
    dips = _find_dips(world, times.ravel(), flat)
    return max(dips, key=lambda dip: dip.depth, default=None)


def find_grazes(world: World, motion: ShootingResult, speed: float) -> list[int]:
    """Returns which bounces among the touches of a motion are slower than a speed [m/s]."""
    n, (_, before) = world.num_positions, find_slopes(world, motion)
    found = []
    for place, (touch, knot) in enumerate(motion.starts):
        if knot is not None and not touch.lasts:
            J = world.calc_contact_jacobian(motion.states[knot, :n])[touch.contact]
            if J @ before[knot - 1] > -speed:
                found.append(place)
    return found


def find_lacks(world: World, motion: ShootingResult, margin: float) -> Floats:
    """Returns by how much φ should be larger at knots not to fall below a margin between them.

    It is the same for all faces of a solid, and zero next to a bounce on it, and from the start to
    where a motion first leaves it by the margin.

    Returns:
        At least 0, shape (N + 1, m) [m].
    """
    _, positions = _look_between(world, motion)
    distances = world.calc_signed_distance(positions)
    N, m = len(positions), distances.shape[-1]
    lacks, is_touched = np.zeros((N, m)), np.zeros((N + 1, m), dtype=bool)
    for faces in map(list, world.solids):
        of_solid = distances[..., faces]
        lowest = of_solid.max(axis=2).argmin(axis=1)
        there = of_solid[np.arange(N), lowest]
        # At knots, the face in front counts: around a corner, that is another one.
        lacks[:, faces] = margin - there.max(axis=1, keepdims=True)
        is_left = np.maximum.accumulate(there.max(axis=1) >= margin)
        is_touched[:-1, faces] |= ~is_left[:, np.newaxis]
        touched = motion.phases.knots[np.isin(motion.phases.contacts, faces)]
        is_touched[touched[:, np.newaxis], faces] = True
        along = np.flatnonzero(motion.phases.held[:, faces].any(axis=1))
        ends = [0, *motion.phases.knots.tolist(), N]
        for phase in along.tolist():
            is_touched[ends[phase] : ends[phase + 1] + 1, faces] = True
    lacks[is_touched[1:] | is_touched[:-1]] = 0.0
    found = np.zeros((N + 1, m))
    found[:-1] = lacks
    found[1:] = np.maximum(found[1:], lacks)
    return np.where(is_touched, 0.0, np.maximum(found, 0.0))


def _find_dips(world: World, times: Floats, positions: Floats) -> Iterator[Dip]:
    """Yields the deepest point of each stretch inside of a solid, by time."""
    distances = world.calc_signed_distance(positions)
    found = []
    for faces in map(list, world.solids):
        clearance = distances[:, faces].max(axis=1)
        inside = np.flatnonzero(clearance < 0)
        for knots in np.split(inside, 1 + np.flatnonzero(np.diff(inside) > 1)):
            if len(knots) and knots[-1] > 0:
                deepest = knots[np.argmin(clearance[knots])]
                entered = faces[int(np.argmax(distances[knots[0], faces]))]
                touch = Touch.bounce(times[deepest], entered)
                ends = float(times[knots[0]]), float(times[knots[-1]])
                found.append(Dip(-float(clearance[deepest]), touch, *ends))
    yield from sorted(found, key=lambda dip: dip.touch.start)


def sample(world: World, motion: ShootingResult, times: Floats) -> Floats:
    """Returns states at times (K,), on cubics between knots, at a bounce after it; (K, 2n)."""
    starts, h = motion.times[:-1], np.diff(motion.times)[:, np.newaxis]
    rows = np.clip(np.searchsorted(starts, times, side="right") - 1, 0, len(starts) - 1)
    s = (times - starts[rows])[:, np.newaxis] / h[rows]
    q, start, bend, twist = (each[rows] for each in _find_cubics(world, motion))
    slopes = start + s * (2 * bend + 3 * s * twist)
    return np.hstack([q + s * (start + s * (bend + s * twist)), slopes / h[rows]])


def _look_between(world: World, motion: ShootingResult) -> tuple[Floats, Floats]:
    """Returns times (N, K) and positions (N, K, n) between knots, also where corners are passed."""
    q, start, bend, twist = (each[:, np.newaxis] for each in _find_cubics(world, motion))

    def look(s: Floats) -> Floats:
        s = s[..., np.newaxis]
        return q + s * (start + s * (bend + s * twist))

    s = np.broadcast_to(_LOOKS, (len(q), len(_LOOKS)))
    for faces in map(list, world.solids):
        if len(faces) == 1:
            continue
        # Deepest there, where two faces are equally far, between looks to the first and last.
        distances = world.calc_signed_distance(look(s))[..., faces]
        front = distances.argmax(axis=2)[..., np.newaxis]
        pairs = np.concatenate([front[:, :-1], front[:, 1:]], axis=2)
        ahead = -np.diff(np.take_along_axis(distances[:, :-1], pairs, axis=2), axis=2)[..., 0]
        after = np.diff(np.take_along_axis(distances[:, 1:], pairs, axis=2), axis=2)[..., 0]
        share = ahead / np.where(ahead + after > 0, ahead + after, 1.0)
        s = np.sort(np.hstack([s, s[:, :-1] + share * np.diff(s, axis=1)]), axis=1)
    return motion.times[:-1, np.newaxis] + s * np.diff(motion.times)[:, np.newaxis], look(s)


def _find_cubics(world: World, motion: ShootingResult) -> tuple[Floats, Floats, Floats, Floats]:
    """Returns positions as coefficients of powers of the part of a step, shape (N, n) each."""
    n, h = world.num_positions, np.diff(motion.times)[:, np.newaxis]
    q = motion.states[:, :n]
    start, end = (h * slopes for slopes in find_slopes(world, motion))
    way = np.diff(q, axis=0)
    return q[:-1], start, 3 * way - 2 * start - end, start + end - 2 * way


def keep_off(
    world: World, problem: ShootingProblem, motion: ShootingResult, margin: float
) -> ShootingProblem | None:
    """Returns a motion's problem off walls that it dips into between knots; None: into none."""
    if not np.isfinite(motion.cost):
        return None
    lacks = find_lacks(world, motion, margin)
    return replace(problem, clearances=lacks) if np.max(lacks) > margin else None
