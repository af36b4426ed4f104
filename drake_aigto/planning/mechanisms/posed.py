"""A mechanism's task, posed for shooting, and what shooting finds, judged by simulations."""

from __future__ import annotations

import dataclasses
from functools import cache, cached_property
from typing import Any, TypeVar

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import (
    AnyMechanism,
    CompliantLaw,
    ContactLaw,
    RigidLaw,
    contact_law,
    make_mechanism,
)
from drake_aigto.planning.candidate import (
    NO_CONTROL,
    Candidate,
    Origin,
    Replays,
    add_to_replay,
    sample,
)
from drake_aigto.planning.feedback import Feedback
from drake_aigto.planning.mechanisms.closing import HOPELESS, MOST_SUBSTEPS, POLISH
from drake_aigto.planning.mechanisms.guesses import Measures
from drake_aigto.planning.mechanisms.traces import trace
from drake_aigto.planning.options import PlanOptions
from drake_aigto.planning.tracked import (
    confirm_in_drake,
    follow,
    make_feedback,
    perturb,
    replay_alone,
)
from drake_aigto.shooting import (
    NO_TERMS,
    AddedTerms,
    FreeStart,
    Phases,
    ShootingProblem,
    ShootingResult,
    limit_states,
)
from drake_aigto.simulation import (
    BOUNDS,
    CLEARANCE,
    HARD_GOAL,
    MOST_GROWTH,
    Replay,
    calc_excess,
    calc_lacks,
    calc_misses,
    find_contacts,
    max_penetration,
    narrow_bounds,
    replay_event_driven,
    state_scales,
)
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import INTEGRATION, NO_ADDITIONS, Additions, Samples
from drake_aigto.world import Scales, Scenario, SpaceWorld, TaskCost, World

_Task = TypeVar("_Task", bound="PosedMechanism")


@dataclasses.dataclass(frozen=True, eq=False)
class Compiled:
    """Tables that all tasks with one contact law share."""

    mechanism: AnyMechanism  # the world as shooting has it
    additions: Additions = NO_ADDITIONS  # costs and constraints of users
    added: AddedTerms = NO_TERMS  # these, compiled for shooting

    @classmethod
    def of(
        cls, world: World, scenario: Scenario, law: ContactLaw, additions: Additions
    ) -> Compiled:
        """Compiles a world with its contact law, and costs and constraints of users.

        Raises:
            ProgramError, UnsupportedTermError: see `AddedTerms.of`.
        """
        apart = np.flatnonzero(np.isfinite(world.least_distances(scenario)))
        if not isinstance(world, SpaceWorld):
            apart = apart[:0]  # There, distances of all contacts have bounds.
        added = AddedTerms.of(world, additions, apart) if additions or len(apart) else NO_TERMS
        return cls(make_mechanism(world, law), additions, added)


