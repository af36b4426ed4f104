"""Mechanisms, planned again: a descent leads from the last motion to the next one."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from drake_aigto.arrays import Bools, Floats, interpolate
from drake_aigto.control.horizon import AnyHorizon, BallHorizon, Horizon
from drake_aigto.control.touches import MARGIN, PlannedMotion, choose, find_left, go_on, keep_apart
from drake_aigto.errors import OptionsError, TrajectoryError
from drake_aigto.planning import (
    FeedbackPhase,
    MechanismSearch,
    Planner,
    Regulator,
    RigidMechanismTask,
    find_deepest,
    keep_off,
    lay_onto,
    make_mechanism_task,
    make_trajectory,
)
from drake_aigto.shooting import (
    IMPLICIT,
    Phases,
    ShootingOptions,
    ShootingProblem,
    ShootingResult,
    Smoothing,
)
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch, TouchSequence
from drake_aigto.world import Scenario, SpaceWorld, TaskCost

# Where nothing promises more than this part of the cost, a descent ends before its iterations do.
_TOLERANCE = 1e-4
# A tick descends on compliant walls that are smoothed by this part of the task's length: about how
# far off an estimate is that can still be planned from. With 3e-3 cart_pole/soft_06 stood within
# 0.02 m and rad of upright after 3 s from each of 8 seeds, with 1e-3 and 2e-3 from 5 and 2.
_SMOOTHING, _SUBSTEPS = 3e-3, 4
# What is pushed by friction, or in space, is touched more lightly: with 3e-4 a ball that lay 2 mm
# beside its place before a finger pushed it was 0.6 mm off in the end, with 3e-3 6 mm; and
# pushed_block/slide, planned again on its own model, cost 0.0315, with 3e-3 0.0761.
_LIGHT = 3e-4
# Friction that is too stiff for this number of Runge-Kutta steps in a time step is softened to what
# they resolve. With all of the 30 steps that it asks for, ticks took twice the CPU: the spinner,
# planned again, cost 2.69 for 2.75, and with a fifth less friction 4.11 for 4.06.
_FRICTION_STEPS = 8
# What a search finds is led to its optimum by at most this many iterations, before it is compared.
_FOUND = 60
# What misses its walls, bounds or hard goal by more than this part of the scales is no motion.
_MUCH = 1e-2
# A contact that lasts is this near to its wall, as a part of the task's length, and this slow, as a
# part of its speed.
_AT_WALL, _STILL = 1e-4, 1e-2
# Walls that a motion does not touch are kept off by this part of how much they are in doubt, if
# that costs no more than this part above the last plan. cart_pole/rigid_06 whose walls were 0, 6
# and 12 cm nearer cost 80.3, 80.7 and 81.9, and 79.8, 174 and 164 where none was kept off.
_OFF, _WORTH = 1 / 3, 0.1
# How often a tick's iterations are run again, until walls are met.
_UPDATES = 4
# What is tried where these lead to nothing, and after a search. The last plan is near: steps that
# close gaps at any cost leave it for motions that cost twice as much.
_MORE = ShootingOptions(
    rungs=(Smoothing(0.0, 20, _TOLERANCE),), substeps=4, order=2, multiplier_updates=8, is_wary=True
)


def make_horizon(planner: Planner, is_receding: bool, iterations: int, period: float) -> Horizon:
    """Returns a planner's task, compiled once more: what searches in a thread shares nothing.

    Args:
        planner: of the task.
        is_receding: whether the horizon always lasts as long as the scenario, or ends with it.
        iterations: of a descent in a tick, at most.
        period: between ticks [s].

    Raises:
        ControlError: a free duration, or costs or constraints that were added.
    """
    if planner.is_of_balls:
        return BallHorizon(planner, is_receding, period)
    is_rigid = planner.scenario.contact == "rigid" and planner.world.contacts
    kind = RigidHorizon if is_rigid else CompliantHorizon
    return kind(planner, is_receding, period, iterations)


class _ShootingHorizon(Horizon):
    """Mechanisms, whose motions a descent leads from one tick to the next."""

    _options: ShootingOptions  # of the descent in a tick

    def __init__(self, planner: Planner, is_receding: bool, period: float) -> None:
        """Compiles the planner's task, for ticks a period [s] apart."""
        super().__init__(planner, is_receding, period)
        self._task = make_mechanism_task(planner.world, planner.scenario, planner.options)
        self.num_steps, self.cost_scale = self._task.search_steps, self._task.scales.cost
        self._doubts = np.zeros(self.world.num_contacts)

    def wary(self, doubts: Floats) -> _ShootingHorizon:
        """Returns the same task, which keeps off walls that are not known well; see `Horizon`."""
        other = copy.copy(self)
        other._doubts = doubts
        return other

    def _find_least(self, last: PlannedMotion, q: Floats) -> Floats | None:
        """Returns lower bounds of φ, (m,), where what is in doubt is not touched; None: nowhere."""
        room = self.world.calc_signed_distance(q)
        least = np.where(self._doubts > 0, np.minimum(_OFF * self._doubts, room), -np.inf)
        least[[each.contact for each in last.touches]] = -np.inf
        return least if np.any(least > -np.inf) else None

    def within(self, iterations: int) -> _ShootingHorizon:
        """Returns the same task with other iterations; see `Horizon`."""
        other, rungs = copy.copy(self), self._options.rungs
        rungs = tuple(each._replace(iterations=iterations) for each in rungs)
        other._options = dataclasses.replace(self._options, rungs=rungs)
        return other

    def hold(self) -> Horizon | None:
        """Returns the task to hold a goal that all coordinates have, where a `Regulator` does."""
        world, scenario = self.world, self.scenario
        if not np.all(TaskCost.of(world, scenario).is_asked):
            return None
        goal = np.concatenate([scenario.goal_position, np.zeros(world.num_velocities)])
        regulator = Regulator.of(world, scenario, goal, self._step)
        if regulator is None:
            return None
        held = self.asking(regulator.pose(world, scenario))
        held.is_receding, held.regulator = True, regulator
        return held

    def _search(self, asked: Scenario) -> ShootingResult | None:
        """Returns the best motion that boxes, renewals and neighbors lead to, from time 0 on."""
        search = MechanismSearch(self._task.again(asked))
        try:
            search.explore()
        except (OptionsError, TrajectoryError):  # Numbers overflow from a state so far from all.
            return None
        return search.motions[0].result if search.motions else None


