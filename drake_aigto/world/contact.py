"""Contact geometry, read from a SceneGraph: pairs of a sphere and a flat face, and their distance.

Drake's geometry queries have no symbolic form, so φ is built here from the shapes and the plant's
symbolic kinematics: φ(q) = n · (p_sphere(q) − p_face) − r, exact while the sphere's centre projects
onto the face.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.geometry import Box, GeometryId, HalfSpace, SceneGraph, Sphere
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.symbolic import Expression

from drake_aigto.errors import ModelError

if TYPE_CHECKING:
    import numpy.typing as npt

    _Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Contact:
    """A pair of shapes that can touch, and how far they are apart.

    Attributes:
        name: such as "ball against wall".
        signed_distance: φ(q) [m], positive when apart, a polynomial.
        jacobian: J = ∂φ/∂q, shape (nv,), as q̇ = v.
    """

    name: str
    signed_distance: Expression
    jacobian: npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class SphereAndFace:
    """A sphere on one body and a flat face on another.

    Attributes:
        name: such as "ball against wall".
        sphere_body: the body that carries the sphere.
        face_body: the body that carries the face.
        center: the sphere's centre in its body's frame, shape (3,) [m].
        radius: r [m].
        point: the middle of the face in its body's frame, shape (3,) [m].
        axes: columns are the face's two edge directions and its outward normal n, in its body's
            frame, shape (3, 3).
        half_extents: half the lengths of the two edges, shape (2,) [m]; infinite for a half space.
    """

    name: str
    sphere_body: RigidBody
    face_body: RigidBody
    center: _Array
    radius: float
    point: _Array
    axes: _Array
    half_extents: _Array

    def calc_coordinates(self, plant: Any, context: Any) -> npt.NDArray[Any]:
        """Returns where the sphere's surface is in the face's frame, shape (3,) [m].

        The first two are its centre along the face's edges; the third is φ.

        Args:
            plant: the plant, double or symbolic.
            context: its context.
        """
        X_FS = plant.CalcRelativeTransform(
            context,
            plant.get_body(self.face_body.index()).body_frame(),
            plant.get_body(self.sphere_body.index()).body_frame(),
        )
        p_FS = X_FS.translation() + X_FS.rotation().matrix() @ self.center
        coordinates = self.axes.T @ (p_FS - self.point)
        return coordinates - np.array([0.0, 0.0, self.radius])


def find_pairs(
    plant: MultibodyPlant, scene_graph: SceneGraph, plant_context: Any
) -> list[SphereAndFace]:
    """Returns every pair that may collide (Drake's filters applied), spheres against faces.

    A box offers the face that its sphere faces in the given context: that of largest distance.

    Raises:
        ModelError: a shape or a pair of shapes that is not supported, by name.
    """
    inspector = scene_graph.model_inspector()
    pairs = []
    for first, second in sorted(
        inspector.GetCollisionCandidates(), key=lambda ids: [i.get_value() for i in ids]
    ):
        shapes = inspector.GetShape(first), inspector.GetShape(second)
        if isinstance(shapes[0], Sphere) and isinstance(shapes[1], Box | HalfSpace):
            sphere, wall = first, second
        elif isinstance(shapes[1], Sphere) and isinstance(shapes[0], Box | HalfSpace):
            sphere, wall = second, first
        else:
            raise ModelError(
                f"contact of {inspector.GetName(first)} with {inspector.GetName(second)}",
                got=" against ".join(type(shape).__name__ for shape in shapes),
                expected="Sphere against Box or HalfSpace",
                remedy="Change the collision shapes, or exclude the pair with a "
                "<drake:collision_filter_group>.",
            )
        pairs.append(_read_pair(plant, inspector, sphere, wall, plant_context))
    return pairs


def _read_pair(
    plant: MultibodyPlant, inspector: Any, sphere: GeometryId, wall: GeometryId, context: Any
) -> SphereAndFace:
    """Returns one pair; of a box, the face of largest distance."""
    sphere_body = plant.GetBodyFromFrameId(inspector.GetFrameId(sphere))
    face_body = plant.GetBodyFromFrameId(inspector.GetFrameId(wall))
    names = [
        inspector.GetName(geometry).split("::")[-1] if body == plant.world_body() else body.name()
        for body, geometry in ((sphere_body, sphere), (face_body, wall))
    ]
    X_FW = inspector.GetPoseInFrame(wall)
    candidates = [
        SphereAndFace(
            name=" against ".join(names),
            sphere_body=sphere_body,
            face_body=face_body,
            center=inspector.GetPoseInFrame(sphere).translation(),
            radius=inspector.GetShape(sphere).radius(),
            point=X_FW.multiply(point),
            axes=X_FW.rotation().matrix() @ axes,
            half_extents=half_extents,
        )
        for point, axes, half_extents in _faces(inspector.GetShape(wall))
    ]
    return max(candidates, key=lambda pair: pair.calc_coordinates(plant, context)[2])


def _faces(shape: Box | HalfSpace) -> list[tuple[_Array, _Array, _Array]]:
    """Returns (middle, axes with the outward normal last, half extents) of each face."""
    identity = np.eye(3)
    if isinstance(shape, HalfSpace):
        return [(np.zeros(3), identity, np.full(2, np.inf))]
    half = np.asarray(shape.size()) / 2
    faces = []
    for axis in range(3):
        edges = [(axis + 1) % 3, (axis + 2) % 3]
        for sign in (1.0, -1.0):
            normal = sign * identity[:, axis]
            axes = np.column_stack([identity[:, edges[0]], identity[:, edges[1]], normal])
            faces.append((half[axis] * normal, axes, half[edges]))
    return faces
