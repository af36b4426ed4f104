"""Pairs of shapes that can touch: a sphere and a flat face of a SceneGraph, and their distance.

Drake's geometry queries have no closed form, so φ is built here from the shapes and the plant's
kinematics: φ(q) = n · (p_sphere(q) − p_face) − r, exact while the sphere's center projects onto the
face.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Box, GeometryId, HalfSpace, SceneGraph, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.symbolic import Expression

from drake_aigto.arrays import Floats
from drake_aigto.dynamics import Contact, evaluate, is_constant, tidy
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.world.pair_errors import check_work, find_link
from drake_aigto.world.plant_reader import PlantReader

# Where a scene graph keeps the restitution of a shape, if its maker put it there.
RESTITUTION = ("material", "restitution")

# Of a radius: centers that are nearer coincide but for rounding. In meters: a sphere that slides
# along a face, at a distance that is zero but for rounding, is not inside.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class SphereAndFace:
    """A sphere on one body and a flat face on another."""

    shapes: tuple[GeometryId, GeometryId]  # the sphere, and the shape that has the face
    pair: str  # both, such as "ball against wall"
    face: str  # which of several faces it is, such as "+x"; empty if there is but one
    sphere_body: RigidBody  # the body S that carries the sphere
    p_SC: Floats  # the sphere's center C in its body's frame, shape (3,) [m]
    radius: float  # r [m]
    face_body: RigidBody  # the body B that carries the face
    # The face's frame F in its body's: the origin in the face's middle, x and y along its edges, z
    # its outward normal n.
    X_BF: RigidTransform
    # Half the lengths of its edges, shape (2,) [m]: infinite for a half space, zero for a sphere,
    # which is no wall but on one line.
    half_extents: Floats
    wall_radius: float  # that of the shape with the face if it is a sphere, else 0 [m]
    restitution: float | None  # that of the material, in [0, 1], or None

    @property
    def is_unbounded(self) -> bool:
        """Whether every center projects onto the face."""
        return bool(np.all(np.isinf(self.half_extents)))

    @property
    def is_ball(self) -> bool:
        """Whether the face is that of a second sphere, flat on the line through both centers."""
        return self.wall_radius > 0

    @property
    def sum_of_radii(self) -> float:
        """R, the sum of radii of two spheres, 0 of a sphere and a wall [m]."""
        return self.radius + self.wall_radius if self.is_ball else 0.0

    def calc_center(self, plant: MultibodyPlant, context: Any) -> Floats:
        """Returns the sphere's center in the face's frame, shape (3,) [m]; the third is φ + r."""
        face_body, sphere_body = self.face_body.body_frame(), self.sphere_body.body_frame()
        X_BS = plant.CalcRelativeTransform(context, face_body, sphere_body)
        return np.asarray(self.X_BF.inverse().multiply(X_BS.multiply(self.p_SC)))


class ReachableFace(NamedTuple):
    """A contact, and the face that it is read from."""

    face: SphereAndFace  # its geometry
    lateral: NDArray[Any]  # the sphere's center along the face's edges, shape (2,) Expressions [m]
    contact: Contact  # φ and J
    # R, the sum of radii of two spheres that move about each other; 0 of all else [m].
    reach: float = 0.0


def find_reach(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    reader: PlantReader,
    candidates: Sequence[tuple[GeometryId, GeometryId]],
) -> tuple[tuple[ReachableFace, ...], tuple[SphereAndFace, ...]]:
    """Returns every face that a sphere can touch, by boxes, and those that it is stuck in.

    Pairs of shapes are those of `choose_pairs`. Of a box that the sphere can only move along one
    line to, what counts is the face which it faces at the default positions; of another box, every
    face that the sphere can move to or from. Of two spheres, the second counts as a wall that faces
    the first one at the default positions: exact on the line through their centers. A sphere is
    stuck in a shape that it overlaps as long as it is before that face, which no joint moves it
    away from. It is no contact: walls without friction only push that way.

    Raises:
        ModelError: there are too many pairs across too many joints, spheres coincide at the default
            positions, or a restitution is not in [0, 1].
    """
    check_work(plant, scene_graph, candidates)
    found, stuck = list[ReachableFace](), list[SphereAndFace]()
    solid, default = 0, plant.GetDefaultPositions()
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, default)  # A clone's context forgets them.
    inspector: Any = scene_graph.model_inspector()
    pairs = [_read_pair(plant, inspector, *pair, context) for pair in candidates]
    for pair in pairs:
        places = [_read_place(reader, face) for face in pair]
        chosen, fixed = _choose(places, reader.q, default)
        stuck += [pair[i] for i in fixed]
        for i in chosen:
            face, distance = pair[i], places[i][2]
            name = f"{face.pair}, {face.face} face" if len(chosen) > 1 else face.pair
            jacobian = tidy(distance.Jacobian(reader.q))
            contact = Contact(name, distance, jacobian, solid, face.restitution, face.radius)
            reach = 0.0 if is_constant(jacobian) else face.sum_of_radii
            found.append(ReachableFace(face, places[i][:2], contact, reach))
        solid += bool(chosen)
    return tuple(found), tuple(stuck)


def leave_out_far(
    reachable: Sequence[ReachableFace],
    solids: Sequence[Sequence[int]],
    least: Floats,
    lateral: Floats,
) -> tuple[tuple[ReachableFace, ...], dict[str, float]]:
    """Returns the faces that joints within their limits reach, and how far off other pairs stay.

    There the least φ are (m,), and (m, 2) is how far the sphere's center gets along each edge [m].
    Of a box before one face of which a sphere always stays, the other faces are left out.
    """
    far: dict[str, float] = {}
    for faces in solids:
        if (distance := max(least[i] for i in faces)) > 0:
            far |= {reachable[i].face.pair: distance for i in faces}
    halves = np.array([each.face.half_extents for each in reachable]).reshape(-1, 2)
    radii = np.array([each.face.radius for each in reachable])
    inside = np.all(lateral <= halves, axis=1) & (least > -radii)
    near = []
    for faces in solids:
        first = next((i for i in faces if inside[i]), None)
        for each in (reachable[i] for i in (faces if first is None else (first,))):
            name = each.contact.name if first is None else each.face.pair
            contact = replace(each.contact, name=name)
            if each.face.pair not in far:
                near.append(each._replace(contact=contact))
    return tuple(near), far


def find_sphere_body(plant: MultibodyPlant, reachable: Sequence[ReachableFace]) -> RigidBody:
    """Returns the only body with spheres that touch, whose mass a scenario may replace."""
    bodies = list(
        {each.face.sphere_body.index(): each.face.sphere_body for each in reachable}.values()
    )
    names = ", ".join(repr(body.name()) for body in bodies)
    if not bodies:
        got, expected = "a model in which nothing touches", "one link with spheres that do"
    elif len(bodies) > 1:
        got, expected = f"links {names}, which all carry spheres that touch", "one such link"
    elif plant.IsAnchored(bodies[0]):
        got = f"link {names}, which carries the contact's sphere and does not move"
        expected = "the sphere on a moving link"
    else:
        return bodies[0]
    masses = "mass" if len(bodies) == 1 else "masses"
    raise ModelError("mass", got, expected, f"Edit the {masses} in the model instead.")


def refuse_inside(
    name: str, face: SphereAndFace, distance: float, num_faces: int, plant: MultibodyPlant
) -> ScenarioError:
    """Returns the error of a position inside a solid."""
    faced = np.round(plant.GetDefaultPositions(), 6).tolist()
    remedy = (
        f"The wall is the face that the sphere faces at q = {faced}; start and goal must both be "
        "in front of it."
    )
    return ScenarioError(
        f"{name} is inside or behind the wall ({face.pair})",
        got=f"a signed distance of {distance:g} m",
        expected="at least 0 m",
        remedy=remedy if num_faces == 1 else "Start and goal must both be outside.",
    )


def refuse_beside(name: str, face: SphereAndFace, off: Floats) -> ScenarioError:
    """Returns the error of a position off the edges of the only face of a wall."""
    return ScenarioError(
        f"{name} is beside the face of the wall ({face.pair})",
        got=f"the sphere's center {np.round(off, 6).tolist()} m off the face's middle",
        expected=f"within {face.half_extents.tolist()} m",
        remedy="Widen the wall, or use a half space.",
    )


def _choose(
    places: list[NDArray[Any]], q: NDArray[Any], default: Floats
) -> tuple[list[int], list[int]]:
    """Returns the indices of the faces that count, and of the one that the sphere is stuck in."""
    distances = np.array([place[2] for place in places])
    fixed = [i for i, distance in enumerate(distances) if is_constant(distance)]
    if any(distances[i].Evaluate() >= -_ROUNDING for i in fixed):
        return [], []
    rates = np.array([length.Jacobian(q) for length in places[0]])
    is_on_line = is_constant(rates) and np.linalg.matrix_rank(evaluate(rates)) <= 1
    if len(places) > 1 and not is_on_line:
        return [i for i in range(len(places)) if i not in fixed], []
    nearest = int(np.argmax(evaluate(distances, dict(zip(q, default, strict=True)))))
    return ([], [nearest]) if nearest in fixed else ([nearest], [])


def list_pairs(inspector: Any) -> list[tuple[GeometryId, GeometryId]]:
    """Returns all pairs of shapes that may collide, always in the same order."""
    pairs = inspector.GetCollisionCandidates()
    return sorted(pairs, key=lambda pair: [shape.get_value() for shape in pair])


def order_pair(
    inspector: Any, pair: tuple[GeometryId, GeometryId]
) -> tuple[GeometryId, GeometryId] | None:
    """Returns the sphere first, or None of a pair that is not supported."""
    for sphere, wall in (pair, pair[::-1]):
        shapes = inspector.GetShape(sphere), inspector.GetShape(wall)
        if isinstance(shapes[0], Sphere) and isinstance(shapes[1], Box | HalfSpace | Sphere):
            return sphere, wall
    return None


def _read_pair(
    plant: MultibodyPlant, inspector: Any, sphere: GeometryId, wall: GeometryId, context: Any
) -> list[SphereAndFace]:
    """Returns all faces of one pair: the six of a box, the one of a half space or a sphere."""
    sphere_body, face_body = (
        plant.GetBodyFromFrameId(inspector.GetFrameId(shape)) for shape in (sphere, wall)
    )
    shape, radius = inspector.GetShape(wall), inspector.GetShape(sphere).radius()
    X_BG = inspector.GetPoseInFrame(wall)
    p_SC = inspector.GetPoseInFrame(sphere).translation()
    frames = face_body.body_frame(), sphere_body.body_frame()
    p_GC = X_BG.inverse().multiply(plant.CalcRelativeTransform(context, *frames).multiply(p_SC))
    pair = " against ".join(_name(plant, inspector, shape) for shape in (sphere, wall))
    if isinstance(shape, Sphere) and np.linalg.norm(p_GC) <= _ROUNDING * radius:
        raise ModelError(
            f"contact of {pair}",
            got="spheres whose centers coincide at the plant's default positions, "
            f"{plant.GetDefaultPositions().tolist()}",
            expected="default positions that show which one is on which side of the other",
            remedy="Start them apart; in your own diagram, by the plant's SetDefaultPositions.",
        )
    return [
        SphereAndFace(
            shapes=(sphere, wall),
            pair=pair,
            face=face,
            sphere_body=sphere_body,
            p_SC=p_SC,
            radius=radius,
            face_body=face_body,
            X_BF=X_BG @ X_GF,
            half_extents=half_extents,
            wall_radius=shape.radius() if isinstance(shape, Sphere) else 0.0,
            restitution=_read_restitution(inspector, sphere, wall),
        )
        for face, X_GF, half_extents in _faces(shape, p_GC)
    ]


def _name(plant: MultibodyPlant, inspector: Any, shape: GeometryId) -> str:
    """Returns the name of a shape's body, or its own where a body has several, as the world may."""
    body = find_link(plant, inspector, shape)
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


def _read_place(reader: PlantReader, face: SphereAndFace) -> NDArray[Any]:
    """Returns where a sphere is before a face, (x, y, φ), shape (3,) [m].

    x and y are its center's coordinates along the edges, zeros where a face has none. A second
    sphere is no flat face but on one line: else φ = (|d|² − R²)/2R, with d from one center to the
    other and R the sum of radii: zero where they touch, and with the gradient of the distance
    there, n = d/R. Elsewhere it is |d| − R times (|d| + R)/2R.
    """
    what = f"the place of {face.pair}"
    x, y, height = reader.read(face.calc_center, degree=1, what=what)
    nothing, R = Expression(0.0), face.sum_of_radii
    if face.is_unbounded:
        x, y = nothing, nothing
    x, y, distance = tidy(np.array([x, y, height - face.radius]))
    if face.is_ball and not (x.EqualTo(nothing) and y.EqualTo(nothing)):
        distance = (x**2 + y**2 + (distance + R) ** 2 - R**2) / (2 * R)
        return tidy(np.array([nothing, nothing, distance]))
    return np.array([x, y, distance])
