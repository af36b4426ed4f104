"""A mechanism's task between rigid walls: first on springs, then in phases that meet at walls."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import cached_property

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import Mechanism, RigidLaw
from drake_aigto.planning.candidate import Candidate, ChangeName, Origin
from drake_aigto.planning.mechanisms.closing import COARSE, Aim, begin_at, keep_off
from drake_aigto.planning.mechanisms.guesses import Guess
from drake_aigto.planning.mechanisms.phases import (
    Dip,
    find_deepest,
    find_grazes,
    find_lacks,
    lay_out,
    make_trajectory,
    read_touches,
    sample,
)
from drake_aigto.planning.mechanisms.task import MechanismTask
from drake_aigto.planning.mechanisms.touches import (
    NEAR,
    find_neighbors,
    lead_over_edges,
    read_replay,
    rests_early,
    switch_modes,
    with_dip,
)
from drake_aigto.planning.mechanisms.traces import add_impulses, replay_at_knots, with_losses
from drake_aigto.planning.options import PlanOptions
from drake_aigto.planning.search import scaled
from drake_aigto.planning.sequence_search import swapped
from drake_aigto.shooting import Phases, ShootingOptions, ShootingProblem, ShootingResult, Smoothing
from drake_aigto.simulation import Replay, replay_event_driven
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import NO_ADDITIONS, RESTITUTION, Additions, TouchSequence
from drake_aigto.world import Scenario, World

# A bounce is added where a motion penetrates a wall between knots by this part of the task's
# length, and how often at most.
_DEEP, _MOST_ADDED = 1e-2, 4
# Bounces this near each other, as a part of the duration, are as near as phases may be.
_AT_ONCE = 2e-3
# Clearance of walls, as a part of the task's length; how often knots are lifted for it at most; and
# the part of its speed below which touches become passes, and no sustained touch begins: any error
# would miss the wall.
_MARGIN, _MOST_LIFTS, _SLOW = 1e-4, 6, 1e-2
# How often modes of touches with friction are changed at their edges, at most.
_MOST_SWITCHED = 3
# Near a grazed wall speeds change with the square root of distances: a finalist has to meet its
# walls closely.
_FINE = ShootingOptions(
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
_UNPOLISHED = 1.2  # A polish may lower costs by up to this factor.
# A polish that raised the cost by more than these factors ended at another optimum, or diverged;
# while walls are cleared, and met to rounding, it falls by up to the third.
_OTHER, _FAR, _UNSETTLED = 1.01, 1.05, 1.01
_COARSE = ShootingOptions(rungs=(Smoothing(0.0, 40, 1e-3),), multiplier_updates=4)
_FIRST = dataclasses.replace(_COARSE, multiplier_updates=0)
# With friction, motions that cost more than this times the best are left unfinished. Of 185
# neighbors in a shot with spin, no such one led to a better motion; they took 3/4 of the time.
_HOPELESS = 3.0


class RigidMechanismTask(MechanismTask):
    """A task of a mechanism between rigid walls.

    The first shooting has springs in place of the walls (`soften`). The touches of that motion are
    read off, and shooting continues in phases that meet there (`Phases`), at knots with free times.
    """

    @property
    def _falls(self) -> tuple[float, int]:
        """By how much costs may fall in a polish, and how many times more motions it is for."""
        return _UNPOLISHED, 1

    @property
    def close_ratio(self) -> float:
        """Motions that cost more than this times the best are left unfinished."""
        return _HOPELESS if self.rigid_law.has_friction else self.polish_ratio

    @cached_property
    def mechanism(self) -> Mechanism:
        """The mechanism between springs."""
        return Mechanism.of(self.world, self._springs)

    def close(self, guess: Guess, aim: Aim) -> ShootingResult:
        """Returns the motion on rigid walls near a guess, closed on springs or as it is.

        Args:
            guess: the guess.
            aim: of its `most` see `bounce`.
        """
        soft = self._close_on_springs(guess, begin_at(COARSE, guess.width))
        touches = read_touches(self.world, self.rigid_law, soft, self.lasting)
        found = [self.bounce(touches, soft, aim.most)]
        controls, states = guess.sample(soft.times)
        if (self._sinks_in or guess.touches is not None) and states is not None:
            shown = dataclasses.replace(soft, states=states, controls=controls)
            touches = guess.touches or read_touches(self.world, self.rigid_law, shown, self.lasting)
            found.append(self.bounce(touches, shown, aim.most))
        return min(found, key=self.rank)

    @cached_property
    def _sinks_in(self) -> bool:
        return rests_early(self.world, self.rigid_law, self.scenario)

    @property
    def rigid_law(self) -> RigidLaw:
        """The law of the walls."""
        assert isinstance(self.law, RigidLaw)
        return self.law

    @cached_property
    def lasting(self) -> Floats:
        """The shortest touch of a spring that is sustained on a wall, shape (m,) [s].

        With zero restitution, any is; else twice the time in which a spring reverses a velocity.
        """
        time_step = self.scenario.duration / self.search_steps
        return np.where(self.rigid_law.restitution == 0, 0.0, 2 * np.pi * time_step)

    def bounce(
        self, touches: TouchSequence, guess: ShootingResult | None, most: float = np.inf
    ) -> ShootingResult:
        """Returns a motion with these touches after a few steps from another.

        A bounce is added where it penetrates a wall deeply between knots. Bounces off two walls at
        once change their order, and touches with friction their modes, if that is better.

        Args:
            touches: in their order.
            guess: the other motion; None: no control.
            most: a motion that costs more before its bounds hold is returned as it is.
        """
        tried = list[ShootingResult]()
        for _ in range(1 + _MOST_ADDED):
            motion = self._with_depth(self._close_phases(touches, guess, most))
            if motion.is_left or motion.cost > most:
                return min([*tried, motion], key=self.rank)
            dip = find_deepest(self.world, motion) if np.isfinite(motion.cost) else None
            tried.append(motion)
            is_full = len(motion.phases.knots) + 1 >= self.search_steps
            if dip is None or dip.depth < _DEEP * self.measures.length or is_full:
                break
            guess, touches = motion, self.with_dip(motion, dip)
        return self._switch(self._lift(min(tried, key=self.rank)))

    def _lift(self, motion: ShootingResult) -> ShootingResult:
        """Returns a motion, led off walls if dips into them are priced higher than it."""
        if self.price(motion) <= 2 * motion.cost:
            return motion
        margin = _MARGIN * self.measures.length
        apart = keep_off(self.world, self.pose_again(motion), motion, margin)
        lifted = apart.solve(motion.controls, None, _COARSE) if apart else motion
        return min(motion, self._with_depth(lifted), key=self.rank)

    def with_dip(self, motion: ShootingResult, dip: Dip) -> TouchSequence:
        """Returns the touches of a motion and its dip (`with_dip`)."""
        step = self.scenario.duration / self.search_steps
        return with_dip(self.world, self.rigid_law, motion, dip, self.lasting, step)

    def _close_phases(
        self, touches: TouchSequence, guess: ShootingResult | None, most: float
    ) -> ShootingResult:
        """Returns a motion in coarse steps, bounces that end at once in their better order."""
        N, near = self.search_steps, _AT_ONCE * self.scenario.duration
        found = self._shoot(touches, guess, N, _COARSE, most)
        if found.is_left or found.cost > most or not swapped(found.touches, near):
            return found
        # Penalties of an order that does not fit only grow: the first pass has none of this yet.
        best = self._shoot(touches, guess, N, _FIRST)
        while orders := swapped(best.touches, near):
            others = [self._shoot(each, best, N, _FIRST, rolls=True) for each in orders]
            if not (other := min(others, key=lambda each: each.cost)).cost < best.cost:
                break
            best = other
        ordered = self._shoot(best.touches, best, N, _COARSE, most, rolls=True)
        return min(found, ordered, key=self.rank)

    def _switch(self, motion: ShootingResult) -> ShootingResult:
        """Returns the best motion found by switching modes of touches at their edges."""
        may_switch = self.rigid_law.has_friction and np.isfinite(motion.cost)
        for _ in range(_MOST_SWITCHED * may_switch):
            world, law = self.world, self.rigid_law
            touches = switch_modes(world, law, motion) or lead_over_edges(world, law, motion)
            if touches is None:
                break
            other = self._with_depth(self._shoot(touches, motion, self.search_steps, _COARSE))
            if not self.rank(other) < self.rank(motion):
                break
            motion = other
        return motion

    @cached_property
    def coasting(self) -> TouchSequence:
        """The touches of the uncontrolled motion; sustained ones last until the next."""
        idle = self.idle_motion
        times = self._end_exactly(idle.times)
        replay = replay_event_driven(self.world, self.scenario, times, idle.controls)
        return read_replay(self.world, self.rigid_law, replay, self.lasting)

    def find_neighbors(self, motion: ShootingResult) -> Iterator[tuple[ChangeName, TouchSequence]]:
        """Yields sequences of touches near a motion's, and how they differ."""
        law, near = self.rigid_law, NEAR * self.scenario.duration
        yield from find_neighbors(self.world, law, motion, self.lasting, near)

    def tighten(self, motion: ShootingResult, least: float = np.inf) -> ShootingResult:
        """Returns a motion as it is: in phases, few steps err little."""
        return motion

    def polish(self, motion: ShootingResult, most: float = np.inf) -> ShootingResult:
        """Returns the local optimum near a motion in phases, in the scenario's time steps.

        Grazed walls are passed at a small distance instead, also between knots: a graze changes
        the motion with the square root of any error.

        Args:
            motion: the motion.
            most: what promises to cost more is left before it clears its walls, or meets them to
                rounding.
        """
        num_steps, margin = self.scenario.num_steps, _MARGIN * self.measures.length
        grazes = find_grazes(self.world, motion, _SLOW * self.measures.speed)
        touches = tuple(each for i, each in enumerate(motion.touches) if i not in grazes)
        is_as_is = not grazes and len(motion.controls) == num_steps
        limit = scaled(_UNSETTLED, most)
        first = motion if is_as_is else self._shoot(touches, motion, num_steps, _FINE, limit)
        found = self._with_depth(self._refine(first, most=limit))
        if scaled(_OTHER, self.price(motion)) < self.price(found) and self.price(motion) < most:
            # That is another optimum, because of other steps or of a graze left out.
            wary = self._shoot(touches, motion, num_steps, _FINE.wary, limit)
            others = [self._refine(wary, is_wary=True, most=limit)]
            if not is_as_is:
                others.append(self._refine(motion, most=limit))
            tried = found, *map(self._with_depth, others)
            found = min(tried, key=lambda each: (each.is_left, self.rank(each)))
        if found.is_left or found.cost > limit:
            return found
        clearances = np.zeros((len(found.times), self.world.num_contacts))
        for _ in range(_MOST_LIFTS):
            lacks = find_lacks(self.world, found, margin)
            if not np.isfinite(found.cost) or np.max(lacks) < margin / 2:
                break
            lifted = self._with_depth(self._refine(found, clearances + lacks))
            if self.price(lifted) > scaled(_FAR, self.price(found)):
                break
            found, clearances = lifted, clearances + lacks
        return self._with_depth(self._settle(found, clearances, most))

    def _with_depth(self, motion: ShootingResult) -> ShootingResult:
        """Returns a motion whose violation includes penetrations between its knots."""
        dip = find_deepest(self.world, motion) if np.isfinite(motion.cost) else None
        depth = 0.0 if dip is None else dip.depth / self.measures.length
        return dataclasses.replace(motion, violation=max(motion.violation, depth))

    def _shoot(
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

    def _refine(
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
        penalty = _GENTLE if self.rigid_law.has_friction else _FINE.penalty
        options = dataclasses.replace(_FINE, penalty=penalty, most_promised=most)
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

    def _settle(self, motion: ShootingResult, clearances: Floats, most: float) -> ShootingResult:
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
        costs_as_much = self.price(settled) <= scaled(_FAR, self.price(motion))
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
            slowest=_SLOW * self.measures.speed,
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


def make_mechanism_task(
    world: World, scenario: Scenario, options: PlanOptions, additions: Additions = NO_ADDITIONS
) -> MechanismTask:
    """Returns a mechanism's task, between rigid walls or others."""
    is_rigid = scenario.contact == "rigid" and bool(world.contacts)
    kind = RigidMechanismTask if is_rigid else MechanismTask
    return kind(world, scenario, options, additions=additions)
