"""Whether a motion reaches its goal, and if not, which bounds hold it back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.world import Scenario, TaskCost, World

# A goal is reached within this part of the longest way of its kind, and of 1 rad (2.9°): weights
# trade nearness for effort, so that plans end a little off. Where its velocity is weighed, the
# error of that is within this part of the largest speed: the motion has nearly stopped.
_NEAR, _SLOW = 0.05, 0.25


@dataclass(frozen=True)
class Arrival:
    """How near its goal a motion ends, in coordinates and velocities that the task weighs.

    Each is the norm of several; None where the task weighs none of the kind.

    Attributes:
        is_reached: whether positions are off by at most 5 % of the longest way of their kind, to
            go or gone, angles by at most 0.05 rad, and velocities by a quarter of the largest.
        distance: of lengths [m].
        angle: of angles [rad].
        speed: off the goal's velocity [m/s].
        turn_rate: likewise, of angles [rad/s].
        active_bounds: of a goal that is not reached: bounds of the model and the scenario that the
            motion touches, in words. If there are none, the weights hold it back.
    """

    is_reached: bool
    distance: float | None
    angle: float | None
    speed: float | None
    turn_rate: float | None
    active_bounds: tuple[str, ...]

    @classmethod
    def of(
        cls, world: World, scenario: Scenario, q: Floats, v: Floats, u: Floats | None = None
    ) -> Arrival:
        """Returns where a motion ends.

        Args:
            world: of the motion.
            scenario: has the goal.
            q: positions, the end the last, shape (K, nq).
            v: velocities, shape (K, nv).
            u: controls, shape (N, nu); None leaves out which bounds are active.
        """
        cost = TaskCost.of(world, scenario)
        weighs_end = np.any(cost.QTv, axis=0)
        if scenario.hard_goal and scenario.goal_velocity is not None:
            weighs_end = np.ones_like(weighs_end)
        errors = np.concatenate([cost.goal_errors(q[-1]), v[-1] - cost.goal_velocity])
        asked = np.concatenate([cost.is_asked, weighs_end])
        ways = np.abs(cost.subtract(q, q[-1:])).max(axis=0)
        ways = np.maximum(ways, np.abs(cost.subtract(q[0], cost.goal)))
        sizes = np.concatenate([_NEAR * ways, _SLOW * np.abs(v).max(axis=0)])
        n = world.num_velocities
        first, turns = np.arange(2 * n) < n, np.tile(world.turns, 2)
        kinds = (first & ~turns, first & turns, ~first & ~turns, ~first & turns)
        most = [float(np.max(sizes[kind], initial=0.0)) for kind in kinds]
        missed = [errors[kind & asked] for kind in kinds]
        for i, off in enumerate(() if cost.frames is None else cost.frames.asked(q)):
            way = np.maximum(np.abs(off - off[-1]).max(axis=0), np.abs(off[0]))
            most[i] = max(most[i], _NEAR * float(np.max(way, initial=0.0)))
            missed[i] = np.concatenate([missed[i], off[-1]])
        most[1] = min(most[1], _NEAR)
        is_reached = all(
            np.all(np.abs(off) <= size) for off, size in zip(missed, most, strict=True)
        )
        active: tuple[str, ...] = ()
        if u is not None and not is_reached and world.bounds(scenario).are_any:
            active = tuple(world.limits.active_items(world.plant, scenario, q, v, u))
        distance, angle, speed, turn_rate = (
            float(np.linalg.norm(off)) if off.size else None for off in missed
        )
        return cls(is_reached, distance, angle, speed, turn_rate, active)
