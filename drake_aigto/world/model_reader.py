"""From a model's file to a diagram, parsed by Drake, with what Drake leaves out; or one's own."""

from __future__ import annotations

import math
import re
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import PackageMap, Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import (
    Joint,
    JointActuator,
    ModelInstanceIndex,
    PrismaticSpring,
    RevoluteSpring,
)
from pydrake.symbolic import Expression, MakeVectorVariable
from pydrake.symbolic import max as largest
from pydrake.symbolic import min as least
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import SymbolicVectorSystem

from drake_aigto.arrays import Floats, read_only
from drake_aigto.dynamics import STICTION_SPEED, refuse_loop, smooth_sign
from drake_aigto.errors import ModelError
from drake_aigto.world.diagram import add_actuation, check_plant, hear_drake, list_bodies
from drake_aigto.world.fields import check_size
from drake_aigto.world.files import find_model, find_packages
from drake_aigto.world.frames import fill_named
from drake_aigto.world.meshes import MESHES
from drake_aigto.world.model_facts import FixableError, ModelFacts, Spring, fits, pick
from drake_aigto.world.model_fields import ModelFields, Named
from drake_aigto.world.model_shapes import (
    add_ends,
    choose_ends,
    keep_apart,
    leave_pairs_out,
    note_unlike_friction,
    set_materials,
    set_planes,
)
from drake_aigto.world.model_text import read_model_text
from drake_aigto.world.pairs import order_pair
from drake_aigto.world.space_parts import order_shapes

_TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
# What Drake says of joints that form a loop.
_LOOP = "loops in the system graph"
# What Drake's reader says and nothing depends on, or what is read here in its place.
_HARMLESS = (
    *("deformable", "camera", "texture", "'friction' attribute", "zero effort limit", "condim"),
    *("contype", "is ignored: unsupported", "safety_controller", "gazebo", "calibration"),
    *(
        "torsional",
        "material",
        "mechanicalReduction",
        "'type' found in a 'link'",
        "rgba",
        "Asymmetrical",
    ),
)


class ReadModel(NamedTuple):
    """A model's diagram, and what a plant can't tell of it.

    Attributes:
        diagram: of a continuous plant and its scene graph. Ports: ``actuation`` in; ``state``,
            ``contact_results`` and ``query`` (for a visualizer) out.
        dry_friction: of each coordinate, (nv,) [N, N m], which a system of the diagram applies.
        efforts: least and largest u of actuators, by name, where the model says them.
        ignored: what is left out, as the scenario allowed it.
        notes: what else differs from the file.
        is_bare: whether meshes are left out, or others stand for them.
    """

    diagram: Diagram
    dry_friction: Floats | None = None
    efforts: dict[str, tuple[float, float]] = {}  # noqa: RUF012
    ignored: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    is_bare: bool = False


def read_model(
    model: str,
    dry_friction: Floats | Named[Floats] | None = None,
    stiction_speed: float = STICTION_SPEED,
    fields: ModelFields | None = None,
    is_bare: bool = False,
    in_space: bool = False,
) -> ReadModel:
    """Reads a model's file: URDF, SDF, MJCF, or model directives that add such files.

    Args:
        model: a ``package://`` URI, or a path.
        dry_friction: of joints, shape (nv,) or by names [N, N m]; None: the model's, if any.
        stiction_speed: that of all friction [m/s, rad/s].
        fields: how the model is read.
        is_bare: whether meshes are left out that only make shapes, as reading them takes seconds.
        in_space: see `check_plant`.

    Raises:
        ModelError: there is no such file, Drake can't parse it, its joints form a loop, or it has
            what changes the physics and can't be planned for; or the fields do not fit it.
        ScenarioError: dry friction of another size.
    """
    friction = dry_friction, stiction_speed
    with TemporaryDirectory() as name:
        folder, stub = Path(name), None
        if is_bare:
            stub = folder / "stub.obj"
            stub.write_text(_TETRAHEDRON, encoding="utf-8")
        return _read_model(model, *friction, fields or ModelFields(), in_space, folder, stub)


