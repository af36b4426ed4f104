"""A task, asked again from where things are: what a controller that plans again goes through."""

from __future__ import annotations

import copy
import dataclasses
from abc import ABC, abstractmethod
from typing import Any, TypeVar

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.control.touches import WALL_DOUBT, PlannedMotion, SeenBounces, choose, find_left
from drake_aigto.errors import (
    ControlError,
    OptionsError,
    ProgramError,
    TrajectoryError,
    UnsupportedTermError,
)
from drake_aigto.planning import (
    BallSearch,
    BallTask,
    Feedback,
    FeedbackPhase,
    Path,
    Planner,
    PlanningError,
    Regulator,
    make_ball_task,
)
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import TouchSequence
from drake_aigto.world import Scales, Scenario

_ASKED = "the planner of a controller that plans again"
# A step of which less than this part is left is over.
_OVER = 1e-3
# What walls are thought to return counts like a bounce at this part of the task's velocity; and a
# bounce is seen between samples that are at most this number of periods apart.
_DOUBT, _RECENT = 0.1, 4.0
# Of what they return, and of where they stand in the task's length: programs are compiled for each,
# and noise blurs them by more.
_DIGITS = 3


# Iterations of the local solver for balls after plain Newton steps: none, but where these lead to
# nothing. And the same of searches, whose unlikely touches would take most of their time.
_ITERATIONS, _SEARCHED = (0, 20), 10
# Off a motion to rest is what is so by more than this part of the task's scale, by the V of the
# regulator; nor is a motion one to rest that ends so far from it.
_ASTRAY = 0.1
# How many places of walls are kept compiled at most.
_MOST_KEPT = 8

AnyHorizon = TypeVar("AnyHorizon", bound="Horizon")


