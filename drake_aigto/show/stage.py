"""What a scene shows of a world: its shapes, and the frame that their motion is watched in."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
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
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import Context

from drake_aigto.arrays import Floats
from drake_aigto.show.coordinates import wall_places
from drake_aigto.world import World

GRAY = Rgba(0.6, 0.6, 0.6)  # of what has no color of its own
# Meshcat draws no half spaces; this much of one is drawn as a slab [m].
_SLAB = (2.0, 2.0, 0.05)
# Closer than this to the vertical, or to a line, counts as that.
_UPRIGHT = 1e-3
_SIGNS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
_UP, _FORWARDS, _SIDE = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0, 0])


@dataclass(frozen=True)
class Actor:
    """One shape of a world's scene graph.

    Attributes:
        name: unique; model, body and shape.
        shape: what to draw for it.
        X_BS: its pose in its body's frame.
        color: its own; None: the model gives none.
        body: the name of its body, unique.
        index: of its body.
        moves: whether this body moves.
        corners: of a box around the drawn shape, in its frame, shape (8, 3) [m].
        is_half_space: whether the shape is a slab that stands for one.
    """

    name: str
    shape: Shape
    X_BS: RigidTransform
    color: Rgba | None
    body: str
    index: BodyIndex
    moves: bool
    corners: Floats
    is_half_space: bool = False

    @property
    def radius(self) -> float:
        """Half of its longest side [m]."""
        return float(np.max(np.ptp(self.corners, axis=0))) / 2


class Scenery:
    """A world's shapes, where its joints bring them, and a frame T to watch their motion in.

    Attributes:
        actors: all shapes.
        X_WT: T's pose in the world.
    """

    X_WT: RigidTransform

    def __init__(self, world: World) -> None:
        """Reads the shapes."""
        self._world = world
        self._root = world.create_context()
        self.actors = _read_actors(world)

    def pose(self, actor: Actor, q: Floats) -> RigidTransform:
        """Returns the pose of an actor's drawn shape in the world, at q of shape (nq,)."""
        body = self._world.plant.get_body(actor.index)
        return self._world.plant.EvalBodyPoseInWorld(self._set(q), body) @ actor.X_BS

    def _set(self, q: Floats) -> Context:
        """Returns the plant's context at q."""
        plant = self._world.plant
        context = plant.GetMyMutableContextFromRoot(self._root)
        plant.SetPositions(context, q)
        return context

    def places(self, actor: Actor, positions: Floats) -> Floats:
        """Returns where in T an actor's middle is, shape (K, 3), at positions of shape (K, nq)."""
        X_TW = self.X_WT.inverse()
        return np.array([X_TW.multiply(self.pose(actor, q).translation()) for q in positions])

    def extent(self, actors: Iterable[Actor], positions: Floats) -> Floats:
        """Returns opposite corners in T of shapes over positions, shape (2, 3) [m]."""
        found = []
        for actor in actors:
            for q in positions if actor.moves else positions[:1]:
                X_TS = self.X_WT.inverse().multiply(self.pose(actor, q))
                found.append(X_TS.multiply(actor.corners.T).T)
        corners = np.vstack(found)
        return np.array([corners.min(axis=0), corners.max(axis=0)])


class Stage(Scenery):
    """The shapes of a world in which nothing turns, and a frame T to watch their motion in.

    Where all that moves keeps to one level line, T's x axis is its direction, with the sign of the
    positions, and y is level. Otherwise x and y are to the right and up in the plane of motion, as
    seen from above or from the front. The origin is below, or behind, the first moving shape at
    q = 0, so that where one joint slides, x, or up y, is its position.

    Attributes:
        movers: the first moving shape of each body that moves.
        directions: by how much each mover moves in the world with each coordinate, shape
            (movers, nq, 3) [m/m].
        is_line: whether the motion is along a level line.
        radius: of the first moving shape, half of its longest side [m].
        lowest: the least x of a moving shape's middle in T over the motions [m].
        highest: the largest [m].
    """

    def __init__(self, world: World, positions: Floats) -> None:
        """Reads the shapes, and looks how they move through positions, shape (K, nq) [m]."""
        super().__init__(world)
        # There is one: a world has a shape that moves to its wall.
        self.movers = list({a.body: a for a in reversed(self.actors) if a.moves}.values())[::-1]
        lead = self.movers[0]
        self.radius = lead.radius
        origin = self.pose(lead, np.zeros(world.num_positions)).translation()
        self.directions = np.array([self._ways(mover) for mover in self.movers])
        self.is_line, R_WT = face_motion(self.directions.reshape(-1, 3))
        self.X_WT = RigidTransform(R_WT, origin - self.radius * R_WT.matrix()[:, 2])
        along = [self.places(mover, positions)[:, 0] for mover in self.movers]
        self.lowest, self.highest = float(np.min(along)), float(np.max(along))

    def _ways(self, mover: Actor) -> list[Floats]:
        """Returns by how much a shape moves in the world with each coordinate."""
        origin, *moved = (
            self.pose(mover, q).translation()
            for q in (np.zeros(self._world.num_positions), *np.eye(self._world.num_positions))
        )
        return [place - origin for place in moved]

    def rotation(self, actor: Actor) -> RotationMatrix:
        """Returns R_WS of an actor's drawn shape: nothing turns as it moves."""
        return self.pose(actor, np.zeros(self._world.num_positions)).rotation()

    def walls(self) -> list[tuple[float, float]]:
        """Returns where in T's x walls stop the middles of shapes, and the side that each faces."""
        found = []
        eye = np.eye(self._world.num_positions)
        for i, direction in enumerate(eye):
            for _, place, side in wall_places(self._world, i):
                for mover in self.movers:
                    zero, one, there = self.places(mover, np.outer([0, 1, place], direction))[:, 0]
                    if one != zero:
                        found.append((float(there), side * float(np.sign(one - zero))))
        return found


