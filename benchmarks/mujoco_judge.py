"""A third judge: MuJoCo simulates a world in space with its own contact, not Drake's.

Its contacts are constraints, with the softness of the file if the scenario names an MJCF, else with
MuJoCo's own (`MujocoModel`); its friction is Coulomb's within a cone. A plan that holds in Drake is
one for springs of a given stiffness; that it arrives here as well says that it does not live on
these.

    pip install 'drake_aigto[models]'
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.mujoco_model import MujocoModel
from drake_aigto.simulation import Controller, Recording, StepTrace
from drake_aigto.world import Scenario, World

STEP = 2e-4  # Of MuJoCo's simulation, at most [s].


class MujocoJudge:
    """Simulates a scenario in MuJoCo (a `Judge`).

    Args:
        prepare: changes MuJoCo's model before it runs.
        step: of its simulation, at most [s].
    """

    def __init__(self, prepare: Callable[[Any], None] = lambda _: None, step: float = STEP) -> None:
        self._prepare, self._step = prepare, step

    def simulate(self, world: World, scenario: Scenario, controller: Controller) -> Recording:
        """Runs a controller from the scenario's start."""
        mujoco: Any = importlib.import_module("mujoco")
        found = MujocoModel.of(world, scenario)
        model = found.model
        self._prepare(model)
        data: Any = mujoco.MjData(model)
        found.write(data, scenario.initial_position, scenario.initial_velocity)
        trace, now = StepTrace(world), controller.start
        while now < controller.end:
            x = found.read(data.qpos, data.qvel)
            held = controller.sample(now, x, ())
            trace.hold(now, held)
            trace.add(now, x)
            data.ctrl[:] = held.control
            count = math.ceil((held.until - now) / self._step)
            model.opt.timestep = (held.until - now) / count
            for time in np.linspace(now, held.until, count + 1)[1:].tolist():
                mujoco.mj_step(model, data)
                trace.add(time, found.read(data.qpos, data.qvel))
            now = held.until
        recording = trace.read(controller.end)
        recording.simulator = "mujoco"
        return recording
