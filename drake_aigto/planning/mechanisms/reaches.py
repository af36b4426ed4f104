"""Motions of hands that push objects: the object's path, then the hand's, then its simulation."""

from __future__ import annotations

from bisect import insort
from collections.abc import Iterator, Sequence
from operator import itemgetter

import numpy as np
import scipy  # Not scipy.optimize, which takes a tenth of a second and few need.

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.contact import CompliantLaw
from drake_aigto.planning.mechanisms.following import (
    Grasp,
    Grasps,
    Pairs,
    Stroke,
    answer_way,
    find_edges,
    follow_strokes,
    take_best,
)
from drake_aigto.simulation import Compliant
from drake_aigto.world import SpaceWorld, TaskCost

# Configurations of which the one is taken that pushes the object the best way along, or carries it;
# powers of ten of their distances from the nearest touch, in units.
_SAMPLES, _SPREAD = (20, 60), (-1.5, 0.3)
# Parts of the way to a touch at which it is looked at; prices of collisions there, in units, and of
# its distance.
_LOOKS, _COLLISION, _DISTANCE = np.linspace(0.2, 1.0, 5), 3.0, 0.1
# Parts of an object's way, how much of each a hand may slip, and the part of what is left that a
# part may be in the direction of it, at least; parts of the way to a touch.
_PARTS, _SLIP, _LEAST, _ROUND = 16, 0.5, 0.3, np.linspace(0.0, 1.0, 9)
# A stroke's part of the time that is left, in its part of the way that is; what is carried is held
# at its goal for the rest.
_HURRY = (0.5, 1.0), (0.35, 0.8)
# Newton steps to touches, the longest in units, the part of the largest singular value of slopes
# below which they count as zero, how near to shapes steps end in theirs, and how near touches are.
_NEWTON, _LONGEST, _SINGULAR, _TOUCHES, _NEAR = 12, 0.5, 1e-6, 1e-6, 1e-3
# Of hands that push, and that carry: how many do at once, at most; the part of friction they use.
_MOST_HANDS, _INSIDE = (2, 3), (0.7, 0.6)
# Grasps that carry are chosen by what part of the weight they drop with this part of friction, in
# some places on the way, at a price. The fewest that are ready to be tried: of those that push, the
# best one, and of those that carry.
_SAFE, _PLACES, _FALL, _NUM_READY = 0.4, 5, 3.0, (1, 12)
# In units: how far off hands keep on their way to them, how high they lift objects, and from how
# far they have lost them. Forces count by this part of the norm of all their effects.
_CLEAR, _LIFT, _LOST, _EVEN = 0.1, 0.2, 0.05, 1e-2
_NOTHING = 1e-300  # No size is below.
# Of the simulation of hands; more steps of it between knots are no motion.
_TOLERANCE, _MOST_STEPS = 1e-6, 5_000


