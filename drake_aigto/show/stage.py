"""A world's shapes at any q, and the frame and the window in which their motion is watched."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from pydrake.geometry import Box, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import BodyIndex, JacobianWrtVariable, Joint, PrismaticJoint, RigidBody
from pydrake.systems.framework import Context

from drake_aigto.arrays import Bools, Floats
from drake_aigto.show.motion import Motion, color_of, find_row
from drake_aigto.show.shapes import (
    Actor,
    box_corners,
    find_hinge,
    moves_straight,
    moving_joints,
    outboard_joints,
    read_actors,
)
from drake_aigto.transcription import Touch
from drake_aigto.world import SpaceWorld, World, list_moving

# A direction in which points move by less than this part of the largest way is none of motion:
# of motions in a plane, and along a line. Beyond this cosine with the vertical it is upright.
_FLAT, _STRAIGHT, _LEVEL = 1e-6, 1e-3, 1 - 1e-3
# As parts of the motion's size: how far off walls are looked at, what is seen around all, and the
# thickness of half spaces.
_REACH, _EDGE, _SLAB = 0.15, 0.04, 0.03
# Of motions in space: how far from above they are seen [rad]; ways along a line are this much
# longer than across it.
_ABOVE, _ALONG = np.deg2rad(25.0), 1.5
# Seen above and below what moves along a level line, in its height; and below, in its depth.
_LANE, _LEAN = 0.25, 0.25
_SMALL = 0.02  # the radius of what touches where no sphere does, in sizes of the window
_MOST_ROWS = 40  # of a motion, at which its directions are looked at
_UP, _FORWARDS, _SIDE = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0, 0])


class Stage:
    """The shapes of a world, and a frame T to watch their motion in.

    T's x is to the right and y up in the plane of motion, as seen from above or from the front; of
    a motion that keeps to no plane, as seen across its way from a little above. Places in T's x and
    y are those of the world. Half spaces are slabs as wide as the motion, and boxes that stand
    still end where they are out of sight.

    Attributes:
        actors: all shapes.
        X_WT: T's pose in the world.
        is_flat: whether the motion keeps to a plane.
        is_line: whether it keeps to a level line.
        low: lower left corner of all that is to be seen, in T's x and y, shape (2,) [m].
        high: the opposite corner [m].
        depth: how far what moves reaches towards the viewer, from T's origin, which is as far back
            as anything moves [m].
        height: of what moves, in T's y [m].
        tracers: points whose way tells the motion, each of them its body and its place there, shape
            (3,) [m]: the middles of spheres that touch, or else the ends of links that carry no
            other link.
    """

    def __init__(self, world: World, positions: Floats) -> None:
        """Reads the shapes, and looks how they move through positions, shape (K, nq)."""
        self._world = world
        self._root = world.create_context()
        self.actors = read_actors(world)
        rows = positions[:: max(1, len(positions) // _MOST_ROWS)]
        ways = np.vstack([self._ways(q) for q in rows])
        _, sizes, directions = np.linalg.svd(ways, full_matrices=False)
        self.is_flat = bool(sizes[2] < _FLAT * sizes[0])
        is_straight, is_upright = sizes[1] < _STRAIGHT * sizes[0], abs(directions[0] @ _UP) > _LEVEL
        self.is_line = self.is_flat and bool(is_straight and not is_upright)
        normal = directions[2]
        if is_straight:
            normal = -_FORWARDS if is_upright else np.cross(directions[0], _UP)
        R_WT = _face(normal) if self.is_flat else self._find_view(rows)
        self.X_WT = RigidTransform(R_WT, np.zeros(3))
        self._set_window(positions)
        self.tracers = list(self._find_tracers())

    @property
    def size(self) -> float:
        """The longer side of what is to be seen [m]."""
        return float(np.max(self.high - self.low))

    @property
    def radius(self) -> float:
        """Of the largest sphere that touches something, or what takes its place [m]."""
        inspector = self._world.scene_graph.model_inspector()
        boxes = (inspector.GetObbInGeometryFrame(pair[0]) for pair in self._world.shapes)
        sizes = (float(np.min(box.half_width())) for box in boxes)
        return max(sizes, default=_SMALL * self.size)

    def color(self, actor: Actor, index: int) -> Rgba:
        """Returns a link's own color in the first motion, else, and of balls, the motion's."""
        own = None if index or moves_straight(self._world) else actor.color
        return own or Rgba(*to_rgb(color_of(index)))

    def pose(self, actor: Actor, q: Floats) -> RigidTransform:
        """Returns the pose of an actor's drawn shape in the world, at q of shape (nq,)."""
        return actor.pose(self._world.plant, self._set(q))

    def _set(self, q: Floats) -> Context:
        """Returns the plant's context at q."""
        plant = self._world.plant
        context = plant.GetMyMutableContextFromRoot(self._root)
        plant.SetPositions(context, q)
        return context

    def extent(self, actors: Iterable[Actor], positions: Floats) -> Floats:
        """Returns opposite corners in T of shapes over positions, shape (2, 3) [m]."""
        found = []
        for actor in actors:
            for q in positions if actor.moves else positions[:1]:
                X_TS = self.X_WT.inverse().multiply(self.pose(actor, q))
                found.append(X_TS.multiply(actor.corners.T).T)
        corners = np.vstack(found)
        return np.array([corners.min(axis=0), corners.max(axis=0)])

    def _find_view(self, rows: Floats) -> RotationMatrix:
        """Returns R_WT of a motion in space, seen across the longest of its level ways."""
        moving = [actor for actor in self.actors if actor.moves]
        places = np.array([[self.pose(a, q).translation()[:2] for a in moving] for q in rows])
        ways = (places - places.mean(axis=0)).reshape(-1, 2)
        _, sizes, (along, _) = np.linalg.svd(ways, full_matrices=False)
        if sizes[0] < _ALONG * sizes[1]:
            along = np.array([1.0, 0.0])
        along = along if along[0] + 1e-6 * along[1] >= 0 else -along
        back = np.array([along[1] * np.cos(_ABOVE), -along[0] * np.cos(_ABOVE), np.sin(_ABOVE)])
        x = np.append(along, 0.0)
        return RotationMatrix(np.column_stack([x, np.cross(back, x), back]))

    def _ways(self, q: Floats) -> Floats:
        """Returns by how much corners of moving shapes move with each coordinate, (k, 3) [m]."""
        plant, context = self._world.plant, self._set(q)
        found = []
        for actor in (actor for actor in self.actors if actor.moves):
            frame = plant.get_body(actor.index).body_frame()
            corners = actor.X_BS.multiply(actor.corners.T)
            J = self._calc_jacobian(context, frame, corners, plant.world_frame())
            found.append(J.T.reshape(-1, 3))
        return np.vstack(found)

    def _calc_jacobian(self, context: Context, frame: Any, places: Floats, base: Any) -> Floats:
        """Returns how places (3, k) in a frame move with v, as another frame sees it, (3 k, nv)."""
        plant, wrt = self._world.plant, JacobianWrtVariable.kV
        jacobian: Floats = plant.CalcJacobianTranslationalVelocity(
            context, wrt, frame, places, base, plant.world_frame()
        )
        return jacobian

    def _set_window(self, positions: Floats) -> None:
        """Finds what is to be seen: all that moves, and walls where they are near."""
        low, high = self.extent((actor for actor in self.actors if actor.moves), positions)
        self.height, self.depth = float(high[1] - low[1]), float(high[2] - low[2])
        reach = np.full(3, _REACH * float(np.max(high - low)))
        if self.is_line:
            reach[1:] = _LANE * self.height
        self.actors = [self._fit(actor, positions[0], low, high, reach) for actor in self.actors]
        still = [actor for actor in self.actors if not actor.moves]
        corners = self.extent(still, positions[:1]) if still else np.array([low, high])
        near = np.clip(corners, low - reach, high + reach)
        self.X_WT = self.X_WT @ RigidTransform([0.0, 0.0, low[2]])
        first, last = np.minimum(low, near[0])[:2], np.maximum(high, near[1])[:2]
        edge = np.full(2, _EDGE * np.max(last - first))
        if self.is_line:
            # Seen a little from above, what is in front covers what is below it.
            first[1], last[1], edge[1] = (low - reach)[1] - _LEAN * self.depth, (high + reach)[1], 0
        self.low, self.high = first - edge, last + edge

    def _fit(self, actor: Actor, q: Floats, low: Floats, high: Floats, reach: Floats) -> Actor:
        """Returns what stands still as far as it is seen: of a half space, just what is touched."""
        if actor.moves or not isinstance(actor.shape, Box):
            return actor
        thick = _SLAB * float(np.max(high - low))
        room = np.full(3, thick) if actor.is_half_space else reach
        X_ST = self.pose(actor, q).inverse() @ self.X_WT
        corners = X_ST.multiply(((low + high) / 2 + box_corners((high - low) / 2 + room)).T).T
        seen = np.array([corners.min(axis=0), corners.max(axis=0)])
        own = np.array([actor.corners.min(axis=0), actor.corners.max(axis=0)])
        if actor.is_half_space:
            # The face of the slab that was drawn so far is that of the half space.
            seen[:, 2] = own[1, 2] - thick, own[1, 2]
        else:
            seen = np.clip(seen, *own)
            seen = np.where(np.ptp(seen, axis=0) > 0, seen, own)  # Out of sight altogether.
        sides, X_SB = np.ptp(seen, axis=0), RigidTransform(seen.mean(axis=0))
        return replace(
            actor, shape=Box(*sides), X_BS=actor.X_BS @ X_SB, corners=box_corners(sides / 2)
        )

    def _find_tracers(self) -> Iterator[tuple[BodyIndex, Floats]]:
        """Yields the points whose way tells the motion."""
        inspector, plant = self._world.scene_graph.model_inspector(), self._world.plant
        shapes = dict.fromkeys(shape for pair in self._world.shapes for shape in pair)
        spheres: dict[BodyIndex, list[Floats]] = {}
        for shape in shapes:
            body = plant.GetBodyFromFrameId(inspector.GetFrameId(shape))
            is_round = isinstance(inspector.GetShape(shape), Sphere)
            if (is_round or isinstance(self._world, SpaceWorld)) and not plant.IsAnchored(body):
                place = inspector.GetPoseInFrame(shape).translation()
                spheres.setdefault(body.index(), []).append(place)
        for index, middles in spheres.items():
            yield index, np.mean(middles, axis=0)
        if shapes:
            return
        for body in list_moving(self._world.plant):
            if outboard_joints(self._world, body):
                continue
            # The end of the link that is the farthest from its joint.
            origin = find_hinge(self._world, body)
            ends = [origin[np.newaxis]]
            for actor in (actor for actor in self.actors if actor.index == body.index()):
                # The middles of a box's faces, from its corners.
                middle, half = actor.corners.mean(axis=0), np.ptp(actor.corners, axis=0) / 2
                faces = middle + np.vstack([np.diag(half), np.diag(-half)])
                ends.append(actor.X_BS.multiply(faces.T).T)
            places = np.vstack(ends)
            yield body.index(), places[np.argmax(np.linalg.norm(places - origin, axis=1))]

    @property
    def names_without_contact(self) -> list[str]:
        """The names of bodies that move, and pass through all that they meet."""
        inspector, plant = self._world.scene_graph.model_inspector(), self._world.plant
        touching = {
            plant.GetBodyFromFrameId(inspector.GetFrameId(shape)).index()
            for pair in self._world.shapes
            for shape in pair
        }
        drawn = {actor.index for actor in self.actors}
        bodies = [
            body for body in list_moving(self._world.plant) if body.index() in drawn - touching
        ]
        return [body.name().replace("_", " ") for body in bodies]

    def trace(self, positions: Floats) -> Floats:
        """Returns where in T the tracers are, shape (tracers, K, 3), at positions (K, nq)."""
        X_TW, plant = self.X_WT.inverse(), self._world.plant
        bodies = [(plant.get_body(body), place) for body, place in self.tracers]
        traced = np.empty((len(bodies), len(positions), 3))
        for row, q in enumerate(positions):
            context = self._set(q)
            for number, (body, place) in enumerate(bodies):
                X_WB = plant.EvalBodyPoseInWorld(context, body)
                traced[number, row] = X_TW.multiply(X_WB.multiply(place))
        return traced

    def is_in_the_way(self, actor: Actor) -> bool:
        """Returns whether a shape that stands still is in the plane of motion, not behind it."""
        _, high = self.extent([actor], self._world.plant.GetDefaultPositions()[np.newaxis])
        return bool(high[2] > _FLAT * self.size)

    def movers_of(self, body: BodyIndex) -> Bools:
        """Returns which coordinates move a body, shape (nv,)."""
        plant = self._world.plant
        found = np.zeros(self._world.num_velocities, dtype=bool)
        for joint in moving_joints(self._world):
            bodies = plant.GetBodiesKinematicallyAffectedBy([joint.index()])
            if body in bodies:
                start = joint.velocity_start()
                found[start : start + joint.num_velocities()] = True
        return found

    def touch(self, contact: int, q: Floats) -> tuple[Floats, Floats]:
        """Returns where a contact's shapes are nearest, and its normal, in the world, (3,) each.

        The place is on what the sphere touches [m], in space midway; the normal points to the
        sphere.
        """
        if isinstance(self._world, SpaceWorld):
            return self._world.find_touch(contact, q)
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

    def place_touches(self, motion: Motion, touches: Sequence[Touch]) -> Floats:
        """Returns where in T's x and y a motion touches something, shape (t, 2) [m]."""
        X_TW = self.X_WT.inverse()
        rows = [motion.positions[find_row(motion, touch.start)] for touch in touches]
        places = [
            X_TW.multiply(self.touch(touch.contact, q)[0])[:2]
            for touch, q in zip(touches, rows, strict=True)
        ]
        return np.reshape(places, (-1, 2))

    def find_tangent(self, contact: int, q: Floats, v: Floats) -> Floats:
        """Returns the direction in the world in which a contact's s = T v counts, shape (3,).

        That of what the sphere's material moves by where it touches, as the wall sees it, when v is
        along T; in space, as it moves by v. Zero where nothing can slide.
        """
        if isinstance(self._world, SpaceWorld):
            along = self._world.calc_slides(q, v)[contact]
            size = float(np.linalg.norm(along))
            return along / size if size > 0 else along
        place, normal = self.touch(contact, q)
        T = self._world.rubbing.calc_tangent_jacobian(q)[contact]
        plant, context = self._world.plant, self._set(q)
        inspector = self._world.scene_graph.model_inspector()
        sphere, wall = (
            plant.GetBodyFromFrameId(inspector.GetFrameId(shape)).body_frame()
            for shape in self._world.shapes[contact]
        )
        place = sphere.CalcPoseInWorld(context).inverse().multiply(place)
        along = self._calc_jacobian(context, sphere, place, wall) @ T
        along -= normal * (normal @ along)
        size = float(np.linalg.norm(along))
        return along / size if size > 0 else along

    def load(self, joint: Joint, q: Floats, forces: Floats) -> tuple[Floats, Floats, Floats]:
        """Returns where a joint drives, and by what force and torque its generalized forces act.

        Generalized forces are of shape (nv,). All results are in the world, shape (3,) each [m],
        [N], [N m]. A slider drives the middle of its link, or of what slides on that if it has no
        shape; another joint drives where it is.
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
        driven = self.find_driven(joint) if np.any(push) else None
        if driven is None:
            return frame.CalcPoseInWorld(context).translation(), push, moment
        middle = driven.corners.mean(axis=0)
        return self.pose(driven, q).multiply(middle), push, moment

    def find_driven(self, joint: Joint) -> Actor | None:
        """Returns the first shape of the link that a joint moves, or that it carries along.

        That is one that slides on the link, or turns on it about its middle.
        """
        outward = [joint]
        for each in outward:
            body = each.child_body()
            for actor in (actor for actor in self.actors if actor.index == body.index()):
                if isinstance(each, PrismaticJoint) or each is joint or self._is_about(actor, body):
                    return actor
            outward += outboard_joints(self._world, body)
        return None

    def _is_about(self, actor: Actor, body: RigidBody) -> bool:
        """Returns whether the joint that carries a body is in the middle of a shape of it."""
        place = actor.X_BS.inverse().multiply(find_hinge(self._world, body))
        off = np.abs(place - actor.corners.mean(axis=0))
        return bool(np.all(off < np.ptp(actor.corners, axis=0) / 4))


def _face(normal: Floats) -> RotationMatrix:
    """Returns R_WT of a plane of motion with a normal, shape (3,)."""
    normal = normal / np.linalg.norm(normal)
    # Towards the viewer: up if it can be, or against the world's y axis.
    is_level = abs(normal @ _UP) > _LEVEL
    normal = normal if normal @ (_UP if is_level else -_FORWARDS - 1e-6 * _SIDE) >= 0 else -normal
    y = _FORWARDS if is_level else _UP
    y = y - (y @ normal) * normal
    x = np.cross(y, normal)
    return RotationMatrix(np.column_stack([each / np.linalg.norm(each) for each in (x, y, normal)]))
