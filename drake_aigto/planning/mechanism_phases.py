"""Motions that bounce off rigid walls: where they touch, and their knots in phases."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints, read_only
from drake_aigto.planning.impact_modes import find_other_mode, read_mode
from drake_aigto.shooting import Phases, ShootingResult
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch, TouchSequence
from drake_aigto.world import RigidLaw, World

# No phase starts out shorter than this part of the duration.
_SHORTEST = 1e-2
# Knots that are this part of the duration apart are one and the same.
_SAME = 1e-6
# Where walls are looked at between two knots, as parts of the time between them.
_LOOKS = np.linspace(0.0, 1.0, 9)[1:-1]


@dataclass(frozen=True, eq=False)
class BouncingResult(ShootingResult):
    """A motion in phases, and where they meet.

    Attributes:
        contacts: what is touched at the end of each phase but the last, −1 where what was held
            lets go, shape (P − 1,).
        knots: where that is, shape (P − 1,).
        held: which contacts are held in each phase, shape (P, m).
        modes: how impacts end at contacts that rub (`Touch`), shape (P − 1,).
    """

    contacts: Ints
    knots: Ints
    held: Bools
    modes: Ints

    def __post_init__(self) -> None:
        """Makes the arrays read-only."""
        super().__post_init__()
        for name in ("contacts", "knots", "modes"):
            object.__setattr__(self, name, read_only(getattr(self, name), np.int64))
        object.__setattr__(self, "held", read_only(self.held, np.bool_))

    @classmethod
    def of(cls, found: ShootingResult, phases: Phases) -> BouncingResult:
        """Returns what shooting found in phases."""
        names = (field.name for field in fields(ShootingResult))
        values = {name: getattr(found, name) for name in names}
        places = {name: getattr(phases, name) for name in ("contacts", "knots", "held", "modes")}
        return cls(**values, **places)

    @property
    def touches(self) -> TouchSequence:
        """What is touched, and when."""
        times, modes = self.times[[*self.knots, -1]].tolist(), self.modes.tolist()
        return tuple(
            Touch(times[i], times[self._find_end(i, contact)], contact, modes[i])
            for i, contact in enumerate(self.contacts.tolist())
            if contact >= 0
        )

    def phases(self, total: tuple[float, float]) -> Phases:
        """Returns its phases, whose sum may become the least and the most of a total [s]."""
        return Phases(
            self.contacts, self.knots, self.durations, total, held=self.held, modes=self.modes
        )

    def _find_end(self, joint: int, contact: int) -> int:
        """Returns where what is hit at a joint of phases is let go, or hit again."""
        end, last = joint, len(self.contacts)
        while end < last and self.held[end + 1, contact]:
            end += 1
            if end < last and self.contacts[end] == contact:
                break
        return end

    @property
    def hits(self) -> Ints:
        """The knots at which something is hit."""
        return self.knots[self.contacts >= 0]

    def as_trajectory(self, world: World) -> Trajectory:
        """Returns the motion with velocities before impacts, and their impulses.

        Before an impact, that is the slope of a parabola, but for what the impulse changes.
        """
        n, m = world.num_positions, world.num_contacts
        q, v = np.split(self.states, [n], axis=1)
        v, impulses = v.copy(), np.zeros((len(q), m))
        _, slopes = _find_slopes(world, self)
        for knot, i in zip(self.hits, self.contacts[self.contacts >= 0], strict=True):
            kick, J = (
                world.calc_velocity_change(q[knot], np.eye(m)[i]),
                world.calc_contact_jacobian(q[knot])[i],
            )
            impulses[knot, i] = J @ (v[knot] - slopes[knot - 1]) / (J @ kick)
            v[knot] -= impulses[knot, i] * kick
        forces = np.zeros((len(self.controls), m))
        return Trajectory(self.times, q, v, self.controls, impulses, forces)


class Dip(NamedTuple):
    """Where a motion is inside of a wall."""

    depth: float  # −φ at most [m]
    touch: Touch  # then, and through that face
    start: float  # the first time that it is inside [s]
    end: float  # the last one [s]

    def as_touch(
        self, world: World, law: RigidLaw, lasting: Floats, motion: ShootingResult
    ) -> Touch:
        """Returns the touch of a motion's dip, in the mode that its state before it leads to.

        It lasts if the dip lasts longer than its contact's number says.
        """
        n, contact = world.num_positions, self.touch.contact
        before = motion.states[max(0, int(np.searchsorted(motion.times, self.start)) - 1)]
        mode = read_mode(world, law, contact, before[:n], before[n:])
        lasts = self.end - self.start > lasting[contact]
        ends = (self.start, self.end) if lasts else (self.touch.start, self.touch.end)
        return Touch(*ends, contact, mode)


def lay_out(
    touches: TouchSequence,
    num_steps: int,
    duration: float,
    total: tuple[float, float],
    num_contacts: int,
) -> tuple[Floats, Phases]:
    """Returns knots of which one is at each touch and release, and the phases between.

    What a touch holds lets go where the next bounce is, at the latest: touches that last may
    overlap. Where there are not enough steps, the last touches are left out.

    Args:
        touches: by time.
        num_steps: N.
        duration: of the motion [s].
        total: the least and the most that it may become [s].
        num_contacts: m.
    """
    joints = list(_find_joints(touches, duration))[: num_steps - 1]
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
    modes = np.array([joint.mode for joint in joints], dtype=np.int64)
    held = _find_held(joints, num_contacts)
    return times, Phases(contacts, knots, durations, total, held, modes)


class _Joint(NamedTuple):
    """Where phases meet."""

    time: float  # [s]
    contact: int  # what is touched then, or −1
    held: list[int]  # what is held from then on
    mode: int  # how the impact ends


def _find_held(joints: Sequence[_Joint], num_contacts: int) -> Bools:
    """Returns which contacts are held in each of the phases that meet at joints, shape (P, m)."""
    held = np.zeros((1 + len(joints), num_contacts), dtype=np.bool_)
    for phase, joint in enumerate(joints, start=1):
        held[phase, joint.held] = True
    return held


def lay_onto(touches: TouchSequence, times: Floats, num_contacts: int) -> tuple[Floats, Phases]:
    """Returns knots, those given and one at each touch and release, and the phases between.

    Args:
        touches: by time.
        times: of knots, from 0 on [s]; those that nearly are at a touch are left out.
        num_contacts: m.
    """
    duration = float(times[-1])
    joints = list(_find_joints(touches, duration))
    ends = np.array([joint.time for joint in joints])
    off = np.abs(times[1:-1, np.newaxis] - ends).min(axis=1, initial=np.inf)
    inside = times[1:-1][off > _SAME * duration]
    knots = np.sort(np.concatenate([[0.0], inside, ends, [duration]]))
    phases = Phases(
        contacts=np.array([joint.contact for joint in joints], dtype=np.int64),
        knots=np.searchsorted(knots, ends),
        durations=np.diff(ends, prepend=0.0, append=duration),
        total=(duration, duration),
        held=_find_held(joints, num_contacts),
        modes=np.array([joint.mode for joint in joints], dtype=np.int64),
    )
    return knots, phases


def _find_joints(touches: TouchSequence, duration: float) -> Iterator[_Joint]:
    ends: dict[int, float] = {}  # Of what is held.
    nexts = [*(touch.start for touch in touches), duration][1:]
    for touch, until in zip(touches, nexts, strict=True):
        ends = {**ends, touch.contact: touch.end} if touch.lasts else {}
        yield _Joint(touch.start, touch.contact, list(ends), touch.mode)
        while ends and (end := min(ends.values())) < until:
            # What lets go at about the same time does so at once.
            ends = {i: each for i, each in ends.items() if each > end + _SHORTEST * duration}
            yield _Joint(end, -1, list(ends), 0)
        ends = {i: end for i, end in ends.items() if end > until}


def read_touches(
    world: World, law: RigidLaw, motion: ShootingResult, lasting: Floats
) -> TouchSequence:
    """Returns where a motion between walls that yield is inside, by time.

    Args:
        world: the mechanism.
        law: of the rigid walls that these stand for.
        motion: its motion.
        lasting: from how long on a touch of each contact lasts, shape (m,) [s].
    """
    q = motion.states[:, : world.num_positions]
    dips = _find_dips(world, motion.times, q)
    touches = (dip.as_touch(world, law, lasting, motion) for dip in dips)
    return tuple(sorted(touches, key=lambda touch: touch.start))


def find_deepest(world: World, motion: BouncingResult) -> Dip | None:
    """Returns where a motion in phases is deepest inside of a wall between its knots, if at all."""
    times, positions = _look_between(world, motion)
    flat = positions.reshape(-1, positions.shape[-1])
    dips = _find_dips(world, times.ravel(), flat)
    return max(dips, key=lambda dip: dip.depth, default=None)


def find_grazes(world: World, motion: BouncingResult, speed: float) -> list[int]:
    """Returns which bounces among the touches of a motion are slower than a speed [m/s]."""
    n, knots, touches = world.num_positions, motion.hits, motion.touches
    contacts = [touch.contact for touch in touches]
    J = world.calc_contact_jacobian(motion.states[knots, :n])[np.arange(len(knots)), contacts]
    _, before = _find_slopes(world, motion)
    is_slow = np.einsum("bi,bi->b", J, before[knots - 1]) > -speed
    return [i for i in np.flatnonzero(is_slow).tolist() if not touches[i].lasts]


def switch_modes(world: World, law: RigidLaw, motion: BouncingResult) -> TouchSequence | None:
    """Returns the touches of a motion, impacts at the edge of their mode beyond it; None: no one.

    Beyond an edge the cost may fall on, as stick becomes slip there, or slip ends.
    """
    n, knots, touches = world.num_positions, motion.hits, motion.touches
    _, before = _find_slopes(world, motion)
    others = [
        find_other_mode(world, law, touch, motion.states[knot, :n], before[knot - 1])
        for touch, knot in zip(touches, knots.tolist(), strict=True)
    ]
    if all(other is None for other in others):
        return None
    pairs = zip(touches, others, strict=True)
    return tuple(one if mode is None else replace(one, mode=mode) for one, mode in pairs)


def find_lacks(world: World, motion: BouncingResult, margin: float) -> Floats:
    """Returns by how much φ should be larger at knots not to fall below a margin between them.

    Of solids, that is the face which the sphere is in front of. Next to a bounce on it nothing is
    asked for.

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
        foremost = there.argmax(axis=1)
        lacks[np.arange(N), np.array(faces)[foremost]] = margin - there.max(axis=1)
        touched = motion.knots[np.isin(motion.contacts, faces)]
        is_touched[touched[:, np.newaxis], faces] = True
        along = np.flatnonzero(motion.held[:, faces].any(axis=1))
        ends = [0, *motion.knots.tolist(), N]
        for phase in along.tolist():
            is_touched[ends[phase] : ends[phase + 1] + 1, faces] = True
    lacks[is_touched[1:] | is_touched[:-1]] = 0.0
    found = np.zeros((N + 1, m))
    found[:-1] = lacks
    found[1:] = np.maximum(found[1:], lacks)
    return np.where(is_touched, 0.0, np.maximum(found, 0.0))


