"""A mechanism's task, compiled for shooting: the road's steps one by one."""

from __future__ import annotations

import dataclasses
from functools import cache, cached_property
from typing import ClassVar

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
from drake_aigto.errors import ProgramError, ScenarioError
from drake_aigto.planning.candidate import (
    NO_CONTROL,
    Candidate,
    Origin,
    Replays,
    add_to_replay,
    sample,
)
from drake_aigto.planning.feedback import Feedback
from drake_aigto.planning.mechanisms.closing import (
    COOLING,
    HOPELESS,
    POLISH,
    Aim,
    begin_at,
    close_gaps,
    find_closing,
    find_tight,
    halve_steps,
    settle,
    soften,
    steady,
)
from drake_aigto.planning.mechanisms.guesses import Guess, Guesses, Measures, sample_cubic
from drake_aigto.planning.mechanisms.traces import trace
from drake_aigto.planning.options import PlanOptions
from drake_aigto.planning.tracked import (
    Simulated,
    confirm_in_drake,
    follow,
    make_feedback,
    needs_feedback,
    perturb,
    replay_alone,
)
from drake_aigto.shooting import (
    NO_TERMS,
    AddedTerms,
    Phases,
    ShootingOptions,
    ShootingProblem,
    ShootingResult,
    limit_states,
)
from drake_aigto.simulation import (
    BOUNDS,
    Replay,
    calc_excess,
    calc_lacks,
    find_contacts,
    max_penetration,
    narrow_bounds,
    replay_event_driven,
    state_scales,
)
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import (
    INTEGRATION,
    NO_ADDITIONS,
    Additions,
    Samples,
)
from drake_aigto.world import Scales, Scenario, SpaceWorld, TaskCost, World

# Price of violating bounds (relative to the state's scales) in the task's scale. As a violation may
# save more than that, motions with a larger one than `_MUCH` rank after all others.
_PRICE, _MUCH = 10.0, 1e-2
# Horizons of more periods than this are searched at half their length first.
_LONG = 4.0
# The factor by which costs fall at most as steps become shorter, which changes their order, and how
# many times as many finalists are polished for that: without friction; with it; and in space, where
# motions are ranked after few iterations.
_PLAIN, _SLIDING, _IN_SPACE = (1.0, 1), (1.2, 2), (2.0, 4)
# Motions that promise to cost more than this times the worst kept one are left unfinished. In 3,072
# boxes around cart-poles between soft walls that saves 31 % of all iterations and loses 10 of 346
# motions that would have been the best so far; 1.0 saves 37 % and loses 13, and 1.5 22 % and 8.
_WORTH = 1.2


@dataclasses.dataclass(frozen=True, eq=False)
class Compiled:
    """Tables that all tasks with one contact law share.

    Attributes:
        mechanism: the world as shooting has it.
        additions: costs and constraints of users.
        added: these, compiled for shooting.
    """

    mechanism: AnyMechanism
    additions: Additions = NO_ADDITIONS
    added: AddedTerms = NO_TERMS

    @classmethod
    def of(cls, world: World, law: ContactLaw, additions: Additions) -> Compiled:
        """Compiles a world with its contact law, and costs and constraints of users.

        Raises:
            ProgramError, UnsupportedTermError: see `AddedTerms.of`.
        """
        if additions and isinstance(world, SpaceWorld):
            remedy = "Weigh coordinates in the scenario."
            raise ProgramError("costs and constraints of users", "some, in space", "none", remedy)
        added = AddedTerms.of(world, additions) if additions else NO_TERMS
        return cls(make_mechanism(world, law), additions, added)


