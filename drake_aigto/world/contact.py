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
from pydrake.math import RigidTransform, RotationMatrix
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
        sphere_body: the body S that carries the sphere.
        p_SC: the sphere's centre C in its body's frame, shape (3,) [m].
        radius: r [m].
        face_body: the body B that carries the face.
        X_BF: the face's frame F in its body's: the origin in the face's middle, x and y along its
            edges, z its outward normal n.
        half_extents: half the lengths of its edges, shape (2,) [m]; infinite for a half space.
    """

    name: str
    sphere_body: RigidBody
    p_SC: _Array
    radius: float
    face_body: RigidBody
    X_BF: RigidTransform
    half_extents: _Array

    def calc_center(self, plant: Any, context: Any, scalar: type = float) -> npt.NDArray[Any]:
        """Returns the sphere's centre in the face's frame, shape (3,) [m].

        Args:
            plant: the plant that the bodies belong to, or its symbolic twin.
            context: that plant's context.
            scalar: float, or Expression for the symbolic twin.
        """
        X_BS = plant.CalcRelativeTransform(
            context,
            plant.get_body(self.face_body.index()).body_frame(),
            plant.get_body(self.sphere_body.index()).body_frame(),
        )
        X_FB = self.X_BF.inverse().cast[scalar]()
        return X_FB.multiply(X_BS.multiply(self.p_SC))

    def calc_signed_distance(self, plant: Any, context: Any, scalar: type = float) -> Any:
        """Returns φ [m]; arguments as `calc_center`."""
        return self.calc_center(plant, context, scalar)[2] - self.radius


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
    shape = inspector.GetShape(wall)
    X_BG = inspector.GetPoseInFrame(wall)
    candidates = [
        SphereAndFace(
            name=" against ".join(names),
            sphere_body=sphere_body,
            p_SC=inspector.GetPoseInFrame(sphere).translation(),
            radius=inspector.GetShape(sphere).radius(),
            face_body=face_body,
            X_BF=X_BG @ X_GF,
            half_extents=half_extents,
        )
        for X_GF, half_extents in _faces(shape)
    ]
    return max(candidates, key=lambda pair: pair.calc_signed_distance(plant, context))


def _faces(shape: Box | HalfSpace) -> list[tuple[RigidTransform, _Array]]:
    """Returns X_GF, as `SphereAndFace` has it, and half extents of each face of a geometry G."""
    if isinstance(shape, HalfSpace):
        return [(RigidTransform(), np.full(2, np.inf))]
    half = np.asarray(shape.size()) / 2
    faces = []
    for z in range(3):
        for sign in (1.0, -1.0):
            # The two edges in the order that makes a right-handed frame with ±z.
            edges = [(z + 1) % 3, (z + 2) % 3][:: int(sign)]
            normal = sign * np.eye(3)[z]
            R_GF = RotationMatrix(np.column_stack([*np.eye(3)[edges], normal]))
            faces.append((RigidTransform(R_GF, half[z] * normal), half[edges]))
    return faces
