"""From a diagram to its one plant and its thrusters, if they are supported ones."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import CollisionFilterDeclaration, GeometryId, GeometrySet, SceneGraph
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant, Propeller, PropellerInfo
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import Demultiplexer

from drake_aigto.arrays import Floats
from drake_aigto.dynamics import Thrust, check_constraints
from drake_aigto.errors import ModelError
from drake_aigto.world.files import suggest
from drake_aigto.world.model_facts import FixableError
from drake_aigto.world.model_fields import Thruster

# Drake warns that half spaces don't touch deformable bodies: we have none.
_HALF_SPACES = "half spaces are not currently supported for deformable"
# By how much positions differ from their defaults where nothing cancels by chance.
_ANYWHERE = 0.37

# Joints that can be read, and which of their positions are angles.
_HINGES = {
    "prismatic": [False],
    "revolute": [True],
    "planar": [False, False, True],
    "universal": [True, True],
}


def check_friction_acts(plant: MultibodyPlant, diagram: Diagram) -> None:
    """Refuses a diagram in which nothing makes dry friction act on its plant."""
    context = plant.GetMyContextFromRoot(create_root(diagram))
    if not plant.get_applied_generalized_force_input_port().HasValue(context):
        raise ModelError(
            "dry_friction",
            got="a diagram in which nothing applies forces to the plant's joints",
            expected="a system that does",
            remedy="Make it with add_dry_friction(builder, plant, dry_friction).",
        )


def _find_systems(diagram: Diagram, kind: type[Any]) -> list[Any]:
    """Returns the systems of a kind in a diagram, at any depth."""
    systems: list[Any] = [diagram]
    for system in systems:  # It grows meanwhile.
        systems += system.GetSystems() if isinstance(system, Diagram) else ()
    return [system for system in systems if isinstance(system, kind)]


def find_plant(diagram: Diagram) -> tuple[MultibodyPlant, SceneGraph]:
    """Returns the plant and the scene graph of a diagram, at any depth."""
    found = []
    for kind in (MultibodyPlant, SceneGraph):
        matches = _find_systems(diagram, kind)
        if len(matches) != 1:
            raise ModelError(
                "diagram",
                got=f"{len(matches)} of type {kind.__name__}",
                expected="one MultibodyPlant and one SceneGraph",
                remedy="Make both with AddMultibodyPlantSceneGraph(builder, time_step=0).",
            )
        found.append(matches[0])
    return found[0], found[1]


def check_plant(plant: MultibodyPlant, in_space: bool = False, has_thrusters: bool = False) -> None:
    """Refuses a plant that can't be planned for, whatever its equations are."""
    if plant.time_step() > 0:
        raise ModelError(
            "plant",
            got=f"a discrete one (time_step = {plant.time_step():g} s)",
            expected="a continuous one (time_step = 0)",
            remedy="Plan on one with time_step=0: discrete contact loses energy, an elastic bounce "
            "keeps only 0.7 of its speed at 1 ms. Controllers run plans in discrete plants, too.",
        )
    if plant.num_positions() == 0:
        raise ModelError(
            "the model lacks a joint that moves",
            remedy="Attach the moving link by a prismatic or a revolute joint.",
        )
    if not in_space:
        _check_velocities(plant)
        find_hinges(plant)
    check_constraints(plant)
    _check_actuators(plant, has_thrusters)


def list_bodies(plant: MultibodyPlant) -> list[RigidBody]:
    """Returns all links, the world first."""
    return [plant.get_body(BodyIndex(i)) for i in range(plant.num_bodies())]


def list_moving(plant: MultibodyPlant) -> list[RigidBody]:
    """Returns the links that move."""
    return [body for body in list_bodies(plant) if not plant.IsAnchored(body)]


def scale_masses(plant: MultibodyPlant, context: Context, factor: float) -> None:
    """Multiplies masses and inertias of all links that move, in this context only."""
    for body in list_moving(plant) if factor != 1 else []:
        body.SetMass(context, factor * body.get_mass(context))


def find_hinges(plant: MultibodyPlant) -> list[bool]:
    """Returns whether each generalized position is an angle, (nq,); other ones are lengths."""
    found = [False] * plant.num_positions()
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        if joint.num_positions() == 0:
            continue
        if joint.type_name() not in _HINGES:
            raise FixableError(
                f"joint {joint.name()!r} ({joint.type_name()})",
                got="a motion that is neither a slider's nor a hinge's",
                expected=f"one of {', '.join(_HINGES)}",
                remedy="Use one of these, or fix it by the scenario's fixed_joints.",
                fields={"fixed_joints": [joint.name()]},
            )
        start = joint.position_start()
        found[start : start + joint.num_positions()] = _HINGES[joint.type_name()]
    return found


def find_anywhere(plant: MultibodyPlant) -> Floats:
    """Returns positions at which nothing cancels by chance, as it may at the default ones, (nq,).

    There an arm may be stretched out along the normal of a wall.
    """
    return plant.GetDefaultPositions() + _ANYWHERE * np.arange(1, plant.num_positions() + 1)


