"""What mechanisms are asked again and again, between walls that yield and between rigid ones."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.control.horizon import OVER, Horizon
from drake_aigto.control.motion import Motion
from drake_aigto.planning import MechanismTask
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scenario


class ShootingHorizon(Horizon):
    """A task of a mechanism, whose motions a descent leads from one tick to the next."""

    def __init__(self, problem: MechanismTask, is_receding: bool) -> None:
        """Takes the planner's problem."""
        super().__init__(problem.world, problem.scenario, is_receding, problem.search_steps)
        self._problem = problem

    @property
    def cost_scale(self) -> float:
        """What the task costs where all is off by its scale."""
        return self._problem.scales.cost

    def _ask(self, now: float, x: Floats) -> Scenario:
        """Returns the task from a state on."""
        # No plan may start beyond its bounds, where an estimate may be.
        bounds, (q, v) = self._problem.bounds, np.split(x, 2)
        left = self.end(now) - now
        return dataclasses.replace(
            self.scenario,
            initial_position=np.clip(q, *bounds.position),
            initial_velocity=np.clip(v, *bounds.velocity),
            duration=left,
            time_step=left / self.scenario.num_steps,
        )

    def _renew(self, motion: Motion, now: float, x: Floats) -> Motion:
        """Returns a motion, or rest in place of one that nobody was told the end of."""
        return self.rest(now, x) if now >= motion.trajectory.times[-1] else motion

    def _shift(self, last: Trajectory, now: float, x: Floats) -> Trajectory:
        """Returns what is left of a trajectory, from a state on, and what comes after it.

        Knots stay where they are, so that a motion stays what it was. Where the horizon recedes, as
        many as are over come at its end, with the last control and state.
        """
        k = int(np.searchsorted(last.times, now + OVER * self._step, side="right")) - 1
        added = k if self.is_receding else 0
        ahead = last.times[-1] + self._step * np.arange(1, added + 1)
        q, v = np.split(x, 2)

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
