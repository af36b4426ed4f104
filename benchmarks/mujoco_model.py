"""Worlds in space as models of MuJoCo: the same dynamics, but MuJoCo's contact.

Links, joints, springs and dampers (servos are such), rotors, dry friction, actuators and thrusters
are those of the world's tree. Its pairs of shapes may touch, with its coefficients of friction. To
MuJoCo contact is no spring but a constraint, by default with a time constant of 20 ms. Corners of
boxes and meshes are balls of 0.1 mm. Where a scenario names an MJCF, its own model is taken, with
the world's actuators in place of the file's.

    pip install 'drake_aigto[models]'
"""

from __future__ import annotations

import importlib
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from drake_aigto.arrays import Floats, Ints
from drake_aigto.dynamics import PRISMATIC, QUATERNION, TRANSLATION, Tree
from drake_aigto.errors import ModelError
from drake_aigto.geometry import BALL, BOX, CAPSULE, CYLINDER, HALF_SPACE, Shapes
from drake_aigto.world import Scenario, SpaceWorld, World, find_model

_POINT = 1e-4  # The radius of a corner [m].
_NAMES = {BALL: "SPHERE", BOX: "BOX", CAPSULE: "CAPSULE", CYLINDER: "CYLINDER", HALF_SPACE: "PLANE"}


class MujocoModel(NamedTuple):
    """A model of MuJoCo, whose controls are the world's, and where states are in it."""

    model: Any
    places: Ints  # of q in its positions, shape (nq,)
    speeds: Ints  # of v in its velocities, shape (nv,)
    turns: tuple[tuple[int, int], ...] = ()  # where quaternions start in q, their velocities in v

    @classmethod
    def of(cls, world: World, scenario: Scenario) -> MujocoModel:
        """Returns a world's model.

        Raises:
            ModelError: it is one of the plane, or has joints or shapes that are not translated.
        """
        path = find_model(scenario.model)
        if path.suffix == ".xml":
            return _read_mjcf(world, scenario, str(path))
        if isinstance(world, SpaceWorld):
            return _Writer(world, scenario).write()
        raise ModelError("the world", got="a planar one, of sums", expected="one in space")

    def read(self, positions: Floats, velocities: Floats) -> Floats:
        """Returns x = (q, v), shape (…, nq + nv), of MuJoCo's positions and velocities."""
        q, v = positions[..., self.places], velocities[..., self.speeds]
        for at, first in self.turns:  # MuJoCo turns about axes of the body.
            v[..., first : first + 3] = _turn(q[..., at : at + 4], v[..., first : first + 3])
        return np.concatenate([q, v], axis=-1)

    def write(self, data: Any, q: Floats, v: Floats) -> None:
        """Puts a state into MuJoCo's data."""
        v = np.array(v)
        for at, first in self.turns:
            back = q[at : at + 4] * [1.0, -1.0, -1.0, -1.0]
            v[first : first + 3] = _turn(back, v[first : first + 3])
        data.qpos[self.places], data.qvel[self.speeds] = q, v


def _turn(quaternions: Floats, vectors: Floats) -> Floats:
    """Returns vectors (…, 3), turned by quaternions (w, x, y, z), shape (…, 4)."""
    turns = Rotation.from_quat(np.roll(quaternions.reshape(-1, 4), -1, axis=1))
    return np.asarray(turns.apply(vectors.reshape(-1, 3))).reshape(vectors.shape)


def _read_mjcf(world: World, scenario: Scenario, path: str) -> MujocoModel:
    """Returns the model of a file, without joints that the scenario fixes."""
    mujoco: Any = importlib.import_module("mujoco")
    spec = mujoco.MjSpec.from_file(path)
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for joint in list(spec.joints):
        if any(fnmatchcase(joint.name, glob) for glob in scenario.model_fields.fixed_joints):
            spec.delete(joint)
    joints = [world.plant.get_joint(each) for each in world.plant.GetJointIndices()]
    names = [each.name() for each in joints if each.num_positions()]
    for column in world.actuation.T:
        (place,) = np.flatnonzero(column)
        _add_motor(spec, mujoco.mjtTrn.mjTRN_JOINT, names[place], [column[place]])
    model = spec.compile()
    moving = [model.joint(each) for each in names]
    places = np.concatenate([each.qposadr for each in moving])
    return MujocoModel(model, places, np.concatenate([each.dofadr for each in moving]))


def _add_motor(spec: Any, kind: Any, target: str, gear: list[float]) -> None:
    limits = {"ctrllimited": False, "forcelimited": False}  # A file may have them by default.
    spec.add_actuator(trntype=kind, target=target, gear=gear + [0.0] * (6 - len(gear)), **limits)


