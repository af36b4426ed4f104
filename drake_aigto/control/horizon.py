"""The best motion from where a mechanism is, found again and again."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.errors import ControlError
from drake_aigto.planning import MechanismOptions, MechanismProblem, MechanismSearch, Planner
from drake_aigto.shooting import ShootingOptions, ShootingResult, Smoothing

# A tick descends on walls that are smoothed by this part of the task's length: about how far off
# an estimate is that is worth to be planned from.
_SMOOTHING = 1e-3
# Where nothing promises more than this part of the cost, a tick ends before its iterations do.
_TOLERANCE = 1e-4
_SUBSTEPS = 4
# What a search finds is led so near to its optimum, before it is compared.
_FOUND = Smoothing(_SMOOTHING, 60, _TOLERANCE)
# A step of which less than this part is left is over.
_OVER = 1e-3


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion over a horizon.

    Attributes:
        times: of the knots, shape (N + 1,), in the context's time [s].
        states: q and v there, shape (N + 1, 2n).
        controls: held between them, shape (N, nu).
        cost: J from the first knot on.
    """

    times: Floats
    states: Floats
    controls: Floats
    cost: float

    @classmethod
    def of(cls, result: ShootingResult) -> Motion:
        """Returns a result's motion."""
        return cls(result.times, result.states, result.controls, result.cost)

    def calc_control(self, time: float) -> Floats:
        """Returns u at a time, shape (nu,); before and after the horizon its first and last."""
        k = int(np.searchsorted(self.times, time, side="right")) - 1
        return np.array(self.controls[min(max(k, 0), len(self.controls) - 1)])


class Horizon:
    """A task of a mechanism, as it is asked again from where the mechanism is.

    Walls yield, or nothing is touched: then a motion is all that has to be known of a plan, and a
    few iterations of the descent lead from the last one to the next (`ShootingProblem`).
    """

    def __init__(self, planner: Planner, is_receding: bool, iterations: int) -> None:
        """Takes the planner's world, task and options.

        Args:
            planner: of a mechanism between walls that yield, or that touches nothing.
            is_receding: whether the horizon always lasts as long as the scenario, or ends with it.
            iterations: of the descent in a tick, at most.

        Raises:
            ControlError: the planner's walls are rigid.
        """
        options, scenario = planner.options, planner.scenario
        if not isinstance(options, MechanismOptions) or (
            scenario.contact == "rigid" and planner.world.contacts
        ):
            raise ControlError(
                "the planner of a controller that plans again",
                got="rigid walls",
                expected="walls that yield, or none",
                remedy='Say contact="compliant", or track a plan (TrackingController).',
            )
        self._problem = MechanismProblem(planner.world, scenario, options)
        self._task = self._problem.shooting(self._problem.search_steps)
        self._duration, self._is_receding = scenario.duration, is_receding
        self._step = scenario.duration / (len(self._task.times) - 1)
        rungs = (Smoothing(_SMOOTHING, iterations, _TOLERANCE),)
        self._options = ShootingOptions(rungs, _SUBSTEPS, order=2, multiplier_updates=1)

    def times(self, now: float) -> Floats:
        """Returns the knots of a horizon that begins now [s]."""
        end = now + self._duration if self._is_receding else self._duration
        return np.linspace(now, end, len(self._task.times))

    def shift(self, motion: Motion, now: float, x: Floats) -> Motion | None:
        """Returns what is left of a motion; None if that is less than half a step.

        Its knots stay where they are, so that the motion stays what it was. Where the horizon
        recedes, as many as are over come at its end, with the last control and state.
        """
        k = int(np.searchsorted(motion.times, now + _OVER * self._step, side="right")) - 1
        added = k if self._is_receding else 0
        if k + 1 >= len(motion.times) + added or motion.times[-1] + added * self._step <= now:
            return None
        ahead = motion.times[-1] + self._step * np.arange(1, added + 1)
        return Motion(
            times=np.concatenate([[now], motion.times[k + 1 :], ahead]),
            states=np.vstack([x, motion.states[k + 1 :], *[motion.states[-1:]] * added]),
            controls=np.vstack([motion.controls[k:], *[motion.controls[-1:]] * added]),
            cost=motion.cost,
        )

    def improve(self, motion: Motion) -> Motion:
        """Returns the motion that a few iterations lead to, whose gaps they close."""
        return self._descend(motion, self._options)

    def _descend(self, motion: Motion, options: ShootingOptions) -> Motion:
        task = dataclasses.replace(self._task, times=motion.times, start=motion.states[0])
        return Motion.of(task.solve(motion.controls, motion.states, options))

    def search(self, now: float, x: Floats) -> Motion | None:
        """Returns the best motion that boxes and renewals find from a state; None if they do not.

        It takes what the planner's options allow: counts, not seconds.
        """
        # No plan may start beyond its bounds, where an estimate may be.
        bounds, (q, v) = self._problem.bounds, np.split(x, 2)
        q, v = np.clip(q, *bounds.position), np.clip(v, *bounds.velocity)
        left, scenario = float(np.ptp(self.times(now))), self._problem.scenario
        scenario = dataclasses.replace(
            scenario,
            initial_position=q,
            initial_velocity=v,
            duration=left,
            time_step=left / scenario.num_steps,
        )
        search = MechanismSearch(self._problem.again(scenario))
        search.explore()
        if not search.motions:
            return None
        found = search.motions[0].result
        states = np.vstack([x, found.states[1:]])
        motion = Motion(now + found.times, states, found.controls, found.cost)
        return self._descend(motion, dataclasses.replace(self._options, rungs=(_FOUND,)))

    @property
    def cost_scale(self) -> float:
        """What the task costs where all is off by its scale."""
        return self._problem.scales.cost

    def rest(self, now: float, x: Floats) -> Motion:
        """Returns no control, where nothing better is known."""
        times, task = self.times(now), self._task
        none = np.clip(
            np.zeros((len(times) - 1, task.mechanism.num_controls)), *task.control_bounds
        )
        return Motion(times, np.tile(x, (len(times), 1)), none, np.inf)
