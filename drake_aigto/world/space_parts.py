"""Parts of worlds in space: coordinates on a manifold, tables of pairs of shapes, and friction."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    GeometryId,
    HalfSpace,
    Mesh,
    Role,
    SceneGraph,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, Diagram

from drake_aigto.arrays import Bools, Floats, Ints, read_only
from drake_aigto.dynamics import PRISMATIC, QUATERNION, RPY, TRANSLATION, Coordinates, Tree
from drake_aigto.errors import ModelError
from drake_aigto.geometry import BALL, BOX, CAPSULE, CYLINDER, HALF_SPACE, HULL, Shapes, can_meet
from drake_aigto.world.material import impose_friction, read_frictions
from drake_aigto.world.pair_errors import name_shape

_KINDS: dict[type[Shape], int] = {
    Sphere: BALL,
    Capsule: CAPSULE,
    Box: BOX,
    Cylinder: CYLINDER,
    Convex: HULL,
    Mesh: HULL,  # Drake's touches are those of its convex hull.
    HalfSpace: HALF_SPACE,
}
EXPECTED = (
    "Sphere against Sphere, Box, Capsule, Cylinder, Mesh or HalfSpace, "
    "Capsule against Capsule, Box or HalfSpace, Box or Mesh against Box, Mesh or HalfSpace, "
    "Cylinder against HalfSpace"
)
# All faces of a hull are looked at: of as many corners, before a ball and the ground, in 3 µs.
MOST_CORNERS = 64
# Spheres at each rim of a cylinder: as it rolls on them, it rises and falls by 2 % of its radius.
RIM = 16


class ShapePair(NamedTuple):
    """Two shapes that may touch; the kind of the first one is the lower number."""

    name: str  # such as "puck with pusher"
    shapes: tuple[GeometryId, GeometryId]


class SpaceShapes(NamedTuple):
    """Shapes of all pairs, and the pairs, as compiled code takes them."""

    shapes: Shapes
    pairs: Ints  # which of them may touch, shape (P, 2)
    radii: Floats  # of a sphere about each shape, or about the one that it is a corner of, (G,) [m]

    @property
    def pair_kinds(self) -> Ints:
        """The kinds of both shapes of each pair, shape (P, 2)."""
        return self.shapes.kinds[self.pairs]


def order_shapes(
    inspector: Any, pair: Sequence[GeometryId]
) -> tuple[GeometryId, GeometryId] | None:
    """Returns a pair in the order of `geometry`, or None if its distance is not known."""
    first, second = pair
    kinds = [_KINDS.get(type(inspector.GetShape(shape)), -1) for shape in pair]
    if min(kinds) < 0 or not can_meet(*kinds):
        return None
    return (first, second) if kinds[0] <= kinds[1] else (second, first)


def read_shapes(
    plant: MultibodyPlant, scene_graph: SceneGraph, tree: Tree, pairs: Sequence[ShapePair]
) -> SpaceShapes:
    """Returns the shapes of pairs, in the frames of the tree's links."""
    inspector: Any = scene_graph.model_inspector()
    numbers = {
        shape: k for k, shape in enumerate(dict.fromkeys(s for pair in pairs for s in pair.shapes))
    }
    links, poses = [], []
    for shape in numbers:
        body = int(plant.GetBodyFromFrameId(inspector.GetFrameId(shape)).index())
        R, p = tree.body_rotations[body].reshape(3, 3), tree.body_offsets[body]
        X_BG: RigidTransform = inspector.GetPoseInFrame(shape)
        poses.append((R @ X_BG.rotation().matrix(), p + R @ X_BG.translation()))
        links.append(int(tree.body_links[body]))
    shapes = [inspector.GetShape(shape) for shape in numbers]
    hulls = [_read_hull(inspector, shape) for shape in numbers]
    sizes = [_read_size(shape, faces) for shape, faces in zip(shapes, hulls, strict=True)]
    kinds = [_KINDS[type(shape)] for shape in shapes]
    table = Shapes(
        bodies=np.array(links, dtype=np.int64),
        kinds=np.array(kinds, dtype=np.int64),
        rotations=np.array([R for R, _ in poses]).reshape(-1, 3, 3),
        places=np.array([p for _, p in poses]).reshape(-1, 3),
        sizes=np.array([size for size, _ in sizes]).reshape(-1, 3),
        bounds=np.array([bound for _, bound in sizes], dtype=float),
        spans=np.cumsum([0, *map(len, hulls)]),
        faces=np.concatenate([np.zeros((0, 4, 3)), *hulls]),
    )
    rows = [[numbers[shape] for shape in pair.shapes] for pair in pairs]
    radii = np.array([_read_radius(inspector, shape) for shape in numbers], dtype=float)
    return SpaceShapes(table, np.array(rows, dtype=np.int64).reshape(-1, 2), radii)


def find_whole(inspector: Any, shape: GeometryId) -> GeometryId:
    """Returns the shape that has this one as an end or a corner; itself if it is none."""
    name = name_shape(inspector, shape)
    if name == inspector.GetName(shape):
        return shape
    frame = inspector.GetFrameId(shape)
    found: GeometryId = inspector.GetGeometryIdByName(frame, Role.kProximity, name)
    return found