class Horizon(ABC):
    """A planner's task, as it is asked again from where things are.

    A motion is a plan from a state on. `advance` leads the last one to the best one near it, from
    another state; `search` finds one without. How depends on what the world is made of, which heirs
    know (`make_horizon`).

    Attributes:
        world: where the task is.
        scenario: the task; its start does not count.
        is_receding: whether the horizon always lasts as long as the scenario, or ends with it.
        num_steps: time steps of a motion.
        cost_scale: what the task costs where all is off by its scale.
        regulator: of the goal, where the task is to hold it; else None.
        is_rigid: whether walls return a part of the speed that they are hit with.
    """

    is_rigid = True
    num_steps: int
    cost_scale: float
    regulator: Regulator | None = None
    _task: Any  # of the planning room, by its kind

    def __init__(self, planner: Planner, is_receding: bool, period: float) -> None:
        """Takes a planner's task, for ticks a period [s] apart.

        Raises:
            ControlError: a free duration, or costs or constraints that were added: those at knots
                of a plan are at none of a motion that goes on.
        """
        check_planner(planner)
        self.world, self.scenario, self.is_receding = planner.world, planner.scenario, is_receding
        self._period, self._scales = period, Scales.of(self.world, self.scenario)

    @abstractmethod
    def is_inside(self, x: Floats) -> bool:
        """Returns whether a state is inside of a wall that nothing can be planned from."""

    @abstractmethod
    def search(self, now: float, x: Floats) -> PlannedMotion | None:
        """Returns the best motion that the planner finds from a state on; None if it finds none.

        It takes what the planner's options allow: counts, not seconds.
        """

    @abstractmethod
    def _lead(self, last: PlannedMotion, left: Trajectory) -> PlannedMotion | None:
        """Returns the best motion near what is left of the last one; None if there is none.

        Args:
            last: the motion, with its touches and its cost.
            left: what is left of it, from a state on.
        """

    @property
    def restitution(self) -> float | None:
        """Restitution that walls are planned with; None where that is no number."""
        return self.scenario.restitution if self.is_rigid else None

    def wary(self: AnyHorizon, doubts: Floats) -> AnyHorizon:
        """Returns the same task, where walls are known so well [m], shape (m,)."""
        return self

    @property
    def _step(self) -> float:
        """Time step of a motion [s]."""
        return self.scenario.duration / self.num_steps

    def end(self, now: float) -> float:
        """Returns when a horizon ends that begins now [s]."""
        return now + self.scenario.duration if self.is_receding else self.scenario.duration

    def is_over(self, now: float) -> bool:
        """Returns whether hardly anything is left of a horizon that begins now [s]."""
        return self.end(now) - now <= _OVER * self._step

    def rest(self, now: float, x: Floats) -> PlannedMotion:
        """Returns no control, or a regulator's, as far as bounds allow: nothing better is known."""
        count, m = self.num_steps, self.world.num_contacts
        times = np.linspace(now, max(self.end(now), now + self._step), count + 1)
        states, controls = np.tile(x, (count + 1, 1)), np.zeros((count, self.world.num_actuators))
        if self.regulator:
            states, controls = self.regulator.respond(self.world, x, count)
        q, v = self.world.split(states)
        controls = np.clip(controls, *self.world.bounds(self.scenario).control)
        impulses, forces = np.zeros((count + 1, m)), np.zeros((count, m))
        return PlannedMotion(Trajectory(times, q, v, controls, impulses, forces), np.inf, ())

    def advance(self, motion: PlannedMotion, now: float, x: Floats) -> PlannedMotion | None:
        """Returns the best motion near what is left of another one; None if there is none."""
        # Where it leads after its end, no plan says.
        if now >= motion.trajectory.times[-1] - _OVER * self._step:
            motion = self.rest(now, x)
        left = self._shift(motion.trajectory, now, x)
        return self._lead(motion, left)

    def _ask(self, now: float, x: Floats) -> Scenario:
        """Returns the task from a state on."""
        # No plan may start beyond its bounds, where an estimate may be.
        bounds, (q, v) = self.world.bounds(self.scenario), self.world.split(x)
        left, clock = self.end(now) - now, self.scenario.reference_times
        return dataclasses.replace(
            self.scenario,
            reference_times=None if clock is None else clock - now,
            initial_position=self.world.normalized(np.clip(q, *bounds.position)),
            initial_velocity=np.clip(v, *bounds.velocity),
            duration=left,
            time_step=left / self.scenario.num_steps,
        )

    def _shift(self, last: Trajectory, now: float, x: Floats) -> Trajectory:
        """Returns what is left of a trajectory, from a state on, and what comes after it.

        Knots stay where they are, so that a motion stays what it was. Where the horizon recedes, as
        many as are over come at its end, with the last control and state.
        """
        k = int(np.searchsorted(last.times, now + _OVER * self._step, side="right")) - 1
        added = k if self.is_receding else 0
        ahead = last.times[-1] + self._step * np.arange(1, added + 1)
        q, v = self.world.split(x)

        def go_on(first: Floats, rows: Floats) -> Floats:
            return np.vstack([first, rows[k + 1 :], *[rows[-1:]] * added])

        controls = np.vstack([last.controls[k:], *[last.controls[-1:]] * added])
        none = np.zeros(self.world.num_contacts)
        return Trajectory(
            times=np.concatenate([[now], last.times[k + 1 :], ahead]),
            positions=go_on(q, last.positions),
            velocities=go_on(v, last.velocities),
            controls=controls,
            impulses=np.vstack([none, last.impulses[k + 1 :], np.zeros((added, len(none)))]),
            forces=np.zeros((len(controls), len(none))),
        )

    def watch(
        self, seen: SeenBounces, samples: tuple[Floats, Floats], elapsed: float, control: Floats
    ) -> SeenBounces:
        """Returns what is seen of bounces by now; the arguments are those of `SeenBounces`.

        Only J that does not change tells where a wall is: mechanisms learn nothing.
        """
        return seen

    def knowing(self, seen: SeenBounces) -> Horizon:
        """Returns the same task between walls that return what was seen, and stand there."""
        return self

    def within(self, iterations: int) -> Horizon:
        """Returns the same task, in which a tick takes at most this number of iterations."""
        return self

    def toward(self, goal: Floats, path: tuple[Floats, Floats] | None = None) -> Horizon:
        """Returns the same task with another goal, and another reference on the way.

        Args:
            goal: q and v, shape (nq + n,), of which q is moved within bounds; v counts where the
                scenario has one.
            path: times, shape (K,) [s], and q and v then, shape (K, nq + n); None: the scenario's.
                It counts where the scenario weighs the way.
        """
        (q, v), scenario = self.world.split(goal), self.scenario
        asked = {"goal_position": np.clip(q, *self.world.bounds(scenario).position)}
        if scenario.goal_velocity is not None:
            asked["goal_velocity"] = v
        if path and (np.any(scenario.position_weight) or np.any(scenario.velocity_weight)):
            positions, velocities = self.world.split(path[1])
            asked |= {"reference_times": path[0], "reference_positions": positions}
            asked["reference_velocities"] = velocities
        return self.asking(dataclasses.replace(scenario, **asked))  # type: ignore[arg-type]

    def hold(self) -> Horizon | None:
        """Returns the task to hold the goal from then on; None where it is not known how."""
        return None

    def asking(self: AnyHorizon, scenario: Scenario) -> AnyHorizon:
        """Returns the same for another task in the same world."""
        other = copy.copy(self)
        other.scenario, other._task = scenario, self._task.again(scenario)
        return other

    def is_off(self, x: Floats, planned: Floats | None = None) -> bool:
        """Returns whether a state is off another one, or the goal, by the V of the regulator."""
        assert self.regulator
        off = self.world.calc_error(x, self.regulator.state if planned is None else planned)
        return bool(off @ self.regulator.value @ off > _ASTRAY * self.cost_scale)

    def make_feedback(self, motion: PlannedMotion) -> Feedback | None:
        """Returns feedback about a motion; None where there is none."""
        of = self.world, self.scenario, motion.trajectory
        try:
            return Feedback(*of, self._find_phases(motion), period=self._period)
        except (ProgramError, TrajectoryError):
            return None

    def _find_phases(self, motion: PlannedMotion) -> list[FeedbackPhase]:
        """Returns the phases of feedback where they are known without a sweep."""
        return []


