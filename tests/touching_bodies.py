"""Two bodies that float, or one and a half space, which touch: Drake's plant, and tables of it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    Box,
    Capsule,
    Convex,
    Cylinder,
    HalfSpace,
    ProximityProperties,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, JacobianWrtVariable, SpatialInertia, UnitInertia
from pydrake.systems.framework import Context, DiagramBuilder
from scipy.spatial import ConvexHull

from drake_aigto.arrays import Floats
from drake_aigto.contact import TouchRoom, TouchTable, make_touch_room, push
from drake_aigto.geometry import BALL, BOX, CAPSULE, CYLINDER, HALF_SPACE, HULL, Shapes
from drake_aigto.kernels import borrow, kernel

CORNERS = 0.12 * np.random.default_rng(3).normal(size=(14, 3))
CORNERS /= np.maximum(1.0, np.linalg.norm(CORNERS, axis=1, keepdims=True) / 0.2)
SHAPES: dict[str, tuple[int, Shape, list[float], float]] = {
    "ball": (BALL, Sphere(0.1), [0.1, 0, 0], 0.1),
    "capsule": (CAPSULE, Capsule(0.06, 0.3), [0.06, 0.15, 0], 0.21),
    "box": (BOX, Box(0.2, 0.3, 0.25), [0.1, 0.15, 0.125], 0.25),
    "cylinder": (CYLINDER, Cylinder(0.1, 0.3), [0.1, 0.15, 0], 0.19),
    "hull": (HULL, Convex(CORNERS.T, "hull"), [0, 0, 0], 0.2),
    "ground": (HALF_SPACE, HalfSpace(), [0, 0, 0], 0.0),
}
STICTION = 0.2  # [m/s]: many states stick.
# Stiffness [N/m], dissipation [s/m] and friction of both shapes.
MATERIALS = (2000.0, 0.3, 0.6), (5000.0, 0.1, 0.8)
_X_BG = RigidTransform(RollPitchYaw(0.3, 0.2, -0.4), [0.02, -0.03, 0.01])


class Bodies(NamedTuple):
    """A plant of two bodies, the second of which may be the world."""

    plant: MultibodyPlant
    diagram: Any
    root: Context
    context: Context
    table: TouchTable
    room: TouchRoom

    @classmethod
    def of(cls, *kinds: str) -> Bodies:
        """Returns bodies with shapes of these kinds."""
        builder = DiagramBuilder()
        plant, _ = AddMultibodyPlantSceneGraph(builder, 0.0)
        of_shapes = []
        for name, kind, material in zip("ab", kinds, MATERIALS, strict=True):
            body = plant.world_body()
            if kind != "ground":
                inertia = SpatialInertia(1.3, np.zeros(3), UnitInertia(0.02, 0.03, 0.025))
                body = plant.AddRigidBody(name, inertia)
            properties, (k, d, mu) = ProximityProperties(), material
            AddContactMaterial(d, k, CoulombFriction(mu, mu), properties)
            shape = SHAPES[kind][1]
            plant.RegisterCollisionGeometry(body, _X_BG, shape, name, properties)
            of_shapes.append((int(body.index()) - 1, *SHAPES[kind]))
        plant.Finalize()
        plant.set_stiction_tolerance(STICTION)
        diagram = builder.Build()
        root = diagram.CreateDefaultContext()
        table = _make_table(of_shapes, plant.num_velocities())
        context = plant.GetMyMutableContextFromRoot(root)
        return cls(plant, diagram, root, context, table, make_touch_room(table))

    def place(self, q: Floats) -> tuple[Floats, Floats]:
        """Returns poses (B, 12) and motions (n, 6) of bodies at positions."""
        plant, poses = self.plant, []
        plant.SetPositions(self.context, q)
        motions = np.zeros((plant.num_velocities(), 6))
        for body in self.bodies:
            X = plant.EvalBodyPoseInWorld(self.context, body)
            poses.append([*X.rotation().matrix().ravel(), *X.translation()])
            world, first = plant.world_frame(), body.floating_velocities_start_in_v()
            origin = X.inverse().translation()
            J = plant.CalcJacobianSpatialVelocity(
                self.context, JacobianWrtVariable.kV, body.body_frame(), origin, world, world
            )
            motions[first : first + 6] = J[:, first : first + 6].T
        return np.array(poses), motions

    @property
    def bodies(self) -> list[Any]:
        """The bodies that float."""
        return [self.plant.get_body(BodyIndex(i)) for i in range(1, self.plant.num_bodies())]

    def push(self, q: Floats, v: Floats, eps: float = 0.0) -> tuple[Floats, Floats]:
        """Returns the generalized force of contact, and its derivatives."""
        n = len(v)
        force, slopes = np.zeros(n), np.zeros((n, 2 * n))
        _push(self.table, *self.place(q), v, eps, self.room, force, slopes)
        return force, slopes

    def draw(self, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Returns random positions and velocities."""
        q = self.plant.GetPositions(self.context).copy()
        for body in self.bodies:
            first = body.floating_positions_start()
            turn = rng.normal(size=4)
            q[first : first + 4] = turn / np.linalg.norm(turn)
            q[first + 4 : first + 7] = rng.uniform(-0.22, 0.22, 3)
        return q, 0.3 * rng.normal(size=self.plant.num_velocities())

    def moved(self, q: Floats, delta: Floats) -> Floats:
        """Returns q ⊕ δ to first order."""
        self.plant.SetPositions(self.context, q)
        return q + self.plant.MapVelocityToQDot(self.context, delta)


