"""What follows a plan that is over: motions to rest at its goal, from where the plan has led."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.control.horizon import Horizon
from drake_aigto.control.mechanism_horizon import make_horizon
from drake_aigto.planning import Feedback, Planner
from drake_aigto.world import Scenario, World

# Iterations of the descent to a motion, at most. Another one begins, a time step later at least,
# where the state is off this one by more than this part of the task's scale, by the regulator's V.
_ITERATIONS, _ASTRAY = 30, 0.1


class Catch:
    """Motions to rest at the goal of a mechanism that a `Regulator` holds, each with its feedback.

    A regulator is right near the goal. Farther off its response, as if all were linear, is where a
    descent begins; which motion that leads to depends on nothing but where and when it begins.
    """

    def __init__(self, world: World, scenario: Scenario, period: float) -> None:
        """Takes a task, and the period of samples [s]; what they need is made when first needed."""
        self._world, self._scenario, self._period = world, scenario, period
        self._last: tuple[Floats, Feedback | None] = (np.array([-np.inf]), None)

    @cached_property
    def _task(self) -> Horizon | None:
        """The task to hold the goal; None where a regulator alone does, as for balls, or none."""
        asked = dataclasses.replace(self._scenario, duration_range=None)
        if (planner := Planner(asked, world=self._world)).is_of_balls:
            return None
        return make_horizon(planner, False, _ITERATIONS, self._period).hold()

    def follow(self, begun: Floats, time: float, x: Floats) -> tuple[Floats, Feedback | None]:
        """Returns when and where the motion to follow begins, and its feedback; None: none is.

        Args:
            begun: the same of the last sample, (t, q, v), shape (1 + nq + n,); t = −∞: none has.
            time: now [s].
            x: q and v.
        """
        if self._task is None or self._task.regulator is None:
            return begun, None
        law, (state, _, _, value, _) = self._find(begun), self._task.regulator
        is_on = law is not None and time < law.end
        off = self._world.calc_error(x, law.find_state(time, ()) if law and is_on else state)
        is_astray = off @ value @ off > _ASTRAY * self._task.cost_scale
        if np.isinf(begun[0]) or (is_astray and time >= begun[0] + self._scenario.time_step):
            begun = np.append(time, x)
            law = self._find(begun)
        return begun, law if law and time < law.end else None

    def _find(self, begun: Floats) -> Feedback | None:
        """Returns feedback about the motion that begins then and there; None: none is found."""
        if self._task is None or np.isinf(begun[0]):
            return None
        if not np.array_equal(self._last[0], begun):
            time, x = float(begun[0]), begun[1:]
            motion = self._task.advance(self._task.rest(time, x), time, x)
            self._last = begun, self._task.make_feedback(motion, ()) if motion else None
        return self._last[1]