class MechanismTask:
    """A task of a mechanism between compliant walls, or of one without contacts.

    Guesses of its motion (`Guesses`) are closed by shooting (`ShootingProblem`), which is compiled
    for the world, once.

    Attributes:
        world: the mechanism.
        scenario: the task.
        options: numerics.
        additions: costs and constraints of users.
        task: the scenario's cost.
        bounds: of positions, velocities and controls.
        least_distances: φ of contacts at least, by the clearance, shape (m,) [m]; −∞: any.
        law: of its contacts.
        scales: of the task and its verdict, and `state_scales` of q and v, shape (2n,).
        measures: units of the search.
        search_steps: of motions during the search.
        shooting: the problem in any number of time steps.
    """

    transcription_name: ClassVar[str] = "shooting"
    remedy: ClassVar[str] = "Allow more time or control, or try more renewals."

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
            ScenarioError: the duration is free, in space.
        """
        options.check(is_of_balls=False)
        if isinstance(world, SpaceWorld) and scenario.duration_range is not None:
            got = f"{list(scenario.duration_range)}, in space"
            raise ScenarioError("duration_range", got, "none, as its time is given there")
        self.world, self.scenario, self.options = world, scenario, options
        self.task, self.bounds = TaskCost.of(world, scenario), world.bounds(scenario)
        self.least_distances = world.least_distances(scenario)
        self.law = contact_law(world, scenario)
        self.scales, self.state_scales = Scales.of(world, scenario), state_scales(world, scenario)
        self.measures = Measures.of(world, scenario)
        self.search_steps = min(scenario.num_steps, options.search_steps)
        self._compiled = compiled or Compiled.of(world, self.law, additions)
        self.additions = self._compiled.additions
        if isinstance(self.law, RigidLaw) or scenario.duration_range is not None:
            self._compiled.added.check_untimed()
        self.shooting = cache(self._pose)

    @property
    def mechanism(self) -> AnyMechanism:
        """The mechanism of motions during the search."""
        return self._compiled.mechanism

    def _pose(self, num_steps: int) -> ShootingProblem:
        """Returns the task in this number of time steps."""
        T, free, bounds = self.scenario.duration, self.scenario.duration_range, self.bounds
        times, measures = np.linspace(0.0, T, num_steps + 1), self.measures
        return dataclasses.replace(
            ShootingProblem.of(
                self.world, self.scenario, self.mechanism, times, self._compiled.added
            ),
            scales=np.concatenate([measures.position, measures.velocity]),
            length=measures.length,
            state_bounds=limit_states(self.world, bounds),
            least_distances=self.least_distances if self.mechanism.num_contacts else None,
            phases=None if free is None else Phases.free(T, free),
        )

    @cached_property
    def coast(self) -> ShootingResult:
        """The uncontrolled motion."""
        problem = self.shooting(self.search_steps)
        controls = np.zeros((self.search_steps, self.world.num_actuators))
        return problem.simulate(controls, substeps=4)

    @property
    def num_starts(self) -> int:
        """How many guesses are closed first."""
        return self.options.starts + len(self.guesses.sharp_starts)

    @property
    def sources(self) -> str:
        """The sources of candidates, in words."""
        return f"{self.num_starts} starts and {self.options.renewals} renewals"

    @property
    def polish_ratio(self) -> float:
        """Motions that cost more than this times the best finalist are not polished."""
        return self._falls[0]

    @property
    def finalists(self) -> int:
        """How many of the best motions are polished, at most."""
        return self.options.finalists * self._falls[1]

    @property
    def _falls(self) -> tuple[float, int]:
        """By how much costs may fall in a polish, and how many times more motions it is for."""
        if not self.mechanism.has_friction:
            return _PLAIN
        return _IN_SPACE if isinstance(self.world, SpaceWorld) else _SLIDING

    @property
    def close_ratio(self) -> float:
        """Motions that promise to cost more than this times a kept one are left unfinished."""
        return _WORTH

    @cached_property
    def _springs(self) -> CompliantLaw:
        """The springs that replace walls in guesses."""
        if isinstance(self.law, CompliantLaw):
            return self.law
        time_step = self.scenario.duration / self.search_steps
        return soften(self.world, self.law, time_step, self.measures.speed)

    @cached_property
    def guesses(self) -> Guesses:
        """Guesses of motions."""
        T = self.scenario.duration
        total = self.scenario.duration_range or (T, T)
        problem = self.shooting(self.search_steps)
        return Guesses(self.world, self._springs, problem, self.measures, self.coast, total)

    def shortened(self) -> MechanismTask | None:
        """Returns the task in half of the time, if the mechanism may rest in the other half.

        None where the duration is free, or no longer than a few periods of the mechanism, or hands
        push, which take their time.
        """
        scenario, step = self.scenario, self.scenario.time_step
        is_long = scenario.duration > _LONG * self.measures.period
        if scenario.duration_range is not None or not is_long or "push" in self.guesses.starts:
            return None
        half = dataclasses.replace(scenario, duration=step * max(2, scenario.num_steps // 2))
        options = dataclasses.replace(self.options, renewals=self.options.renewals // 2)
        return type(self)(self.world, half, options, self._compiled)

    def close(self, guess: Guess, aim: Aim) -> ShootingResult:
        """Returns the motion after a few steps from a guess."""
        options = begin_at(self._closing, guess.width)
        is_telling = self.mechanism.has_friction and not isinstance(self.world, SpaceWorld)
        options = aim.limit(options, is_telling)
        return self._close_on_springs(guess, options, aim.is_patient)

    @cached_property
    def _closing(self) -> ShootingOptions:
        """Options for closing guesses."""
        q, is_aimed = self.scenario.initial_position, self.scenario.hard_goal
        time_step = self.scenario.duration / self.search_steps
        return self._resolve(find_closing(self.world, self.law, q, time_step, is_aimed))

    @cached_property
    def _tightening(self) -> ShootingOptions:
        """Options for refining closed motions."""
        scenario = self.scenario
        tight = find_tight(self.world, scenario.initial_position, scenario.time_step)
        return self._resolve(tight)

    def _resolve(self, options: ShootingOptions) -> ShootingOptions:
        """Returns options with as many Runge-Kutta steps as are asked for."""
        substeps = max(options.substeps, self.options.search_substeps)
        return dataclasses.replace(options, substeps=substeps)

    def _close_on_springs(
        self, guess: Guess, options: ShootingOptions, is_patient: bool = True
    ) -> ShootingResult:
        problem = self.shooting(self.search_steps).lasting(float(guess.times[-1]))
        controls, states = guess.sample(problem.knot_times)
        found = problem.solve(controls, states, options)
        if self.mechanism.has_friction or not is_patient or self.is_of_use(found):
            return found
        # Worse than no control, it has most likely diverged.
        return min(found, problem.solve(controls, states, options.wary), key=self.rank)

    def is_of_use(self, motion: ShootingResult) -> bool:
        """Returns whether a motion is better than no control, or was left unfinished."""
        return motion.is_left or self.rank(motion) < self.rank(self.coast)

    def tighten(self, motion: ShootingResult) -> ShootingResult:
        """Returns the local optimum near a motion, in the scenario's time steps.

        As other steps change an unstable motion, its states are kept, and gaps between them are
        closed.
        """
        problem = self.shooting(self.scenario.num_steps).starting_from(motion)
        times = problem.knot_times
        controls = motion.controls[np.searchsorted(motion.times, (times[1:] + times[:-1]) / 2) - 1]
        q, v = self.world.split(motion.states)
        states = sample_cubic(self.world, motion.times, q, v, times)
        return close_gaps(problem, motion, controls, states, self._tightening)

    def polish(self, motion: ShootingResult, most: float = np.inf) -> ShootingResult:
        """Returns the local optimum near a motion, its time steps halved until they agree.

        A steady motion is refined from its controls, by steps that never raise the cost. With
        friction it may not be steady: as friction sharpens, the same controls lose contact.

        Args:
            motion: the motion.
            most: what promises to cost more is left unfinished.
        """
        has_friction, num_steps = self.mechanism.has_friction, self.scenario.num_steps
        if len(motion.controls) < num_steps or motion.substeps < POLISH.substeps:
            motion = self.tighten(motion)
        problem = self.shooting(num_steps)
        if self.world.dry_friction is not None:
            # While a joint sticks, only far smoother friction has slopes that show what moves it.
            substeps = max(COOLING.substeps, motion.substeps)
            cooling = dataclasses.replace(COOLING, substeps=substeps)
            cooled = problem.starting_from(motion).solve(motion.controls, None, cooling)
            motion = min(motion, cooled, key=self.rank)
        if isinstance(self.world, SpaceWorld) and has_friction:
            return settle(self.world, self.scenario, problem, motion, most)
        motion = halve_steps(problem, motion, most)
        is_done = motion.is_left or motion.violation > HOPELESS
        if is_done or not (has_friction and np.isfinite(motion.exact_cost)):
            return motion
        return steady(self.world, self.scenario, problem.starting_from(motion), motion)

    def price(self, motion: ShootingResult) -> float:
        """Returns J of a motion, plus a price for violations of bounds and a hard goal."""
        missed = max(0.0, motion.violation - POLISH.feasibility)
        return motion.cost + _PRICE * self.scales.cost * missed

    def rank(self, motion: ShootingResult) -> tuple[bool, float]:
        """Orders motions by whether their violation is large, and by their price."""
        return motion.violation > _MUCH, self.price(motion)

    def judge(self, origin: Origin, start: ShootingResult, found: ShootingResult) -> Candidate:
        """Returns the candidate of a motion: the simulation of its controls.

        Args:
            origin: where it came from.
            start: the first motion.
            found: the result of shooting from it, in the scenario's time steps.
        """
        simulated = self._simulate(found)
        replay, trajectory = simulated.replay, simulated.trajectory
        (cost, error), added = self._calc_cost(found), dict[str, float]()
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
            goal_error=float(self.task.goal_error(found.states[-1, : self.world.num_positions])),
            defects=simulated.defects,
            max_penetration=max_penetration(self.world, trajectory),
            contacts=find_contacts(self.world, trajectory),
            replay=add_to_replay(replay, self.additions, trajectory),
            scales=self.scales,
            added_costs=added,
            cost_error=error,
            growth=simulated.growth,
            gains=simulated.gains,
            alone=simulated.alone,
            perturbed=simulated.perturbed,
        )

    def _calc_cost(self, found: ShootingResult) -> tuple[float, float]:
        """Returns J of a motion in steps of half the length, and by how much that differs."""
        return self.pose_again(found).refine_cost(found)

    def pose_again(self, found: ShootingResult) -> ShootingProblem:
        """Returns the problem that a motion is a result of."""
        return self.shooting(len(found.controls)).starting_from(found)

    def _simulate(self, found: ShootingResult) -> Simulated:
        """Returns the simulation of a motion: its control alone, or with its feedback."""
        world, scenario, mechanism = self.world, self.scenario, self._compiled.mechanism
        motion, feedback = self.make_trajectory(found), None
        if found is not self.idle_motion:
            feedback = make_feedback(world, scenario, motion, mechanism=mechanism)
        growth = feedback.growth if feedback else None
        if feedback is None or not needs_feedback(growth):
            replay, trajectory, defects = self._simulate_alone(found)
            return Simulated(replay, trajectory, defects, growth)
        assert growth is not None
        followed = follow(world, scenario, feedback)
        return Simulated(
            followed.replay,
            *self._trace(*followed),
            growth,
            tuple(feedback.phases),
            replay_alone(world, scenario, motion),
            perturb(world, scenario, feedback, growth),
        )

    def make_trajectory(self, found: ShootingResult) -> Trajectory:
        """Returns a motion of shooting as a trajectory."""
        q, v = self.world.split(found.states)
        none = np.zeros((len(q), self.world.num_contacts))
        return Trajectory(found.times, q, v, found.controls, none, none[1:])

    def _simulate_alone(self, found: ShootingResult) -> tuple[Replay, Trajectory, dict[str, float]]:
        """Returns the simulation of controls, its trajectory, and defects of the equations."""
        replay = found.replay or replay_event_driven(
            self.world, self.scenario, found.times, found.controls
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
        return dataclasses.replace(
            found, start_cost=cost, cost=cost, goal_error=goal_error, cost_error=None
        )

    @cached_property
    def idle_motion(self) -> ShootingResult:
        """The uncontrolled motion, of the best duration."""
        problem = self.shooting(self.scenario.num_steps)
        none = np.zeros((self.scenario.num_steps, self.world.num_actuators))
        if problem.phases is None:
            return problem.simulate(none, POLISH.substeps)
        nothing = np.tile(np.clip(0.0, *problem.control_bounds), (2, 1))
        return dataclasses.replace(problem, control_bounds=nothing).solve(none, None, POLISH)

    def confirm(self, candidate: Candidate) -> Replays:
        """Returns the candidate's replays: its own, and Drake's if the options confirm."""
        if not self.options.confirm:
            return candidate.own_replays
        motion, gains = candidate.trajectory, candidate.gains
        feedback = Feedback(self.world, self.scenario, motion, gains) if gains else None
        drake, *alone = confirm_in_drake(self.world, self.scenario, motion, feedback)
        own = candidate.own_replays
        return dataclasses.replace(
            own,
            drake=add_to_replay(drake, self.additions, motion),
            alone=(*own.alone, *alone),
        )

    def narrowed(self, motion: ShootingResult, replay: Replay) -> MechanismTask:
        """Returns the task with bounds and clearances narrowed by the excess of a motion's replay.

        Bounds hold at knots, and speeds may exceed them in between, as right before a touch.
        """
        excess = calc_excess(self.world, self.scenario, replay.positions, replay.velocities)
        other = self.again(self.scenario)
        other.bounds = narrow_bounds(self.bounds, motion.states[1:], excess)
        lacks = calc_lacks(self.world, self.scenario, replay.positions)
        other.least_distances = self.least_distances + lacks
        return other

    def again(self, scenario: Scenario) -> MechanismTask:
        """Returns the task of a changed scenario."""
        return type(self)(self.world, scenario, self.options, self._compiled)