def _read_model(
    model: str,
    dry_friction: Floats | Named[Floats] | None,
    stiction_speed: float,
    fields: ModelFields,
    in_space: bool,
    folder: Path,
    stub: Path | None,
) -> ReadModel:
    path = find_model(model)
    packages = find_packages(path, fields.packages)
    text, kind, facts = read_model_text(path, fields, packages, folder, 1.0, stub, in_space)
    if facts.total_mass is not None:
        plant = MultibodyPlant(time_step=0.0)
        _parse(plant, path, packages, text, kind)
        mass = sum(body.default_mass() for body in list_bodies(plant)[1:])
        scale = facts.total_mass / mass
        text, kind, facts = read_model_text(path, fields, packages, folder, scale, stub, in_space)
    builder = DiagramBuilder()
    # Continuous, since every discrete contact model loses energy.
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    facts.notes += _parse(plant, path, packages, text, kind)
    _weld(plant, path, fields)
    _drive(plant, path, facts)
    _add_servos(plant, path, facts)
    for name, (stiffness, reference) in facts.springs.items():
        if (joint := plant.GetJointByName(name)).num_velocities() == 1:
            spring = PrismaticSpring if joint.type_name() == "prismatic" else RevoluteSpring
            plant.AddForceElement(spring(joint, reference, stiffness))
    found = map(ModelInstanceIndex, range(2, plant.num_model_instances()))  # 0, 1: Drake's own.
    instances = {plant.GetModelInstanceName(each): each for each in found}
    for name in pick(f"weightless in {path}", fields.weightless, instances):
        plant.set_gravity_enabled(instances[name], False)
    set_planes(plant, scene_graph, facts.planes)
    set_materials(plant, scene_graph, fields.material)
    keep_apart(plant, scene_graph, facts)
    ends = add_ends(plant, scene_graph, in_space)
    try:
        plant.Finalize()
    except RuntimeError as error:
        if _LOOP in str(error):
            raise refuse_loop(f"a loop of joints in {path}") from error
        raise ModelError(f"Drake can't parse the model {path}", got=error) from error
    check_plant(plant, in_space, bool(fields.thrusters))
    plant.set_stiction_tolerance(stiction_speed)
    choose_ends(scene_graph, ends)
    leave_pairs_out(scene_graph, order_shapes if in_space else order_pair, facts)
    if kind == "xml":
        note_unlike_friction(scene_graph, facts)
    friction = _find_friction(plant, facts) if dry_friction is None else dry_friction
    if isinstance(friction, Named):
        friction = fill_named(plant, "dry_friction", friction)
    if friction is not None:
        check_size("dry_friction", friction, plant.num_velocities())
        add_dry_friction(builder, plant, friction, stiction_speed)
    add_actuation(builder, plant, path, fields.thrusters)
    builder.ExportOutput(plant.get_state_output_port(), "state")
    builder.ExportOutput(plant.get_contact_results_output_port(), "contact_results")
    builder.ExportOutput(scene_graph.get_query_output_port(), "query")
    ignored = tuple(dict.fromkeys(f"{what}: {cost}" for _, what, cost in facts.ignored))
    told = ignored, tuple(facts.notes), facts.is_bare
    diagram = builder.Build()
    return ReadModel(diagram, friction, facts.efforts, *told)


def add_dry_friction(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    dry_friction: Floats,
    stiction_speed: float = STICTION_SPEED,
) -> SymbolicVectorSystem:
    """Adds −F σ(v / v_s) to the forces on a plant's joints, and returns the system that does.

    Args:
        builder: of the plant's diagram.
        plant: finalized, with q̇ = v.
        dry_friction: F of each coordinate, shape (nv,) [N, N m].
        stiction_speed: v_s [m/s, rad/s].
    """
    n = plant.num_velocities()
    state = MakeVectorVariable(2 * n, "x")
    forces = []
    for F, v in zip(dry_friction, state[n:], strict=True):  # As `calc_friction_share` has it.
        x = largest(-1.0, least(1.0, v / stiction_speed))
        forces.append(-F * smooth_sign(x))
    # A state that stays where it is: without any, Drake 1.51 aborts when it asks for derivatives.
    still = MakeVectorVariable(1, "still")
    system = builder.AddSystem(
        SymbolicVectorSystem(
            state=still, input=state, dynamics=np.array([Expression(0.0)]), output=np.array(forces)
        )
    )
    builder.Connect(plant.get_state_output_port(), system.get_input_port())
    builder.Connect(system.get_output_port(), plant.get_applied_generalized_force_input_port())
    return system


def _parse(
    plant: MultibodyPlant, path: Path, packages: PackageMap, text: str | None, kind: str
) -> list[str]:
    """Has Drake parse a text, or the file where there is none; returns its warnings that matter."""
    parser = Parser(plant)
    parser.package_map().AddMap(packages)
    with hear_drake() as heard:
        try:
            parser.AddModels(path) if text is None else parser.AddModelsFromString(text, kind)
        except (RuntimeError, SystemExit) as error:  # pydrake has its assertions as exits.
            if _LOOP in str(error):
                raise refuse_loop(f"a loop of joints in {path}") from error
            text = re.sub(r"/?/?<literal-string>\.\w+", str(path), str(error))
            remedy = "Leave its shape out by the scenario's collisions: [...] or none."
            is_mesh = any(f"{ending}." in f"{text}." for ending in MESHES)
            what = f"Drake can't parse the model {path}"
            raise ModelError(what, text, None, remedy if is_mesh else None) from error
    told = (each.partition("warning: ")[2] or each for each in heard)
    return [each for each in told if not any(word in each for word in _HARMLESS)]


