"""Strokes of hands, and a controller that follows them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.simulation import Controller, Held
from drake_aigto.world import SpaceWorld

_TRACKING = 0.5  # Hands follow their paths at this frequency, in steps [rad].
_SINGULAR = 1e-3  # Singular values below this part of the largest one are none.

Pairs: TypeAlias = tuple[int, ...]  # Contacts, by their numbers.


class Stroke(NamedTuple):
    """Positions of hands at knots, (N + 1, nq), which contacts push then, and where it ends."""

    positions: Floats
    contacts: list[Pairs]
    end: int


class Strokes(Protocol):
    """What finds strokes, and the forces that push in them (`Reaches`)."""

    world: SpaceWorld
    must_carry: bool
    hand_unit: Floats

    def find_stroke(
        self, start: Floats, count: int, share: float, rng: np.random.Generator, last: Pairs = ()
    ) -> Stroke:
        """Returns a stroke from q at the start."""

    def is_lost(self, q: Floats, contacts: Pairs) -> bool:
        """Returns whether some contacts that should touch are far from it."""

    def calc_push(self, q: Floats, wanted: Floats, contacts: Pairs) -> tuple[Floats, float]:
        """Returns the forces of contacts that come nearest to those on objects."""


class Following(Controller):
    """Drives hands along strokes, by computed torques; `controls` are those that it has held.

    Each stroke begins where those before it have led. While hands push, they have the forces at
    their touches, too, that best move the object along as asked. What it needs at rest, its weight,
    they carry if it leaves the ground, which answers that elsewhere. Then they go along with the
    object itself, and what they lose ends the motion.
    """

    def __init__(
        self,
        reaches: Strokes,
        times: Floats,
        share: float,
        bounds: Floats,
        rng: np.random.Generator,
    ) -> None:
        """Takes knots (N + 1,) [s], the share of strokes to reach in, and bounds (2, nu)."""
        self.start, self.end = times[[0, -1]].tolist()
        self.controls = np.zeros((len(times) - 1, reaches.world.num_actuators))
        self._reaches, self._times, self._share = reaches, times, share
        self._bounds, self._rng = bounds, rng
        self._begin, self._stroke = 0, Stroke(np.empty(0), [()], 0)

    @property
    def is_done(self) -> bool:
        """Whether hands did not lose what they carry until the last time."""
        return self.end == self._times[-1]

    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        """Returns the controls that are held until the next knot."""
        world, row = self._reaches.world, int(np.searchsorted(self._times, time, side="right")) - 1
        (q, v), h = world.split(x), self._times[row + 1] - self._times[row]
        if row >= self._begin + self._stroke.end:
            left, last = len(self._times) - 1 - row, self._stroke.contacts[self._stroke.end - 1]
            self._begin = row
            self._stroke = self._reaches.find_stroke(q, left, self._share, self._rng, last)
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
