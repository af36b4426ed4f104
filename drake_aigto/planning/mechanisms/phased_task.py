"""Motions in phases between rigid walls: posed, closed near others, refined and simulated."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import Mechanism, RigidLaw
from drake_aigto.planning.candidate import Candidate, Origin
from drake_aigto.planning.mechanisms.dips import find_deepest, sample
from drake_aigto.planning.mechanisms.phases import find_slopes, lay_out, make_trajectory
from drake_aigto.planning.mechanisms.task import MechanismTask
from drake_aigto.planning.mechanisms.traces import add_impulses, replay_at_knots, with_losses
from drake_aigto.planning.search import scaled
from drake_aigto.shooting import Phases, ShootingOptions, ShootingProblem, ShootingResult, Smoothing
from drake_aigto.simulation import Replay
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import RESTITUTION, TouchSequence

# Near a grazed wall speeds change with the square root of distances: a finalist has to meet its
# walls closely.
FINE = ShootingOptions(
    (Smoothing(0.0, 40, 1e-6),), substeps=4, penalty=1e4, multiplier_updates=8, feasibility=1e-6
)
_EXACT, _MOST_SUBSTEPS = 1e-4, 16
# The best impact with friction is often at the edge of its mode. Steps toward it pass the edge, and
# with a high penalty none of them would be accepted.
_GENTLE = 1e2
# Violations this small cost next to nothing: steps that gain less have to count, too.
_SETTLED = ShootingOptions((Smoothing(0.0, 40, 1e-12),), multiplier_updates=24, feasibility=1e-11)
# Walls are met to rounding in Runge-Kutta steps whose error is at most this part of the scales.
_TRUE = 1e-7
# A motion is steady if other steps move its end by less than this part of its scales.
_STEADY = 1.0
# Bounces slower than this part of the task's speed become passes, and no sustained touch begins:
# any error would miss the wall.
SLOW = 1e-2
# A polish that raised the cost by more than this factor ended at another optimum, or diverged.
FAR = 1.05


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
        settled = problem.solve(motion.controls, states, options, motion.prices)
        costs_as_much = self.price(settled) <= scaled(FAR, self.price(motion))
        is_better = settled.violation < motion.violation and costs_as_much
        return settled if settled.is_left or is_better else motion

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
