"""Motions of hands that push objects: the object's path, then the hand's, then its simulation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy  # Not scipy.optimize, which takes a tenth of a second and few need.

from drake_aigto.arrays import Floats
from drake_aigto.contact import CompliantLaw
from drake_aigto.simulation import Compliant, CompliantMotion, Held, HeldControl
from drake_aigto.world import SpaceWorld, TaskCost

# Configurations of which the one is taken that pushes the object the best way along; powers of ten
# of their distances from the nearest touch, in units.
_SAMPLES, _SPREAD = 20, (-1.5, 0.3)
# Parts of the way to a touch at which it is looked at; prices of collisions there, in units, and of
# its distance.
_LOOKS, _COLLISION, _DISTANCE = np.linspace(0.2, 1.0, 5), 3.0, 0.1
# Parts of an object's way, strokes of it at most, and how much of each part a hand may slip; parts
# of the way to a touch.
_PARTS, _MOST_STROKES, _SLIP, _ROUND = 32, 4, 0.5, np.linspace(0.0, 1.0, 9)
# Newton steps to a touch, the longest in units, how near to its shape they end in theirs, and how
# near touches are.
_NEWTON, _LONGEST, _TOUCHES, _NEAR = 12, 0.5, 1e-6, 1e-3
# Singular values below this part of the largest one are none.
_SINGULAR = 1e-3
# Hands that push at once, at most; the part of friction that they use.
_MOST_HANDS, _INSIDE = 2, 0.7
_NOTHING = 1e-300  # No size is below.
# Hands follow their paths at this frequency, in steps [rad]; the tolerance of their simulation.
_TRACKING, _TOLERANCE = 0.5, 1e-6


class _Stroke(NamedTuple):
    """Positions of a reach, and of the push that follows, (K, nq) each, and its contacts."""

    reached: Floats
    pushed: Floats
    contacts: tuple[int, ...]


class Path(NamedTuple):
    """Positions at knots, shape (N + 1, nq), and the contacts at which hands push after each."""

    positions: Floats
    contacts: list[tuple[int, ...]]


class _Following(HeldControl):
    """Drives hands along a path, by computed torques; `controls` are those that it has held.

    While hands push, they have the forces at their touches, too, that best move the object along as
    asked, but for what the object needs at rest, as the ground under it answers that.
    """

    is_open_loop = False

    def __init__(self, reaches: Reaches, times: Floats, path: Path, bounds: Floats) -> None:
        super().__init__(times, np.zeros((len(times) - 1, reaches.world.num_actuators)))
        self._reaches, self._path, self._bounds = reaches, path, bounds

    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        world, k = self._reaches.world, int(np.searchsorted(self.times, time, side="right")) - 1
        (q, v), h = world.split(x), self.times[k + 1] - self.times[k]
        pace, (positions, contacts) = _TRACKING / h, self._path
        speed = world.subtract(positions[k + 1], positions[k]) / h
        asked = pace**2 * world.subtract(positions[k], q) + 2 * pace * (speed - v)
        # Springs and dampers of servos, stiffer than steps resolve, are those at the step's end.
        then = v + h * asked
        bias = world.calc_bias(world.add(q, h * then), then)
        force = world.calc_mass_matrix(q) @ asked + bias
        if contacts[k]:
            force -= self._reaches.calc_push(q, force - world.calc_bias(q, 0 * v), contacts[k])[0]
        self.controls[k] = np.clip(world.inverse_actuation @ force, *self._bounds)
        return Held(self.controls[k], float(self.times[k + 1]))


def _find_edges(normal: Floats, friction: float) -> Floats:
    """Returns edges of a contact's cone of friction, (4, 3), or its normal, (1, 3)."""
    if friction == 0:
        return normal[np.newaxis]
    across = np.linalg.svd(normal[np.newaxis])[2][1:]
    return normal + _INSIDE * friction * np.vstack([across, -across])