class Reaches:
    """Motions in which a hand reaches for an object, and pushes it towards its goal.

    Hands are moved by actuators, objects are not. Of random configurations in which one hand or
    several touch an object they reach the one from which they push it nearest to its goal. The
    object goes as near to the way Δ that is left as these contacts can push it, by (M + T D)⁻¹ Jᵀ f
    against its inertia and its dampers D, with T the task's duration,

        min ‖W (M + T D)⁻¹ Jᵀ f − W Δ‖,   f in its cone of friction,

    W² the weights of the goal; or straight, as far as that is possible, where the ground helps.
    Hands stick to it: J_hand δ_hand = −J_object δ_object − n φ, with J of the velocity of the
    hand's material relative to the object's, and n the normal. That is a stroke. It is simulated,
    so that what hands do to the object is what contact does, and the next one begins where this
    led to: at touches sought anew, or of an object that would fall if they let go at the same ones.

    What hands must carry they lift at once, and take straight to its goal. Touches roll on what
    turns: those are best that carry its weight all of its way, with a small part of friction.

    Attributes:
        world: has hands and objects.
        contacts: of hands with objects that have a goal.
        must_carry: whether hands alone hold objects at their goal.
        hurries: whether they do not, and each moment costs that objects are not there; of hands on
            sliders alone, as for others it was not measured.
        hand_unit: units of hands' positions, 0 of others, shape (nv,).
    """

    def __init__(
        self,
        world: SpaceWorld,
        law: CompliantLaw,
        cost: TaskCost,
        unit: Floats,
        limits: Floats,
        duration: float,
    ) -> None:
        """Takes the law of contact, the cost, units of positions (nv,), limits (2, nv), and T."""
        self._limits, self._duration = limits, duration
        self.world, self._law, self._cost, self._unit = world, law, cost, unit
        self._driven = np.any(world.actuation != 0, axis=1)
        self.hand_unit = unit * self._driven
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
        is_moved = np.any(self._hands, axis=1)
        self._moved = np.flatnonzero(is_moved)
        self._supports = np.flatnonzero(~is_moved & are_objects.any(axis=0))
        self.contacts = np.flatnonzero((are_hands & are_objects[::-1]).any(axis=0))
        self.must_carry = len(self.contacts) > 0 and self.is_carried(cost.goal)
        is_early = len(self.contacts) > 0 and bool(np.any(cost.Q[~self._driven] > 0))
        is_measured = not np.any(world.turns & self._driven)
        self.hurries = is_early and is_measured and not self.must_carry

    def push(
        self,
        times: Floats,
        state: tuple[Floats, Floats],
        share: float,
        bounds: Floats,
        rng: np.random.Generator,
    ) -> tuple[Floats, Floats | None]:
        """Returns controls (N, nu) of hands that from q and v reach for an object, and push it.

        They reach in a share of the time to the last knot, of (N + 1,) [s], and push in the rest.
        Bounds of controls are (2, nu). The second result is where this leads to: states at knots,
        (N + 1, nq + nv); None if hands lose what they carry. They try anew then, a few times, and
        where a stroke moves an object by less than a part of what it should.

        Raises:
            TrajectoryError: the motion runs away.
        """
        dynamics = Compliant(self.world, self._law)
        dynamics.tolerance = _TOLERANCE
        if self.hurries:
            dynamics.most_steps = _MOST_STEPS
        return follow_strokes(self, dynamics, np.concatenate(state), (times, share, bounds), rng)

    def find_stroke(
        self,
        start: Floats,
        count: int,
        share: float,
        rng: np.random.Generator,
        last: Pairs = (),
        ready: Grasps | None = None,
    ) -> Stroke:
        """Returns a stroke from q at the start (nq,), within a count of even steps of time.

        It takes the part of them that it has of the way, or less, and hands reach in a share of it.
        Objects that are carried by the last contacts are held on. Hands take the best grasp that is
        ready; if none is, grasps are drawn, and others than the one taken are added for later.
        """
        near = self.world.calc_signed_distance(start)[list(last)] < _NEAR * self._length
        held = last if self.must_carry and near.all() and self.is_carried(start) else ()
        contacts, path = [held] * count, np.tile(start, (count + 1, 1))
        size = max(self.measure_left(start), _NOTHING)
        if held:
            pushed, by = self._follow(start, size / _PARTS, held, True), held
        else:
            pushed, by = self._reach(start, size, rng, [] if ready is None else ready)
        if len(pushed) < 2 or count < 2:
            return Stroke(path, contacts, count)
        left = self.measure_left(pushed[-1]) / size
        end = count * rng.uniform(*_HURRY[self.must_carry or self.hurries]) * (1 - left)
        then = int(np.clip(np.ceil(end), 2, count))
        middle = 1 if held else int(np.clip(share * then, 1, then - 1))
        reached = self.world.add(start, np.outer(_ROUND, self.world.subtract(pushed[0], start)))
        clear = np.outer(_ROUND * (1 - _ROUND), np.ones(len(self._moved)))
        clear *= 4 * _CLEAR * self._length * self.must_carry
        for row in range(1, len(reached) - 1):  # Out of what hands would run into.
            reached[row] = self._move_out(reached[row], self._moved, clear[row], self._driven)
        for rows, first, after in ((reached, 0, middle), (np.array(pushed), middle, then)):
            s = np.clip(np.arange(count + 1 - first) / (after - first), 0.0, 1.0)
            at = s * s * (3 - 2 * s) * (len(rows) - 1)
            k = np.minimum(at.astype(int), len(rows) - 2)
            part = (at - k)[:, np.newaxis] * self.world.subtract(rows[k + 1], rows[k])
            path[first:] = self.world.add(rows[k], part)
        contacts[middle:then] = [by] * (then - middle)
        return Stroke(path, contacts, then)

    def is_lost(self, q: Floats, contacts: Pairs) -> bool:
        """Returns whether some contacts that should touch are far from it."""
        distances = self.world.calc_signed_distance(q)[list(contacts)]
        return bool(np.any(distances > _LOST * self._length))

    def is_carried(self, q: Floats) -> bool:
        """Returns whether objects have weight, and hands alone may touch them."""
        weight = self.world.calc_bias(q, np.zeros(len(self._unit)))[~self._driven]
        distances = self.world.calc_signed_distance(q)[self._supports]
        return bool(weight.any() and np.all(distances > _NEAR * self._length))

    def measure_left(self, q: Floats) -> float:
        """Returns the length of the way that objects have left, by the roots of its weights."""
        return self._measure(self._find_way(q))

    def _measure(self, way: Floats) -> float:
        """Returns the length of an object's way, by the roots of its weights."""
        return float(np.linalg.norm(self._root * way))

    def _find_way(self, q: Floats) -> Floats:
        """Returns the way of objects to their goal."""
        return np.where(self._root > 0, -self._cost.goal_errors(q), 0.0)

    def _calc_inertia(self, q: Floats) -> Floats:
        """Returns M + T D, of dampers D and the task's duration T: what a lasting push works on."""
        return self.world.calc_mass_matrix(q) + self._duration * np.diag(self.world.damping)

    def _move_out(self, q: Floats, among: Ints, least: Floats, driven: Bools) -> Floats:
        """Returns positions in which some contacts are hardly nearer than the least distances."""
        for _ in range(_NEWTON):
            over = self.world.calc_signed_distance(q)[among] - least
            if np.min(over, initial=0.0) > -_NEAR * self._length:
                break
            nearest = int(np.argmin(over))
            q = self._touch(q, (int(among[nearest]),), driven, float(least[nearest]))
        return q

    def calc_push(
        self, q: Floats, wanted: Floats, contacts: Pairs, is_safe: bool = False
    ) -> tuple[Floats, float]:
        """Returns Jᵀ f of contacts that comes nearest to a generalized force on objects.

        It is nearest in accelerations by the roots of their weights, with forces f within cones of
        a part of friction, of four edges each. What carries is nearest in M⁻¹, as it can not turn
        objects at any price, and has small forces, which do not jump as hands move. The second
        result is how far off it is there.
        """
        _, normals, jacobians = self.world.relate(q)
        part = _SAFE if is_safe else _INSIDE[self.must_carry]
        cones = (find_edges(normals[i], part * self._law.friction[i]) for i in contacts)
        edges = np.vstack([each @ jacobians[i] for each, i in zip(cones, contacts, strict=True)])
        by_force = np.linalg.inv(self._calc_inertia(q))
        if self.must_carry:
            by_force = np.linalg.cholesky(by_force).T * (self._root > 0)
        else:
            by_force *= self._root[:, np.newaxis] * ~self._driven
        rows, wanted = by_force @ edges.T, by_force @ wanted
        if self.must_carry:
            rows = np.vstack([rows, _EVEN * np.linalg.norm(rows) * np.eye(len(edges))])
            wanted = np.append(wanted, np.zeros(len(edges)))
        shares, off = scipy.optimize.nnls(rows, wanted)
        return edges.T @ shares, float(off)

    def _calc_fall(self, pushed: Sequence[Floats], contacts: Pairs) -> float:
        """Returns the part of objects' weight that contacts drop, the mean of places on a way."""
        parts, still = list[float](), np.zeros(len(self._unit))
        for q in (pushed[k] for k in np.linspace(0, len(pushed) - 1, _PLACES).astype(int)):
            weight = self.world.calc_bias(q, still) * ~self._driven
            whole = np.sqrt(weight @ np.linalg.solve(self._calc_inertia(q), weight))
            parts.append(self.calc_push(q, weight, contacts, True)[1] / max(whole, _NOTHING))
        return float(np.mean(parts))

    def _draw_contacts(self, rng: np.random.Generator) -> Pairs:
        """Returns contacts of one hand, or of several that other joints move."""
        drawn, most = list[int](), _MOST_HANDS[self.must_carry]
        most = int(rng.integers(1 + self.must_carry, 1 + most))
        for contact in rng.permutation(self.contacts):
            differ = np.any(self._hands[contact] != self._hands[drawn], axis=1)
            if len(drawn) < most and differ.all():
                drawn.append(int(contact))
        return tuple(drawn)

    def _reach(
        self, start: Floats, size: float, rng: np.random.Generator, ready: Grasps
    ) -> tuple[list[Floats], Pairs]:
        """Returns positions of touches that push the object far to its goal, part by part.

        Also returns their contacts. They are the best that are ready (`take_best`); if none is,
        grasps are drawn and made ready first. The object's way is this long, at least.
        """
        grasps = [] if ready else sorted(self._draw_grasps(start, size, rng), key=lambda g: -g.most)
        for most, q, contacts, is_straight in grasps:
            if len(ready) >= _NUM_READY[self.must_carry] and most <= ready[-1][0]:
                break
            pushed = self._follow(q, size / _PARTS, contacts, is_straight)
            value = most - self.measure_left(pushed[-1]) / size
            insort(ready, (value, pushed, contacts), key=itemgetter(0))
        return take_best(ready, self.world, self._unit)

    def _draw_grasps(self, start: Floats, size: float, rng: np.random.Generator) -> Iterator[Grasp]:
        """Yields random ones; the object's way is this long, at least.

        Most of those that carry are near the best one so far.
        """
        world, way = self.world, self._find_way(start)
        nearest = np.minimum(world.calc_signed_distance(start), 0.0)
        found: dict[Pairs, Floats] = {}
        best: tuple[float, Floats, Pairs] | None = None
        for _ in range(_SAMPLES[self.must_carry]):
            contacts, is_straight = self._draw_contacts(rng), bool(rng.integers(2))
            is_straight |= self.must_carry
            if contacts not in found:
                found[contacts] = self._touch(start, contacts, self._driven)
            near = found[contacts]
            if self.must_carry and best and rng.integers(4):
                _, near, contacts = best
            q = self._draw_pose(near, contacts, rng)
            q = self._touch(q, contacts, self._driven)
            there = world.subtract(q, start)
            distances = world.calc_signed_distance(world.add(start, np.outer(_LOOKS, there)))
            is_near = np.all(np.abs(distances[-1, contacts]) < _NEAR * self._length)
            if is_near and not self._find_excess(q).any():
                inside = float(np.sum(np.minimum(distances - nearest, 0.0)))
                most = 1 + _COLLISION * inside / self._length
                most -= _DISTANCE * float(np.linalg.norm(there / self._unit))
                if self.must_carry:
                    pushed = self._follow(q, size / _PLACES, contacts, True)
                    most -= _FALL * self._calc_fall(pushed, contacts)
                    rank = most - self.measure_left(pushed[-1]) / size
                    if best is None or rank > best[0]:
                        best = rank, q, contacts
                elif is_straight:
                    most -= self.calc_push(q, self._calc_inertia(q) @ way, contacts)[1] / size
                yield Grasp(most, q, contacts, is_straight)

    def _draw_pose(self, q: Floats, contacts: Pairs, rng: np.random.Generator) -> Floats:
        """Returns random positions of contacts' hands: near some, or within limits of joints."""
        size = 10 ** rng.uniform(*_SPREAD) * self._unit
        moved = size * rng.normal(size=len(size))
        if rng.integers(2):
            is_limited = np.isfinite(self._limits).all(axis=0)
            at = self.world.in_tangent(q, np.zeros(1))
            moved[is_limited] = rng.uniform(*self._limits[:, is_limited]) - at[is_limited]
        return self.world.add(q, moved * np.any(self._hands[list(contacts)], axis=0))

    def _follow(self, q: Floats, part: float, contacts: Pairs, is_straight: bool) -> list[Floats]:
        """Returns positions from some on while hands stick to an object that goes to its goal.

        It goes straight, but round what is no hand, or as near to that as these contacts can push.
        """
        pushed, world, among = [q], self.world, self._supports
        least = np.minimum(world.calc_signed_distance(q)[among], 0.0)
        whole = max(self.measure_left(q), _NOTHING)
        while len(pushed) <= 2 * _PARTS:
            way = self._find_way(pushed[-1])
            left = self._measure(way)
            if not is_straight:
                # The way nearest to it that contacts can push the object.
                inertia = self._calc_inertia(pushed[-1])
                push = self.calc_push(pushed[-1], inertia @ way, contacts)[0]
                way = np.where(self._root > 0, np.linalg.solve(inertia, push), 0.0)
            size = self._measure(way)
            if size < max(part / 2, _LEAST * left):
                break
            way = way * min(1.0, part / size)
            if is_straight and self.must_carry:
                # It is lifted at once, and set down in the end.
                above = _LIFT * self._length * np.sin(np.pi * min(1.0, 1.1 - left / whole))
                there = world.add(pushed[-1], way)
                there = self._move_out(there, among, least + above, ~self._driven)
                way = world.subtract(there, pushed[-1])
            then = self._stick(pushed[-1], way, contacts)
            if then is None:
                break
            pushed.append(then)
        return pushed

    def _touch(self, q: Floats, contacts: Pairs, driven: Bools, distance: float = 0.0) -> Floats:
        """Returns positions in which contacts are at a distance, by the shortest Newton steps."""
        rows = list(contacts)
        for _ in range(_NEWTON):
            distances, slopes = self.world.measure_contacts(q)
            off = distances[rows] - distance
            if np.max(np.abs(off), initial=0.0) < _TOUCHES * self._length:
                break
            by_unit = slopes[rows] * driven * self._unit
            step = -np.linalg.lstsq(by_unit, off, rcond=_SINGULAR)[0]
            step *= min(1.0, _LONGEST / max(float(np.max(np.abs(step))), _NOTHING))
            q = self.world.add(q, self._unit * step)
            q = self.world.add(q, -self._find_excess(q))
        return q

    def _stick(self, q: Floats, way: Floats, contacts: Pairs) -> Floats | None:
        """Returns positions in which the object has moved, and hands with it; None: they can't.

        What is carried may turn far: slopes are those of the middle of the way, then.
        """
        rows, (distances, normals, jacobians) = list(contacts), self.world.relate(q)
        gaps = normals[rows] * distances[rows, np.newaxis]
        off, by_hand, moved = answer_way(jacobians[rows], way, gaps, self.hand_unit)
        if self.must_carry:
            middle = self.world.add(q, (way + self._unit * moved) / 2)
            slopes = self.world.relate(middle)[2][rows]
            off, by_hand, moved = answer_way(slopes, way, gaps, self.hand_unit)
        slip = np.linalg.norm(by_hand @ moved + off)
        q = self.world.add(q, way + self._unit * moved)
        is_far = np.max(np.abs(moved)) > _LONGEST or slip > _SLIP * np.linalg.norm(off)
        return None if is_far or self._find_excess(q).any() else q

    def _find_excess(self, q: Floats) -> Floats:
        """Returns by how much hands are beyond the limits of their joints, shape (nv,)."""
        at = self.world.in_tangent(q, np.zeros(1))
        return np.where(self._driven, at - np.clip(at, *self._limits), 0.0)
