"""The tree of a MultibodyPlant."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    ForceElementIndex,
    Joint,
    PrismaticSpring,
    RevoluteSpring,
    SpatialInertia,
    UniformGravityFieldElement,
    WeldJoint,
)
from pydrake.systems.framework import Context

from drake_aigto.arrays import Floats
from drake_aigto.dynamics.stiction import STICTION_SPEED
from drake_aigto.dynamics.tree_tables import (
    NUM_VELOCITIES,
    PRISMATIC,
    QUATERNION,
    REVOLUTE,
    RPY,
    SCREW,
    TRANSLATION,
    TreeTables,
)
from drake_aigto.errors import ModelError

# Largest difference of Drake's recursive dynamics and what is read, relative to the largest value.
_TOLERANCE = 1e-9

_X, _Y, _Z = np.eye(3)


class _Part(NamedTuple):
    """A link of a joint's chain: kind, axis, pitch, first position and first velocity of its own.

    The last two count from the joint's own first ones.
    """

    kind: int
    axis: Floats = np.zeros(3)
    pitch: float = 0.0
    position: int = 0
    velocity: int = 0


def _split(joint: Joint) -> tuple[_Part, ...]:
    """Returns the chain of links of a joint, from the parent outward."""
    joint_of: Any = joint
    kind = joint.type_name()
    if kind == "revolute":
        return (_Part(REVOLUTE, joint_of.revolute_axis()),)
    if kind == "prismatic":
        return (_Part(PRISMATIC, joint_of.translation_axis()),)
    if kind == "screw":
        return (_Part(SCREW, _find_screw_axis(joint), joint_of.screw_pitch() / (2 * np.pi)),)
    if kind in _CHAINS:
        return _CHAINS[kind]
    raise ModelError(
        f"joint {joint.name()!r} ({kind})",
        got="a motion that is none of a tree's",
        expected=f"one of prismatic, revolute, screw, {', '.join(_CHAINS)}",
        remedy="Use one of these, or fix it by the scenario's fixed_joints.",
    )


def _find_screw_axis(joint: Any) -> Floats:
    """Returns the axis of a screw, which Drake shows only by the motion along it."""
    context, frame = joint.GetParentPlant().CreateDefaultContext(), joint.frame_on_parent()
    joint.set_angular_velocity(context, 1.0)
    motion = joint.frame_on_child().CalcSpatialVelocity(context, frame, frame)
    return np.asarray(motion.rotational())


_CHAINS = {
    "planar": (
        _Part(PRISMATIC, _X),
        _Part(PRISMATIC, _Y, position=1, velocity=1),
        _Part(REVOLUTE, _Z, position=2, velocity=2),
    ),
    "universal": (_Part(REVOLUTE, _X), _Part(REVOLUTE, _Y, position=1, velocity=1)),
    "ball_rpy": (_Part(RPY),),
    "rpy_floating": (_Part(TRANSLATION, position=3, velocity=3), _Part(RPY)),
    "quaternion_floating": (_Part(TRANSLATION, position=4, velocity=3), _Part(QUATERNION)),
}


class Thrust(NamedTuple):
    """A force that turns with the body that it pushes, such as a propeller's."""

    body: int  # its index
    wrench: Floats  # moment about the body's origin, and force, for u = 1, in its frame; shape (6,)


def read_tables(
    plant: MultibodyPlant, context: Context, dry_friction: Floats, thrusts: Sequence[Thrust]
) -> TreeTables:
    """Returns the tables of a plant, see `Tree.of`."""
    check_constraints(plant)
    return _PlantTree(plant, context).build(dry_friction, thrusts)


class _Link(NamedTuple):
    """A link as it is found."""

    parent: int
    part: _Part
    joint: Joint
    frame: RigidTransform


