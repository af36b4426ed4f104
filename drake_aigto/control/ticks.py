"""Questions, choices and memory of the ticks of a controller that plans again."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto.arrays import Floats
from drake_aigto.control.catch import SOON, Beside, Bridge, Catch, Law
from drake_aigto.control.estimation import ModelEstimate
from drake_aigto.control.horizon import Horizon, check_planner
from drake_aigto.control.mechanism_horizon import make_horizon
from drake_aigto.control.ports import Sample, TickStatus
from drake_aigto.control.touches import MARGIN, PlannedMotion, SeenBounces
from drake_aigto.errors import AigtoError, ControlError
from drake_aigto.planning import Cut, Planner
from drake_aigto.world import Scenario

# Iterations are measured from a state that is off by this part, so that they have work to do; a
# tick may take this part of its period, and has no more than this number.
_MEASURED_OFF, _SHARE, _MOST_ITERATIONS = 1e-2, 0.5, 15
# No reference is shorter [s].
_LEAST = 1e-6
# A wall that is planned to be hit within this number of periods, and left, has been hit.
_NEAR = 2.0
# A state that is off its plan by no more than this part of the scales is on it.
_ON_PLAN = 0.02
# A plan that costs more than the one before met no surprise if that is less than this part of the
# task's scale.
_NOTHING = 1e-3


class PendingSearch(NamedTuple):
    """A search that goes on in its thread."""

    due: int  # the tick that waits for it
    found: Future[PlannedMotion | None]


class TickChoice(NamedTuple):
    """Decision of a tick."""

    motion: PlannedMotion
    reason: str
    has_switched: bool = False
    pending: PendingSearch | None = None
    asked: Floats | None = None  # The motion to rest that is asked for (`Catch`).
    law: Law | None = None  # Feedback about it, or what acts until it is found.

    def find_asked(self, catch: Catch) -> Floats:
        """Returns the motion to rest that is asked for."""
        return catch.nothing if self.asked is None else self.asked


class TickQuestion(NamedTuple):
    """The state that a tick plans from.

    Attributes:
        now: when its command acts, in the task's time [s].
        x: the state then, led on from the sample.
        seen: what is known of walls.
        horizon: knows that, and the goal.
        aside: compiles the same for a thread, which calls it.
        catch: what finds motions to rest, where the horizon ends soon; None: it does not, or
            nothing does.
        sampled: the sample itself, and the context's time of it [s].
        sample: whether it is of use.
        deviation: how far it is off the plan.
    """

    now: float
    x: Floats
    seen: SeenBounces
    horizon: Horizon
    aside: Callable[[], Horizon]
    catch: Catch | None
    sampled: tuple[float, Floats]
    sample: Sample = "valid"
    deviation: float = 0.0

    def price(self, motion: PlannedMotion | None, last: PlannedMotion) -> float:
        """Returns the cost of a motion; where there is none, of the last plan if x is on it."""
        if motion is None:
            return last.cost if self.deviation <= _ON_PLAN else np.inf
        return motion.cost

    @property
    def is_held(self) -> bool:
        """Whether the horizon is over, and motions to rest hold the goal."""
        return self.catch is not None and self.horizon.is_over(self.now)

    @property
    def obstacle(self) -> str | None:
        """Why nothing can be planned from here; None: something can."""
        if self.sample != "valid":
            return f"the estimated state is {self.sample}"
        if self.is_held:
            return None
        if self.horizon.is_over(self.now):
            return "the horizon ends"
        return "a wall is touched" if self.horizon.is_inside(self.x) else None


@dataclass(frozen=True, eq=False)
class TickMemory:
    """Memory from one tick to the next; contexts share it, as it never changes.

    Attributes:
        choice: what the tick decided.
        commands: the last ones, rows (t, u).
        status: what the output port says.
        tick: how many there were before.
        usable: the last question from which something could be planned.
        seen: what is known of walls.
        feedback: about the plan, where there is some.
        known: what is estimated of the model; None: nothing is.
        iterations: of a descent in a tick, where they were chosen by measuring.
    """

    choice: TickChoice
    commands: Floats
    status: TickStatus
    tick: int
    usable: TickQuestion
    seen: SeenBounces
    feedback: Law | None = None
    known: ModelEstimate | None = None
    iterations: int | None = None

    def find_hits(self, question: TickQuestion, period: float) -> list[int]:
        """Returns the contact that the plan is to hit about now, if it is left already."""
        stretches = self.feedback.stretches if self.feedback else ()
        if not stretches or stretches[0].cut != Cut.HIT:
            return []
        contact, world = stretches[0].contact, question.horizon.world
        is_near = abs(stretches[0].end - question.now) <= _NEAR * period
        rate = world.calc_contact_rate(*world.split(question.x))[contact]
        return [contact] if is_near and rate > 0 else []

    def __deepcopy__(self, memo: object) -> TickMemory:
        """Returns itself."""
        return self


class Reference(NamedTuple):
    """The reference that a controller follows: a goal, or a trajectory.

    Attributes:
        goal: q and v, shape (nq + n,).
        path: q and v over the context's time.
        start: of the task in that time [s].
    """

    goal: Floats | None = None
    path: PiecewisePolynomial | None = None
    start: float = 0.0

    def check(self, horizon: Horizon, begin: float) -> None:
        """Refuses a trajectory that is not of q and v, or ends before a horizon does.

        Args:
            horizon: the task.
            begin: of the first horizon, in the task's time [s].

        Raises:
            ControlError: says which.
        """
        if self.path is None:
            return
        nx = horizon.world.num_positions + horizon.world.num_velocities
        end, (rows, columns) = self.start + horizon.end(begin), (self.path.rows(), self.path.cols())
        if (rows, columns) != (nx, 1):
            got, expected, remedy = f"{rows} by {columns} numbers", f"q and v, {nx} by 1", ""
        elif self.path.end_time() < end - _LEAST:
            got, expected = f"one that ends at {self.path.end_time():g} s", f"one until {end:g} s"
            remedy = "That is when the first horizon ends: append what comes then."
        else:
            return
        raise ControlError("reference_path", got=got, expected=expected, remedy=remedy)

    def aim(self, horizon: Horizon, now: float) -> Horizon:
        """Returns a task that follows it from now on."""
        if self.path is None:
            return horizon if self.goal is None else horizon.toward(self.goal)
        times = np.linspace(now, max(horizon.end(now), now + _LEAST), horizon.num_steps + 1)
        states = np.array([self.path.value(time + self.start)[:, 0] for time in times])
        return horizon.toward(states[-1], (times, states))


class Horizons:
    """A planner's task, for ticks and for searches in a thread, with what is known by now."""

    def __init__(
        self,
        planner: Planner,
        scenario: Scenario,
        is_receding: bool,
        iterations: int,
        period: float,
    ) -> None:
        """Compiles the task; arguments are those of `make_horizon`.

        The scenario is the planner's, within limits of the control.

        Raises:
            ControlError: from `make_horizon`.
        """
        check_planner(planner)
        if scenario is not planner.scenario:
            planner = Planner(scenario, planner.options, planner.world)
        self._options, self._period = planner.options, period
        self._posed = is_receding, iterations
        self.own = self._make(planner)  # The task as it was given.
        self._given = self._learned = planner, self.own
        self._models: Any = None  # What is learned is of these.
        self._catch: tuple[Any, Catch | None] = (None, None)
        self._aside: tuple[Planner | None, Horizon] = None, self.own

    def _make(self, planner: Planner) -> Horizon:
        return make_horizon(planner, *self._posed, self._period)

    def find(
        self,
        reference: Reference,
        now: float,
        known: ModelEstimate | None = None,
        iterations: int | None = None,
    ) -> tuple[Horizon, Callable[[], Horizon], Catch | None]:
        """Returns the task, what compiles it in a thread, and after its end what holds the goal.

        Args:
            reference: what it is to follow.
            now: in the task's time [s].
            known: of the model.
            iterations: of a tick's descent; None: as they were given.
        """
        planner, own = self._find_learned(known)
        aimed = reference.aim(own if iterations is None else own.within(iterations), now)
        aimed = aimed if known is None else aimed.wary(known.wall_doubts)
        is_ending = aimed.is_over(now + max(self._period, SOON))
        aside = partial(self._compile_aside, planner, aimed.scenario)
        return aimed, aside, self._hold(aimed) if is_ending else None

    def _compile_aside(self, planner: Planner, asked: Scenario) -> Horizon:
        """Returns the task for a thread: with ticks it shares nothing that changes."""
        if self._aside[0] is not planner:
            self._aside = planner, self._make(planner)
        horizon = self._aside[1]
        return horizon if horizon.scenario is asked else horizon.asking(asked)

    def _hold(self, task: Horizon) -> Catch | None:
        world, scenario = task.world, task.scenario
        goal = scenario.goal_position, scenario.goal_velocity
        same = world, *(each if each is None else tuple(each) for each in goal)
        if self._catch[0] != same:
            catch = Catch(world, scenario, self._period)
            self._catch = same, catch if catch.task else None
        return self._catch[1]

    def _find_learned(self, known: ModelEstimate | None) -> tuple[Planner, Horizon]:
        if known is None or known.is_of_the_model:
            return self._given
        if self._models is not known.models:
            world, scenario = known.models[0].world, known.models[0].scenario
            try:
                planner = Planner(scenario, self._options, world)
                self._learned = planner, self._make(planner)
            except AigtoError:  # Where the task starts there is a wall now.
                pass
            self._models = known.models
        return self._learned

    def measure(self, question: TickQuestion, motion: PlannedMotion) -> int:
        """Returns how many iterations of a descent a tick has time for, by the clock."""
        now, x, horizon = question.now, question.x, question.horizon
        x, seconds = x + _MEASURED_OFF * np.maximum(np.abs(x), 1.0), list[float]()
        for count in (1, 1, _MOST_ITERATIONS):  # The first one has more to do.
            begin = time.perf_counter()
            horizon.within(count).advance(motion, now, x)
            seconds.append(time.perf_counter() - begin)
        _, one, most = seconds
        each = max(most - one, 0.0) / (_MOST_ITERATIONS - 1)
        left = _SHARE * self._period - one
        return 1 + int(min(max(left / each, 0.0) if each else np.inf, _MOST_ITERATIONS - 1))


