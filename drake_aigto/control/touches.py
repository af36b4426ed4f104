"""Touches over a horizon: which of a plan may still come, and what seen bounces tell of walls."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from pydrake.multibody.plant import ContactResults

from drake_aigto.arrays import Bools, Floats
from drake_aigto.planning import Candidate
from drake_aigto.shooting import ShootingProblem
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch, TouchSequence
from drake_aigto.world import World, find_link

# Touches that are planned within this number of periods of now may have happened, or not yet.
_NEAR = 2.0
# A motion costs more than the last plan if it does by this share of that: noise makes less of it.
MARGIN = 0.05
# Touches are kept this part of the time that is left apart, and away from both ends.
_APART = 1e-4
# Times that differ by less than this part are the same.
_SAME = 1e-9
# A ball that is deeper in a wall than this part of how far off walls may be shows that it stands
# elsewhere; then it is thought of as farther away in steps of that part.
_DEEP, _STEP = 0.025, 0.1
# No wall returns more than it is hit with, but for noise; a kick may.
_MOST_RETURNED = 1.2
# What turns round more slowly than this part of the slowest impact that is planned is noise.
_FAINT = 0.2
# Walls may stand this part of the task's length from where they are thought to be.
WALL_DOUBT = 0.2


@dataclass(frozen=True, eq=False)
class PlannedMotion:
    """A motion over a horizon.

    Attributes:
        trajectory: states and controls at knots, in the context's time.
        cost: J from the first knot on.
        touches: the contacts that are come into, by time, which is the context's.
        problem: that it is the best motion of, where a descent found it; else None.
    """

    trajectory: Trajectory
    cost: float
    touches: TouchSequence
    problem: ShootingProblem | None = None

    def calc_control(self, time: float) -> Floats:
        """Returns u at a time, shape (nu,); before and after the horizon its first and last."""
        times, controls = self.trajectory.times, self.trajectory.controls
        k = int(np.searchsorted(times, time, side="right")) - 1
        return np.array(controls[min(max(k, 0), len(controls) - 1)])

    def calc_held(self, start: float, end: float) -> Floats:
        """Returns what to hold from a time to another one: u, or its mean over several steps."""
        times, controls = self.trajectory.times, self.trajectory.controls
        if end - start <= np.max(np.diff(times)):
            return self.calc_control(start)
        knots = np.clip(np.append(times[1:-1], np.inf), start, end)
        shares = np.diff(knots, prepend=start) / (end - start)
        return np.asarray(shares @ controls)

    @classmethod
    def of(cls, found: Candidate) -> PlannedMotion:
        """Returns a candidate as a motion."""
        touches = (Touch(each.time, each.last_time, each.index) for each in found.contacts)
        return cls(found.trajectory, found.cost, tuple(touches))

    @cached_property
    def reach(self) -> Floats:
        """The largest |q| and |v| at knots, shape (nq + n,)."""
        return np.asarray(np.max(np.abs(self.trajectory.states), axis=0))

    def calc_state(self, time: float) -> Floats:
        """Returns q and v at a time, shape (nq + n,); beyond the horizon its first and last."""
        return self.trajectory.calc_state(time)

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
) -> list[TouchSequence]:
    """Returns touches of a plan that may be left, as times from now on, the likelier ones first.

    Which these are, a state does not tell for sure: a bounce may come sooner or later than it was
    planned. What leaves a wall may have been there; what comes to it has not.

    Args:
        touches: of the plan.
        now: the time [s].
        left: how long it goes on [s].
        period: between ticks [s].
        rates: φ̇ of each contact, shape (m,) [m/s].
        bounced: the contact that was just seen to bounce, if one was.
        slips: of each contact that lasts now, the sign of its slip, 0 where it sticks.
    """
    near, lasting = _NEAR * period, slips or {}
    coming = [touch for touch in touches if touch.end > now]
    late = [touch for touch in touches if now - near < touch.end <= now]
    whole, fewer = keep_apart(coming, now, left), keep_apart(coming[1:], now, left)
    found = [whole]
    if coming:
        first = coming[0]
        comes = rates[first.contact] < 0 or (first.lasts and first.contact in lasting)
        is_near = first.start < now + near or first.contact == bounced
        if is_near and not comes:
            found = [fewer, whole]
        elif is_near or not comes:
            found = [whole, fewer]
    if late and late[-1].contact not in lasting and rates[late[-1].contact] < 0:
        found.insert(0, keep_apart([late[-1], *coming], now, left))
    return [_begin(each, lasting, near) for each in found]


def choose(tried: Iterable[PlannedMotion | None], last: float) -> PlannedMotion | None:
    """Returns the first motion that costs no more than the last plan, or else the cheapest one.

    Args:
        tried: motions, the likelier ones first.
        last: what the last plan costs.
    """
    found: list[PlannedMotion] = []
    for motion in tried:
        found += [motion] if motion else []
        if motion and motion.cost <= (1 + MARGIN) * last:
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


def go_on(motion: PlannedMotion) -> TouchSequence:
    """Returns the touches of a motion; what lasts to its end goes on beyond it."""
    end = (1 - _SAME) * float(motion.trajectory.times[-1])
    return tuple(
        dataclasses.replace(touch, end=np.inf) if touch.lasts and touch.end >= end else touch
        for touch in motion.touches
    )


def _begin(sequence: TouchSequence, lasting: Mapping[int, int], near: float) -> TouchSequence:
    """Returns touches, where those that are to last soon begin now if their contacts last now.

    A contact that slips otherwise than the plan says does so for a while before.
    """
    found, seen = list[Touch](), set[int]()
    for touch in sequence:
        lasts = touch.contact in lasting and touch.contact not in seen
        seen.add(touch.contact)
        if not (lasts and touch.lasts and touch.start <= near):
            found.append(touch)
            continue
        slip = lasting[touch.contact]
        if slip in (0, touch.mode):
            found.append(replace(touch, start=0.0))
            continue
        until = min(near, touch.end) / 2
        found += [Touch(0.0, until, touch.contact, slip), replace(touch, start=until)]
    return tuple(found)


class Bounce(NamedTuple):
    """A bounce between two samples."""

    contact: int
    place: float  # φ there [m]
    comes: float  # φ̇⁻ [m/s]
    leaves: float  # φ̇⁺ [m/s]


@dataclass(frozen=True)
class SeenBounces:
    """Knowledge of walls from bounces: how much they return, and where they stand.

    Attributes:
        squares: Σ (φ̇⁻)² of bounces off walls that return what the scenario says [m²/s²].
        products: −Σ φ̇⁻ φ̇⁺ of the same [m²/s²].
        nearer: by how much nearer the wall of each contact stands than the model has it, shape (m,)
            [m]; empty: nothing was seen.
        latest: the contact that bounced between the last two samples; None: none did.
    """

    squares: float = 0.0
    products: float = 0.0
    nearer: tuple[float, ...] = ()
    latest: int | None = None

    def find_restitution(self, expected: float, weight: float) -> float:
        """Returns the e in [0, 1] with the least w (e − e₀)² + Σ (φ̇⁺ + e φ̇⁻)².

        Args:
            expected: e₀, before any bounce.
            weight: w [m²/s²].
        """
        if not self.squares:
            return expected
        e = (weight * expected + self.products) / (weight + self.squares)
        return float(np.clip(e, 0.0, 1.0))

    def watch(
        self,
        world: World,
        samples: tuple[Floats, Floats],
        elapsed: float,
        control: Floats,
        off: float,
    ) -> SeenBounces:
        """Returns the same, with the bounce between two samples of a state, if there is one.

        The arguments are those of `find_bounce`; J must not change, as that of balls.
        """
        bounce = find_bounce(world, samples, elapsed, control, off)
        if bounce is None:
            return dataclasses.replace(self, latest=None)
        nearer = self._read(world)
        nearer[bounce.contact] = bounce.place
        seen = SeenBounces(self.squares, self.products, tuple(nearer.tolist()), bounce.contact)
        if world.contacts[bounce.contact].restitution is not None:
            return seen
        return dataclasses.replace(
            seen,
            squares=self.squares + bounce.comes**2,
            products=self.products - bounce.comes * bounce.leaves,
        )

    def pass_walls(self, world: World, q: Floats, off: float) -> SeenBounces:
        """Returns the same, with walls that the balls are inside of farther away.

        Nothing is deep inside of a rigid wall: it stands behind what seems to be.

        Args:
            world: of balls, as the model has it.
            q: where the balls are, shape (n,) [m].
            off: see `find_bounce`.
        """
        nearer, step = self._read(world), _STEP * off
        distances = world.calc_signed_distance(q)
        for faces in map(list, world.solids):
            contact = faces[int(np.argmax((distances - nearer)[faces]))]
            depth = nearer[contact] - distances[contact]
            if depth > _DEEP * off and distances[contact] > -off:
                nearer[contact] -= step * (1 + depth // step)
        if np.array_equal(nearer, self._read(world)):
            return self
        return dataclasses.replace(self, nearer=tuple(nearer.tolist()))

    def _read(self, world: World) -> Floats:
        return np.array(self.nearer) if self.nearer else np.zeros(world.num_contacts)


def find_bounce(
    world: World, samples: tuple[Floats, Floats], elapsed: float, control: Floats, off: float
) -> Bounce | None:
    """Returns the only bounce between two samples of a state; None if there is none, or several.

    The place of the wall does not matter: contact i bounces if φ̇_i changes its sign, when and where
    both flights meet, at

        t = (φ⁺ − φ⁻ − φ̇⁺ h) / (φ̇⁻ − φ̇⁺)

    after the first of two samples that are h apart. That is no kick in mid-air if φ_i is near 0
    there, and no more is returned than came.

    Args:
        world: the mechanism as the model has it.
        samples: (q, v) before and after, shape (2n,) each.
        elapsed: h [s].
        control: u between them, shape (nu,).
        off: how far from where it is thought to be a wall may stand [m].
    """
    (q, v), (later, after) = (np.split(x, 2) for x in samples)
    phi, rate = world.calc_signed_distance(q), world.calc_contact_rate(q, v)
    phi_later, rate_later = (
        world.calc_signed_distance(later),
        world.calc_contact_rate(later, after),
    )
    turns = (rate < 0) & (rate_later > 0)
    if not turns.any():
        return None
    push = world.calc_contact_rate(q, world.calc_acceleration(q, v, control))
    span = np.where(turns, rate - rate_later, 1.0)
    time = np.clip((phi_later - phi - rate_later * elapsed) / span, 0.0, elapsed)
    comes, leaves = rate + time * push, rate_later - (elapsed - time) * push
    place = phi + time * (rate + comes) / 2
    turns &= (np.abs(place) <= off) & (comes < 0)
    turns &= (leaves > 0) & (leaves <= -_MOST_RETURNED * comes)
    if np.count_nonzero(turns) != 1:
        return None
    (i,) = np.flatnonzero(turns).tolist()
    return Bounce(i, float(place[i]), float(comes[i]), float(leaves[i]))


def infer_touched(
    world: World,
    samples: tuple[Floats, Floats],
    elapsed: float,
    control: Floats,
    speeds: Mapping[int, float],
    doubt: float,
) -> Bools:
    """Returns which contacts were touched between two samples (`find_bounce`), shape (m,).

    There J_i v < 0, and φ_i(q + v t + a t² / 2) ≤ 0 later; or it turns round as at planned speeds.
    """
    q, v = world.split(samples[0])
    moved = elapsed * (v + elapsed / 2 * world.calc_acceleration(q, v, control))
    comes = world.calc_contact_rate(q, v) < 0
    touched = np.asarray(comes & (world.calc_signed_distance(world.add(q, moved)) <= 0))
    bounce = find_bounce(world, samples, elapsed, control, doubt) if speeds else None
    if bounce and -bounce.comes > _FAINT * speeds.get(bounce.contact, np.inf):
        touched[bounce.contact] = True
    return touched


def find_bodies(world: World) -> list[list[set[str]]]:
    """Returns the names of both bodies that meet in each contact, plain and with their model's."""
    inspector, plant = world.scene_graph.model_inspector(), world.plant
    bodies = [[find_link(plant, inspector, shape) for shape in pair] for pair in world.shapes]
    return [[{body.name(), str(body.scoped_name())} for body in pair] for pair in bodies]


