"""Motions in phases between rigid walls: posed, closed near others, refined and simulated.

Between knots they may dip into walls; where, and by how much they are off, is found here.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import Mechanism, RigidLaw, read_mode
from drake_aigto.planning.candidate import Candidate, Origin
from drake_aigto.planning.mechanisms.phases import (
    SAME,
    find_slopes,
    is_closed,
    lay_out,
    make_trajectory,
    read_hold,
)
from drake_aigto.planning.mechanisms.task import MechanismTask
from drake_aigto.planning.mechanisms.traces import add_impulses, replay_at_knots, with_losses
from drake_aigto.planning.search import scaled
from drake_aigto.shooting import Phases, ShootingOptions, ShootingProblem, ShootingResult, Smoothing
from drake_aigto.simulation import Replay
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import RESTITUTION, Touch, TouchSequence
from drake_aigto.world import World

# Next to a bounce, what is inside by less than 10 % of the margin may be the error of cubics.
_INSIDE = 1.1
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
    """Returns by how much φ should be larger at knots, (N + 1, m), to keep a margin between them.

    It is at least 0, the same for all faces of a solid, and 0 from the start to where a motion
    first leaves it by the margin, and next to a bounce on it, where that is not inside.
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
    count = is_touched[1:].astype(int) + is_touched[:-1]
    lacks[(count == 2) | ((count == 1) & (lacks < _INSIDE * margin))] = 0.0
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


# Near a grazed wall speeds change with the square root of distances: a finalist has to meet its
# walls closely.
FINE = ShootingOptions(
    (Smoothing(0.0, 40, 1e-6),), substeps=4, penalty=1e4, multiplier_updates=8, feasibility=1e-6
)
_EXACT, _MOST_SUBSTEPS = 1e-4, 16
# The best impact with friction is often at the edge of its mode. Steps toward it pass the edge, and
# with a high penalty none of them would be accepted.
_GENTLE = 1e2
# Before walls are met to rounding, the optimum is found more exactly, in two passes.
_SETTLED = dataclasses.replace(
    FINE, rungs=(Smoothing(0.0, 20, 1e-9),), multiplier_updates=1, feasibility=1e-8
)
# Walls are met to rounding in Runge-Kutta steps whose error is at most this part of the scales.
_TRUE = 1e-7
# A motion is steady if other steps move its end by less than this part of its scales.
_STEADY = 1.0
# Bounces slower than this part of the task's speed become passes, and no sustained touch begins:
# any error would miss the wall.
SLOW = 1e-2
# A polish that raised the cost by more than this factor ended at another optimum, or diverged.
_FAR = 1.05