class BallHorizon(Horizon):
    """Balls between rigid walls: what has to be known of a plan is its touches.

    Each tick polishes the multi-phase problem of those that are still to come, from the last
    plan's times. Which these are, a state does not tell for sure: a bounce may come sooner or later
    than it was planned. So near a touch, or where one was just seen, the motion with it and that
    without it are polished, the likelier first, and the other where that costs more than the last
    plan did: to repeat a bounce that has been costs more, and so does to leave one out.
    """

    def __init__(self, planner: Planner, is_receding: bool, period: float) -> None:
        """Compiles the planner's task, for ticks a period [s] apart."""
        super().__init__(planner, is_receding, period)
        self._task = make_ball_task(self.world, self.scenario, planner.options).in_brief(_SEARCHED)
        self.num_steps = self.scenario.num_steps
        self.cost_scale = self._task.transcription.cost_scale()
        self._bounced: int | None = None
        self._kept: dict[tuple[float, ...], BallTask] = {}

    def watch(
        self, seen: SeenBounces, samples: tuple[Floats, Floats], elapsed: float, control: Floats
    ) -> SeenBounces:
        """Returns what is seen of bounces by now; the arguments are those of `SeenBounces`."""
        off = WALL_DOUBT * self._scales.length
        if elapsed <= _RECENT * self._period:
            seen = seen.watch(self.world, samples, elapsed, control, off)
        else:
            seen = dataclasses.replace(seen, latest=None)
        return seen.pass_walls(self.world, np.split(samples[1], 2)[0], off)

    def knowing(self, seen: SeenBounces) -> BallHorizon:
        """Returns the same task between walls that return what was seen, and stand there."""
        if seen == SeenBounces():
            return self
        learned, length = copy.copy(self), self._scales.length
        learned._bounced = seen.latest
        if seen.squares:
            doubt = (_DOUBT * self._scales.velocity) ** 2
            e = round(seen.find_restitution(self.scenario.restitution, doubt), _DIGITS)
            learned.scenario = dataclasses.replace(self.scenario, restitution=e)
        nearer = tuple(length * round(each / length, _DIGITS) for each in seen.nearer)
        if any(nearer):
            if nearer not in self._kept:
                if len(self._kept) >= _MOST_KEPT:
                    del self._kept[next(iter(self._kept))]
                # Its diagram, where walls are as they were, is not simulated.
                moved = self._task.world.with_walls_nearer(np.array(nearer))
                self._kept[nearer] = self._task.in_world(moved)
            learned._task = self._kept[nearer]
        return learned

    def is_inside(self, x: Floats) -> bool:
        """Returns whether a wall is touched: how fast a ball is there, no rigid wall tells."""
        return bool(np.any(self._task.world.calc_clearance(np.split(x, 2)[0]) <= 0))

    def _lead(self, last: PlannedMotion, left: Trajectory) -> PlannedMotion | None:
        """Returns the best polished motion of the touches that may be left; None if none is."""
        now = float(left.times[0])
        asked = self._ask(now, left.states[0])
        task = self._task.again(asked)
        rates = task.world.calc_contact_rate(left.positions[0], left.velocities[0])
        may_be_left = find_left(
            last.touches, now, asked.duration, self._period, rates, self._bounced
        )
        sequences = [each for each in may_be_left if task.fits(each)]
        path = left.times - now, left.positions
        for most in _ITERATIONS:
            tried = (_polish(task, path, touches, most) for touches in sequences)
            if found := choose(tried, last.cost):
                return found.later(now)
        return None

    def search(self, now: float, x: Floats) -> PlannedMotion | None:
        """Returns the best motion that boxes, neighbors and polishes lead to; None if none."""
        search = BallSearch(self._task.again(self._ask(now, x)))
        try:
            search.run()
            best = search.find_best()
        except PlanningError:
            return None
        if search.is_interrupted:
            raise KeyboardInterrupt
        if not best.is_confirmed:
            return None
        return PlannedMotion.of(best).later(now)


def _polish(
    task: BallTask, path: Path, touches: TouchSequence, max_iterations: int
) -> PlannedMotion | None:
    """Returns the local optimum with these touches; None if no motion has them, or none is met."""
    try:
        solved = task.follow(path, touches, max_iterations)
    except (OptionsError, TrajectoryError, UnsupportedTermError):
        return None
    if solved is None:
        return None
    return PlannedMotion(solved.trajectory, task.cost(solved), solved.sequence)


def check_planner(planner: Planner) -> None:
    """Refuses what can't be asked again and again.

    Raises:
        ControlError: says what it is.
    """
    if planner.scenario.duration_range is not None:
        raise ControlError(
            _ASKED,
            got="a task whose duration is free",
            expected="one that is given",
            remedy="Leave duration_range out.",
        )
    if planner.scenario.periodic is not None:
        raise ControlError(
            _ASKED,
            got="a motion that repeats",
            expected="one with a goal",
            remedy="TrackingController follows a plan of it.",
        )
    if planner.transcription.additions():
        raise ControlError(
            _ASKED,
            got="costs or constraints that were added to its transcription",
            expected="the scenario's alone",
        )