def _weld(plant: MultibodyPlant, path: Path, fields: ModelFields) -> None:
    """Welds links to the world that nothing holds."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    held = {joint.child_body().name(): joint.name() for joint in joints}
    names = [body.name() for body in list_bodies(plant)[1:]]
    for name, pose in fields.weld.items():
        free = [each for each in names if each not in held]
        if name not in names or name in held:
            raise ModelError(
                f"weld of {name!r} in {path}",
                got=f"a link that joint {held[name]!r} holds" if name in held else "no such link",
                expected=f"one that nothing holds: {', '.join(free) or 'there is none'}",
            )
        X = RigidTransform(np.reshape(pose, (4, 4)))
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(name), X)


def _drive(plant: MultibodyPlant, path: Path, facts: ModelFacts) -> None:
    """Adds actuators, and sets their limits."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    moving = {joint.name(): joint for joint in joints if joint.num_velocities() == 1}
    asked = pick(f"actuators in {path}", facts.fields.actuators, moving)
    _refuse_twins(path, joints, {*asked, *facts.friction, *facts.no_effort})
    driven: dict[str, list[JointActuator]] = {}
    for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices()):
        driven.setdefault(actuator.joint().name(), []).append(actuator)
    for name in facts.fields.actuators:
        if name in driven:
            names = " and ".join(repr(each.name()) for each in driven[name])
            got = f"joint {name!r}, which actuator {names} drives"
            raise ModelError(f"actuators in {path}", got, "joints that nothing drives")
    limits = facts.fields.effort_limits
    for name in [*asked, *(each for each in facts.no_effort if each in limits)]:
        if name not in driven:
            effort = facts.joint_efforts.get(name, math.inf)
            driven[name] = [plant.AddJointActuator(name, moving[name], effort)]
    known = {each.name(): [each] for several in driven.values() for each in several} | driven
    named = {glob: [each for each in known if fits(each, glob)] or [glob] for glob in limits}
    for name, limit in [(name, limits[glob]) for glob, names in named.items() for name in names]:
        if len(known.get(name, [])) != 1:
            several = ", ".join(repr(each.name()) for each in known.get(name, []))
            raise ModelError(
                f"effort_limits in {path}",
                got=f"joint {name!r}, which {several} drive" if several else repr(name),
                expected="one of these actuators"
                if several
                else f"an actuator or its joint: {', '.join(sorted(known)) or 'there is none'}",
                remedy="Joints without an actuator get one by the scenario's actuators.",
            )
        known[name][0].set_effort_limit(limit)
        facts.efforts.pop(known[name][0].name(), None)
    if moving and not driven and not facts.fields.thrusters:
        idle, others = sorted(facts.no_effort & {*moving}), sorted({*moving} - facts.no_effort)
        ways = [f"actuators: [{each}, ...]" for each in others[:1]]
        ways += [f"effort_limits: {{{each}: ...}}" for each in idle[:1]]
        none = f", and none at {', '.join(others)}" if others else ""
        raise FixableError(
            "the model lacks an actuator",
            got=f"limits of effort of 0 at {', '.join(idle)}{none}" if idle else f"none in {path}",
            expected="a joint that is driven",
            remedy=f"Drive joints by the scenario's {' or '.join(ways)}, or in the model.",
            fields={"actuators": others if idle else "all"}
            if others
            else {"effort_limits": dict.fromkeys(idle, 1.0)},
        )


def _add_servos(plant: MultibodyPlant, path: Path, facts: ModelFacts) -> None:
    """Gives joints the springs and dampers that servos are; their controls are efforts k q*."""
    actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
    driven = {each.joint().name(): each.joint() for each in actuators}
    given, what = {**facts.servos, **facts.fields.servos}, f"servos in {path}"
    servos = {name: given[each] for each in given for name in pick(what, [each], driven)}
    for name, (k, d) in servos.items():
        joint = driven[name]
        own = facts.springs.get(name, Spring(0.0, 0.0))
        total = k + own.stiffness
        rest = own.stiffness * own.reference / total if total else 0.0
        facts.springs[name] = Spring(total, rest)
        joint.set_default_damping(joint.default_damping() + d)


def _refuse_twins(path: Path, joints: list[Joint], read: set[str]) -> None:
    """Refuses joints of one name in several models, where something is read by their name."""
    for name, count in Counter(joint.name() for joint in joints).items():
        if count > 1 and name in read:
            raise ModelError(
                f"joint {name!r} in {path}",
                got=f"{count} joints of this name, in models of their own",
                expected="one, as friction, efforts and actuators are read by names",
                remedy="Rename all but one.",
            )


def _find_friction(plant: MultibodyPlant, facts: ModelFacts) -> Floats | None:
    """Returns the model's friction of coordinates, (nv,) [N, N m], or None."""
    found = np.zeros(plant.num_velocities())
    for name, friction in facts.friction.items():
        if plant.HasJointNamed(name) and plant.GetJointByName(name).num_velocities() == 1:
            found[plant.GetJointByName(name).velocity_start()] = friction
    return read_only(found) if found.any() else None
