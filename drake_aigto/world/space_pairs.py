"""Pairs of shapes in space as tables for compiled code, and their friction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.geometry import (
    Box,
    Capsule,
    Cylinder,
    GeometryId,
    HalfSpace,
    SceneGraph,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, Diagram

from drake_aigto.arrays import Floats, Ints, read_only
from drake_aigto.dynamics import Tree
from drake_aigto.geometry import BALL, BOX, CAPSULE, CYLINDER, HALF_SPACE, Shapes, can_meet
from drake_aigto.world.material import impose_friction, read_frictions

_KINDS: dict[type[Shape], int] = {
    Sphere: BALL,
    Capsule: CAPSULE,
    Box: BOX,
    Cylinder: CYLINDER,
    HalfSpace: HALF_SPACE,
}
EXPECTED = (
    "Sphere against Sphere, Box, Capsule or HalfSpace, Capsule against Capsule or HalfSpace, "
    "Box or Cylinder against HalfSpace"
)


class ShapePair(NamedTuple):
    """Two shapes that may touch; the kind of the first one is the lower number."""

    name: str  # such as "puck with pusher"
    shapes: tuple[GeometryId, GeometryId]


class SpaceShapes(NamedTuple):
    """Shapes of all pairs, and the pairs, as compiled code takes them."""

    shapes: Shapes
    pairs: Ints  # which of them may touch, shape (P, 2)


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
    sizes = [_read_size(inspector.GetShape(shape)) for shape in numbers]
    kinds = [_KINDS[type(inspector.GetShape(shape))] for shape in numbers]
    table = Shapes(
        bodies=np.array(links, dtype=np.int64),
        kinds=np.array(kinds, dtype=np.int64),
        rotations=np.array([R for R, _ in poses]).reshape(-1, 3, 3),
        places=np.array([p for _, p in poses]).reshape(-1, 3),
        sizes=np.array([size for size, _ in sizes]).reshape(-1, 3),
        bounds=np.array([bound for _, bound in sizes], dtype=float),
    )
    rows = [[numbers[shape] for shape in pair.shapes] for pair in pairs]
    return SpaceShapes(table, np.array(rows, dtype=np.int64).reshape(-1, 2))


def _read_size(shape: Any) -> tuple[list[float], float]:
    """Returns a shape's size as `Shapes` has it, and the radius of a sphere that holds it."""
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
        model_coefficients: the model's μ of each, shape (m,).
    """

    def __init__(
        self, plant: MultibodyPlant, scene_graph: SceneGraph, diagram: Diagram,
        pairs: Sequence[ShapePair],
    ) -> None:  # fmt: skip
        """Reads the coefficients, with Drake's defaults where a shape gives none."""
        self._plant, self._scene_graph = plant, scene_graph
        self._shapes = [shape for pair in pairs for shape in pair.shapes]
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
        impose_friction(self._scene_graph, source, root, self._shapes, friction)
