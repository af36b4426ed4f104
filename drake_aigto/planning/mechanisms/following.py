"""Strokes of hands, and a controller that follows them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.errors import TrajectoryError
from drake_aigto.simulation import Compliant, Controller, Held
from drake_aigto.world import SpaceWorld

_TRACKING = 0.5  # Hands follow their paths at this frequency, in steps [rad].
_SINGULAR = 1e-3  # Singular values below this part of the largest one are none.
# Strokes that lose objects, or move them by less than this part of what they promise, are followed
# by another try; the most tries of a stroke, and by how much grasps of these differ, in units.
_KEPT, _TRIES, _APART = 0.5, 4, 0.1

Pairs: TypeAlias = tuple[int, ...]  # Contacts, by their numbers.
# How good they are, positions while they push, and contacts; the best last.
Grasps: TypeAlias = list[tuple[float, list[Floats], Pairs]]


class Grasp(NamedTuple):
    """Hands at an object that they may push: how good that is at most, q, and which contacts push.

    It is best where hands come by a short way, without collisions, and push it all of its way to
    its goal: by the straight one, or as they can.
    """

    most: float
    positions: Floats
    contacts: Pairs
    is_straight: bool


class Stroke(NamedTuple):
    """Positions of hands at knots, (N + 1, nq), which contacts push then, and where it ends."""

    positions: Floats
    contacts: list[Pairs]
    end: int


class Strokes(Protocol):
    """What finds strokes, and the forces that push in them (`Reaches`)."""

    world: SpaceWorld
    must_carry: bool
    hurries: bool
    hand_unit: Floats

    def find_stroke(
        self,
        start: Floats,
        count: int,
        share: float,
        rng: np.random.Generator,
        last: Pairs = (),
        ready: Grasps | None = None,
    ) -> Stroke:
        """Returns a stroke from q at the start; takes the best of grasps that are ready there."""

    def is_lost(self, q: Floats, contacts: Pairs) -> bool:
        """Returns whether some contacts that should touch are far from it."""

    def measure_left(self, q: Floats) -> float:
        """Returns how far objects are from their goal."""

    def calc_push(self, q: Floats, wanted: Floats, contacts: Pairs) -> tuple[Floats, float]:
        """Returns the forces of contacts that come nearest to those on objects."""


class Following(Controller):
    """Drives hands along strokes, by computed torques; `controls` are those that it has held.

    Each stroke begins where those before it have led. While hands push, they have the forces at
    their touches, too, that best move the object along as asked. What it needs at rest, its weight,
    they carry if it leaves the ground, which answers that elsewhere. Then they go along with the
    object itself, stroke by stroke, and what they lose ends the motion; else, where each moment
    counts, one stroke does.

    Attributes:
        controls: that were held, shape (N, nu).
        states: q and v at the knots before, shape (N, nq + nv).
        promised: where the last stroke ends, q (nq,).
    """

    def __init__(
        self,
        reaches: Strokes,
        times: Floats,
        share: float,
        bounds: Floats,
        rng: np.random.Generator,
        ready: Grasps,
    ) -> None:
        """Takes knots (N + 1,) [s], the share of strokes to reach in, and bounds (2, nu).

        The first stroke takes the best grasp that is ready, or draws some, and leaves the others.
        """
        self.start, self.end = times[[0, -1]].tolist()
        self.controls = np.zeros((len(times) - 1, reaches.world.num_actuators))
        size = reaches.world.num_positions + reaches.world.num_velocities
        self.states, self.promised = np.zeros((len(times) - 1, size)), np.empty(0)
        self._reaches, self._times, self._share = reaches, times, share
        self._bounds, self._rng, self._ready = bounds, rng, ready
        self._begin, self._stroke = 0, Stroke(np.empty(0), [()], 0)

    @property
    def is_done(self) -> bool:
        """Whether hands did not lose what they carry until the last time."""
        return self.end == self._times[-1]

    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        """Returns the controls that are held until the next knot."""
        world, row = self._reaches.world, int(np.searchsorted(self._times, time, side="right")) - 1
        (q, v), h = world.split(x), self._times[row + 1] - self._times[row]
        self.states[row] = x
        if row >= self._begin + self._stroke.end:
            left, last = len(self._times) - 1 - row, self._stroke.contacts[self._stroke.end - 1]
            self._begin = row
            others = self._share, self._rng, last, None if row else self._ready
            self._stroke = self._reaches.find_stroke(q, left, *others)
            self.promised = self._stroke.positions[-1]
            if self._reaches.hurries:
                self.end = float(self._times[row + self._stroke.end])
        k, (positions, contacts, _) = row - self._begin, self._stroke
        if self._reaches.must_carry and self._reaches.is_lost(q, contacts[k]):
            self.end, self.controls[row:] = time, self.controls[row - 1]
            return Held(self.controls[row], float(self._times[row + 1]))
        pace = _TRACKING / h
        speed = world.subtract(positions[k + 1], positions[k]) / h
        asked = pace**2 * world.subtract(positions[k], q) + 2 * pace * (speed - v)
        if contacts[k] and self._reaches.must_carry:
            asked = self._go_along(q, v, asked, contacts[k], pace)
        # Springs and dampers of servos, stiffer than steps resolve, are those at the step's end.
        then = v + h * asked
        bias = world.calc_bias(world.add(q, h * then), then)
        force = world.calc_mass_matrix(q) @ asked + bias
        if contacts[k]:
            weight = world.calc_bias(q, 0 * v) * (not self._reaches.must_carry)
            force -= self._reaches.calc_push(q, force - weight, contacts[k])[0]
        self.controls[row] = np.clip(world.inverse_actuation @ force, *self._bounds)
        return Held(self.controls[row], float(self._times[row + 1]))

    def _go_along(
        self, q: Floats, v: Floats, asked: Floats, contacts: Pairs, pace: float
    ) -> Floats:
        """Returns accelerations with which hands go along with the object that they touch.

        They are nearest to those that are asked for, (nv,), and end gaps at a pace [rad/s].
        """
        rows, (distances, normals, jacobians) = list(contacts), self._reaches.world.relate(q)
        gaps = normals[rows] * np.maximum(distances[rows, np.newaxis], 0.0)
        unit, way = self._reaches.hand_unit, asked + 2 * pace * v
        return asked + unit * answer_way(jacobians[rows], way, pace**2 * gaps, unit)[2]


class _Tried(NamedTuple):
    """A stroke of hands that was simulated."""

    following: Following
    x: Floats  # where it leads to, shape (nq + nv,)
    rank: float  # time until hands lose what they carry, negative; or how far objects are then


def follow_strokes(
    reaches: Strokes,
    dynamics: Compliant,
    x: Floats,
    asked: tuple[Floats, float, Floats],
    rng: np.random.Generator,
) -> tuple[Floats, Floats | None]:
    """Returns controls (N, nu) of strokes from a state, and the states at knots, (N + 1, nq + nv).

    These are None if hands lose what they carry.

    Args:
        reaches: finds strokes.
        dynamics: that simulate them.
        x: q and v at the start, shape (nq + nv,).
        asked: times, the share, and bounds, as `Following` takes them.
        rng: of strokes.

    Raises:
        TrajectoryError: all tries of a stroke run away.
    """
    (times, share, bounds), row, states = asked, 0, [x]
    controls = np.zeros((len(times) - 1, reaches.world.num_actuators))
    while row < len(controls):
        best = _try(reaches, dynamics, states[-1], (times[row:], share, bounds), rng)
        if reaches.must_carry and not best.following.is_done:
            controls[row:] = best.following.controls
            return controls, None
        last = int(np.searchsorted(times, best.following.end))
        controls[row:last] = best.following.controls[: last - row]
        states[-1:] = [*best.following.states[: last - row], best.x]
        row = last
    return controls, np.array(states)


def _try(
    reaches: Strokes,
    dynamics: Compliant,
    x: Floats,
    asked: tuple[Floats, float, Floats],
    rng: np.random.Generator,
) -> _Tried:
    """Returns the best of a few strokes from a state, or the first that does as it should.

    Arguments are those of `follow_strokes`, as for what it raises.
    """
    tried, ready = list[_Tried](), Grasps()
    before = reaches.measure_left(reaches.world.split(x)[0])
    for number in range(_TRIES):
        following = Following(reaches, *asked, rng, ready if reaches.must_carry else [])
        try:
            then = dynamics.lead(x, following)
        except TrajectoryError:
            if not reaches.hurries or (number == _TRIES - 1 and not tried):
                raise
            continue
        assert then is not None, "it may touch"
        left = reaches.measure_left(reaches.world.split(then)[0])
        tried.append(_Tried(following, then, -following.end if reaches.must_carry else left))
        promised = before - reaches.measure_left(following.promised)
        if left < before - _KEPT * promised if reaches.hurries else following.is_done:
            break
    return min(tried, key=lambda each: each.rank)


def take_best(ready: Grasps, world: SpaceWorld, unit: Floats) -> tuple[list[Floats], Pairs]:
    """Returns the best of grasps that are ready, if any; those near it are ready no more."""
    if not ready:
        return [], ()
    _, pushed, contacts = ready.pop()
    off = [np.abs(world.subtract(path[0], pushed[0]) / unit) for _, path, _ in ready]
    ready[:] = [each for each, by in zip(ready, off, strict=True) if np.max(by) > _APART]
    return pushed, contacts


def find_edges(normal: Floats, friction: float) -> Floats:
    """Returns edges of a contact's cone of friction, (4, 3), or its normal, (1, 3)."""
    if friction == 0:
        return normal[np.newaxis]
    across = np.linalg.svd(normal[np.newaxis])[2][1:]
    return normal + friction * np.vstack([across, -across])


def answer_way(
    slopes: Floats, way: Floats, gaps: Floats, unit: Floats
) -> tuple[Floats, Floats, Floats]:
    """Returns how far touches are off after a way, slopes of that by hands, and hands' answer.

    Args:
        slopes: of the touches, (K, 3, nv).
        way: of objects, (nv,).
        gaps: of the touches before it, (K, 3).
        unit: units of hands' positions, (nv,), in which they move the least that takes away what
            is off.
    """
    J = slopes.reshape(-1, len(way))
    off, by_hand = J @ way + gaps.ravel(), J * unit
    moved, *_ = np.linalg.lstsq(by_hand, -off, rcond=_SINGULAR)
    return off, by_hand, np.asarray(moved, dtype=float)
