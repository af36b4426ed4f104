"""What follows a plan that is over: motions to rest at its goal, found beside the loop."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from threading import Lock
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.control.horizon import Horizon
from drake_aigto.control.mechanism_horizon import make_horizon
from drake_aigto.control.model import Model
from drake_aigto.control.touches import PlannedMotion
from drake_aigto.planning import Feedback, Plan, Planner, PlanOptions, needs_shooting
from drake_aigto.simulation import Controller, Held, HeldControl
from drake_aigto.world import Scenario, World

# Iterations of the descent to a motion, at most; and what a search takes where that leads nowhere.
_ITERATIONS, _SEARCHED = 30, PlanOptions(renewals=24, search_steps=30, threads=1)
# How motions are asked for: near another one, by a search, or from a plan's end.
_NEAR, _SEARCH, _AHEAD = range(3)
# What is near is taken after this long [s], or after a period if that is longer: descents with
# their gains took 12 ms for cart-poles and the acrobot.
SOON = 0.02
# A search is taken after this part of the scenario's duration: on two cores beside other work it
# took 0.1 to 0.4 s for the acrobot and the cart-pole between soft walls, where this is 0.5 and
# 0.38 s. Twice as much later, nothing is where it was thought to be.
PART = 0.25
# To brake, actuators take speed away as if it fell by a factor e in this part of the duration.
_BRAKE = 0.2
# Motions that are remembered: the last one, which may be asked for anew, and the next.
_KEPT = 4


class Beside:
    """Calls beside a loop, one at a time, each in a thread that ends with it.

    One thread for all would stay: Drake keeps a controller after its Diagram is gone.
    """

    def __init__(self) -> None:
        """Runs nothing yet."""
        self._is_free = Lock()

    def submit(self, call: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Returns what a call is going to return."""
        thread = ThreadPoolExecutor(1, "search")
        found = thread.submit(self._run, call, arguments)
        thread.shutdown(wait=False)
        return found

    def _run(self, call: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        with self._is_free:
            return call(*arguments)


class Caught(NamedTuple):
    """A motion to rest, and feedback about it."""

    motion: PlannedMotion
    law: Feedback


class Bridge(Controller):
    """What acts until a motion to rest is there.

    That is the last motion's law, where there is one; the regulator's near the goal; or else
    brakes, which take energy whatever the mechanism is: u = u* − (Bᵀ M⁻¹ B)⁺ Bᵀ v / τ.
    """

    stretches = ()

    def __init__(
        self,
        task: Horizon,
        span: tuple[float, float],
        period: float,
        x: Floats,
        last: Caught | None = None,
    ) -> None:
        """Takes what is to be held, when this begins and ends, a period [s], and q and v then."""
        assert task.regulator
        self.start, self.end = span
        self._period, self.regulator, self._last = period, task.regulator, last
        self._world, self._bounds = task.world, task.world.bounds(task.scenario).control
        self._brakes, self._pace = (task.is_off(x), _BRAKE * task.scenario.duration)
        acts = "the last motion goes on" if last else "the goal's regulator acts"
        acts = "brakes" if self._brakes and not last else acts
        self.reason = f"{acts} until a motion to rest is found"

    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        """Returns the control of a period."""
        until = time + self._period
        u = np.clip(self._answer(time, x, bounces), *self._bounds)
        return Held(u, until if until < self.end else self.end)

    def _answer(self, time: float, x: Floats, bounces: Sequence[int]) -> Floats:
        rest, (q, v) = self.regulator, self._world.split(x)
        if self._last:
            return self._last.law.sample(time, x, bounces).control
        if not self._brakes:
            return rest.control + rest.gains @ self._world.calc_error(x, rest.state)
        B = self._world.calc_actuation(q)
        share = np.linalg.pinv(B.T @ np.linalg.solve(self._world.calc_mass_matrix(q), B))
        return rest.control - share @ B.T @ v / self._pace


Law: TypeAlias = Feedback | Bridge


class GoalHold(NamedTuple):
    """What is followed from a sample on."""

    asked: Floats  # The motion that is followed, and the next one (`Catch.nothing`).
    law: Law
    motion: PlannedMotion | None  # None: none is.
    is_new: bool = False  # Whether the motion begins.


class Catch:
    """Motions to rest at the goal of a mechanism that a `Regulator` holds, each with its feedback.

    A regulator is right near the goal. Farther off, motions lead there. Each is asked for at a
    sample, and found in a thread, from where a `Bridge` is going to lead until it is taken: the
    best motion near the last one, or near the regulator's response; where neither leads to rest,
    later, what a search finds. The sample at which it is due waits for it. So which motion is
    followed depends on nothing but when, where and how those before were asked for.

    Attributes:
        task: to hold the goal; None where a regulator alone does, as for balls, or none.
        soon: how long before a plan's end a motion from there is asked for [s].
        nothing: what is asked for before that: (t, how, q, v) of the motion that is followed, and
            of the next one, t = −∞ where there is none, shape (2 (2 + nq + n),).
    """

    def __init__(self, world: World, scenario: Scenario, period: float) -> None:
        """Takes a task, and the period of samples [s]."""
        self.task: Horizon | None = None
        size = world.num_positions + world.num_velocities
        self._none = np.append([-np.inf, 0.0], np.zeros(size))
        self.nothing, self._period = np.tile(self._none, 2), period
        self._answers = dict[bytes, Future[Caught | None]]()
        self.soon = max(period, SOON)
        self._waits = self.soon, PART * scenario.duration, 0.0
        asked = dataclasses.replace(scenario, duration_range=None)
        if scenario.periodic is None and needs_shooting(world, asked):  # A gait goes on.
            planner = Planner(asked, _SEARCHED, world)
            self.task = make_horizon(planner, False, _ITERATIONS, period).hold()
        self._thread = Beside()

    def begin(self, asked: Floats, time: float, end: float, x: Floats, u: Floats) -> Floats:
        """Returns what is asked for soon before a plan's end: a motion from where u leads then.

        Args:
            asked: what was asked for by the last sample.
            time: now [s].
            end: of the plan [s].
            x: q and v now.
            u: the control until then, shape (nu,).
        """
        if not self.task or time < end - self.soon or not np.array_equal(asked, self.nothing):
            return asked
        held = HeldControl(np.array([time, end]), u[np.newaxis])
        led = Model(self.task.world, self.task.scenario).find_end(x, held)
        if led is None:
            return self.nothing
        coming = np.append([end, _AHEAD], led)
        self._ask(self.task, coming, None)
        return np.append(self._none, coming)

    def follow(self, asked: Floats, time: float, x: Floats) -> GoalHold:
        """Returns what is followed from now on.

        Args:
            asked: what was asked for by the last sample.
            time: now [s].
            x: q and v.
        """
        assert self.task
        (followed, coming), how, is_new = np.split(asked, 2), _NEAR, False
        last = None if np.isinf(followed[0]) else self._ask(self.task, followed, None).result()
        if not np.isinf(coming[0]):
            if time < self._find_due(coming) - self._period / 2:
                law = self._bridge(self.task, coming, last)
                return GoalHold(asked, law, last and last.motion)
            found = self._ask(self.task, coming, last).result()
            followed, last, is_new = (coming, found, True) if found else (self._none, None, False)
            how = _NEAR if found or coming[1] == _SEARCH else _SEARCH
        if last and not self.task.is_off(x, last.law.find_state(time, ())):
            return GoalHold(np.append(followed, self._none), last.law, last.motion, is_new)
        coming = np.append([time, how], x)
        self._ask(self.task, coming, last)
        law = self._bridge(self.task, coming, last)
        return GoalHold(np.append(followed, coming), law, last and last.motion, is_new)

    def _find_due(self, asked: Floats) -> float:
        """Returns when a motion is taken [s]."""
        return float(asked[0] + self._waits[int(asked[1])])

    def _bridge(self, task: Horizon, asked: Floats, last: Caught | None) -> Bridge:
        span = float(asked[0]), self._find_due(asked)
        return Bridge(task, span, self._period, asked[2:], last)

    def _ask(self, task: Horizon, asked: Floats, last: Caught | None) -> Future[Caught | None]:
        """Returns a motion that the thread is to find, or has found."""
        if (key := asked.tobytes()) not in self._answers:
            if len(self._answers) >= _KEPT:
                del self._answers[next(iter(self._answers))]
            self._answers[key] = self._thread.submit(self._find, task, asked, last)
        return self._answers[key]

    def _find(self, task: Horizon, asked: Floats, last: Caught | None) -> Caught | None:
        """Returns a motion to rest from where it is due; None: none is found."""
        due, x = self._find_due(asked), asked[2:]
        if task.is_inside(x):
            return None
        if asked[1] != _AHEAD:
            model, bridge = Model(task.world, task.scenario), self._bridge(task, asked, last)
            led = model.find_end(x, bridge)
            if led is None or task.is_inside(led):
                return None
            x = led
        near = [last.motion] if last else []
        ways = [partial(task.advance, each) for each in (*near, task.rest(due, x))]
        for way in [task.search] if asked[1] == _SEARCH else ways:
            motion = way(due, x)
            if motion and not task.is_off(motion.calc_state(np.inf)):
                law = task.make_feedback(motion)
                return Caught(motion, law) if law else None
        return None


def keep_within(plan: Plan, world: World, scenario: Scenario, period: float) -> PlannedMotion:
    """Returns a plan, or if its control exceeds a scenario's bounds, the best within them nearby.

    Args:
        plan: to be tracked.
        world: of the plan.
        scenario: the plan's, or the same within other bounds of the control.
        period: between samples [s].
    """
    motion, asked = PlannedMotion.of(plan.best), dataclasses.replace(scenario, duration_range=None)
    u, (low, high) = motion.trajectory.controls, world.bounds(scenario).control
    if scenario is plan.scenario or np.all((u >= low) & (u <= high)):
        return motion
    horizon = make_horizon(Planner(asked, world=world), False, _ITERATIONS, period)
    return horizon.advance(motion, 0.0, asked.initial_state) or motion
