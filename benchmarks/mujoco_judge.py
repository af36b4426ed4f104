"""A third judge: MuJoCo simulates the MJCF that a scenario names, with its contact, not Drake's.

Its contacts are constraints of the file's own softness, its friction is Coulomb's within a cone. A
plan that holds in Drake is one for springs of a given stiffness; that it arrives here as well says
that it does not live on these.

    pip install 'drake_aigto[models]'
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from drake_aigto.simulation import Controller, Recording, StepTrace
from drake_aigto.world import Scenario, World, find_model

STEP = 2e-4  # Of MuJoCo's simulation, at most [s].


def load_mujoco(scenario: Scenario) -> Any:
    """Returns MuJoCo's model of a scenario's file, without joints that it fixes.

    Actuators are left out: efforts are applied to joints.
    """
    mujoco: Any = importlib.import_module("mujoco")
    spec = mujoco.MjSpec.from_file(str(find_model(scenario.model)))
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for joint in list(spec.joints):
        if any(fnmatchcase(joint.name, glob) for glob in scenario.model_fields.fixed_joints):
            spec.delete(joint)
    return spec.compile()


class MujocoJudge:
    """Simulates a scenario's MJCF in MuJoCo, with the contacts of the file (a `Judge`).

    Args:
        prepare: changes MuJoCo's model before it runs.
        step: of its simulation, at most [s].
    """

    def __init__(self, prepare: Callable[[Any], None] = lambda _: None, step: float = STEP) -> None:
        self._prepare, self._step = prepare, step

    def simulate(self, world: World, scenario: Scenario, controller: Controller) -> Recording:
        """Runs a controller from the scenario's start."""
        mujoco: Any = importlib.import_module("mujoco")
        model = load_mujoco(scenario)
        self._prepare(model)
        data: Any = mujoco.MjData(model)
        joints = [world.plant.get_joint(each) for each in world.plant.GetJointIndices()]
        moving = [model.joint(each.name()) for each in joints if each.num_positions()]
        places = np.concatenate([each.qposadr for each in moving])
        speeds = np.concatenate([each.dofadr for each in moving])
        data.qpos[places], data.qvel[speeds] = scenario.initial_position, scenario.initial_velocity
        trace, now = StepTrace(world), controller.start
        while now < controller.end:
            x = np.concatenate([data.qpos[places], data.qvel[speeds]])
            held = controller.sample(now, x, ())
            trace.hold(now, held)
            trace.add(now, x)
            data.qfrc_applied[speeds] = world.actuation @ held.control
            count = math.ceil((held.until - now) / self._step)
            model.opt.timestep = (held.until - now) / count
            for time in np.linspace(now, held.until, count + 1)[1:].tolist():
                mujoco.mj_step(model, data)
                trace.add(time, np.concatenate([data.qpos[places], data.qvel[speeds]]))
            now = held.until
        recording = trace.read(controller.end)
        recording.simulator = "mujoco"
        return recording
