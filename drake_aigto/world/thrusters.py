"""Thrusters: forces along directions that are fixed to bodies, of Drake's `Propeller`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant, Propeller, PropellerInfo
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Demultiplexer

from drake_aigto.dynamics import Thrust
from drake_aigto.errors import ModelError
from drake_aigto.world.files import suggest
from drake_aigto.world.model_fields import Thruster


def add_actuation(
    builder: DiagramBuilder, plant: MultibodyPlant, path: Path, thrusters: Sequence[Thruster]
) -> None:
    """Exports the input ``actuation``: of joints' actuators, then of thrusters, which are added.

    Raises:
        ModelError: a thruster is on no link of the model.
    """
    joints = plant.get_actuation_input_port()
    if not thrusters:
        builder.ExportInput(joints, "actuation")
        return
    links = (plant.get_body(BodyIndex(i)) for i in range(1, plant.num_bodies()))
    bodies = {body.name(): body for body in links}
    infos = []
    for i, thruster in enumerate(thrusters):
        if thruster.body not in bodies:
            raise ModelError(
                f"thrusters[{i}] in {path}",
                got=f"no link {thruster.body!r}",
                expected=f"one of {', '.join(sorted(bodies))}",
                hint=suggest(thruster.body, sorted(bodies)),
            )
        R = RotationMatrix.MakeFromOneVector(thruster.direction, 2)
        X = RigidTransform(R, thruster.xyz)
        infos.append(PropellerInfo(bodies[thruster.body].index(), X, 1.0, thruster.drag))
    propeller = builder.AddNamedSystem("thrusters", Propeller(infos))
    builder.Connect(plant.get_body_poses_output_port(), propeller.get_body_poses_input_port())
    forces = plant.get_applied_spatial_force_input_port()
    builder.Connect(propeller.get_spatial_forces_output_port(), forces)
    commands = propeller.get_command_input_port()
    if joints.size():
        split = builder.AddSystem(Demultiplexer([joints.size(), commands.size()]))
        builder.Connect(split.get_output_port(0), joints)
        builder.Connect(split.get_output_port(1), commands)
        commands = split.get_input_port()
    builder.ExportInput(commands, "actuation")


def find_propeller(diagram: Diagram) -> Propeller | None:
    """Returns the thrusters of a diagram, at any depth; None: there are none.

    Raises:
        ModelError: there are several systems of them.
    """
    systems: list[Any] = [diagram]
    for system in systems:  # It grows meanwhile.
        systems += system.GetSystems() if isinstance(system, Diagram) else ()
    found = [system for system in systems if isinstance(system, Propeller)]
    if len(found) > 1:
        remedy = "Give all PropellerInfo to one."
        raise ModelError("diagram", f"{len(found)} of type Propeller", "one", remedy)
    return found[0] if found else None


def read_thrusts(plant: MultibodyPlant, diagram: Diagram, propeller: Propeller) -> list[Thrust]:
    """Returns what each thruster does to its body, off the forces that Drake applies."""
    root = diagram.CreateDefaultContext()
    context = propeller.GetMyMutableContextFromRoot(root)
    count = propeller.num_propellers()
    propeller.get_command_input_port().FixValue(context, np.ones(count))
    found = []
    for each in propeller.get_spatial_forces_output_port().Eval(context):
        body = plant.get_body(each.body_index)
        pose = plant.EvalBodyPoseInWorld(plant.GetMyContextFromRoot(root), body)
        R = pose.rotation().inverse()
        force, moment = R @ each.F_Bq_W.translational(), R @ each.F_Bq_W.rotational()
        moment = moment + np.cross(each.p_BoBq_B, force)
        found.append(Thrust(int(each.body_index), np.concatenate([moment, force])))
    return found