class PhasedTask(MechanismTask):
    """A mechanism between rigid walls: shooting in phases, whose touches are given."""

    @cached_property
    def mechanism(self) -> Mechanism:
        """The mechanism between springs."""
        return Mechanism.of(self.world, self._springs)

    @property
    def rigid_law(self) -> RigidLaw:
        """The law of the walls."""
        assert isinstance(self.law, RigidLaw)
        return self.law

    def with_depth(self, motion: ShootingResult) -> ShootingResult:
        """Returns a motion whose violation includes penetrations between its knots, and rebounds.

        Contact that is held begins without a rebound, as ever faster bounces end (`Phases`). From
        one that is hit faster, a body bounces off at e times that speed.
        """
        if not np.isfinite(motion.cost):
            return motion
        dip, (_, before) = find_deepest(self.world, motion), find_slopes(self.world, motion)
        parts = [0.0 if dip is None else dip.depth / self.measures.length]
        for touch, knot in motion.starts:
            if knot is not None and touch.lasts:
                J = self.world.calc_contact_jacobian(motion.states[knot, : before.shape[1]])
                speed = abs(float(J[touch.contact] @ before[knot - 1]))
                parts.append(
                    self.rigid_law.restitution[touch.contact] * speed / self.measures.speed
                )
        return dataclasses.replace(motion, violation=max(motion.violation, *parts))

    def shoot_phases(
        self,
        touches: TouchSequence,
        guess: ShootingResult | None,
        num_steps: int,
        options: ShootingOptions,
        most: float = np.inf,
        rolls: bool = False,
    ) -> ShootingResult:
        """Returns the motion with these touches near another one, or no control.

        It begins with its states, or rolls out its controls. Pairs to be kept apart do not touch.
        """
        near = self.idle_motion if guess is None else guess
        T, may_touch = float(near.times[-1]), np.isneginf(self.least_distances)
        touches = tuple(touch for touch in touches if may_touch[touch.contact])
        times, phases = lay_out(touches, num_steps, T, self._total, self.world.num_contacts)
        middles = (times[1:] + times[:-1]) / 2
        row = np.clip(np.searchsorted(near.times, middles) - 1, 0, len(near.controls) - 1)
        states = None if guess is None or rolls else sample(self.world, guess, times)
        options = dataclasses.replace(options, most_promised=most)
        return self.pose_phases(times, phases).solve(near.controls[row], states, options)

    def refine_phases(
        self,
        motion: ShootingResult,
        clearances: Floats | None = None,
        is_wary: bool = False,
        most: float = np.inf,
    ) -> ShootingResult:
        """Returns the optimum near a motion, with as many substeps as its accuracy takes.

        As other steps change an unstable motion, its states are kept, and gaps closed. A steady
        one is refined from its controls, by steps that never raise the cost.
        """
        problem, found = self.pose_phases(motion.times, motion.phases, clearances), motion
        error, is_unsteady = problem.estimate_error(found), False
        penalty = _GENTLE if self.rigid_law.has_friction else FINE.penalty
        options = dataclasses.replace(FINE, penalty=penalty, most_promised=most)
        while not found.is_left:
            wary, substeps = is_wary or is_unsteady, found.substeps
            options = dataclasses.replace(options, is_wary=wary, substeps=substeps)
            states = found.states if is_unsteady or error > _STEADY else None
            found = problem.starting_from(found).solve(found.controls, states, options)
            error = problem.starting_from(found).estimate_error(found)
            if error <= _EXACT or found.substeps >= _MOST_SUBSTEPS or found.cost > most:
                break
            is_unsteady = problem.is_unstable(found)
            found = dataclasses.replace(found, substeps=2 * found.substeps)
        return found

    def settle_phases(
        self, motion: ShootingResult, clearances: Floats, most: float
    ) -> ShootingResult:
        """Returns a polished motion that meets its walls as closely as rounding allows.

        A slow bounce is late by its distance to the wall over its speed, and an unstable motion
        deviates exponentially from there.
        """
        if not len(motion.phases.knots) or not np.isfinite(motion.cost):
            return motion
        problem = self.pose_phases(motion.times, motion.phases, clearances)
        error, substeps = problem.estimate_error(motion), motion.substeps
        while error > _TRUE and substeps < _MOST_SUBSTEPS:
            error, substeps = error / 2**motion.order, 2 * substeps
        options = dataclasses.replace(_SETTLED, substeps=substeps, most_promised=most)
        is_other = substeps != motion.substeps
        states = motion.states if is_other and problem.is_unstable(motion) else None
        prices = np.append(options.penalty * problem.cost_scale, motion.prices[1:])
        settled = problem.solve(motion.controls, states, options, prices)
        if settled.is_left:
            return settled
        settled = problem.restore(settled)
        costs_as_much = self.price(settled) <= scaled(_FAR, self.price(motion))
        is_better = settled.violation < motion.violation and costs_as_much
        return settled if is_better else motion

    def pose_phases(
        self, times: Floats, phases: Phases, clearances: Floats | None = None
    ) -> ShootingProblem:
        """Returns the task on rigid walls, in these phases."""
        return dataclasses.replace(
            self.shooting(len(times) - 1),
            mechanism=self._compiled.mechanism,
            times=times,
            phases=phases,
            clearances=clearances,
            slowest=SLOW * self.measures.speed,
        )

    def judge(self, origin: Origin, start: ShootingResult, found: ShootingResult) -> Candidate:
        """Returns the candidate of a motion (`MechanismTask.judge`)."""
        judged = super().judge(origin, start, found)
        if not self.rigid_law.has_friction:
            return judged
        return dataclasses.replace(judged, contacts=with_losses(judged.contacts, judged.replay))

    def pose_again(self, found: ShootingResult) -> ShootingProblem:
        """Returns the problem that a motion is a result of."""
        return self.pose_phases(found.times, found.phases)

    def make_trajectory(self, found: ShootingResult) -> Trajectory:
        """Returns a motion in phases as a trajectory, with its impulses."""
        times = self._end_exactly(found.times)
        return dataclasses.replace(make_trajectory(self.world, found), times=times)

    def _simulate_alone(self, found: ShootingResult) -> tuple[Replay, Trajectory, dict[str, float]]:
        """Returns the simulation of controls, as a trajectory with knots at its bounces."""
        times = self._end_exactly(found.times)
        times, controls, replay = replay_at_knots(self.world, self.scenario, times, found.controls)
        return replay, *self._trace(replay, times, controls)

    def _trace(
        self, replay: Replay, times: Floats, controls: Floats
    ) -> tuple[Trajectory, dict[str, float]]:
        """Returns the trajectory of a replay, whose bounces are at its knots, and its defects."""
        flight, defects = super()._trace(replay, times, controls)
        trajectory, rebound = add_impulses(self.world, self.scenario, replay, flight)
        return trajectory, {**defects, RESTITUTION: rebound}

    def _end_exactly(self, times: Floats) -> Floats:
        """Returns times that end exactly at the scenario's end: phases may be off a little."""
        return times * (np.clip(times[-1], *self._total) / times[-1])
