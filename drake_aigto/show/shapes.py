"""Shapes of a world as its model has them, with sticks for links and slabs for half spaces."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pydrake.geometry import (
    Box,
    Cylinder,
    GeometryId,
    GeometrySet,
    HalfSpace,
    Rgba,
    Role,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import BodyIndex, Frame, Joint, RigidBody

from drake_aigto.arrays import Floats
from drake_aigto.world import World

# Meshcat draws no half spaces; this much of one is drawn as a slab [m].
_SLAB = (2.0, 2.0, 0.05)
# Thickness of the sticks that stand for links without a shape, as a part of their length.
_STICK = 0.05
_SIGNS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


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


def read_actors(world: World) -> list[Actor]:
    """Returns the shapes to draw of each body: for illustration, or else for contact, and sticks.

    A stick from its joint to what it carries stands for each link without a shape to show.
    """
    inspector = world.scene_graph.model_inspector()
    everything = GeometrySet(inspector.GetAllGeometryIds())
    shown, touched = (
        [
            _read_actor(world, geometry)
            for geometry in sorted(
                inspector.GetGeometryIds(everything, role), key=GeometryId.get_value
            )
        ]
        for role in (Role.kIllustration, Role.kProximity)
    )
    bodies = {actor.body for actor in shown}
    others = (actor for actor in touched if actor.body not in bodies)
    return [*shown, *others, *_make_sticks(world)]


def _read_actor(world: World, geometry: GeometryId) -> Actor:
    inspector = world.scene_graph.model_inspector()
    shape, X_BS = inspector.GetShape(geometry), inspector.GetPoseInFrame(geometry)
    is_half_space = isinstance(shape, HalfSpace)
    if is_half_space:
        X_BS, shape = X_BS @ RigidTransform([0.0, 0.0, -_SLAB[2] / 2]), Box(*_SLAB)
        X_SO, sides = RigidTransform(), np.array(_SLAB)
    else:
        box = inspector.GetObbInGeometryFrame(geometry)
        X_SO, sides = box.pose(), 2 * np.array(box.half_width())
    body = world.plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
    name = _name_body(world, body)
    corners: Floats = X_SO.multiply(box_corners(sides / 2).T).T
    properties = inspector.GetIllustrationProperties(geometry)
    has_color = properties is not None and properties.HasProperty("phong", "diffuse")
    return Actor(
        name=f"{name}/{inspector.GetName(geometry).split('::')[-1]}",
        shape=shape,
        X_BS=X_BS,
        color=properties.GetProperty("phong", "diffuse") if has_color else None,
        body=name,
        index=body.index(),
        moves=not world.plant.IsAnchored(body),
        corners=corners,
        is_half_space=is_half_space,
    )


def _name_body(world: World, body: RigidBody) -> str:
    """Returns the name of a body with its model's, which is unique."""
    return f"{world.plant.GetModelInstanceName(body.model_instance())}/{body.name()}"


def box_corners(half_widths: npt.ArrayLike) -> Floats:
    """Returns the corners of a box in its own frame, shape (8, 3) [m]."""
    corners: Floats = _SIGNS * np.asarray(half_widths, dtype=float)
    return corners


def moving_joints(world: World) -> list[Joint]:
    """Returns the joints that move, in the order of their coordinates."""
    joints = (world.plant.get_joint(index) for index in world.plant.GetJointIndices())
    return sorted((j for j in joints if j.num_positions()), key=lambda j: j.position_start())


def moving_bodies(world: World) -> list[RigidBody]:
    """Returns the bodies that move."""
    bodies = map(world.plant.get_body, map(BodyIndex, range(world.plant.num_bodies())))
    return [body for body in bodies if not world.plant.IsAnchored(body)]


def outboard_joints(world: World, body: RigidBody) -> list[Joint]:
    """Returns the joints that a body carries."""
    joints = (world.plant.get_joint(index) for index in world.plant.GetJointIndices())
    return [joint for joint in joints if joint.parent_body().index() == body.index()]


def find_hinge(world: World, body: RigidBody) -> Floats:
    """Returns where in a body the joint that carries it is, shape (3,) [m]."""
    joints = (world.plant.get_joint(index) for index in world.plant.GetJointIndices())
    inboard = next(joint for joint in joints if joint.child_body().index() == body.index())
    return _origin_of(inboard.frame_on_child())


def _origin_of(frame: Frame) -> Floats:
    """Returns where a frame is fixed in its body, shape (3,) [m]."""
    place: Floats = frame.GetFixedPoseInBodyFrame().translation()
    return place


def _make_sticks(world: World) -> Iterator[Actor]:
    inspector = world.scene_graph.model_inspector()
    for body in moving_bodies(world):
        if world.plant.GetVisualGeometriesForBody(body):
            continue
        begin = find_hinge(world, body)
        joints = outboard_joints(world, body)
        ends = [_origin_of(joint.frame_on_parent()) for joint in joints]
        for geometry in world.plant.GetCollisionGeometriesForBody(body):
            if isinstance(inspector.GetShape(geometry), Sphere):
                ends.append(inspector.GetPoseInFrame(geometry).translation())
        for number, end in enumerate(ends):
            if np.any(end != begin):
                yield _make_stick(world, body, number, begin, end)


def _make_stick(world: World, body: RigidBody, number: int, begin: Floats, end: Floats) -> Actor:
    """Returns a stick from one place in a body to another."""
    length = float(np.linalg.norm(end - begin))
    radius = _STICK * length / 2
    name = _name_body(world, body)
    turned = RotationMatrix.MakeFromOneVector((end - begin) / length, 2)
    return Actor(
        name=f"{name}/stick_{number}",
        shape=Cylinder(radius, length),
        X_BS=RigidTransform(turned, (begin + end) / 2),
        color=None,
        body=name,
        index=body.index(),
        moves=True,
        corners=box_corners([radius, radius, length / 2]),
    )
