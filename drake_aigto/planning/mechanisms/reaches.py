"""Motions of hands that push objects: the object's path, then the hand's, then its simulation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import CompliantLaw
from drake_aigto.simulation import Compliant, CompliantMotion, Held, HeldControl
from drake_aigto.world import SpaceWorld, TaskCost

# Configurations of which the one is taken that pushes the object the best way along; powers of ten
# of their distances from the nearest touch, in units.
_SAMPLES, _SPREAD = 12, (-1.5, 0.3)
# Parts of the way to a touch at which it is looked at; prices of collisions there, in units, and of
# its distance.
_LOOKS, _COLLISION, _DISTANCE = np.linspace(0.2, 1.0, 5), 3.0, 0.1
# Newton steps to a touch, the longest in units, and how near a touch is to its shape, in theirs.
_NEWTON, _LONGEST, _NEAR = 12, 0.5, 1e-3
# Singular values below this part of the largest one are none.
_SINGULAR = 1e-3
_NOTHING = 1e-300  # No size is below.
# Hands follow their paths at this frequency, in steps [rad]; the tolerance of their simulation.
_TRACKING, _TOLERANCE = 0.5, 1e-6


class _Following(HeldControl):
    """Drives hands along a path, by computed torques; `controls` are those that it has held."""

    is_open_loop = False

    def __init__(self, world: SpaceWorld, times: Floats, path: Floats, bounds: Floats) -> None:
        super().__init__(times, np.zeros((len(times) - 1, world.num_actuators)))
        self._world, self._path, self._bounds = world, path, bounds
        self._driven = np.any(world.actuation != 0, axis=1)

    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        world, k = self._world, int(np.searchsorted(self.times, time, side="right")) - 1
        (q, v), h = world.split(x), self.times[k + 1] - self.times[k]
        pace = _TRACKING / h
        speed = world.subtract(self._path[k + 1], self._path[k]) / h
        asked = pace**2 * world.subtract(self._path[k], q) + 2 * pace * (speed - v)
        force = world.calc_mass_matrix(q) @ (asked * self._driven) + world.calc_bias(q, v)
        self.controls[k] = np.clip(world.inverse_actuation @ force, *self._bounds)
        return Held(self.controls[k], float(self.times[k + 1]))


class Reaches:
    """Motions in which a hand reaches for an object, and pushes it towards its goal.

    Hands are moved by actuators, objects are not. Of random configurations in which a hand touches
    an object it reaches the one in which it pushes the object the best way along,

        max (W Δ)ᵀ W M⁻¹ Jᵀ / ‖W M⁻¹ Jᵀ‖

    with Δ the object's way to its goal and W² its weights there. From there on it sticks to the
    object, which goes its way: J_hand δ_hand = −J_object δ_object − n φ, with J of the velocity of
    the hand's material relative to the object's, and n the normal. The hand is simulated along this
    path, so that what it does to the object is what contact does.

    Attributes:
        contacts: of hands with objects that have a goal.
    """

    def __init__(self, world: SpaceWorld, law: CompliantLaw, cost: TaskCost, unit: Floats) -> None:
        """Takes the law of contact, the cost, and units of positions (nv,)."""
        self._world, self._law, self._cost, self._unit = world, law, cost, unit
        self._driven = np.any(world.actuation != 0, axis=1)
        self._length = float(np.max(unit[~world.turns], initial=0.0)) or float(np.max(unit))
        weights = cost.QT.diagonal() if cost.QT.any() else np.ones(len(unit))
        self._root = np.where(self._driven, 0.0, np.sqrt(weights))
        signs = np.empty_like(self._world.signs)
        signs[:, self._world.tree.velocities] = self._world.signs
        sides = np.stack([signs > 0, signs < 0])
        are_hands = sides.any(axis=2) & ~np.any(sides & ~self._driven, axis=2)
        are_objects = np.any(sides & (self._root > 0), axis=2)
        are_objects &= ~np.any(sides & self._driven, axis=2)
        self.contacts = np.flatnonzero((are_hands & are_objects[::-1]).any(axis=0))

    def push(
        self,
        times: Floats,
        state: tuple[Floats, Floats],
        stretch: tuple[float, float],
        bounds: Floats,
        rng: np.random.Generator,
    ) -> Floats:
        """Returns controls (N, nu) of a hand that reaches for an object, and pushes it on.

        Args:
            times: of knots, shape (N + 1,) [s].
            state: q and v at the first of them.
            stretch: when it begins and ends to push [s].
            bounds: of controls, shape (2, nu).
            rng: of what is drawn.

        Raises:
            TrajectoryError: the motion runs away.
        """
        path = self.find_path(times, state[0], stretch, rng)
        follows = _Following(self._world, times, path, bounds)
        dynamics = Compliant(self._world, self._law)
        CompliantMotion(dynamics, state, float(times[0]), _TOLERANCE).run(follows)
        return follows.controls

    def find_path(
        self, times: Floats, start: Floats, stretch: tuple[float, float], rng: np.random.Generator
    ) -> Floats:
        """Returns positions, shape (N + 1, nq), that `push` follows from q at the start (nq,)."""
        begin, end = stretch
        way = np.where(self._root > 0, -self._cost.goal_errors(start), 0.0)
        q, contact = self._reach(start, way, rng)
        hand = self._world.subtract(q, start)
        first = times[0]
        parts = [(times - first) / (begin - first), (times - begin) / (end - begin)]
        s = np.clip(parts, 0.0, 1.0)
        reached, pushed = s * s * (3 - 2 * s)
        path = self._world.add(start, np.outer(reached, hand))
        for k in np.flatnonzero(times > begin):
            q = self._stick(q, (pushed[k] - pushed[k - 1]) * way, contact)
            path[k] = q
        return path

    def _reach(self, start: Floats, way: Floats, rng: np.random.Generator) -> tuple[Floats, int]:
        """Returns positions of a touch that pushes the object along, and its contact."""
        world, best = self._world, (-np.inf, start, int(self.contacts[0]))
        nearest, asked = world.calc_signed_distance(start), self._root * way
        asked = asked / max(float(np.linalg.norm(asked)), _NOTHING)
        for _ in range(_SAMPLES):
            contact = int(rng.choice(self.contacts))
            size = 10 ** rng.uniform(*_SPREAD) * self._unit * self._driven
            moved = world.add(self._touch(start, contact), size * rng.normal(size=len(size)))
            q = self._touch(moved, contact)
            there = world.subtract(q, start)
            ways = world.add(start, np.outer(_LOOKS, there))
            distances, J = world.calc_signed_distance(ways), world.calc_contact_jacobian(q)[contact]
            if abs(distances[-1, contact]) < _NEAR * self._length:
                inside = float(np.sum(np.minimum(distances - np.minimum(nearest, 0.0), 0.0)))
                pushed = self._root * np.linalg.solve(world.calc_mass_matrix(q), J * ~self._driven)
                value = float(asked @ pushed) / max(float(np.linalg.norm(pushed)), _NOTHING)
                value += _COLLISION * inside / self._length
                value -= _DISTANCE * float(np.linalg.norm(there / self._unit))
                best = max(best, (value, q, contact), key=lambda each: each[0])
        return best[1], best[2]

    def _touch(self, q: Floats, contact: int) -> Floats:
        """Returns positions in which a hand touches, by Newton steps from others."""
        for _ in range(_NEWTON):
            J = self._world.calc_contact_jacobian(q)[contact] * self._driven
            towards = self._unit**2 * J
            step = (
                -self._world.calc_signed_distance(q)[contact] * towards / max(J @ towards, _NOTHING)
            )
            longest = float(np.max(np.abs(step) / self._unit))
            q = self._world.add(q, step * min(1.0, _LONGEST / max(longest, _NOTHING)))
        return q

    def _stick(self, q: Floats, way: Floats, contact: int) -> Floats:
        """Returns positions in which the object has moved, and the hand with it."""
        normals, J = self._world.relate(q)
        off = J[contact] @ way + normals[contact] * self._world.calc_signed_distance(q)[contact]
        by_hand = J[contact] * (self._unit * self._driven)
        moved = np.linalg.lstsq(by_hand, -off, rcond=_SINGULAR)[0]
        return self._world.add(q, way + self._unit * moved)
