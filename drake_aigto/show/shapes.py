"""Shapes, joints and coordinates of a world as its model has them, with sticks for bare links."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from pydrake.geometry import (
    Box,
    Convex,
    Cylinder,
    GeometryId,
    GeometrySet,
    HalfSpace,
    Mesh,
    Rgba,
    Role,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Frame, Joint, PrismaticJoint, RigidBody
from pydrake.systems.framework import Context

from drake_aigto.arrays import Bools, Floats
from drake_aigto.world import Scenario, TaskCost, World, list_moving

# Meshcat draws no half spaces; this much of one is drawn as a slab [m].
_SLAB = (2.0, 2.0, 0.05)
# Thickness of the sticks that stand for links without a shape, as a part of their length.
_STICK = 0.05
_SIGNS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


@dataclass(frozen=True)
class Actor:
    """One shape of a world's scene graph."""

    name: str  # unique; model, body and shape
    shape: Shape  # what to draw for it
    X_BS: RigidTransform  # its pose in its body's frame
    color: Rgba | None  # its own; None: the model gives none
    body: str  # the name of its body, unique
    index: BodyIndex  # of its body
    moves: bool  # whether this body moves
    corners: Floats  # of a box around the drawn shape, in its frame, shape (8, 3) [m]
    is_half_space: bool = False  # whether the shape is a slab that stands for one

    def pose(self, plant: MultibodyPlant, context: Context) -> RigidTransform:
        """Returns the pose of the drawn shape in the world."""
        return plant.EvalBodyPoseInWorld(context, plant.get_body(self.index)) @ self.X_BS

    @cached_property
    def points(self) -> Floats:
        """Corners of the shape's convex hull, if it is a mesh, else `corners`, (k, 3) [m]."""
        if not isinstance(self.shape, Convex | Mesh):
            return self.corners
        hull = self.shape.GetConvexHull()
        return np.array([hull.vertex(i) for i in range(hull.num_vertices())])


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
    for body in list_moving(world.plant):
        if world.plant.GetVisualGeometriesForBody(body):
            continue
        begin = find_hinge(world, body)
        joints = outboard_joints(world, body)
        ends = [_origin_of(joint.frame_on_parent()) for joint in joints]
        for geometry in world.plant.GetCollisionGeometriesForBody(body):
            if isinstance(inspector.GetShape(geometry), Sphere):
                ends.append(inspector.GetPoseInFrame(geometry).translation())
        name = _name_body(world, body)
        for number, end in enumerate(ends):
            if not np.any(end != begin):
                continue
            length = float(np.linalg.norm(end - begin))
            radius = _STICK * length / 2
            turned = RotationMatrix.MakeFromOneVector((end - begin) / length, 2)
            yield Actor(
                name=f"{name}/stick_{number}",
                shape=Cylinder(radius, length),
                X_BS=RigidTransform(turned, (begin + end) / 2),
                color=None,
                body=name,
                index=body.index(),
                moves=True,
                corners=box_corners([radius, radius, length / 2]),
            )


def read_coordinates(world: World, scenario: Scenario, q: Floats) -> Floats:
    """Returns a number for each velocity, shape (…, nv), of positions q, shape (…, nq).

    These are q, but of bodies that turn in space the rotation vector from the goal [rad].
    """
    return world.in_tangent(q, world.subtract(q, scenario.goal_position))


def coordinate_names(world: World) -> list[str]:
    """Returns a name for each velocity: its axis where axes tell them apart, or its joint's."""
    plant, moving = world.plant, moving_joints(world)
    context = plant.CreateDefaultContext()
    axes = [
        joint.frame_on_parent().CalcPoseInWorld(context).rotation() @ joint.translation_axis()
        for joint in moving
        if isinstance(joint, PrismaticJoint)
    ]
    letters = ["xyz"[int(np.argmax(axis))] for axis in axes if np.max(axis) > 1 - 1e-9]
    if len(set(letters)) == len(moving):
        return letters
    look = {"add_model_instance_prefix": False, "always_add_suffix": False}
    turns = [name.replace("_w", "_turn_") for name in plant.GetVelocityNames(**look)]
    names = world.in_tangent(np.array(plant.GetPositionNames(**look)), np.array(turns))
    return [name.replace("_", " ") for name in names]


def moves_straight(world: World) -> bool:
    """Returns whether all that moves keeps to straight lines, as balls on sliders do."""
    return world.has_constant_inertia and not np.any(world.is_hinge)


def has_goal(world: World, scenario: Scenario) -> Bools:
    """Returns which coordinates a scenario wants at their goal, at the end or always, (nv,)."""
    cost = TaskCost.of(world, scenario)
    is_weighted = np.diag(cost.QT) > 0
    if scenario.reference_positions is None:
        is_weighted = is_weighted | (cost.Q > 0)
    return is_weighted | scenario.hard_goal


def find_goal(world: World, scenario: Scenario, end: Floats) -> Floats:
    """Returns the goal of a motion that ends at q, shape (nq,).

    Of an angle whose turns do not count, it is the one nearest to q; without a weight, q itself.
    """
    way = -TaskCost.of(world, scenario).goal_errors(end)
    return world.add(end, np.where(has_goal(world, scenario), way, 0.0))


def solid_regions(world: World, coordinates: tuple[int, int], window: Floats) -> list[Floats]:
    """Returns where solids are in the plane of two coordinates, as polygons.

    There the sphere would be inside: φ(q) < 0 for all faces of the solid, φ being affine. Solids
    that other coordinates matter to have no place in this plane, and are left out, as are all of a
    mechanism, whose φ is not affine. What is looked at is a window, opposite corners of shape
    (2, 2) [m].

    Returns:
        for each solid that is there, its corners in order, shape (k, 2) [m].
    """
    if not world.has_constant_inertia:
        return []
    distances, slopes = world.constant_inertia.offset, world.constant_inertia.jacobian
    others = np.setdiff1d(np.arange(world.num_positions), coordinates)
    regions = []
    for faces in world.solids:
        if np.any(slopes[list(faces)][:, others]):
            continue
        (x0, y0), (x1, y1) = window
        corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        for face in faces:
            corners = cut_polygon(corners, distances[face], slopes[face, list(coordinates)])
        if len(corners):
            regions.append(corners)
    return regions


def wall_places(world: World, coordinate: int) -> list[tuple[int, float, float]]:
    """Returns the walls across one coordinate: contact, place [m], and the side it faces, ±1.

    Of solids with one face only: those with several end somewhere along other coordinates. Links
    that turn meet walls at no one place of a coordinate.
    """
    if not world.has_constant_inertia:
        return []
    distances, slopes = world.constant_inertia.offset, world.constant_inertia.jacobian
    alone = [faces[0] for faces in world.solids if len(faces) == 1]
    return [
        (i, -distances[i] / slopes[i, coordinate], float(np.sign(slopes[i, coordinate])))
        for i in alone
        if slopes[i, coordinate] and np.count_nonzero(slopes[i]) == 1
    ]


def cut_polygon(corners: Floats, distance: float, slope: Floats) -> Floats:
    """Returns the part of a convex polygon where distance + slope · corner ≤ 0."""
    kept: list[Floats] = []
    heights = distance + corners @ slope
    for i, (corner, height) in enumerate(zip(corners, heights, strict=True)):
        if height <= 0:
            kept.append(corner)
        after, later = corners[(i + 1) % len(corners)], heights[(i + 1) % len(corners)]
        if height * later < 0:
            kept.append(corner + height / (height - later) * (after - corner))
    return np.array(kept).reshape(-1, 2)
