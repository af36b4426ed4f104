"""Controls that lead where a plan goes under the exact law of friction, too."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.shooting import ShootingProblem, ShootingResult
from drake_aigto.simulation import EVENT_DRIVEN, Held, HeldControl, has_knots, replay_with
from drake_aigto.world import Scenario, World


class _Correcting(HeldControl):
    """Holds a motion's controls between knots, less what its gains answer at each."""

    is_open_loop = False

    def __init__(self, motion: ShootingResult, gains: Floats, bounds: Floats) -> None:
        super().__init__(motion.times, motion.controls)
        self._motion, self._gains, self._bounds = motion, gains, bounds
        self.controls = np.array(motion.controls)

    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        held = super().sample(time, x, bounces)
        k = int(np.searchsorted(self._motion.times, held.until)) - 1
        answer = self._gains[k] @ (x - self._motion.states[k])
        self.controls[k] = np.clip(self._motion.controls[k] + answer, *self._bounds)
        return Held(self.controls[k], held.until)


def steady(
    world: World, scenario: Scenario, problem: ShootingProblem, motion: ShootingResult
) -> ShootingResult:
    """Returns a motion with its controls corrected along the exact law.

    Where friction sticks and slips, Runge-Kutta steps are of low order, and what is unstable makes
    much of their errors: of a pole that balances for 3 s 1e-8 becomes 1e-3. So the motion is
    simulated again by the world's own equations, each control corrected at its knot by
    the gains of the motion (`ShootingProblem.calc_gains`), and what was held is the answer.

    Args:
        world: the mechanism.
        scenario: the task.
        problem: that the motion is a result of.
        motion: near an optimum.
    """
    gains = problem.calc_gains(motion.controls, motion.substeps)
    controller = _Correcting(motion, gains, problem.control_bounds)
    found = None
    if scenario.contact == "compliant":
        found = replay_with(EVENT_DRIVEN, world, scenario, controller)
    else:
        EVENT_DRIVEN.simulate(world, scenario, controller)
    # Where its cost has kinks between knots, the replay of a plan has knots there, too.
    is_whole = has_knots(scenario, motion.times)
    return dataclasses.replace(
        motion, controls=controller.controls, replay=found if is_whole else None
    )