class CompliantHorizon(_ShootingHorizon):
    """A mechanism between compliant walls, or one that touches nothing.

    There a motion is all that has to be known of a plan, and a few iterations of the descent lead
    from the last one to the next (`ShootingProblem`).
    """

    is_rigid = False

    def __init__(self, planner: Planner, is_receding: bool, period: float, iterations: int) -> None:
        """Compiles the planner's task, for at most this many iterations in a tick."""
        super().__init__(planner, is_receding, period)
        self._problem = self._pose()
        self._has_friction = self._problem.mechanism.has_friction
        is_in_space = isinstance(self.world, SpaceWorld)
        stiff = _FRICTION_STEPS, IMPLICIT if is_in_space else 4
        substeps, order = stiff if self._has_friction else (_SUBSTEPS, 2)
        smoothing = _LIGHT if self._has_friction or is_in_space else _SMOOTHING
        rungs = (Smoothing(smoothing, iterations, _TOLERANCE),)
        self._options = ShootingOptions(rungs, substeps, order, multiplier_updates=0, judges=False)

    def _pose(self) -> ShootingProblem:
        problem = self._task.shooting(self.num_steps)
        return dataclasses.replace(problem, duration=self.scenario.duration)

    def asking(self: AnyHorizon, scenario: Scenario) -> AnyHorizon:
        """Returns the same for another task; see `Horizon`."""
        other: Any = super().asking(scenario)
        other._problem = other._pose()
        return other

    def _find_phases(self, motion: PlannedMotion) -> list[FeedbackPhase]:
        """Returns the one phase, with the gains of the descent about it."""
        if self.regulator:
            return super()._find_phases(motion)
        plan, states = motion.trajectory, motion.trajectory.states
        problem = motion.problem
        if problem is None:
            problem = dataclasses.replace(self._problem, times=plan.times, start=states[0])
        steps, smoothing = self._options, self._options.rungs[0].smoothing
        about = problem.linearize(plan.controls, steps.substeps, smoothing, states, steps.order)
        return [FeedbackPhase(plan.times, states, plan.controls, about.gains)]

    def is_inside(self, x: Floats) -> bool:
        """Returns False: compliant walls may be planned in."""
        return False

    def _lead(self, last: PlannedMotion, left: Trajectory) -> PlannedMotion | None:
        """Returns what a few iterations make of what is left of a motion."""
        asked = left.times, left.states, left.controls, self._options, last.cost
        if (least := self._find_least(last, left.positions[0])) is not None:
            wary = self._descend(*asked, least)
            if wary and wary.cost <= (1 + _WORTH) * last.cost:
                return wary
        return self._descend(*asked)

    def search(self, now: float, x: Floats) -> PlannedMotion | None:
        """Returns the best motion that boxes and renewals find from a state; None if none."""
        found = self._search(self._ask(now, x))
        if found is None:
            return None
        states = np.vstack([x, found.states[1:]])
        options = self.within(_FOUND)._options
        return self._descend(now + found.times, states, found.controls, options, np.inf)

    def _descend(
        self,
        times: Floats,
        states: Floats,
        controls: Floats,
        options: ShootingOptions,
        last_cost: float,
        least: Floats | None = None,
    ) -> PlannedMotion | None:
        """Returns the best motion near another one, whose gaps it closes; None if it finds none.

        Steps that close gaps let go of what is pushed by friction, and stay off it. So, with
        friction, what the controls lead to is tried before, from which no step costs more than the
        one before; gaps are closed where that costs more than the last plan did. Else a second pass
        makes bounds hold, if it has to.
        """
        known = {"times": times, "start": states[0], "least_distances": least}
        problem = dataclasses.replace(self._problem, **known)
        found = problem.solve(controls, None if self._has_friction else states, options)
        costs_more = not np.isfinite(found.cost) or found.cost > (1 + MARGIN) * last_cost
        if costs_more and self._has_friction:
            found = min(found, problem.solve(controls, states, options), key=lambda each: each.cost)
        elif found.violation > options.feasibility:
            found = problem.solve(found.controls, None, options, found.prices)
        motion = self._read(found)
        return motion and dataclasses.replace(motion, problem=problem)

    def _read(self, found: ShootingResult) -> PlannedMotion | None:
        """Returns a result as a motion; None if it leads nowhere."""
        if not (np.isfinite(found.cost) and np.all(np.isfinite(found.states))):
            return None
        motion = self._task.make_trajectory(found)
        inside = self.world.calc_signed_distance(motion.positions) <= 0
        comes = inside & ~np.vstack([np.zeros_like(inside[:1]), inside[:-1]])
        touches = (Touch.bounce(found.times[k], int(i)) for k, i in np.argwhere(comes))
        return PlannedMotion(motion, found.cost, tuple(touches))