class Searches:
    """Searches for other contact sequences: when they begin, and in their tick or in a thread."""

    def __init__(
        self,
        period: float,
        margin: float,
        surprise: float,
        every: int | None,
        ticks: int | None,
        waits: bool,
    ) -> None:
        """Takes what `ModelPredictiveController` is given."""
        self._period, self._margin, self._surprise = period, margin, surprise
        self._every, self._ticks, self._waits = every, ticks, waits
        if ticks is not None:
            self._thread = Beside()

    def choose(self, before: TickMemory, question: TickQuestion) -> TickChoice:
        """Returns the plan from now on, and why it is that."""
        if obstacle := question.obstacle:
            reason = f"{obstacle}: the last plan goes on"
            return before.choice._replace(reason=reason, has_switched=False)
        if question.catch and question.is_held:
            return _hold(before.choice, question, question.catch)
        choice, now = self._improve(before, question), question.now
        if catch := question.catch:
            end, u = question.horizon.end(now), choice.motion.calc_control(now)
            asked = catch.begin(before.choice.find_asked(catch), now, end, question.x, u)
            choice = choice._replace(asked=asked)
        return choice

    def _improve(self, before: TickMemory, question: TickQuestion) -> TickChoice:
        """Returns the best motion near the last one, or another that a search has found."""
        last, then, horizon = before.choice.motion, before.usable, question.horizon
        motion = horizon.advance(last, question.now, question.x)
        is_same = question.seen == then.seen and horizon.scenario is then.horizon.scenario
        most = (1 + MARGIN) * last.cost + _NOTHING * horizon.cost_scale
        costs_more = motion and motion.cost > most
        if costs_more and is_same and question.deviation <= _ON_PLAN:
            motion = None  # It is far off the last plan, which still holds.
        cost = question.price(motion, last)
        has_searched, found, pending = self._find(before, question, motion)
        if found and found.cost < (1 - self._margin) * cost:
            reason = f"switched: {found.cost:.4g} in place of {cost:.4g}"
            return TickChoice(found, reason, has_switched=True, pending=pending)
        if motion is None:
            what = "a costlier" if costs_more else "no"
            reason = f"{what} motion was found: the last plan goes on"
            return TickChoice(last, reason, pending=pending)
        reason = "warm; a search found nothing better" if has_searched else "warm"
        return TickChoice(motion, reason, pending=pending)

    def _find(
        self, before: TickMemory, question: TickQuestion, motion: PlannedMotion | None
    ) -> tuple[bool, PlannedMotion | None, PendingSearch | None]:
        """Returns whether a search is done, what it found, and one that goes on.

        Args:
            before: the last tick.
            question: of this one.
            motion: what a descent from the last plan led to.
        """
        last, pending, tick = before.choice.motion.cost, before.choice.pending, before.tick + 1
        now, x, horizon = question.now, question.x, question.horizon
        if pending is not None:
            if tick < pending.due or not (self._waits or pending.found.done()):
                return False, None, pending
            found = pending.found.result()
            return True, found and horizon.advance(found, now, x), None
        is_due = self._every is not None and tick % self._every == 0
        cost = question.price(motion, before.choice.motion)
        if not is_due and cost - last <= self._calc_surprise(last, horizon.cost_scale):
            return False, None, None
        if self._ticks is None:
            return True, horizon.search(now, x), None
        ahead = now + self._ticks * self._period
        x = motion.calc_state(ahead) if motion else np.array(x)
        if horizon.is_over(ahead) or horizon.is_inside(x):
            return False, None, None
        begun = self._thread.submit(_search, question, ahead, x)
        return False, None, PendingSearch(tick + self._ticks, begun)

    def _calc_surprise(self, cost: float, scale: float) -> float:
        """Returns by how much a plan costs more than the one before, if it met a surprise."""
        if np.isinf(self._surprise):  # What costs nothing any more, too.
            return np.inf
        return self._surprise * cost + _NOTHING * scale


def _search(question: TickQuestion, ahead: float, x: Floats) -> PlannedMotion | None:
    """Returns what a search beside the loop finds from a state."""
    return question.aside().knowing(question.seen).search(ahead, x)


def _hold(last: TickChoice, question: TickQuestion, catch: Catch) -> TickChoice:
    """Returns the motion to rest at the goal from now on, or what acts until one is found."""
    before = last.find_asked(catch)
    asked, law, motion, _ = catch.follow(before, question.now, question.x)
    reason = law.reason if isinstance(law, Bridge) else "a motion to rest"
    return TickChoice(motion or last.motion, reason, asked=asked, law=law)


def append_command(commands: Floats, time: float, u: Floats) -> Floats:
    """Returns rows (t, u) with one more in place of the oldest, or of the last of the same time."""
    kept = commands[:-1] if commands[-1, 0] == time else commands[1:]
    return np.vstack([kept, np.append(time, u)])