def read_touched(
    results: ContactResults, bodies: Sequence[Sequence[set[str]]], distances: Floats
) -> Bools:
    """Returns which contacts a plant reports as touched, shape (m,).

    Of several contacts between the same two bodies it is the nearest to its wall.

    Args:
        results: the plant's.
        bodies: by name (`find_bodies`).
        distances: φ, shape (m,).
    """
    touched, plant = np.zeros(len(distances), dtype=bool), results.plant()
    for k in range(results.num_point_pair_contacts()):
        info = results.point_pair_contact_info(k)
        a, b = (_name_body(plant, index) for index in (info.bodyA_index(), info.bodyB_index()))
        same = [
            i
            for i, (one, other) in enumerate(bodies)
            if (a in one and b in other) or (a in other and b in one)
        ]
        if same:
            touched[min(same, key=lambda i: distances[i])] = True
    return touched


def _name_body(plant: Any, index: Any) -> str:
    """Returns a body's name, with its model's if other bodies of the plant have the same."""
    body = plant.get_body(index)
    is_alone = plant.NumBodiesWithName(body.name()) == 1
    return str(body.name() if is_alone else body.scoped_name())


def list_hits(counts: Floats) -> list[int]:
    """Returns the contact of each bounce, from how often each contact, shape (m,), has bounced."""
    return [int(i) for i in np.repeat(np.arange(len(counts)), counts.astype(int))]
