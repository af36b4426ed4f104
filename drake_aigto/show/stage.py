"""What a scene shows of a world: its shapes, and the track that they move along."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from pydrake.geometry import (
    Box,
    GeometryId,
    GeometrySet,
    HalfSpace,
    Rgba,
    Role,
    SceneGraphInspector,
    Shape,
)
from pydrake.math import RigidTransform, RotationMatrix

if TYPE_CHECKING:
    import numpy.typing as npt

    from drake_aigto.world import World

_GRAY = Rgba(0.6, 0.6, 0.6)
# Meshcat draws no half spaces; this much of one is drawn as a slab [m].
_SLAB = (2.0, 2.0, 0.05)
# Closer to the vertical than this a direction has no level side.
_UPRIGHT = 1e-3


@dataclass(frozen=True)
class Actor:
    """One shape of a world's scene graph.

    Attributes:
        name: unique; model, body and shape.
        geometry: its id.
        shape: what to draw for it.
        X_GS: the drawn shape's pose in the geometry's frame.
        color: its own.
        moves: whether it is on a body that moves.
        radius: half of its longest side [m].
    """

    name: str
    geometry: GeometryId
    shape: Shape
    X_GS: RigidTransform
    color: Rgba
    moves: bool
    radius: float


class Stage:
    """A world's shapes, and a frame T to watch their motion in.

    T's x axis is the direction in which they move most, with the sign of the positions, and its
    y axis is level. Its origin is below the first moving shape at q = 0, so that where one joint
    slides, x is its position.

    Attributes:
        actors: all shapes.
        X_WT: T's pose in the world.
        radius: of the first moving shape, half of its longest side [m].
        lowest: the first moving shape's least x in T over the motions [m].
        highest: its largest [m].
    """

    def __init__(self, world: World, positions: npt.NDArray[np.float64]) -> None:
        """Reads the shapes, and looks how they move through positions, shape (K, nq) [m]."""
        self._world = world
        self._root = world.create_context()
        self.actors = _read_actors(world)
        # There is one: a world has a shape that moves to its wall.
        self._lead = lead = next(actor for actor in self.actors if actor.moves)
        self.radius = lead.radius
        path = np.array([self.pose(lead, q).translation() for q in positions])
        zero, one = (
            self.pose(lead, np.full(world.num_positions, value)).translation()
            for value in (0.0, 1.0)
        )
        R_WT = _face(path - path.mean(axis=0), one - zero)
        self.X_WT = RigidTransform(R_WT, zero - self.radius * R_WT.matrix()[:, 2])
        places = [self.along(q) for q in positions]
        self.lowest, self.highest = min(places), max(places)

    def pose(self, actor: Actor, q: npt.NDArray[np.float64]) -> RigidTransform:
        """Returns the pose of an actor's drawn shape in the world, at q of shape (nq,) [m]."""
        plant, scene_graph = self._world.plant, self._world.scene_graph
        plant.SetPositions(plant.GetMyMutableContextFromRoot(self._root), q)
        query = scene_graph.get_query_output_port().Eval(
            scene_graph.GetMyContextFromRoot(self._root)
        )
        return query.GetPoseInWorld(actor.geometry).multiply(actor.X_GS)

    def along(self, q: npt.NDArray[np.float64]) -> float:
        """Returns where along T's x axis the first moving shape is at q, shape (nq,) [m]."""
        return float(self.X_WT.inverse().multiply(self.pose(self._lead, q).translation())[0])


def _read_actors(world: World) -> list[Actor]:
    """Returns the shapes to draw: those for illustration, or for contact if none of them moves."""
    inspector = world.scene_graph.model_inspector()
    everything = GeometrySet(inspector.GetAllGeometryIds())
    actors: list[Actor] = []
    for role in (Role.kIllustration, Role.kProximity):
        ids = sorted(inspector.GetGeometryIds(everything, role), key=GeometryId.get_value)
        actors = [_read_actor(world, inspector, geometry) for geometry in ids]
        if any(actor.moves for actor in actors):
            break
    return actors


def _read_actor(world: World, inspector: SceneGraphInspector, geometry: GeometryId) -> Actor:
    shape, X_GS = inspector.GetShape(geometry), RigidTransform()
    if isinstance(shape, HalfSpace):
        shape, X_GS = Box(*_SLAB), RigidTransform([0.0, 0.0, -_SLAB[2] / 2])
        radius = max(_SLAB) / 2
    else:
        radius = float(max(inspector.GetObbInGeometryFrame(geometry).half_width()))
    properties = inspector.GetIllustrationProperties(geometry)
    color = properties.GetPropertyOrDefault("phong", "diffuse", _GRAY) if properties else _GRAY
    body = world.plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
    moves = not world.plant.IsAnchored(body)
    model = world.plant.GetModelInstanceName(body.model_instance())
    name = f"{model}/{body.name()}/{inspector.GetName(geometry).split('::')[-1]}"
    return Actor(name, geometry, shape, X_GS, color, moves, radius)


def _face(path: npt.NDArray[np.float64], forwards: npt.NDArray[np.float64]) -> RotationMatrix:
    """Returns R_WT for a path about its mean, shape (K, 3), and the way that positions count."""
    x = np.linalg.svd(path, full_matrices=False)[2][0]
    x = -x if x @ forwards < 0 else x
    level = np.cross([0.0, 0.0, 1.0], x)
    if np.linalg.norm(level) < _UPRIGHT:
        level = np.cross([0.0, 1.0, 0.0], x)
    y = level / np.linalg.norm(level)
    return RotationMatrix(np.column_stack([x, y, np.cross(x, y)]))