class RigidHorizon(_ShootingHorizon):
    """A mechanism between rigid walls: a plan is its touches, and its motion.

    A few iterations of the descent, in the phases between the touches that are still to come, lead
    from the last plan to the next (`Phases`). Which touches these are is asked as for balls. Where
    they lead into a wall, as after a kick, a bounce is added there. With friction each touch keeps
    its mode, stick or slip. A contact that lasts does so as long as it was planned to, in the modes
    of the last plan, but for a slip that is seen to be another. Walls in doubt are kept off.
    """

    _task: RigidMechanismTask

    def __init__(self, planner: Planner, is_receding: bool, period: float, iterations: int) -> None:
        """Compiles the planner's task, for at most this many iterations in a tick."""
        super().__init__(planner, is_receding, period)
        rungs = (Smoothing(0.0, iterations, _TOLERANCE),)
        self._options = dataclasses.replace(_MORE, rungs=rungs, multiplier_updates=_UPDATES)

    def is_inside(self, x: Floats) -> bool:
        """Returns whether a wall is touched, and no contact lasts there.

        How fast something is in a rigid wall, the wall does not tell.
        """
        of_solids = self.world.are_of_one_solid @ self._lasts(x)
        inside = self.world.calc_signed_distance(np.split(x, 2)[0]) <= 0
        return any(
            np.all(inside[list(faces)]) and not np.any(of_solids[list(faces)])
            for faces in self.world.solids
        )

    def _lasts(self, x: Floats) -> Bools:
        """Returns which contacts last in a state, shape (m,)."""
        scales, (q, v) = self._task.scales, np.split(x, 2)
        at = np.abs(self.world.calc_signed_distance(q)) <= _AT_WALL * scales.length
        rates = self.world.calc_contact_rate(q, v)
        return np.asarray(at & (np.abs(rates) <= _STILL * scales.velocity))

    def _read_slips(self, x: Floats) -> dict[int, int]:
        """Returns, of contacts that last, the sign of the slip, 0 if they stick."""
        q, v = np.split(x, 2)
        slips = self.world.rubbing.calc_slips(q, v)
        is_still = np.abs(slips) <= _STILL * self._task.scales.velocity
        has_friction = self._task.rigid_law.friction > 0
        signs = np.where(is_still | ~has_friction, 0.0, np.sign(slips)).astype(int)
        return {int(i): int(signs[i]) for i in np.flatnonzero(self._lasts(x))}

    def _lead(self, last: PlannedMotion, left: Trajectory) -> PlannedMotion | None:
        """Returns what a few iterations make of what is left of a motion; None if that is none."""
        now, q, v = float(left.times[0]), left.positions[0], left.velocities[0]
        duration, rates = float(left.times[-1]) - now, self.world.calc_contact_rate(q, v)
        touches, slips = go_on(last), self._read_slips(np.concatenate([q, v]))
        sequences = find_left(touches, now, duration, self._period, rates, None, slips)
        missed = list[ShootingResult]()
        if (least := self._find_least(last, q)) is not None:
            wary = choose(self._close(left, sequences[:1], self._options, [], least), last.cost)
            if wary and wary.cost <= (1 + _WORTH) * last.cost:
                return wary
        for options in (self._options, _MORE):
            missed.clear()
            if found := choose(self._close(left, sequences, options, missed), last.cost):
                return found
        return choose((self._with_bounce(each, now) for each in missed), last.cost)

    def _close(
        self,
        left: Trajectory,
        sequences: Sequence[TouchSequence],
        options: ShootingOptions,
        found: list[ShootingResult],
        least: Floats | float = -np.inf,
    ) -> Iterator[PlannedMotion | None]:
        """Yields the motions of descents, and appends what they led to, which may be none.

        First they close gaps; where whole steps that do so lead far off, what the controls lead to
        may be nearer.
        """
        for closes_gaps in (True, False):
            for touches in sequences:
                found.append(self._descend(left, touches, options, closes_gaps, least))
                yield self._read(found[-1], float(left.times[0]))

    def search(self, now: float, x: Floats) -> PlannedMotion | None:
        """Returns the best motion that boxes, renewals and neighbors lead to; None if none."""
        found = self._search(self._ask(now, x))
        if found is None:
            return None
        # With its prices it stays where it is; penalties that begin anew would lead away from it.
        problem = self._pose_from(x, now, found.times, found.phases)
        settled = self._solve(problem, found.controls, None, _MORE, found.prices)
        return choose((self._read(each, now) for each in (settled, found)), np.inf)

    def _with_bounce(self, missed: ShootingResult, now: float) -> PlannedMotion | None:
        """Returns the best motion near one that misses walls, with a bounce where it is deepest."""
        dip = find_deepest(self.world, missed) if np.isfinite(missed.cost) else None
        if dip is None:
            return None
        motion = make_trajectory(self.world, missed)
        apart = keep_apart(self._task.with_dip(missed, dip), 0.0, float(motion.times[-1]))
        return self._read(self._descend(motion.later(now), apart, _MORE), now)

    def _descend(
        self,
        left: Trajectory,
        touches: TouchSequence,
        options: ShootingOptions,
        closes_gaps: bool = True,
        least: Floats | float = -np.inf,
    ) -> ShootingResult:
        """Returns the best motion near a trajectory, with touches as times after its start."""
        q, elapsed = left.positions, left.times - left.times[0]
        times, phases = lay_onto(touches, elapsed, self.world.num_contacts)
        after = np.hstack([q, left.velocities + self.world.calc_velocity_change(q, left.impulses)])
        middles = (times[1:] + times[:-1]) / 2
        problem = self._pose_from(after[0], left.times[0], times, phases, least)
        controls = left.controls[np.searchsorted(elapsed, middles) - 1]
        states = interpolate(times, elapsed, after) if closes_gaps else None
        return self._solve(problem, controls, states, options)

    def _pose_from(
        self, start: Floats, now: float, times: Floats, phases: Phases, least: Any = -np.inf
    ) -> ShootingProblem:
        """Returns the task from a state and a time on, at knots that count from then on."""
        task = self._task.pose_phases(times, phases)
        cost = dataclasses.replace(task.cost, times=task.cost.times - now)
        least = np.maximum(least, self._task.least_distances)
        return dataclasses.replace(task, start=start, cost=cost, least_distances=least)

    def _solve(
        self,
        problem: ShootingProblem,
        controls: Floats,
        states: Floats | None,
        options: ShootingOptions,
        prices: Floats | None = None,
    ) -> ShootingResult:
        """Returns the best motion near a guess (`ShootingProblem.solve`).

        Where it grazes a wall between its knots it is restored off it, as the plant would bounce.
        """
        found = problem.solve(controls, states, options, prices)
        apart = keep_off(self.world, problem, found, _AT_WALL * self._task.scales.length)
        return found if apart is None else apart.restore(found)

    def _read(self, found: ShootingResult, now: float) -> PlannedMotion | None:
        """Returns a result as a motion from now on; None if it leads nowhere, or misses walls."""
        is_finite = np.isfinite(found.cost) and np.all(np.isfinite(found.states))
        if not is_finite or found.violation > _MUCH:
            return None
        motion = make_trajectory(self.world, found)
        return PlannedMotion(motion, self._task.price(found), found.touches).later(now)