class PosedMechanism:
    """A task of a mechanism as a problem of shooting, which is compiled for its world, once.

    Attributes:
        world: the mechanism.
        scenario: the task.
        options: numerics.
        additions: costs and constraints of users.
        task: the scenario's cost.
        bounds: of positions, velocities and controls.
        least_distances: φ of contacts at least, by the clearance, shape (m,) [m]; −∞: any.
        lead: how far beside a hard goal motions end in steps, to be there in exact ones, (2n,).
        law: of its contacts.
        scales: of the task and its verdict, and `state_scales` of q and v, shape (2n,).
        measures: units of the search.
        search_steps: of motions during the search.
        shooting: the problem in any number of time steps.
    """

    def __init__(
        self,
        world: World,
        scenario: Scenario,
        options: PlanOptions,
        compiled: Compiled | None = None,
        additions: Additions = NO_ADDITIONS,
    ) -> None:
        """Reads the task.

        Args:
            world: the mechanism.
            scenario: the task.
            options: numerics.
            compiled: of the same world, law and additions.
            additions: costs and constraints of users.

        Raises:
            OptionsError: an option does not count for mechanisms.
            ProgramError: a cost or constraint of the user can't be planned here; says why.
            UnsupportedTermError: it has a factor that is no power, sin or cos.
        """
        options.check(is_of_balls=False)
        self.world, self.scenario, self.options = world, scenario, options
        self.task, self.bounds = TaskCost.of(world, scenario), world.bounds(scenario)
        self.least_distances = world.least_distances(scenario)
        self.lead = np.zeros(2 * world.num_velocities)
        self.law = contact_law(world, scenario)
        self.scales, self.state_scales = Scales.of(world, scenario), state_scales(world, scenario)
        self.measures = Measures.of(world, scenario)
        self.search_steps = min(scenario.num_steps, options.search_steps)
        self._compiled = compiled or Compiled.of(world, scenario, self.law, additions)
        self.additions = self._compiled.additions
        is_free = scenario.duration_range is not None or scenario.periodic is not None
        if isinstance(self.law, RigidLaw) or is_free:
            self._compiled.added.check_untimed()
        self.shooting = cache(self._pose)

    @property
    def mechanism(self) -> AnyMechanism:
        """The mechanism of motions during the search."""
        return self._compiled.mechanism

    def _pose(self, num_steps: int) -> ShootingProblem:
        """Returns the task in this number of time steps."""
        T, free, bounds = self.scenario.duration, self.scenario.duration_range, self.bounds
        times, measures, world = np.linspace(0.0, T, num_steps + 1), self.measures, self.world
        limits, start = limit_states(world, bounds), None
        if self.scenario.periodic is not None:  # How far it may begin from the given start.
            (q, v), n = world.split(self.scenario.initial_state), world.num_velocities
            off = limits - np.concatenate([world.in_tangent(q, np.zeros(1)), v])
            off[:, :n][:, np.isfinite(world.find_advance(self.scenario))] = 0.0
            free, start = free or (T, T), FreeStart(off, np.zeros(2 * n))
        added = self._compiled.added
        problem = ShootingProblem.of(world, self.scenario, self.mechanism, times, added)
        return dataclasses.replace(
            problem,
            hard_goal=problem.hard_goal + self.lead,
            scales=np.concatenate([measures.position, measures.velocity]),
            length=measures.length,
            # Springs that stand in for rigid walls are as soft as they should be.
            softens=isinstance(self.law, CompliantLaw) and self.law.has_friction,
            state_bounds=limits,
            least_distances=self.least_distances,
            phases=None if free is None else Phases.free(T, free),
            free_start=start,
        )

    def judge(self, origin: Origin, start: ShootingResult, found: ShootingResult) -> Candidate:
        """Returns the candidate of a motion: the simulation of its controls.

        Args:
            origin: where it came from.
            start: the first motion.
            found: the result of shooting from it, in the scenario's time steps.
        """
        scenario, (end, _) = self.ask(found), self.world.split(found.states[-1])
        replay, trajectory, judged = self._simulate(found)
        refined = None if found is self.idle_motion else self.pose_again(found).refine_cost(found)
        (cost, error), added = refined or (found.exact_cost, None), dict[str, float]()
        if self.additions:
            q, v = self.world.split(found.states)
            counted = self.additions.costs(Samples(found.times, q, v, found.controls))
            added = self.additions.costs(sample(trajectory))
            # At an impact, shooting takes the state after it, and trajectories the one before.
            cost += sum(added.values()) - sum(counted.values())
        return Candidate(
            origin=origin,
            start_cost=start.exact_cost,
            start_defects={BOUNDS: start.violation},
            trajectory=trajectory,
            cost=cost,
            goal_error=float(TaskCost.of(self.world, scenario).goal_error(end)),
            max_penetration=max_penetration(self.world, trajectory),
            contacts=find_contacts(self.world, trajectory),
            replay=add_to_replay(replay, self.additions, trajectory),
            scales=self.scales,
            added_costs=added,
            cost_error=error,
            **judged,
        )

    def pose_again(self, found: ShootingResult) -> ShootingProblem:
        """Returns the problem that a motion is a result of."""
        return self.shooting(len(found.controls)).starting_from(found)

    def ask(self, found: ShootingResult) -> Scenario:
        """Returns the scenario, from where a motion begins."""
        return self.scenario.starting_at(found.states[0])

    def _simulate(self, found: ShootingResult) -> tuple[Replay, Trajectory, dict[str, Any]]:
        """Returns the replay that judges a motion, its trajectory, and a candidate's fields."""
        world, scenario, mechanism = self.world, self.ask(found), self._compiled.mechanism
        motion, feedback = self.make_trajectory(found), None
        if found is not self.idle_motion:
            feedback = make_feedback(world, scenario, motion, mechanism=mechanism)
        growth = feedback.growth if feedback else None
        if feedback is None or growth is None or growth.factor <= MOST_GROWTH:
            replay, trajectory, defects = self._simulate_alone(found)
            return replay, trajectory, {"defects": defects, "growth": growth}
        replay, *held = follow(world, scenario, feedback)
        trajectory, defects = self._trace(replay, *held)
        judged: dict[str, Any] = {"defects": defects, "growth": growth}
        judged |= {"gains": tuple(feedback.phases)}
        judged |= {"alone": replay_alone(world, scenario, motion)}
        judged |= {"perturbed": perturb(world, scenario, feedback, growth)}
        return replay, trajectory, judged

    def make_trajectory(self, found: ShootingResult) -> Trajectory:
        """Returns a motion of shooting as a trajectory."""
        q, v = self.world.split(found.states)
        none = np.zeros((len(q), self.world.num_contacts))
        return Trajectory(found.times, q, v, found.controls, none, none[1:])

    def _simulate_alone(self, found: ShootingResult) -> tuple[Replay, Trajectory, dict[str, float]]:
        """Returns the simulation of controls, its trajectory, and defects of the equations."""
        replay = found.replay or replay_event_driven(
            self.world, self.ask(found), found.times, found.controls
        )
        return replay, *self._trace(replay, found.times, found.controls)

    def _trace(
        self, replay: Replay, times: Floats, controls: Floats
    ) -> tuple[Trajectory, dict[str, float]]:
        """Returns the trajectory of a replay, and its defects of the equations."""
        trajectory, gap = trace(self.world, self.law, replay, times, controls)
        return trajectory, {INTEGRATION: float(np.max(gap / self.state_scales))}

    def idle_candidate(self) -> Candidate:
        """Returns the uncontrolled motion, of the best duration, with the cost of its replay.

        Nothing corrects it, however unstable it is.
        """
        idle = self.idle_motion
        found = self.judge(Origin(NO_CONTROL), idle, idle)
        cost, goal_error = found.replay.cost, found.replay.goal_error
        return dataclasses.replace(found, start_cost=cost, cost=cost, goal_error=goal_error)

    @cached_property
    def idle_motion(self) -> ShootingResult:
        """The uncontrolled motion, of the best duration."""
        num_steps = self.scenario.num_steps
        if (problem := self.shooting(num_steps)).phases is None:
            return self.let_go(num_steps)
        none = np.zeros((num_steps, self.world.num_actuators))
        nothing = np.tile(np.clip(0.0, *problem.control_bounds), (2, 1))
        return dataclasses.replace(problem, control_bounds=nothing).solve(none, None, POLISH)

    def let_go(self, num_steps: int) -> ShootingResult:
        """Returns the uncontrolled motion, in Runge-Kutta steps that do not blow it up."""
        problem, none = self.shooting(num_steps), np.zeros((num_steps, self.world.num_actuators))
        motion = problem.simulate(none, POLISH.substeps)
        while not np.isfinite(motion.states).all() and motion.substeps < MOST_SUBSTEPS:
            motion = problem.simulate(none, 2 * motion.substeps)
        return motion

    def confirm(self, candidate: Candidate) -> Replays:
        """Returns the candidate's replays: its own, and Drake's if the options confirm."""
        if not self.options.confirm:
            return candidate.own_replays
        motion, gains = candidate.trajectory, candidate.gains
        scenario = self.scenario.starting_at(motion.states[0])
        feedback = Feedback(self.world, scenario, motion, gains) if gains else None
        drake, *alone = confirm_in_drake(self.world, scenario, motion, feedback)
        own = candidate.own_replays
        return dataclasses.replace(
            own, drake=add_to_replay(drake, self.additions, motion), alone=(*own.alone, *alone)
        )

    def narrowed(self: _Task, motion: ShootingResult, candidate: Candidate) -> _Task | None:
        """Returns the task narrowed by what simulations of a motion miss; None if it is nothing.

        Bounds and clearances hold at knots, and may be exceeded in between, as right before a
        touch. A hard goal that is missed by little is moved by as much.
        """
        world, scenario, last = self.world, self.scenario, candidate.replay
        replays = candidate.own_replays.judging
        broken = [each for each in replays if not {BOUNDS, CLEARANCE}.isdisjoint(each.broken)]
        is_beside = HARD_GOAL in last.broken and last.violations[HARD_GOAL] < HOPELESS
        if not broken and not is_beside:
            return None
        other = self.again(scenario)
        other.bounds, other.least_distances = self.bounds, self.least_distances
        other.lead = self.lead
        if broken:
            q = np.concatenate([each.positions for each in broken])
            v = np.concatenate([each.velocities for each in broken])
            excess = calc_excess(world, scenario, q, v)
            other.bounds = narrow_bounds(self.bounds, motion.states[1:], excess)
            other.least_distances = self.least_distances + calc_lacks(world, scenario, q)
        if is_beside:
            asked = scenario.starting_at(motion.states[0])  # With its goal, where it is periodic.
            end = last.positions[-1], last.velocities[-1]
            other.lead = self.lead - calc_misses(world, asked, *end)
        return other

    def again(self: _Task, scenario: Scenario) -> _Task:
        """Returns the task of a changed scenario."""
        return type(self)(self.world, scenario, self.options, self._compiled)