class Reaches:
    """Motions in which a hand reaches for an object, and pushes it towards its goal.

    Hands are moved by actuators, objects are not. Of random configurations in which one hand or
    several touch an object they reach the one in which they push it the best way along,

        min ‖W M⁻¹ Jᵀ f − W Δ‖,   f in its cone of friction,

    with Δ the object's way to its goal and W² its weights there. From there on they stick to the
    object, which goes its way: J_hand δ_hand = −J_object δ_object − n φ, with J of the velocity of
    the hand's material relative to the object's, and n the normal. Where they can't follow, some
    reach anew. Hands are simulated along this path, so that what they do to the object
    is what contact does.

    Attributes:
        world: has hands and objects.
        contacts: of hands with objects that have a goal.
    """

    def __init__(
        self, world: SpaceWorld, law: CompliantLaw, cost: TaskCost, unit: Floats, limits: Floats
    ) -> None:
        """Takes the law of contact, the cost, units of positions (nv,), and limits (2, nv)."""
        self._limits = limits
        self.world, self._law, self._cost, self._unit = world, law, cost, unit
        self._driven = np.any(world.actuation != 0, axis=1)
        self._length = float(np.max(unit[~world.turns], initial=0.0)) or float(np.max(unit))
        weights = cost.QT.diagonal() if cost.QT.any() else np.ones(len(unit))
        self._root = np.where(self._driven, 0.0, np.sqrt(weights))
        signs = np.empty_like(self.world.signs)
        signs[:, self.world.tree.velocities] = self.world.signs
        sides = np.stack([signs > 0, signs < 0])
        are_hands = sides.any(axis=2) & ~np.any(sides & ~self._driven, axis=2)
        are_objects = np.any(sides & (self._root > 0), axis=2)
        are_objects &= ~np.any(sides & self._driven, axis=2)
        self._hands = (signs != 0) & self._driven  # that a contact has, shape (m, nv)
        self._is_moved = np.any(self._hands, axis=1)
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
        follows = _Following(self, times, path, bounds)
        dynamics = Compliant(self.world, self._law)
        CompliantMotion(dynamics, state, float(times[0]), _TOLERANCE).run(follows)
        return follows.controls

    def find_path(
        self, times: Floats, start: Floats, stretch: tuple[float, float], rng: np.random.Generator
    ) -> Path:
        """Returns what `push` follows from q at the start (nq,)."""
        clock, (begin, end) = float(times[0]), stretch
        strokes = self._find_strokes(start, rng)
        total = sum(len(each.pushed) - 1 for each in strokes)
        path = np.tile(start, (len(times), 1))
        contacts: list[tuple[int, ...]] = [()] * len(times)
        none: tuple[int, ...] = ()
        for each in strokes:
            pushes = (end - begin) * (len(each.pushed) - 1) / total
            reaches = (begin - times[0]) / len(strokes)
            for rows, lasts, by in (
                (each.reached, reaches, none),
                (each.pushed, pushes, each.contacts),
            ):
                s = np.clip((times - clock) / lasts, 0.0, 1.0)
                at = s * s * (3 - 2 * s) * (len(rows) - 1)
                k = np.minimum(at.astype(int), len(rows) - 2)
                part = (at - k)[:, np.newaxis] * self.world.subtract(rows[k + 1], rows[k])
                path = np.where(times[:, np.newaxis] > clock, self.world.add(rows[k], part), path)
                for row in np.flatnonzero((times >= clock) & (times < clock + lasts)):
                    contacts[row] = by
                clock += lasts
        return Path(path, contacts)

    def _find_strokes(self, q: Floats, rng: np.random.Generator) -> list[_Stroke]:
        """Returns strokes; each ends where hands can't follow the object, then some reach anew."""
        strokes, way, left = list[_Stroke](), self._find_way(q) / _PARTS, _PARTS
        for _ in range(_MOST_STROKES):
            pushed, contacts = self._reach(q, way, left, rng)
            if len(pushed) > 1:
                strokes.append(_Stroke(self._go_round(q, pushed[0]), np.array(pushed), contacts))
                q, left = pushed[-1], left - (len(pushed) - 1)
            if not left:
                break
        return strokes

    def _find_way(self, q: Floats) -> Floats:
        """Returns the way of objects to their goal."""
        return np.where(self._root > 0, -self._cost.goal_errors(q), 0.0)

    def _go_round(self, q: Floats, touch: Floats) -> Floats:
        """Returns positions from some to others, moved out of what hands would run into."""
        path = self.world.add(q, np.outer(_ROUND, self.world.subtract(touch, q)))
        for row in range(1, len(path) - 1):
            for _ in range(_NEWTON):
                distances = np.where(
                    self._is_moved, self.world.calc_signed_distance(path[row]), 0.0
                )
                if np.min(distances) > -_NEAR * self._length:
                    break
                path[row] = self._touch(path[row], (int(np.argmin(distances)),))
        return path

    def calc_push(
        self, q: Floats, wanted: Floats, contacts: tuple[int, ...]
    ) -> tuple[Floats, float]:
        """Returns Jᵀ f of contacts that comes nearest to a generalized force on objects.

        It is nearest in accelerations by the roots of their weights, with forces f within cones of
        friction, of four edges each. The second result is how far off it is there.
        """
        normals, jacobians = self.world.relate(q)
        edges = np.vstack(
            [_find_edges(normals[i], self._law.friction[i]) @ jacobians[i] for i in contacts]
        )
        by_force = self._root[:, np.newaxis] * np.linalg.inv(self.world.calc_mass_matrix(q))
        by_force *= ~self._driven
        shares, off = scipy.optimize.nnls(by_force @ edges.T, by_force @ wanted)
        return edges.T @ shares, float(off)

    def _draw_contacts(self, rng: np.random.Generator) -> tuple[int, ...]:
        """Returns contacts of one hand, or of several that move independently."""
        drawn, most = list[int](), int(rng.integers(1, 1 + _MOST_HANDS))
        moved = np.zeros(len(self._unit), dtype=bool)
        for contact in rng.permutation(self.contacts):
            if len(drawn) < most and not np.any(moved & self._hands[contact]):
                drawn.append(int(contact))
                moved |= self._hands[contact]
        return tuple(drawn)

    def _reach(
        self, start: Floats, way: Floats, most: int, rng: np.random.Generator
    ) -> tuple[list[Floats], tuple[int, ...]]:
        """Returns positions of touches that push the object along a way, that often at most.

        Also returns their contacts.
        """
        world, best = self.world, (-np.inf, list[Floats](), tuple[int, ...]())
        nearest, size = world.calc_signed_distance(start), np.linalg.norm(self._root * way)
        for _ in range(_SAMPLES):
            contacts = self._draw_contacts(rng)
            q = self._touch(self._draw_pose(self._touch(start, contacts), contacts, rng), contacts)
            there = world.subtract(q, start)
            distances = world.calc_signed_distance(world.add(start, np.outer(_LOOKS, there)))
            is_near = np.all(np.abs(distances[-1, contacts]) < _NEAR * self._length)
            if is_near and not self._find_excess(q).any():
                pushed = self._follow(q, way, most, contacts)
                inside = float(np.sum(np.minimum(distances - np.minimum(nearest, 0.0), 0.0)))
                off = self.calc_push(q, world.calc_mass_matrix(q) @ way, contacts)[1]
                value = len(pushed) / most - off / max(float(size), _NOTHING)
                value += _COLLISION * inside / self._length
                value -= _DISTANCE * float(np.linalg.norm(there / self._unit))
                best = max(best, (value, pushed, contacts), key=lambda each: each[0])
        return best[1:]

    def _draw_pose(self, q: Floats, contacts: tuple[int, ...], rng: np.random.Generator) -> Floats:
        """Returns random positions of contacts' hands: near some, or within limits of joints."""
        size = 10 ** rng.uniform(*_SPREAD) * self._unit
        moved = size * rng.normal(size=len(size))
        if rng.integers(2):
            is_limited = np.isfinite(self._limits).all(axis=0)
            at = self.world.in_tangent(q, np.zeros(1))
            moved[is_limited] = rng.uniform(*self._limits[:, is_limited]) - at[is_limited]
        return self.world.add(q, moved * np.any(self._hands[list(contacts)], axis=0))

    def _follow(self, q: Floats, way: Floats, most: int, contacts: tuple[int, ...]) -> list[Floats]:
        """Returns positions from some on while hands stick to an object that goes a way."""
        pushed = [q]
        while len(pushed) <= most and (then := self._stick(pushed[-1], way, contacts)) is not None:
            pushed.append(then)
        return pushed

    def _touch(self, q: Floats, contacts: tuple[int, ...]) -> Floats:
        """Returns positions in which hands touch, by Newton steps from others, one by one."""
        for contact in contacts:
            for _ in range(_NEWTON):
                off = float(self.world.calc_signed_distance(q)[contact])
                if abs(off) < _TOUCHES * self._length:
                    break
                J = self.world.calc_contact_jacobian(q)[contact] * self._driven
                towards = self._unit**2 * J
                step = -off * towards / max(J @ towards, _NOTHING)
                longest = float(np.max(np.abs(step) / self._unit))
                q = self.world.add(q, step * min(1.0, _LONGEST / max(longest, _NOTHING)))
                q = self.world.add(q, -self._find_excess(q))
        return q

    def _stick(self, q: Floats, way: Floats, contacts: tuple[int, ...]) -> Floats | None:
        """Returns positions in which the object has moved, and hands with it; None: they can't."""
        rows, (normals, jacobians) = list(contacts), self.world.relate(q)
        gaps = normals[rows] * self.world.calc_signed_distance(q)[rows, np.newaxis]
        J = jacobians[rows].reshape(-1, len(way))
        off, by_hand = J @ way + gaps.ravel(), J * (self._unit * self._driven)
        moved = np.linalg.lstsq(by_hand, -off, rcond=_SINGULAR)[0]
        slip = np.linalg.norm(by_hand @ moved + off)
        q = self.world.add(q, way + self._unit * moved)
        is_far = np.max(np.abs(moved)) > _LONGEST or slip > _SLIP * np.linalg.norm(off)
        return None if is_far or self._find_excess(q).any() else q

    def _find_excess(self, q: Floats) -> Floats:
        """Returns by how much hands are beyond the limits of their joints, shape (nv,)."""
        at = self.world.in_tangent(q, np.zeros(1))
        return np.where(self._driven, at - np.clip(at, *self._limits), 0.0)
