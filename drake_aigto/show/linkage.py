"""What a scene shows of a mechanism: links that turn and slide, and the frame to watch them in."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from pydrake.geometry import Box, Cylinder, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import BodyIndex, Frame, JacobianWrtVariable, Joint, RigidBody

from drake_aigto.arrays import Bools, Floats
from drake_aigto.show.stage import Actor, Scenery, box_corners, face_motion, name_body
from drake_aigto.world import World

# Of a link without a shape to show: how thick the sticks are that stand for it, in their lengths.
_STICK = 0.05
# A direction in which points move by less than this part of the largest way is none of motion.
_FLAT = 1e-6
# As parts of the mechanism's size: how far off walls are looked at, what is seen around all, and
# the thickness of half spaces.
_REACH, _EDGE, _SLAB = 1.0, 0.04, 0.03
_FROM_FRONT = RotationMatrix.MakeXRotation(np.pi / 2)  # x to the right, z up
_MOST_ROWS = 40  # of a motion, at which its directions are looked at


class Linkage(Scenery):
    """The shapes of a mechanism, and a frame T to watch their motion in.

    T's x is to the right and y up in the plane of motion, as seen from above or from the front; of
    a motion that keeps to no plane, as seen from the front. Links without a shape to show
    are drawn as sticks from joint to joint, and half spaces as slabs as wide as the motion.

    Attributes:
        is_flat: whether the motion keeps to a plane.
        low: lower left corner of all that is to be seen, in T's x and y, shape (2,) [m].
        high: the opposite corner [m].
        depth: how far links reach towards who looks on, from T's origin, which is as far back as
            anything moves [m].
        tracers: points whose way tells the motion, each of them its body and its place there, shape
            (3,) [m]: the spheres that touch, or else the ends of links that carry no other link.
    """

    low: Floats
    high: Floats
    depth: float

    def __init__(self, world: World, positions: Floats) -> None:
        """Reads the shapes, and looks how they move through positions, shape (K, nq)."""
        super().__init__(world)
        self.actors = [*self.actors, *_make_sticks(world)]
        rows = positions[:: max(1, len(positions) // _MOST_ROWS)]
        ways = np.vstack([self._ways(q) for q in rows])
        sizes = np.linalg.svd(ways, compute_uv=False)
        self.is_flat = bool(sizes[2] < _FLAT * sizes[0])
        R_WT = face_motion(ways)[1] if self.is_flat else _FROM_FRONT
        self.X_WT = RigidTransform(R_WT, np.zeros(3))
        self._set_window(positions)
        self.tracers = list(self._find_tracers())

    @property
    def num_positions(self) -> int:
        """The number of coordinates, nq."""
        return self._world.num_positions

    @property
    def size(self) -> float:
        """The longer side of what is to be seen [m]."""
        return float(np.max(self.high - self.low))

    @property
    def radius(self) -> float:
        """Of the largest sphere that touches something, or what takes its place [m]."""
        inspector = self._world.scene_graph.model_inspector()
        spheres = (inspector.GetShape(pair[0]) for pair in self._world.shapes)
        return max((sphere.radius() for sphere in spheres), default=0.02 * self.size)

    def _ways(self, q: Floats) -> Floats:
        """Returns by how much corners of moving shapes move with each coordinate, (k, 3) [m]."""
        plant, context = self._world.plant, self._set(q)
        found = []
        for actor in filter(lambda actor: actor.moves, self.actors):
            J = plant.CalcJacobianTranslationalVelocity(
                context,
                JacobianWrtVariable.kV,
                plant.get_body(actor.index).body_frame(),
                actor.X_BS.multiply(actor.corners.T),
                plant.world_frame(),
                plant.world_frame(),
            )
            found.append(J.T.reshape(-1, 3))
        return np.vstack(found)

    def _set_window(self, positions: Floats) -> None:
        """Finds what is to be seen: all that moves, and walls where they are near."""
        moving = [actor for actor in self.actors if actor.moves]
        low, high = self.extent(moving, positions)
        reach = _REACH * float(np.max(high - low))
        self.actors = [self._fit(actor, positions[0], low, high) for actor in self.actors]
        still = [actor for actor in self.actors if not actor.moves]
        corners = self.extent(still, positions[:1]) if still else np.array([low, high])
        near = np.clip(corners, low - reach, high + reach)
        self.depth = float(high[2] - low[2])
        self.X_WT = self.X_WT @ RigidTransform([0.0, 0.0, low[2]])
        first, last = np.minimum(low, near[0]), np.maximum(high, near[1])
        edge = _EDGE * np.max((last - first)[:2])
        self.low, self.high = first[:2] - edge, last[:2] + edge

    def _fit(self, actor: Actor, q: Floats, low: Floats, high: Floats) -> Actor:
        """Returns a half space as a slab as wide as the motion, and other actors as they are."""
        if actor.moves or not actor.is_half_space:
            return actor
        X_ST = self.pose(actor, q).inverse() @ self.X_WT
        middle, half = (low + high) / 2, (high - low) / 2
        corners = X_ST.multiply((middle + box_corners(half)).T).T
        first, last = corners.min(axis=0), corners.max(axis=0)
        thick = _SLAB * float(np.max(high - low))
        sides = np.array([*(last - first)[:2] + 2 * thick, thick])
        # The face of the slab that was drawn so far is that of the half space.
        face = float(np.max(actor.corners[:, 2]))
        place = np.array([*(first + last)[:2] / 2, face - thick / 2])
        shape, X_BS = Box(*sides), actor.X_BS @ RigidTransform(place)
        return replace(actor, shape=shape, X_BS=X_BS, corners=box_corners(sides / 2))

    def _find_tracers(self) -> Iterator[tuple[BodyIndex, Floats]]:
        """Yields the points whose way tells the motion."""
        inspector, plant = self._world.scene_graph.model_inspector(), self._world.plant
        shapes = dict.fromkeys(shape for pair in self._world.shapes for shape in pair)
        for shape in shapes:
            body = plant.GetBodyFromFrameId(inspector.GetFrameId(shape))
            if isinstance(inspector.GetShape(shape), Sphere) and not plant.IsAnchored(body):
                yield body.index(), inspector.GetPoseInFrame(shape).translation()
        if shapes:
            return
        for body in _moving_bodies(self._world):
            if not _outboard(self._world, body):
                yield body.index(), self._find_tip(body)

    def _find_tip(self, body: RigidBody) -> Floats:
        """Returns the end of a link that is the farthest from its joint, shape (3,) [m]."""
        origin = _origin_of(_inboard(self._world, body).frame_on_child())
        ends = []
        for actor in self.actors:
            if actor.index == body.index():
                # The middles of a box's faces, from its corners.
                middle, half = actor.corners.mean(axis=0), np.ptp(actor.corners, axis=0) / 2
                faces = middle + np.vstack([np.diag(half), np.diag(-half)])
                ends.append(actor.X_BS.multiply(faces.T).T)
        places = np.vstack([*ends, origin])
        tip: Floats = places[np.argmax(np.linalg.norm(places - origin, axis=1))]
        return tip

    def trace(self, positions: Floats) -> Floats:
        """Returns where in T the tracers are, shape (K, tracers, 3), at positions (K, nq)."""
        return np.array([[self._locate(*each, q) for each in self.tracers] for q in positions])

    def _locate(self, body: BodyIndex, place: Floats, q: Floats) -> Floats:
        plant = self._world.plant
        X_WB = plant.EvalBodyPoseInWorld(self._set(q), plant.get_body(body))
        located: Floats = self.X_WT.inverse().multiply(X_WB.multiply(place))
        return located

    def is_in_the_way(self, actor: Actor) -> bool:
        """Returns whether a shape that stands still is in the plane of motion, not behind it."""
        _, high = self.extent([actor], np.zeros((1, self.num_positions)))
        return bool(high[2] > _FLAT * self.size)

    def movers_of(self, body: BodyIndex) -> Bools:
        """Returns which coordinates move a body, shape (nq,)."""
        plant = self._world.plant
        found = np.zeros(self._world.num_positions, dtype=bool)
        for joint in moving_joints(self._world):
            bodies = plant.GetBodiesKinematicallyAffectedBy([joint.index()])
            if body in bodies:
                start = joint.position_start()
                found[start : start + joint.num_positions()] = True
        return found

    def touch(self, contact: int, q: Floats) -> tuple[Floats, Floats]:
        """Returns where a contact's shapes are nearest, and its normal, in the world, (3,) each.

        The place is on what the sphere touches [m]; the normal points from there to the sphere.
        """
        self._set(q)
        sphere, wall = self._world.shapes[contact]
        scene_graph = self._world.scene_graph
        query = scene_graph.get_query_output_port().Eval(
            scene_graph.GetMyContextFromRoot(self._root)
        )
        pair = query.ComputeSignedDistancePairClosestPoints(sphere, wall)
        is_first = pair.id_A == sphere
        place = query.GetPoseInWorld(wall).multiply(pair.p_BCb if is_first else pair.p_ACa)
        return place, pair.nhat_BA_W * (1.0 if is_first else -1.0)

    def find_tangent(self, contact: int, q: Floats) -> Floats:
        """Returns the direction in the world in which a contact's s = T v counts, shape (3,).

        That of what the sphere's material moves by where it touches, as the wall sees it, when v is
        along T; zero where nothing can slide.
        """
        place, normal = self.touch(contact, q)
        T = self._world.rubbing.calc_tangent_jacobian(q)[contact]
        plant, context = self._world.plant, self._set(q)
        inspector = self._world.scene_graph.model_inspector()
        sphere, wall = (
            plant.GetBodyFromFrameId(inspector.GetFrameId(shape)).body_frame()
            for shape in self._world.shapes[contact]
        )
        J = plant.CalcJacobianTranslationalVelocity(
            context,
            JacobianWrtVariable.kV,
            sphere,
            sphere.CalcPoseInWorld(context).inverse().multiply(place),
            wall,
            plant.world_frame(),
        )
        along = J @ T
        along -= normal * (normal @ along)
        size = float(np.linalg.norm(along))
        return along / size if size > 0 else along

    def load(self, joint: Joint, q: Floats, forces: Floats) -> tuple[Floats, Floats, Floats]:
        """Returns where a joint is, and by what force and torque its generalized forces (nv,) act.

        All are in the world, shape (3,) each [m], [N], [N m].
        """
        plant, context = self._world.plant, self._set(q)
        frame = joint.frame_on_child()
        J = plant.CalcJacobianSpatialVelocity(
            context,
            JacobianWrtVariable.kV,
            frame,
            np.zeros(3),
            joint.frame_on_parent(),
            plant.world_frame(),
        )
        moment, push = (J @ forces).reshape(2, 3)
        return frame.CalcPoseInWorld(context).translation(), push, moment


def moving_joints(world: World) -> list[Joint]:
    """Returns the joints that move, in the order of their coordinates."""
    joints = (world.plant.get_joint(index) for index in world.plant.GetJointIndices())
    return sorted((j for j in joints if j.num_positions()), key=lambda j: j.position_start())


def _moving_bodies(world: World) -> list[RigidBody]:
    bodies = map(world.plant.get_body, map(BodyIndex, range(world.plant.num_bodies())))
    return [body for body in bodies if not world.plant.IsAnchored(body)]


def _inboard(world: World, body: RigidBody) -> Joint:
    """Returns the joint that carries a body."""
    joints = (world.plant.get_joint(index) for index in world.plant.GetJointIndices())
    return next(joint for joint in joints if joint.child_body().index() == body.index())


def _outboard(world: World, body: RigidBody) -> list[Joint]:
    """Returns the joints that a body carries."""
    joints = (world.plant.get_joint(index) for index in world.plant.GetJointIndices())
    return [joint for joint in joints if joint.parent_body().index() == body.index()]


def _origin_of(frame: Frame) -> Floats:
    """Returns where a frame is fixed in its body, shape (3,) [m]."""
    place: Floats = frame.GetFixedPoseInBodyFrame().translation()
    return place


def _make_sticks(world: World) -> Iterator[Actor]:
    """Yields sticks from its joint to what it carries, for each link without a shape to show."""
    for body in _moving_bodies(world):
        if world.plant.GetVisualGeometriesForBody(body):
            continue
        begin = _origin_of(_inboard(world, body).frame_on_child())
        ends = [_origin_of(joint.frame_on_parent()) for joint in _outboard(world, body)]
        for number, end in enumerate([*ends, *_spheres_of(world, body)]):
            length = float(np.linalg.norm(end - begin))
            if length > 0:
                yield _make_stick(world, body, number, begin, end)


def _spheres_of(world: World, body: RigidBody) -> Iterator[Floats]:
    """Yields where in a body its spheres are, shape (3,) [m]."""
    inspector = world.scene_graph.model_inspector()
    for geometry in world.plant.GetCollisionGeometriesForBody(body):
        if isinstance(inspector.GetShape(geometry), Sphere):
            yield inspector.GetPoseInFrame(geometry).translation()


def _make_stick(world: World, body: RigidBody, number: int, begin: Floats, end: Floats) -> Actor:
    """Returns a stick from one place in a body to another."""
    length = float(np.linalg.norm(end - begin))
    radius = _STICK * length / 2
    name = name_body(world, body)
    return Actor(
        name=f"{name}/stick_{number}",
        shape=Cylinder(radius, length),
        X_BS=RigidTransform(
            RotationMatrix.MakeFromOneVector((end - begin) / length, 2), (begin + end) / 2
        ),
        color=None,
        body=name,
        index=body.index(),
        moves=True,
        corners=box_corners([radius, radius, length / 2]),
    )
