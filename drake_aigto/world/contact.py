"""Contact geometry, read from a SceneGraph: a sphere, a flat face, and how far they are apart.

Drake's geometry queries have no closed form, so φ is built here from the shapes and the plant's
kinematics: φ(q) = n · (p_sphere(q) − p_face) − r, exact while the sphere's center projects onto the
face.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Box, GeometryId, HalfSpace, Role, SceneGraph, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.symbolic import Expression

from drake_aigto.arrays import Floats
from drake_aigto.errors import ModelError

# Where a scene graph keeps the restitution of a shape, if its maker put it there.
RESTITUTION = ("material", "restitution")

# Centers that are nearer than this part of a radius coincide but for rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Contact:
    """A sphere and a face that can touch, and how far they are apart.

    Attributes:
        name: such as "ball against wall", or "ball against block, +x face".
        signed_distance: φ(q) [m], positive when apart.
        jacobian: J = ∂φ/∂q, shape (nv,), as q̇ = v.
        solid: index of what is touched. All faces of a box that one sphere can reach have the same:
            the sphere is outside when it is in front of one of them.
        restitution: the model's own, in [0, 1]; None leaves it to the scenario.
        radius: of the sphere [m].
    """

    name: str
    signed_distance: Expression
    jacobian: NDArray[Any]
    solid: int = 0
    restitution: float | None = None
    radius: float = 0.0


@dataclass(frozen=True, eq=False)
class SphereAndFace:
    """A sphere on one body and a flat face on another.

    Attributes:
        shapes: the sphere, and the shape that has the face.
        pair: both, such as "ball against wall".
        face: which of several faces it is, such as "+x"; empty if there is but one.
        sphere_body: the body S that carries the sphere.
        p_SC: the sphere's center C in its body's frame, shape (3,) [m].
        radius: r [m].
        face_body: the body B that carries the face.
        X_BF: the face's frame F in its body's: the origin in the face's middle, x and y along its
            edges, z its outward normal n.
        half_extents: half the lengths of its edges, shape (2,) [m]: infinite for a half space, zero
            for a sphere, which is no wall but on one line.
        restitution: that of the material, in [0, 1], or None.
    """

    shapes: tuple[GeometryId, GeometryId]
    pair: str
    face: str
    sphere_body: RigidBody
    p_SC: Floats
    radius: float
    face_body: RigidBody
    X_BF: RigidTransform
    half_extents: Floats
    restitution: float | None

    @property
    def is_unbounded(self) -> bool:
        """Whether every center projects onto the face."""
        return bool(np.all(np.isinf(self.half_extents)))

    @property
    def is_ball(self) -> bool:
        """Whether the face is that of a second sphere, flat on the line through both centers."""
        return not np.any(self.half_extents)

    def calc_center(self, plant: MultibodyPlant, context: Any) -> Floats:
        """Returns the sphere's center in the face's frame, shape (3,) [m]; the third is φ + r."""
        X_BS = _calc_pose(plant, context, self.face_body, self.sphere_body)
        return np.asarray(self.X_BF.inverse().multiply(X_BS.multiply(self.p_SC)))


def find_shapes(scene_graph: SceneGraph, names: Iterable[str]) -> frozenset[GeometryId]:
    """Returns the collision shapes of these names, "shape" or "model::shape".

    Raises:
        ModelError: there is none of a name.
    """
    inspector: Any = scene_graph.model_inspector()
    known = {each: inspector.GetName(each) for each in inspector.GetAllGeometryIds(Role.kProximity)}
    found = set[GeometryId]()
    for name in names:
        of_name = [each for each, full in known.items() if f"::{full}".endswith(f"::{name}")]
        if not of_name:
            raise ModelError(
                "ignored_shapes",
                got=repr(name),
                expected=f"of the collision shapes {', '.join(sorted(known.values())) or '(none)'}",
            )
        found.update(of_name)
    return frozenset(found)


def find_pairs(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    plant_context: Any,
    ignored: Collection[GeometryId] = (),
) -> list[list[SphereAndFace]]:
    """Returns all faces of every pair of shapes that may collide (Drake's filters applied).

    Pairs with a shape that is to be ignored are left out.

    Each pair is a list: the six faces of a box, the one of a half space. Of two spheres, the second
    counts as a wall that faces the first one, in the given context: exact on the line through their
    centers.

    Raises:
        ModelError: a pair of shapes that is not supported, by name.
    """
    inspector = scene_graph.model_inspector()
    candidates = inspector.GetCollisionCandidates()
    return [
        _read_pair(plant, inspector, *_order(inspector, first, second), plant_context)
        for first, second in sorted(candidates, key=lambda ids: [i.get_value() for i in ids])
        if first not in ignored and second not in ignored
    ]


def _order(inspector: Any, first: GeometryId, second: GeometryId) -> tuple[GeometryId, GeometryId]:
    """Returns the sphere first."""
    shapes = inspector.GetShape(first), inspector.GetShape(second)
    if isinstance(shapes[0], Sphere) and isinstance(shapes[1], Box | HalfSpace | Sphere):
        return first, second
    if isinstance(shapes[1], Sphere) and isinstance(shapes[0], Box | HalfSpace):
        return second, first
    raise ModelError(
        f"contact of {inspector.GetName(first)} with {inspector.GetName(second)}",
        got=" against ".join(type(shape).__name__ for shape in shapes),
        expected="Sphere against Box, HalfSpace or Sphere",
        remedy="Change the collision shapes, leave one out by the scenario's ignored_shapes, or "
        "exclude the pair with a <drake:collision_filter_group>.",
    )


def _read_pair(
    plant: MultibodyPlant, inspector: Any, sphere: GeometryId, wall: GeometryId, context: Any
) -> list[SphereAndFace]:
    """Returns all faces of one pair."""
    sphere_body, face_body = (
        plant.GetBodyFromFrameId(inspector.GetFrameId(shape)) for shape in (sphere, wall)
    )
    X_BG = inspector.GetPoseInFrame(wall)
    p_SC = inspector.GetPoseInFrame(sphere).translation()
    p_BC = _calc_pose(plant, context, face_body, sphere_body).multiply(p_SC)
    pair = " against ".join(_name(plant, inspector, shape) for shape in (sphere, wall))
    p_GC = X_BG.inverse().multiply(p_BC)
    if isinstance(inspector.GetShape(wall), Sphere):
        _check_apart(pair, p_GC, inspector.GetShape(sphere).radius(), plant)
    return [
        SphereAndFace(
            shapes=(sphere, wall),
            pair=pair,
            face=face,
            sphere_body=sphere_body,
            p_SC=p_SC,
            radius=inspector.GetShape(sphere).radius(),
            face_body=face_body,
            X_BF=X_BG @ X_GF,
            half_extents=half_extents,
            restitution=_read_restitution(inspector, sphere, wall),
        )
        for face, X_GF, half_extents in _faces(inspector.GetShape(wall), p_GC)
    ]


def _check_apart(pair: str, p_GC: Floats, radius: float, plant: MultibodyPlant) -> None:
    """Refuses spheres with one center, of which none is on any side of the other."""
    if np.linalg.norm(p_GC) <= _ROUNDING * radius:
        raise ModelError(
            f"contact of {pair}",
            got="spheres whose centers coincide at the plant's default positions, "
            f"{plant.GetDefaultPositions().tolist()}",
            expected="default positions that show which one is on which side of the other",
            remedy="Start them apart; in your own diagram, by the plant's SetDefaultPositions.",
        )


def _calc_pose(plant: Any, context: Any, base: RigidBody, body: RigidBody) -> Any:
    """Returns the pose of a body in another."""
    return plant.CalcRelativeTransform(context, base.body_frame(), body.body_frame())


def _name(plant: MultibodyPlant, inspector: Any, shape: GeometryId) -> str:
    """Returns the name of a shape's body, or its own where a body has several, as the world may."""
    body = plant.GetBodyFromFrameId(inspector.GetFrameId(shape))
    if body == plant.world_body() or len(plant.GetCollisionGeometriesForBody(body)) > 1:
        return inspector.GetName(shape).split("::")[-1]
    return body.name()


def _read_restitution(inspector: Any, sphere: GeometryId, wall: GeometryId) -> float | None:
    """Returns the material's restitution, the smaller one where both shapes have it."""
    found = []
    for shape in (sphere, wall):
        properties = inspector.GetProximityProperties(shape)
        if not properties.HasProperty(*RESTITUTION):
            continue
        value = properties.GetProperty(*RESTITUTION)
        if not (isinstance(value, float | int) and 0 <= value <= 1):
            raise ModelError(
                f"restitution of collision shape {inspector.GetName(shape)!r}",
                got=value,
                expected="a number from 0 to 1",
            )
        found.append(float(value))
    return min(found, default=None)


def _faces(
    shape: Box | HalfSpace | Sphere, p_GC: Floats
) -> list[tuple[str, RigidTransform, Floats]]:
    """Returns name, X_GF and half extents of each face of a geometry G, seen from a center C."""
    if isinstance(shape, HalfSpace):
        return [("", RigidTransform(), np.full(2, np.inf))]
    if isinstance(shape, Sphere):
        normal = p_GC / np.linalg.norm(p_GC)
        R_GF = RotationMatrix.MakeFromOneVector(normal, 2)
        return [("", RigidTransform(R_GF, shape.radius() * normal), np.zeros(2))]
    half = np.asarray(shape.size()) / 2
    faces = []
    for z, axis in enumerate("xyz"):
        for sign in (1.0, -1.0):
            # The two edges in the order that makes a right-handed frame with ±z.
            edges = [(z + 1) % 3, (z + 2) % 3][:: int(sign)]
            normal = sign * np.eye(3)[z]
            R_GF = RotationMatrix(np.column_stack([*np.eye(3)[edges], normal]))
            name = f"{'+' if sign > 0 else '-'}{axis}"
            faces.append((name, RigidTransform(R_GF, half[z] * normal), half[edges]))
    return faces
