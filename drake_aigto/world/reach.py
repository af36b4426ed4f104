"""Which faces a sphere can reach: pairs of shapes become contacts."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import GeometryId, Role, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.symbolic import Expression

from drake_aigto.arrays import Floats
from drake_aigto.errors import ModelError
from drake_aigto.world.contact import Contact, SphereAndFace, find_pairs
from drake_aigto.world.plant_reader import PlantReader
from drake_aigto.world.sums import evaluate, is_constant, tidy

# A sphere that slides along a face, at a distance that is zero but for rounding, is not inside [m].
_ROUNDING = 1e-9


class ReachableFace(NamedTuple):
    """A contact, and the face that it is read from.

    Attributes:
        face: its geometry.
        lateral: the sphere's center along the face's edges, shape (2,) Expressions [m].
        contact: φ and J.
        reach: R, the sum of radii of two spheres that move about each other; 0 of all else [m].
    """

    face: SphereAndFace
    lateral: NDArray[Any]
    contact: Contact
    reach: float = 0.0


class Reach(NamedTuple):
    """What spheres can touch, and what they are stuck in.

    Attributes:
        faces: every face that a sphere can touch, those of one box in a row.
        stuck: a face of each shape that a sphere overlaps as long as it is before that face, which
            no joint moves it away from. It is no contact: walls without friction only push that
            way.
    """

    faces: tuple[ReachableFace, ...]
    stuck: tuple[SphereAndFace, ...]


def find_reach(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    reader: PlantReader,
    ignored: Collection[GeometryId] = (),
) -> Reach:
    """Returns every face that a sphere can touch, and those that it is stuck in.

    Shapes that are to be ignored touch nothing. Of a box that the sphere can only move along one
    line to, what counts is the face which it faces at the default positions; of another box, every
    face that the sphere can move to or from.

    Raises:
        ModelError: no motion brings any two shapes together that may collide, or a pair of shapes
            is not supported.
    """
    found, stuck = list[ReachableFace](), list[SphereAndFace]()
    solid = 0
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, plant.GetDefaultPositions())  # A clone's context forgets them.
    pairs = find_pairs(plant, scene_graph, context, ignored)
    for pair in pairs:
        places = [_read_place(reader, scene_graph, face) for face in pair]
        chosen, fixed = _choose(pair, places, reader.q, plant.GetDefaultPositions())
        stuck += [pair[i] for i in fixed]
        for i in chosen:
            face, distance = pair[i], places[i][2]
            name = f"{face.pair}, {face.face} face" if len(chosen) > 1 else face.pair
            jacobian = tidy(distance.Jacobian(reader.q))
            contact = Contact(name, distance, jacobian, solid, face.restitution, face.radius)
            reach = 0.0 if is_constant(jacobian) else _sum_radii(scene_graph, face)
            found.append(ReachableFace(face, places[i][:2], contact, reach))
        solid += bool(chosen)
    if pairs and not found:
        raise _refuse_apart(pairs)
    return Reach(tuple(found), tuple(stuck))


def find_sphere_body(plant: MultibodyPlant, reachable: Sequence[ReachableFace]) -> RigidBody:
    """Returns the only body with spheres that touch, whose mass a scenario may replace."""
    bodies = {each.face.sphere_body.index(): each.face.sphere_body for each in reachable}
    if not bodies:
        raise ModelError(
            "mass",
            got="a model in which nothing touches",
            expected="one link with spheres that do",
            remedy="Edit the masses in the model instead.",
        )
    if len(bodies) > 1:
        raise ModelError(
            "mass",
            got=f"links {', '.join(repr(body.name()) for body in bodies.values())}, which all "
            "carry spheres that touch",
            expected="one such link",
            remedy="Edit the masses in the model instead.",
        )
    (body,) = bodies.values()
    if plant.IsAnchored(body):
        raise ModelError(
            "mass",
            got=f"link {body.name()!r}, which carries the contact's sphere and does not move",
            expected="the sphere on a moving link",
            remedy="Edit the mass in the model instead.",
        )
    return body


def _choose(
    pair: list[SphereAndFace], places: list[NDArray[Any]], q: NDArray[Any], default: Floats
) -> tuple[list[int], list[int]]:
    """Returns the indices of the faces that count, and of the one that the sphere is stuck in."""
    distances = [place[2] for place in places]
    fixed = [i for i, distance in enumerate(distances) if is_constant(distance)]
    if any(distances[i].Evaluate() >= -_ROUNDING for i in fixed):
        return [], []
    at_default = dict(zip(q, default, strict=True))
    if len(pair) > 1 and not _is_on_line(places[0], q):
        return [i for i in range(len(pair)) if i not in fixed], []
    nearest = int(np.argmax(evaluate(np.array(distances), at_default)))
    return ([], [nearest]) if nearest in fixed else ([nearest], [])


def refuse_no_contact(scene_graph: SceneGraph) -> ModelError:
    """Returns the error of a model in which no two shapes may collide, with the reason."""
    inspector = scene_graph.model_inspector()
    if len(shapes := inspector.GetAllGeometryIds(Role.kProximity)) < 2:
        got = f"{len(shapes)} collision shape{'s' if len(shapes) != 1 else ''}"
        remedy = "Add <collision> shapes to both links."
    else:
        got = f"{len(shapes)} collision shapes, of which Drake lets no two collide"
        remedy = (
            "Shapes that are welded together, or anchored, or on links that a joint connects, "
            "don't collide, nor those that a <drake:collision_filter_group> excludes."
        )
    return _refuse(got, remedy)


def _refuse_apart(pairs: list[list[SphereAndFace]]) -> ModelError:
    """Returns the error of shapes that no joint brings together."""
    got = f"no motion that brings together {' or '.join(pair[0].pair for pair in pairs)}"
    remedy = "Move a shape into the other's way: distances that no joint changes are no contact."
    return _refuse(got, remedy)


def _refuse(got: str, remedy: str) -> ModelError:
    expected = "a sphere, and a box, half space or sphere that it can touch"
    return ModelError("the model lacks a contact", got, expected, remedy)


def _is_on_line(place: NDArray[Any], q: NDArray[Any]) -> bool:
    """Returns whether a center can only move along one line."""
    rates = np.array([length.Jacobian(q) for length in place])
    return is_constant(rates) and np.linalg.matrix_rank(evaluate(rates)) <= 1


def _read_place(reader: PlantReader, scene_graph: SceneGraph, face: SphereAndFace) -> NDArray[Any]:
    """Returns where a sphere is before a face, (x, y, φ), shape (3,) [m]."""
    place = reader.calc_place(face)
    return _round(place, _sum_radii(scene_graph, face)) if face.is_ball else place


def _sum_radii(scene_graph: SceneGraph, face: SphereAndFace) -> float:
    """Returns R of two spheres, 0 of a sphere and a wall [m]."""
    if not face.is_ball:
        return 0.0
    wall: Any = scene_graph.model_inspector().GetShape(face.shapes[1])
    return float(face.radius + wall.radius())


def _round(place: NDArray[Any], R: float) -> NDArray[Any]:
    """Returns a sphere's place before another sphere, as that is no wall but on one line.

    φ = (|d|² − R²)/2R, with d from one center to the other and R the sum of radii: zero where they
    touch, and with the gradient of the distance there, n = d/R. Elsewhere it is |d| − R times
    (|d| + R)/2R.
    """
    x, y, height = place
    if x.EqualTo(Expression(0.0)) and y.EqualTo(Expression(0.0)):
        return place
    distance = (x**2 + y**2 + (height + R) ** 2 - R**2) / (2 * R)
    return tidy(np.array([Expression(0.0), Expression(0.0), distance]))
