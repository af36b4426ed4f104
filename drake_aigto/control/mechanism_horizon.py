"""The best motion from where a mechanism is, between walls that yield."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.control.motion import Motion
from drake_aigto.control.shooting_horizon import ShootingHorizon
from drake_aigto.control.touches_left import choose
from drake_aigto.planning import MechanismSearch, MechanismTask, PlanOptions
from drake_aigto.shooting import ShootingOptions, ShootingResult, Smoothing
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch
from drake_aigto.world import Scenario, World

# A tick descends on walls that are smoothed by this part of the task's length: about how far off
# an estimate is that is worth to be planned from.
_SMOOTHING = 1e-3
# Where nothing promises more than this part of the cost, a tick ends before its iterations do.
_TOLERANCE = 1e-4
_SUBSTEPS = 4
# Friction is resolved by Runge-Kutta steps that are no longer than these parts of a time step.
_FEWEST, _MOST = 8, 64
# What a search finds is led so near to its optimum, before it is compared.
_FOUND = Smoothing(_SMOOTHING, 60, _TOLERANCE)


class MechanismHorizon(ShootingHorizon):
    """A task of a mechanism between walls that yield, or of one that touches nothing.

    There a motion is all that has to be known of a plan, and a few iterations of the descent lead
    from the last one to the next (`ShootingProblem`).
    """

    def __init__(
        self,
        world: World,
        scenario: Scenario,
        options: PlanOptions,
        is_receding: bool,
        iterations: int,
    ) -> None:
        """Takes the planner's world, task and options.

        Args:
            world: the mechanism.
            scenario: the task.
            options: of searches.
            is_receding: whether the horizon always lasts as long as the scenario, or ends with it.
            iterations: of the descent in a tick, at most.
        """
        super().__init__(MechanismTask(world, scenario, options), is_receding)
        task = self._problem.shooting(self._num_steps)
        self._task = dataclasses.replace(task, duration=scenario.duration)
        self._rubs = task.mechanism.rubs
        substeps, order = _SUBSTEPS, 2
        if self._rubs:
            substeps, order = min(max(task.rubbing_substeps, _FEWEST), _MOST), 4
        rungs = (Smoothing(_SMOOTHING, iterations, _TOLERANCE),)
        self._options = ShootingOptions(rungs, substeps, order=order, multiplier_updates=1)

    def is_inside(self, x: Floats) -> bool:
        """Returns False: walls that yield may be planned in."""
        return False

    def advance(self, motion: Motion, now: float, x: Floats) -> Motion | None:
        """Returns what a few iterations make of what is left of a motion."""
        left = self._shift(self._renew(motion, now, x).trajectory, now, x)
        states = np.hstack([left.positions, left.velocities])
        return self._descend(left.times, states, left.controls, self._options, motion.cost)

    def _descend(
        self,
        times: Floats,
        states: Floats,
        controls: Floats,
        options: ShootingOptions,
        last: float = np.inf,
    ) -> Motion | None:
        """Returns the best motion near another one, whose gaps it closes; None if it finds none.

        Steps that close gaps let go of what is pushed by friction, and stay off it. So, where
        something rubs, what the controls lead to is tried before, from which no step is dearer than
        the one before; gaps are closed where that is dearer than the last plan was.
        """
        task = dataclasses.replace(self._task, times=times, start=states[0])
        starts = (None, states) if self._rubs else (states,)
        tried = (self._read(task.solve(controls, start, options)) for start in starts)
        return choose(tried, last)

    def _read(self, found: ShootingResult) -> Motion | None:
        """Returns a result as a motion; None if it leads nowhere."""
        if not (np.isfinite(found.cost) and np.all(np.isfinite(found.states))):
            return None
        q, v = np.split(found.states, 2, axis=1)
        none = np.zeros((len(q), self.world.num_contacts))
        motion = Trajectory(found.times, q, v, found.controls, none, none[1:])
        inside = self.world.calc_signed_distance(q) <= 0
        comes = inside & ~np.vstack([np.zeros_like(inside[:1]), inside[:-1]])
        touches = (Touch.bounce(found.times[k], int(i)) for k, i in np.argwhere(comes))
        return Motion(motion, found.cost, tuple(touches))

    def search(self, now: float, x: Floats) -> Motion | None:
        """Returns the best motion that boxes and renewals find from a state; None if none."""
        search = MechanismSearch(self._problem.again(self._ask(now, x)))
        search.explore()
        if not search.motions:
            return None
        found = search.motions[0].result
        states = np.vstack([x, found.states[1:]])
        options = dataclasses.replace(self._options, rungs=(_FOUND,))
        return self._descend(now + found.times, states, found.controls, options)