class _Writer:
    """Translates a world in space, link by link."""

    def __init__(self, world: SpaceWorld, scenario: Scenario) -> None:
        self._mujoco: Any = importlib.import_module("mujoco")
        self._spec, self._world, self._scenario = self._mujoco.MjSpec(), world, scenario
        self._tree: Tree = world.tree
        pulls = self._tree.gravity
        self._spec.option.gravity = pulls[np.argmax(np.linalg.norm(pulls, axis=1))]
        self._bodies: list[Any] = []

    def write(self) -> MujocoModel:
        """Returns the model."""
        tree, kinds = self._tree, self._mujoco.mjtTrn
        for link in range(len(tree.parents)):
            self._bodies.append(self._add_link(link))
        for column in tree.actuation.T[: tree.actuation.shape[1] - len(tree.thruster_links)]:
            (dof,) = np.flatnonzero(column).tolist()
            _add_motor(self._spec, kinds.mjTRN_JOINT, _name_joint(dof), [column[dof]])
        for number, link in enumerate(tree.thruster_links):
            self._bodies[link].add_site(name=f"thruster {number}")
            moment, force = np.split(tree.thrusts[number], 2)
            gear = [*force.tolist(), *moment.tolist()]
            _add_motor(self._spec, kinds.mjTRN_SITE, f"thruster {number}", gear)
        self._add_shapes(self._world.geometry.shapes)
        mu = self._world.rubbing.calc_coefficients(self._scenario.friction)
        for (one, other), friction in zip(self._world.geometry.pairs, mu, strict=True):
            names = {"geomname1": f"shape {one}", "geomname2": f"shape {other}"}
            self._spec.add_pair(**names, condim=3, friction=[friction, friction, 0.0, 0.0, 0.0])
        return self._find_places(self._spec.compile())

    def _add_link(self, link: int) -> Any:
        """Returns the body of a link: its parent's if that has no mass, as MuJoCo has no such."""
        tree = self._tree
        parent, mass = int(tree.parents[link]), float(tree.masses[link])
        rotation, place = tree.rotations[link].reshape(3, 3), tree.offsets[link]
        if parent >= 0 and tree.masses[parent] == 0.0:
            body = self._bodies[parent]
            if not np.allclose(rotation, np.eye(3)) or np.any(place):
                raise ModelError(f"link {link}", "turned or moved on one without mass", "one at it")
        else:
            base = self._spec.worldbody if parent < 0 else self._bodies[parent]
            body = base.add_body(pos=place, quat=_find_quaternion(rotation))
        if mass:
            xx, xy, yy, xz, yz, zz = tree.inertias[link]
            body.mass, body.ipos, body.explicitinertial = mass, tree.centers[link], True
            body.fullinertia = [xx, yy, zz, xy, xz, yz]
            body.gravcomp = float(not np.any(tree.gravity[link]))
        kind, dofs = int(tree.kinds[link]), range(tree.dofs[link], tree.dofs[link + 1])
        kinds = self._mujoco.mjtJoint
        if kind == QUATERNION:
            self._add_joint(body, link, dofs[0], kinds.mjJNT_BALL, [0.0, 0.0, 1.0])
        elif kind == TRANSLATION:
            for dof, axis in zip(dofs, np.eye(3), strict=True):
                self._add_joint(body, link, dof, kinds.mjJNT_SLIDE, axis)
        elif len(dofs) == 1 and not tree.pitches[link]:
            is_slider = kind == PRISMATIC
            joint = kinds.mjJNT_SLIDE if is_slider else kinds.mjJNT_HINGE
            self._add_joint(body, link, dofs[0], joint, tree.axes[link])
        else:
            raise ModelError(f"link {link}", "a screw, or roll, pitch and yaw", "another joint")
        return body

    def _add_joint(self, body: Any, link: int, dof: int, kind: Any, axis: Any) -> None:
        tree = self._tree
        body.add_joint(
            name=_name_joint(dof),
            type=kind,
            axis=axis,
            stiffness=[tree.stiffnesses[link], 0.0, 0.0],
            springref=tree.rests[link],
            damping=[tree.damping[dof], 0.0, 0.0],
            armature=tree.armature[dof],
            frictionloss=tree.friction[dof],
        )

    def _add_shapes(self, shapes: Shapes) -> None:
        for number, (link, kind) in enumerate(zip(shapes.bodies, shapes.kinds, strict=True)):
            body = self._spec.worldbody if link < 0 else self._bodies[link]
            given: dict[str, Any] = {}
            if kind in _NAMES:
                size = np.array(shapes.sizes[number])
                size[0] = size[0] or _POINT
                given["size"] = size if kind != HALF_SPACE else [0.0, 0.0, 1.0]
            else:
                span = slice(*shapes.spans[number : number + 2])
                corners = np.unique(shapes.faces[span, :3].reshape(-1, 3), axis=0)
                self._spec.add_mesh(name=f"hull {number}", uservert=corners.ravel().tolist())
                given["meshname"] = f"hull {number}"
            body.add_geom(
                name=f"shape {number}",
                type=getattr(self._mujoco.mjtGeom, f"mjGEOM_{_NAMES.get(int(kind), 'MESH')}"),
                pos=shapes.places[number],
                quat=_find_quaternion(shapes.rotations[number]),
                contype=0,
                conaffinity=0,
                **given,
            )

    def _find_places(self, model: Any) -> MujocoModel:
        tree, turns = self._tree, []
        q, v = np.empty(tree.num_positions, dtype=int), np.empty(tree.num_velocities, dtype=int)
        for link in range(len(tree.parents)):
            first, dofs = int(tree.positions[link]), range(tree.dofs[link], tree.dofs[link + 1])
            if tree.kinds[link] == QUATERNION:
                joint = model.joint(_name_joint(dofs[0]))
                q[first : first + 4] = int(joint.qposadr[0]) + np.arange(4)
                v[tree.velocities[dofs]] = int(joint.dofadr[0]) + np.arange(3)
                turns.append((first, int(tree.velocities[dofs[0]])))
                continue
            for number, dof in enumerate(dofs):
                joint = model.joint(_name_joint(dof))
                q[first + number], v[tree.velocities[dof]] = joint.qposadr[0], joint.dofadr[0]
        return MujocoModel(model, q, v, tuple(turns))


def _name_joint(dof: int) -> str:
    return f"joint {dof}"


def _find_quaternion(rotation: Floats) -> Floats:
    """Returns w, x, y, z of a rotation matrix."""
    return np.roll(Rotation.from_matrix(rotation).as_quat(), 1)