def _find_dips(world: World, times: Floats, positions: Floats) -> Iterator[Dip]:
    """Yields of each stretch inside of a solid where it is deepest; by time."""
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


def _look_between(world: World, motion: BouncingResult) -> tuple[Floats, Floats]:
    """Returns times (N, K) and positions (N, K, n) between knots."""
    q, start, bend, twist = (each[:, np.newaxis] for each in _find_cubics(world, motion))
    s, h = _LOOKS[:, np.newaxis], np.diff(motion.times)[:, np.newaxis]
    positions = q + s * (start + s * (bend + s * twist))
    return motion.times[:-1, np.newaxis] + _LOOKS * h, positions


def _find_cubics(world: World, motion: ShootingResult) -> tuple[Floats, Floats, Floats, Floats]:
    """Returns positions as coefficients of powers of the part of a step, shape (N, n) each."""
    n, h = world.num_positions, np.diff(motion.times)[:, np.newaxis]
    q = motion.states[:, :n]
    start, end = (h * slopes for slopes in _find_slopes(world, motion))
    way = np.diff(q, axis=0)
    return q[:-1], start, 3 * way - 2 * start - end, start + end - 2 * way


def _find_slopes(world: World, motion: ShootingResult) -> tuple[Floats, Floats]:
    """Returns the velocities at the start and the end of each step, shape (N, n) each.

    Before a bounce, that is the slope of a parabola.
    """
    n, h = world.num_positions, np.diff(motion.times)[:, np.newaxis]
    q, v = motion.states[:, :n], motion.states[:, n:]
    end = v[1:].copy()
    if isinstance(motion, BouncingResult):
        bounces = motion.hits - 1
        end[bounces] = 2 * (np.diff(q, axis=0) / h)[bounces] - v[:-1][bounces]
    return v[:-1], end