def copy_diagram(diagram: Diagram) -> Diagram:
    """Returns a copy of a diagram, in which shapes can be changed."""
    try:
        return diagram.Clone()
    except RuntimeError as error:
        raise ModelError(
            "shapes can't be changed, as the diagram can't be copied",
            got=error,
            remedy="Make it of systems that Drake can clone.",
        ) from error


def move_shape(diagram: Diagram, shape: GeometryId, translation: Floats) -> Diagram:
    """Returns a copy of a diagram with one shape, in all of its roles, elsewhere on its body.

    The translation is in the frame of its body, shape (3,) [m].

    Raises:
        ModelError: a system in the diagram can't be copied.
    """
    copy = copy_diagram(diagram)
    plant, scene_graph = find_plant(copy)
    inspector = scene_graph.model_inspector()
    X_BG = RigidTransform(translation) @ inspector.GetPoseInFrame(shape)
    before = inspector.GetCollisionCandidates()
    scene_graph.ChangeShape(plant.get_source_id(), shape, inspector.GetShape(shape), X_BG)
    # Drake forgets the collision filters of a shape that it changes.
    for pair in inspector.GetCollisionCandidates() - before:
        exclude(scene_graph, pair[:1], pair[1:])
    return copy


def exclude(
    scene_graph: SceneGraph,
    shapes: Iterable[GeometryId],
    others: Iterable[GeometryId],
    root: Context | None = None,
) -> None:
    """Keeps shapes from colliding with others, in the model or in this context only."""
    sets = GeometrySet(list(shapes)), GeometrySet(list(others))
    context = [] if root is None else [scene_graph.GetMyMutableContextFromRoot(root)]
    scene_graph.collision_filter_manager(*context).Apply(
        CollisionFilterDeclaration().ExcludeBetween(*sets)
    )


def create_root(diagram: Diagram) -> Context:
    """Returns a new root context, at defaults."""
    with hear_drake(_HALF_SPACES):
        return diagram.CreateDefaultContext()


@contextmanager
def hear_drake(words: str = "") -> Iterator[list[str]]:
    """Yields a list that gets what Drake warns of in these words, in place of its log."""
    heard: list[str] = []

    def hear(record: logging.LogRecord) -> bool:
        text = record.getMessage()
        is_heard = record.levelno >= logging.WARNING and words in text
        if is_heard:
            heard.append(" ".join(text.split()))
        return not is_heard

    logger = logging.getLogger("drake")
    logger.addFilter(hear)
    try:
        yield heard
    finally:
        logger.removeFilter(hear)


def _check_actuators(plant: MultibodyPlant, has_thrusters: bool) -> None:
    """Refuses a plant that nothing drives, or that something else drives than the control."""
    if plant.num_actuators() == 0 and not has_thrusters:
        raise ModelError(
            "the model lacks an actuator",
            remedy="In SDF drop <effort>0</effort> from the joint's <limit>; in URDF add a "
            "<transmission>.",
        )
    for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices()):
        if actuator.has_controller():
            raise ModelError(
                f"actuator {actuator.name()!r}",
                got="a PD controller, which a continuous plant leaves out",
                expected="a motor that does what the control says",
                remedy="Leave out <drake:controller_gains>.",
            )


def _check_velocities(plant: MultibodyPlant) -> None:
    """Refuses joints whose generalized velocity is not the derivative of their position."""
    if plant.IsVelocityEqualToQDot():
        return
    context = plant.CreateDefaultContext()
    # Away from zero, where roll-pitch-yaw rates happen to be the angular velocity.
    plant.SetPositions(context, np.full(plant.num_positions(), 0.5))
    # Columns of N, which Drake has as a SciPy matrix: to import that takes half a second.
    units = np.eye(plant.num_velocities())
    N = np.array([plant.MapVelocityToQDot(context, unit) for unit in units]).T
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        nq, nv = joint.num_positions(), joint.num_velocities()
        block = N[joint.position_start() :, joint.velocity_start() :][:nq, :nv]
        if nq == nv and np.allclose(block, np.eye(nq)):
            continue
        link, answer = joint.child_body().name(), {}
        what = f"joint {joint.name()!r} ({joint.type_name()})"
        remedy = "Attach the link by prismatic, revolute or planar joints"
        if joint.is_ephemeral():
            what, answer = f"no joint attaches link {link!r}, so it floats", {link: [0.0] * 3}
            remedy += f", or hold it by the scenario's weld: {{{link}: [0, 0, 0]}}, or let it "
            remedy += "float with contact: compliant"
        raise FixableError(
            what,
            got="velocities v that are not q̇",
            expected="q̇ = v",
            remedy=f"{remedy}.",
            fields={"weld": answer} if answer else {"fixed_joints": [joint.name()]},
        )


def add_actuation(
    builder: DiagramBuilder, plant: MultibodyPlant, path: Path, thrusters: Sequence[Thruster]
) -> None:
    """Exports the input ``actuation``: of joints' actuators, then of thrusters, which are added."""
    joints = plant.get_actuation_input_port()
    if not thrusters:
        builder.ExportInput(joints, "actuation")
        return
    links = list_bodies(plant)[1:]
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
    """Returns the thrusters of a diagram, at any depth; None: there are none."""
    found = _find_systems(diagram, Propeller)
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