class _PlantTree:
    """Links of a plant, and bodies with their poses in them."""

    def __init__(self, plant: MultibodyPlant, context: Context) -> None:
        """Goes from the world outward."""
        self._context = context
        self._plant = plant
        self._links: list[_Link] = []
        # Of each body by its index: its link, and its pose there.
        self._places = {int(plant.world_body().index()): (-1, RigidTransform())}
        joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
        # Welds first, then as velocities are numbered.
        waiting = sorted(joints, key=lambda j: (j.num_velocities() > 0, j.velocity_start()))
        while waiting:
            joint = next(  # A body of which has its place.
                joint
                for joint in waiting
                for body in (joint.parent_body(), joint.child_body())
                if int(body.index()) in self._places
            )
            waiting.remove(joint)
            self._attach(joint)

    def _attach(self, joint: Joint) -> None:
        """Places the joint's other body, on links of its own if the joint moves."""
        parent, child = int(joint.parent_body().index()), int(joint.child_body().index())
        X_PF = joint.frame_on_parent().GetFixedPoseInBodyFrame()
        X_BM = joint.frame_on_child().GetFixedPoseInBodyFrame()
        is_reversed = parent not in self._places
        if is_reversed:
            parent, child, X_PF, X_BM = child, parent, X_BM, X_PF
        link, X_LP = self._places[parent]
        X_LF = X_LP @ X_PF
        if isinstance(joint, WeldJoint):
            X_LF = X_LF @ (joint.X_FM().inverse() if is_reversed else joint.X_FM())
        parts = _split(joint) if joint.num_velocities() else ()
        if is_reversed:  # Drake itself refuses all but sliders, hinges and welds.
            parts = tuple(part._replace(axis=-part.axis) for part in parts)
        for part in parts:
            self._links.append(_Link(link, part, joint, X_LF))
            link, X_LF = len(self._links) - 1, RigidTransform()
        self._places[child] = link, X_LF @ X_BM.inverse()

    def build(self, dry_friction: Floats, thrusts: Sequence[Thrust]) -> TreeTables:
        """Returns the tree."""
        links, num_velocities = self._links, self._plant.num_velocities()
        kinds = np.array([link.part.kind for link in links], dtype=np.int64)
        parents = np.array([link.parent for link in links], dtype=np.int64)
        sizes = NUM_VELOCITIES[kinds] if len(links) else np.zeros(0, dtype=np.int64)
        dofs = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        starts = [link.joint.velocity_start() + link.part.velocity for link in links]
        of_links = [
            np.arange(start, start + size) for start, size in zip(starts, sizes, strict=True)
        ]
        velocities = np.concatenate([np.zeros(0, dtype=np.int64), *of_links])
        up = np.arange(-1, num_velocities - 1)
        up[dofs[:-1]] = [dofs[parent + 1] - 1 if parent >= 0 else -1 for parent in parents]
        plant, armature = self._plant, np.zeros(num_velocities)
        for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices()):
            start = actuator.joint().velocity_start()
            armature[start] += actuator.calc_reflected_inertia(self._context)
        stiffnesses, rests = self._read_springs()
        masses, centers, inertias = self._read_inertias()
        bodies = [self._places[i] for i in range(self._plant.num_bodies())]
        actuation = np.pad(plant.MakeActuationMatrix(), ((0, 0), (0, len(thrusts))))
        return TreeTables(
            parents=parents,
            kinds=kinds,
            positions=_ints(link.joint.position_start() + link.part.position for link in links),
            dofs=dofs,
            velocities=velocities,
            links=np.repeat(np.arange(len(links)), sizes),
            up=up,
            axes=_floats((link.part.axis for link in links), 3),
            pitches=np.array([link.part.pitch for link in links], dtype=float),
            rotations=_floats((link.frame.rotation().matrix() for link in links), 9),
            offsets=_floats((link.frame.translation() for link in links), 3),
            masses=masses,
            centers=centers,
            inertias=inertias,
            gravity=self._read_gravity(parents),
            stiffnesses=stiffnesses,
            rests=rests,
            damping=read_damping(plant, self._context)[velocities],
            armature=armature[velocities],
            friction=np.array(dry_friction, dtype=float)[velocities],
            stiction=np.full(num_velocities, STICTION_SPEED),
            pace=np.zeros(num_velocities),
            actuation=np.ascontiguousarray(actuation[velocities]),
            thruster_links=_ints(self._places[thrust.body][0] for thrust in thrusts),
            thrusts=_floats(map(self._move_thrust, thrusts), 6),
            body_links=_ints(link for link, _ in bodies),
            body_rotations=_floats((X.rotation().matrix() for _, X in bodies), 9),
            body_offsets=_floats((X.translation() for _, X in bodies), 3),
        )

    def _move_thrust(self, thrust: Thrust) -> Floats:
        """Returns the wrench of a thruster in its link's frame, shape (6,)."""
        link, X = self._places[thrust.body]
        if link < 0:
            name = self._plant.get_body(BodyIndex(thrust.body)).name()
            raise ModelError(
                f"a thruster on {name!r}", "a body that nothing moves", "one that moves"
            )
        moment, force = (X.rotation() @ part for part in np.split(thrust.wrench, 2))
        return np.concatenate([moment + np.cross(X.translation(), force), force])

    def _read_inertias(self) -> tuple[Floats, Floats, Floats]:
        """Returns masses (L,), centers (L, 3) and moments of inertia about these (L, 6)."""
        count = len(self._links)
        found = [SpatialInertia.Zero() for _ in range(count)]
        for index, (link, X) in self._places.items():
            if link >= 0:
                body: Any = self._plant.get_body(BodyIndex(index))
                inertia = body.CalcSpatialInertiaInBodyFrame(self._context)
                of_link = inertia.ReExpress(X.rotation()).Shift(-X.translation())
                found[link] += of_link
        masses = np.array([each.get_mass() for each in found], dtype=float)
        centers, moments = np.zeros((count, 3)), np.zeros((count, 6))
        for i, each in enumerate(found):
            if masses[i] > 0:
                centers[i] = each.get_com()
                full = each.Shift(each.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
                moments[i] = full[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
        return masses, centers, moments

    def _read_gravity(self, parents: Any) -> Floats:
        """Returns gravity on the tree of each link, shape (L, 3)."""
        pull, found = self._plant.gravity_field().gravity_vector(), np.zeros((len(parents), 3))
        roots = list(range(len(parents)))
        for i, parent in enumerate(parents):
            roots[i] = roots[parent] if parent >= 0 else i
        answers: dict[int, bool] = {}
        for index, (link, _) in self._places.items():
            if link < 0:
                continue
            body = self._plant.get_body(BodyIndex(index))
            is_pulled = self._plant.is_gravity_enabled(body.model_instance())
            if body.default_mass() > 0 and answers.setdefault(roots[link], is_pulled) != is_pulled:
                raise ModelError(
                    f"body {body.name()!r}",
                    got="gravity on some bodies of its tree, and none on others",
                    expected="gravity on all or none",
                    remedy="Use set_gravity_enabled for all of their model instances alike.",
                )
        for i, root in enumerate(roots):
            found[i] = pull if answers.get(root, True) else 0.0
        return found

    def _read_springs(self) -> tuple[Floats, Floats]:
        """Returns stiffnesses and rests of links, shape (L,)."""
        stiffnesses, moments = np.zeros(len(self._links)), np.zeros(len(self._links))
        place = {int(link.joint.index()): i for i, link in enumerate(self._links)}
        for k in range(self._plant.num_force_elements()):
            element = self._plant.get_force_element(ForceElementIndex(k))
            if isinstance(element, UniformGravityFieldElement):
                continue
            if not isinstance(element, (RevoluteSpring, PrismaticSpring)):
                raise _refuse_force(type(element).__name__)
            i = place[int(element.joint().index())]
            if isinstance(element, RevoluteSpring):
                stiffness = element.GetStiffness(self._context)
                rest = element.GetNominalAngle(self._context)
            else:
                stiffness, rest = element.stiffness(), element.nominal_position()
            stiffnesses[i] += stiffness
            moments[i] += stiffness * rest
        return stiffnesses, moments / np.where(stiffnesses > 0, stiffnesses, 1.0)


def check_constraints(plant: MultibodyPlant) -> None:
    """Refuses links that are constrained otherwise than by joints."""
    if count := plant.num_constraints():
        raise refuse_loop(f"{count} constraint{'s' if count > 1 else ''} beside joints")


def refuse_loop(got: str) -> ModelError:
    """Returns the error of links that do not hang on joints as on a tree."""
    return ModelError(
        "the links of the model",
        got=got,
        expected="a tree: one joint between each link and its parent, and nothing else",
        remedy="Leave out the joint or the constraint that closes a loop, or couples joints.",
    )


def find_joint(plant: MultibodyPlant, velocity: int) -> Joint:
    """Returns the joint that has this generalized velocity (or position, where q̇ = v)."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    return next(j for j in joints if 0 <= velocity - j.velocity_start() < j.num_velocities())


def check_force(plant: MultibodyPlant, found: Floats, expected: Floats) -> None:
    """Refuses forces that are not those of Drake, shape (nv,), by the joint that they act on."""
    errors = np.abs(found - expected)
    worst = int(np.argmax(errors))
    if errors[worst] > _TOLERANCE * max(1.0, np.abs(expected).max()):
        joint = find_joint(plant, worst)
        raise _refuse_force(f"joint {joint.name()!r} ({joint.type_name()})")


def _refuse_force(what: str) -> ModelError:
    """Returns the error of a force that is not read."""
    return ModelError(
        what,
        got="a force that is not gravity, a linear spring or damper of a joint",
        remedy="Remove the force (a LinearSpringDamper is a square root: put spring and damping on "
        "a joint).",
    )


def _ints(values: Any) -> Any:
    return np.array(list(values), dtype=np.int64)


def _floats(rows: Any, size: int) -> Floats:
    """Returns rows of a size as an array."""
    return np.array([np.ravel(row) for row in rows], dtype=float).reshape(-1, size)


def read_damping(plant: MultibodyPlant, context: Context) -> Floats:
    """Returns d of dampers of joints, whose force is −d v, shape (nv,) [N s/m, N m s/rad]."""
    found = np.zeros(plant.num_velocities())
    for joint in map(plant.get_joint, plant.GetJointIndices()):
        start, count = joint.velocity_start(), joint.num_velocities()
        found[start : start + count] = joint.GetDampingVector(context)
    return found