def list_rims(inspector: Any, pairs: Sequence[ShapePair]) -> list[str]:
    """Returns the names of cylinders that touch with points at their rims."""
    shapes = [shape for pair in pairs for shape in pair.shapes]
    wholes = [(shape, find_whole(inspector, shape)) for shape in shapes]
    return list(
        dict.fromkeys(
            inspector.GetName(whole)
            for shape, whole in wholes
            if whole != shape and isinstance(inspector.GetShape(whole), Cylinder)
        )
    )


def _read_radius(inspector: Any, shape: GeometryId) -> float:
    """Returns the radius of a sphere about a shape, or about the solid that it is a corner of."""
    whole = find_whole(inspector, shape)
    shape = shape if isinstance(inspector.GetShape(whole), Capsule) else whole
    return _read_size(inspector.GetShape(shape), _read_hull(inspector, shape))[1]


def _read_hull(inspector: Any, shape: GeometryId) -> Floats:
    """Returns the faces of a shape's convex hull as `Shapes` has them; none of what is no mesh."""
    if not isinstance(inspector.GetShape(shape), Convex | Mesh):
        return np.zeros((0, 4, 3))
    hull, faces = inspector.GetConvexHull(shape), []
    if hull.num_vertices() > MOST_CORNERS:
        raise ModelError(
            f"contact of {inspector.GetName(shape)}",
            got=f"a mesh whose convex hull has {hull.num_vertices()} corners",
            expected=f"{MOST_CORNERS} at most",
            remedy="Simplify the mesh, as in Blender by Decimate or in MeshLab by Quadric Edge "
            "Collapse; or replace it by spheres and boxes, or leave it out by ignored_shapes.",
        )
    corners = [hull.vertex(i) for i in range(hull.num_vertices())]
    for e in range(hull.num_elements()):
        face, normal = hull.element(e), hull.face_normal(e)
        first, *others = [corners[face.vertex(i)] for i in range(face.num_vertices())]
        faces += [(first, *pair, normal) for pair in itertools.pairwise(others)]
    return np.array(faces)


def _read_size(shape: Any, faces: Floats) -> tuple[list[float], float]:
    """Returns a shape's size as `Shapes` has it, and the radius of a sphere that holds it."""
    if len(faces):
        return [0.0, 0.0, 0.0], float(np.max(np.linalg.norm(faces[:, :3], axis=2)))
    if isinstance(shape, Sphere):
        return [shape.radius(), 0.0, 0.0], shape.radius()
    if isinstance(shape, Box):
        half = np.asarray(shape.size()) / 2
        return half.tolist(), float(np.linalg.norm(half))
    if isinstance(shape, Capsule | Cylinder):
        r, half_length = shape.radius(), shape.length() / 2
        rounded = isinstance(shape, Capsule)
        return [r, half_length, 0.0], r + half_length if rounded else float(
            np.hypot(r, half_length)
        )
    return [0.0, 0.0, 0.0], 0.0


class SpaceFriction:
    """Friction of pairs in space: the dynamic coefficient, for sticking too.

    Attributes:
        names: of the pairs.
        shapes: of all of them.
        model_coefficients: the model's μ of each, shape (m,).
    """

    def __init__(
        self, plant: MultibodyPlant, scene_graph: SceneGraph, diagram: Diagram,
        pairs: Sequence[ShapePair],
    ) -> None:  # fmt: skip
        """Reads the coefficients, with Drake's defaults where a shape gives none."""
        self._plant, self._scene_graph = plant, scene_graph
        self.shapes = [shape for pair in pairs for shape in pair.shapes]
        self.names = tuple(pair.name for pair in pairs)
        found = read_frictions(scene_graph, diagram, [pair.shapes for pair in pairs])
        self.model_coefficients = read_only(found)

    @property
    def frictions(self) -> dict[str, float]:
        """The model's μ above 0, by pair."""
        pairs = zip(self.names, self.model_coefficients.tolist(), strict=True)
        return {name: friction for name, friction in pairs if friction > 0}

    def calc_coefficients(self, friction: float | None) -> Floats:
        """Returns μ of each pair, shape (m,): the given one, or the model's if None."""
        if friction is None:
            return self.model_coefficients
        return read_only(np.full(len(self.names), friction))

    def impose(self, root: Context, friction: float | None) -> None:
        """Gives shapes one coefficient for sticking and sliding, in this context only."""
        source = self._plant.get_source_id()
        impose_friction(self._scene_graph, source, root, self.shapes, friction)