def find_faces() -> Floats:
    """Returns triangles of the hull, three corners and the normal outward, shape (T, 4, 3)."""
    hull = ConvexHull(CORNERS)
    faces = np.concatenate([CORNERS[hull.simplices], hull.equations[:, np.newaxis, :3]], axis=1)
    a, b, c, n = np.moveaxis(faces, 1, 0)
    turns = np.sum(np.cross(b - a, c - a) * n, axis=1) < 0
    faces[turns, 1:3] = faces[turns, 2:0:-1]
    return faces


def _make_table(of_shapes: list[Any], num_velocities: int) -> TouchTable:
    (k1, d1, mu1), (k2, d2, mu2) = MATERIALS
    law = [k1 * k2 / (k1 + k2), (k2 * d1 + k1 * d2) / (k1 + k2), 2 * mu1 * mu2 / (mu1 + mu2)]
    bodies, kinds, _, sizes, bounds = zip(*of_shapes, strict=True)
    moving = [body for body in bodies if body >= 0]
    carries = np.zeros((num_velocities, num_velocities), dtype=bool)
    for body in moving:  # Drake has turns first: translations carry them.
        carries[6 * body + 3 : 6 * body + 6, 6 * body : 6 * body + 3] = True
    return TouchTable(
        Shapes(
            np.array(bodies),
            np.array(kinds),
            np.tile(_X_BG.rotation().matrix(), (2, 1, 1)),
            np.tile(_X_BG.translation(), (2, 1)),
            np.array(sizes, dtype=float),
            np.array(bounds),
            np.cumsum([0, *(len(find_faces()) * (kind == HULL) for kind in kinds)]),
            find_faces(),
        ),
        pairs=np.array([[0, 1]]),
        law=np.array([[*law, STICTION, 1.0, 0.006, 0.0]]),
        couples=np.array([0]),
        starts=np.array([0, 6 * len(moving)]),
        chain=np.concatenate([6 * body + np.arange(6) for body in moving]),
        signs=np.repeat([1.0, -1.0][: len(moving)], 6),
        carries=carries,
    )


@kernel
def _push(
    table: TouchTable, poses: Floats, S: Floats, v: Floats,
    eps: float, room: TouchRoom, force: Floats, slopes: Floats,
) -> None:  # fmt: skip
    """Does what `push` does, with derivatives."""
    table, poses, S, v, room = borrow(table), borrow(poses), borrow(S), borrow(v), borrow(room)
    push(table, poses, S, v, eps, 1.0, True, room, borrow(force), borrow(slopes))
