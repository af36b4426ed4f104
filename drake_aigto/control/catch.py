"""What follows a plan that is over: motions to rest at its goal, from where the plan has led."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.control.horizon import Horizon
from drake_aigto.control.mechanism_horizon import make_horizon
from drake_aigto.control.touches import PlannedMotion
from drake_aigto.planning import Feedback, Plan, Planner, PlanOptions, needs_shooting
from drake_aigto.world import Scenario, World

# Iterations of the descent to a motion, at most; and what a search takes where that leads nowhere.
_ITERATIONS, _SEARCHED = 30, PlanOptions(renewals=24, search_steps=30, threads=1)


class Catch:
    """Motions to rest at the goal of a mechanism that a `Regulator` holds, each with its feedback.

    A regulator is right near the goal. Farther off, motions lead there (`Horizon.come_to_rest`);
    which ones depends on nothing but where and when they begin.
    """

    def __init__(self, world: World, scenario: Scenario, period: float) -> None:
        """Takes a task, and the period of samples [s]; what they need is made when first needed."""
        self._world, self._scenario, self._period = world, scenario, period
        self._last: tuple[Floats, PlannedMotion, Feedback | None] | None = None

    @cached_property
    def _task(self) -> Horizon | None:
        """The task to hold the goal; None where a regulator alone does, as for balls, or none."""
        asked = dataclasses.replace(self._scenario, duration_range=None)
        if not needs_shooting(self._world, asked):
            return None
        planner = Planner(asked, _SEARCHED, self._world)
        return make_horizon(planner, False, _ITERATIONS, self._period).hold()

    def follow(self, begun: Floats, time: float, x: Floats) -> tuple[Floats, Feedback | None]:
        """Returns when and where the motion to follow begins, and its feedback; None: none is.

        Args:
            begun: the same of the last sample, (t, q, v), shape (1 + nq + n,); t = −∞: none has.
            time: now [s].
            x: q and v.
        """
        if self._task is None:
            return begun, None
        if np.isinf(begun[0]) or self._task.is_astray(self._find(self._task, begun)[0], time, x):
            begun = np.append(time, x)
        _, law = self._find(self._task, begun)
        return begun, law if law and time < law.end else None

    def _find(self, task: Horizon, begun: Floats) -> tuple[PlannedMotion, Feedback | None]:
        """Returns the motion that begins then and there, and feedback about it; None: none is."""
        if self._last is None or not np.array_equal(self._last[0], begun):
            motion = task.come_to_rest(float(begun[0]), begun[1:])
            self._last = begun, motion, task.make_feedback(motion)
        return self._last[1:]


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
    start = np.concatenate([asked.initial_position, asked.initial_velocity])
    horizon = make_horizon(Planner(asked, world=world), False, _ITERATIONS, period)
    return horizon.advance(motion, 0.0, start) or motion