def _read_actors(world: World) -> list[Actor]:
    """Returns the shapes to draw of each body: those for illustration, or else for contact."""
    inspector = world.scene_graph.model_inspector()
    everything = GeometrySet(inspector.GetAllGeometryIds())
    shown, touched = (
        [
            _read_actor(world, inspector, geometry)
            for geometry in sorted(
                inspector.GetGeometryIds(everything, role), key=GeometryId.get_value
            )
        ]
        for role in (Role.kIllustration, Role.kProximity)
    )
    bodies = {actor.body for actor in shown}
    return [*shown, *(actor for actor in touched if actor.body not in bodies)]


def _read_actor(world: World, inspector: SceneGraphInspector, geometry: GeometryId) -> Actor:
    shape, X_BS = inspector.GetShape(geometry), inspector.GetPoseInFrame(geometry)
    is_half_space = isinstance(shape, HalfSpace)
    if is_half_space:
        X_BS, shape = X_BS @ RigidTransform([0.0, 0.0, -_SLAB[2] / 2]), Box(*_SLAB)
        X_SO, half_widths = RigidTransform(), np.array(_SLAB) / 2
    else:
        box = inspector.GetObbInGeometryFrame(geometry)
        X_SO, half_widths = box.pose(), box.half_width()
    body = world.plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
    name = name_body(world, body)
    shape_name = inspector.GetName(geometry).split("::")[-1]
    return Actor(
        name=f"{name}/{shape_name}",
        shape=shape,
        X_BS=X_BS,
        color=_read_color(inspector, geometry),
        body=name,
        index=body.index(),
        moves=not world.plant.IsAnchored(body),
        corners=box_corners(half_widths, X_SO),
        is_half_space=is_half_space,
    )


def name_body(world: World, body: RigidBody) -> str:
    """Returns the name of a body with its model's, which is unique."""
    return f"{world.plant.GetModelInstanceName(body.model_instance())}/{body.name()}"


def box_corners(half_widths: npt.ArrayLike, X_SO: RigidTransform | None = None) -> Floats:
    """Returns the corners of a box O in a frame S, shape (8, 3) [m]."""
    corners: Floats = (X_SO or RigidTransform()).multiply((_SIGNS * half_widths).T).T
    return corners


def _read_color(inspector: SceneGraphInspector, geometry: GeometryId) -> Rgba | None:
    properties = inspector.GetIllustrationProperties(geometry)
    if properties is None or not properties.HasProperty("phong", "diffuse"):
        return None
    color: Rgba = properties.GetProperty("phong", "diffuse")
    return color


def _unit(vector: Floats) -> Floats:
    unit: Floats = vector / np.linalg.norm(vector)
    return unit


def face_motion(ways: Floats) -> tuple[bool, RotationMatrix]:
    """Returns whether shapes that move in these ways (k, 3) keep to a level line, and R_WT."""
    _, sizes, directions = np.linalg.svd(ways)
    first = directions[0] if directions[0] @ ways.sum(axis=0) >= 0 else -directions[0]
    upright = bool(np.hypot(*first[:2]) < _UPRIGHT)
    if sizes[1:].max(initial=0.0) < _UPRIGHT * sizes[0] and not upright:
        y = _unit(np.cross(_UP, first))
        return True, RotationMatrix(np.column_stack([first, y, np.cross(first, y)]))
    # Towards who looks on: the plane's normal, up if it can be, or against the world's y axis.
    normal = directions[2] if sizes[1:].max(initial=0.0) >= _UPRIGHT * sizes[0] else -_FORWARDS
    level = abs(normal @ _UP) > 1 - _UPRIGHT
    normal = normal if normal @ (_UP if level else -_FORWARDS - 1e-6 * _SIDE) >= 0 else -normal
    y = _FORWARDS if level else _UP
    y = _unit(y - (y @ normal) * normal)
    return False, RotationMatrix(np.column_stack([np.cross(y, normal), y, normal]))