@dataclass(frozen=True, eq=False, repr=False)
class SpaceCoordinates(Coordinates):
    """Positions of joints of any kind, with quaternions of unit length.

    Velocities v are as Drake's plant has them; differences of positions, errors of goals and
    weights are in the tangent space, of shape (nv,).

    Attributes:
        tree: of joints and bodies.
        angular: whether each velocity turns, shape (nv,).
    """

    tree: Tree = field(kw_only=True)
    angular: Bools = field(kw_only=True)

    @property
    def turns(self) -> Bools:
        """Whether each velocity is an angular one, shape (nv,)."""
        return self.angular

    def normalized(self, q: Floats) -> Floats:
        """Returns positions with quaternions of unit length, shape (…, nq)."""
        return self.add(q, np.zeros(self.num_velocities))

    def add(self, q: Floats, delta: Floats) -> Floats:
        """Returns q ⊕ δ, shape (…, nq): links turned by rotation vectors, and moved."""
        return self.tree.add(q, delta)

    def subtract(self, after: Floats, before: Floats) -> Floats:
        """Returns the shortest δ with before ⊕ δ = after, shape (…, nv), of positions (…, nq)."""
        return self.tree.subtract(after, before)

    def measure(self, after: Floats, before: Floats) -> Floats:
        """Returns the same difference for costs, smooth: turns in space by 2 sin(θ/2), not θ."""
        found = self.subtract(after, before)
        for first in self._turns_in_space:
            turn = found[..., first : first + 3]
            angle = np.linalg.norm(turn, axis=-1, keepdims=True)
            turn *= np.sinc(angle / (2 * np.pi))
        return found

    def take_nearest(self, q: Floats, about: Floats) -> Floats:
        """Returns positions as many turns on as bring them nearest to others, shape (…, nq).

        Of both quaternions of a turn that is the one on the other's side.
        """
        found = super().take_nearest(q, about)
        for i in np.flatnonzero(self.tree.kinds == QUATERNION):
            turn = slice(self.tree.positions[i], self.tree.positions[i] + 4)
            dots = np.sum(found[..., turn] * about[..., turn], axis=-1, keepdims=True)
            found[..., turn] *= np.where(dots < 0, -1.0, 1.0)
        return found

    def in_tangent(self, positions: Floats, turn: Floats) -> Floats:
        """Returns numbers of positions (…, nq) by velocities (…, nv); of turns in space `turn`.

        The latter has the shape (…, 1).
        """
        places = self._places
        return np.where(places >= 0, positions[..., places], turn)

    @cached_property
    def _places(self) -> Ints:
        """Which position has each velocity as its rate, −1 of turns in space, shape (nv,)."""
        return self.tree.places

    @cached_property
    def _turns_in_space(self) -> list[int]:
        """Where velocities of links that turn about three axes start."""
        kinds, dofs = self.tree.kinds, self.tree.dofs[:-1]
        return [int(self.tree.velocities[dofs[i]]) for i in np.flatnonzero(kinds >= QUATERNION)]

    @property
    def units_of_positions(self) -> tuple[str, ...]:
        """The unit of each position, nq of them; none, "", of the numbers of a quaternion."""
        found = ["rad" if turns else "m" for turns in self.is_hinge]
        for i in np.flatnonzero(self.tree.kinds >= QUATERNION):
            first = int(self.tree.positions[i])
            found[first : first + 4] = [""] * 4
        return tuple(found)

    def middle(self, one: Floats, other: Floats) -> Floats:
        """Returns positions halfway between two, (…, nq)."""
        return self.add(one, self.subtract(other, one) / 2)

    @property
    def origin(self) -> Floats:
        """Positions that are zero, or not turned, shape (nq,)."""
        return self.tree.unturned

    @cached_property
    def rates(self) -> Floats:
        """N(q) of q̇ = N(q) v, c_ij0 + Σ_k c_ijk q_k of velocity i, shape (nv, nq, 1 + nq).

        NaN of angles of roll, pitch and yaw.
        """
        tree, n = self.tree, self.num_positions
        found = np.zeros((self.num_velocities, n, 1 + n))
        for i, velocity in enumerate(np.eye(self.num_velocities)):
            at_zero = tree.calc_position_rate(np.zeros(n), velocity)
            columns = [tree.calc_position_rate(q, velocity) - at_zero for q in np.eye(n)]
            found[i] = np.column_stack([at_zero, *columns])
        for i in np.flatnonzero(tree.kinds == RPY).tolist():
            first, of_link = tree.positions[i], tree.velocities[tree.dofs[i] : tree.dofs[i + 1]]
            found[of_link, first : first + 3] = np.nan
        return found

    def calc_position_rate(self, q: Floats, v: Floats) -> Floats:
        """Returns q̇ = N(q) v, shape (…, nq)."""
        return self.tree.calc_position_rate(q, v)


def find_angles(tree: Tree) -> tuple[Bools, Bools]:
    """Returns which positions (nq,) and which velocities (nv,) turn."""
    q, v = np.ones(tree.num_positions, dtype=bool), np.ones(tree.num_velocities, dtype=bool)
    for i in np.flatnonzero(np.isin(tree.kinds, (PRISMATIC, TRANSLATION))):
        dofs = slice(tree.dofs[i], tree.dofs[i + 1])
        v[tree.velocities[dofs]] = False
        count, first = tree.dofs[i + 1] - tree.dofs[i], tree.positions[i]
        q[first : first + count] = False
    return read_only(q, bool), read_only(v, bool)
