"""Collision shapes of a parsed model: names, materials, their ends, and pairs kept apart."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    GeometryId,
    HalfSpace,
    Mesh,
    ProximityProperties,
    Role,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, WeldJoint

from drake_aigto.arrays import Floats
from drake_aigto.errors import ModelError
from drake_aigto.world.diagram import exclude
from drake_aigto.world.material import DISSIPATION, FRICTION, STIFFNESS, change_material
from drake_aigto.world.model_facts import ModelFacts, fits
from drake_aigto.world.model_fields import Material
from drake_aigto.world.pair_errors import (
    CORNER,
    END,
    IN_PLANE,
    MARK,
    find_link,
    name_pair,
    name_shape,
    refuse_pairs,
)
from drake_aigto.world.pairs import RESTITUTION, list_pairs, order_pair
from drake_aigto.world.space_parts import MOST_CORNERS, RIM

# Radius of spheres at corners, as a part of the shape's least size.
_TINY = 1e-6
# From an inspector and a pair of shapes to the same in order, or None if they can't be planned for.
Order = Callable[[Any, tuple[GeometryId, GeometryId]], tuple[GeometryId, GeometryId] | None]


def set_materials(
    plant: MultibodyPlant, scene_graph: SceneGraph, materials: Mapping[str, Material]
) -> None:
    """Replaces materials of collision shapes, by names or globs."""
    shapes = name_shapes(plant, scene_graph)
    for glob, material in materials.items():
        for shape in pick_shapes("material", [glob], shapes):
            mu = material.friction
            given = {
                STIFFNESS: material.stiffness,
                DISSIPATION: material.dissipation,
                RESTITUTION: material.restitution,
                FRICTION: None if mu is None else CoulombFriction(mu, mu),
            }
            change_material(plant, scene_graph, shape, given)


def name_shapes(
    plant: MultibodyPlant, scene_graph: SceneGraph
) -> dict[GeometryId, tuple[str, str]]:
    """Returns the names of collision shapes: model::shape and model::link::shape."""
    inspector: Any = scene_graph.model_inspector()
    found = {}
    for shape in inspector.GetAllGeometryIds(Role.kProximity):
        full = name_shape(inspector, shape)
        model, _, name = full.rpartition("::")
        found[shape] = full, f"{model}::{find_link(plant, inspector, shape).name()}::{name}"
    return found


def pick_shapes(
    what: str, globs: tuple[str, ...] | list[str], shapes: dict[GeometryId, tuple[str, str]]
) -> list[GeometryId]:
    """Returns the collision shapes that names or globs choose."""
    found: dict[GeometryId, None] = {}
    known = ", ".join(sorted({full for full, _ in shapes.values()})) or "(none)"
    for glob in globs:
        fitting = [each for each, names in shapes.items() if any(fits(n, glob) for n in names)]
        if not fitting and glob != "*":
            raise ModelError(what, got=repr(glob), expected=f"of the collision shapes {known}")
        if len({shapes[each] for each in fitting}) > 1 and not set(glob) & set("*?["):
            raise ModelError(
                what,
                got=f"{glob!r}, which fits {', '.join(shapes[each][1] for each in fitting)}",
                expected="a name of one shape, or a glob",
                remedy=f"Name it with its link, or all of them by {glob + '*'!r}.",
            )
        found.update(dict.fromkeys(fitting))
    return list(found)


def choose_pairs(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    ignored_shapes: tuple[str, ...],
    order: Order,
    expected: str = IN_PLANE,
) -> list[tuple[GeometryId, GeometryId]]:
    """Returns pairs of shapes that may collide (Drake's filters applied), in order, as a plan may.

    Pairs without an order are refused, unlike those expected.
    """
    inspector: Any = scene_graph.model_inspector()
    names = name_shapes(plant, scene_graph)
    ignored = set(pick_shapes("ignored_shapes", ignored_shapes, names))
    pairs = [pair for pair in list_pairs(inspector) if not ignored & set(pair)]
    ordered = {pair: order(inspector, pair) for pair in pairs}
    if unread := [pair for pair, found in ordered.items() if found is None]:
        raise refuse_pairs(inspector, unread, expected)
    return [found for found in ordered.values() if found]


def keep_apart(plant: MultibodyPlant, scene_graph: SceneGraph, facts: ModelFacts) -> None:
    """Keeps pairs of shapes from colliding, by their names; before shapes have ends."""
    named = name_shapes(plant, scene_graph)
    shapes = {full.rpartition("::")[2]: each for each, (full, _) in named.items()}
    apart = [pair for pair in facts.apart if not set(pair) - set(shapes)]
    _exclude_pairs(scene_graph, [(shapes[one], shapes[other]) for one, other in apart])


def _exclude_pairs(scene_graph: SceneGraph, pairs: list[tuple[GeometryId, GeometryId]]) -> None:
    """Keeps pairs of shapes from colliding."""
    others: dict[GeometryId, list[GeometryId]] = {}
    for shape, other in pairs:
        others.setdefault(shape, []).append(other)
    for shape, apart in others.items():
        exclude(scene_graph, [shape], apart)


def set_planes(
    plant: MultibodyPlant, scene_graph: SceneGraph, normals: Sequence[list[float]]
) -> None:
    """Puts half spaces where the text has marks, by their normals in the frames of these.

    They are on the world, if it holds their link. Beside a half space on a link, more than a dozen
    shapes may end the process in Drake (its issue 19263): a tree of boxes around them, which is
    built anew when it gets deep, takes no infinite box.
    """
    inspector: Any = scene_graph.model_inspector()
    poses = _find_still(plant)
    for mark in inspector.GetAllGeometryIds(Role.kProximity):
        name, _, number = inspector.GetName(mark).rpartition(MARK)
        if not (name and number.isdigit() and normals):
            continue
        turn = RotationMatrix.MakeFromOneVector(normals[int(number)], 2)
        body = plant.GetBodyFromFrameId(inspector.GetFrameId(mark))
        X_BG = RigidTransform(inspector.GetPoseInFrame(mark)) @ RigidTransform(turn, np.zeros(3))
        if body.index() in poses:
            X_BG, body = poses[body.index()] @ X_BG, plant.world_body()
        meets = set(map(frozenset, inspector.GetCollisionCandidates()))
        shapes = inspector.GetAllGeometryIds(Role.kProximity)
        apart = [each for each in shapes if frozenset((mark, each)) not in meets]
        properties = ProximityProperties(inspector.GetProximityProperties(mark))
        scene_graph.RemoveRole(plant.get_source_id(), mark, Role.kProximity)
        wall = plant.RegisterCollisionGeometry(body, X_BG, HalfSpace(), name, properties)
        exclude(scene_graph, [wall], (each for each in apart if each != mark))


def _find_still(plant: MultibodyPlant) -> dict[BodyIndex, RigidTransform]:
    """Returns poses of the world and of links welded to it, before the plant is finalized."""
    joints = (plant.get_joint(index) for index in plant.GetJointIndices())
    welds = [joint for joint in joints if isinstance(joint, WeldJoint)]
    poses = {plant.world_body().index(): RigidTransform()}
    for _ in welds:
        for weld in welds:
            parent, child = weld.parent_body().index(), weld.child_body().index()
            X_PF = weld.frame_on_parent().GetFixedPoseInBodyFrame()
            X_PC = X_PF @ weld.X_FM() @ weld.frame_on_child().GetFixedPoseInBodyFrame().inverse()
            if parent in poses:
                poses.setdefault(child, poses[parent] @ X_PC)
            elif child in poses:
                poses[parent] = poses[child] @ X_PC.inverse()
    return poses


def add_ends(
    plant: MultibodyPlant, scene_graph: SceneGraph, in_space: bool
) -> dict[GeometryId, list[GeometryId]]:
    """Adds spheres where shapes touch half spaces, whatever their pose; returns them by shape.

    These are a capsule's ends and, in space, tiny ones at rims of cylinders, and at corners of
    boxes and of convex hulls of meshes, which touch boxes and meshes, too. Drake's own touch of
    such shapes is one point, the lowest: on a face that rests, that is another one all the time.
    """
    inspector: Any = scene_graph.model_inspector()
    found = {}
    ends = _list_ends(inspector)
    if in_space:
        ends |= _list_rims(inspector) | _list_corners(inspector)
    for shape, (places, radius) in ends.items():
        # What the inspector returns lives until the next shape is registered.
        X_BG = RigidTransform(inspector.GetPoseInFrame(shape))
        properties = ProximityProperties(inspector.GetProximityProperties(shape))
        name = inspector.GetName(shape).rpartition("::")[2]
        name += END if isinstance(inspector.GetShape(shape), Capsule) else CORNER
        found[shape] = [
            plant.RegisterCollisionGeometry(
                plant.GetBodyFromFrameId(inspector.GetFrameId(shape)),
                X_BG @ RigidTransform(place),
                Sphere(radius),
                f"{name}{number}",
                properties,
            )
            for number, place in enumerate(places, 1)
        ]
    return found


# Centers of spheres in a shape's frame, shape (n, 3) [m], and their radius [m].
_Spheres: TypeAlias = tuple[Floats, float]


def _list_ends(inspector: Any) -> dict[GeometryId, _Spheres]:
    """Returns the ends of each capsule."""
    found = {}
    for shape in inspector.GetAllGeometryIds(Role.kProximity):
        if isinstance(capsule := inspector.GetShape(shape), Capsule):
            half = capsule.length() / 2
            places = np.array([[0.0, 0.0, -half], [0.0, 0.0, half]])
            found[shape] = places, float(capsule.radius())
    return found


def _list_rims(inspector: Any) -> dict[GeometryId, _Spheres]:
    """Returns points at the rims of each cylinder that may touch a half space."""
    found, angles = {}, 2 * np.pi / RIM * np.arange(RIM)
    ring = np.array([np.cos(angles), np.sin(angles)])
    for pair in inspector.GetCollisionCandidates():
        shapes = {type(inspector.GetShape(shape)): shape for shape in pair}
        if shapes.keys() != {Cylinder, HalfSpace}:
            continue
        cylinder = inspector.GetShape(shapes[Cylinder])
        radius = _TINY * float(min(2 * cylinder.radius(), cylinder.length()))
        height, around = cylinder.length() / 2 - radius, (cylinder.radius() - radius) * ring
        rims = [np.vstack([around, np.full(RIM, z)]).T for z in (-height, height)]
        found[shapes[Cylinder]] = np.vstack(rims), radius
    return found


def _list_corners(inspector: Any) -> dict[GeometryId, _Spheres]:
    """Returns the corners of each box and mesh that may touch a half space, a box or a mesh."""
    shapes = inspector.GetAllGeometryIds(Role.kProximity)
    flat = {s for s in shapes if isinstance(inspector.GetShape(s), Box | Convex | HalfSpace | Mesh)}
    pairs = map(set, inspector.GetCollisionCandidates())
    near = set[GeometryId]().union(*(pair for pair in pairs if pair <= flat))
    found = {}
    for shape in shapes:
        solid = inspector.GetShape(shape)
        if shape not in near:
            continue
        if isinstance(solid, Box):
            size = np.asarray(solid.size())
            radius = _TINY * float(np.min(size))
            signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
            found[shape] = signs * (size / 2 - radius), radius
        elif isinstance(solid, Convex | Mesh):
            hull = inspector.GetConvexHull(shape)
            corners = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
            if len(corners) <= MOST_CORNERS:
                found[shape] = corners, _TINY * float(np.min(np.ptp(corners, axis=0)))
    return found


def choose_ends(scene_graph: SceneGraph, ends: dict[GeometryId, list[GeometryId]]) -> None:
    """Lets the ends of a shape touch what it may touch with them, and the shape all else.

    Ends of capsules and rims of cylinders touch half spaces; corners boxes and meshes, too, if
    these have corners.
    """
    inspector: Any = scene_graph.model_inspector()
    shapes = inspector.GetAllGeometryIds(Role.kProximity)
    walls = {each for each in shapes if isinstance(inspector.GetShape(each), HalfSpace)}
    round_ones = Capsule | Cylinder
    solids = {each for each in ends if not isinstance(inspector.GetShape(each), round_ones)}
    meets = set(map(frozenset, inspector.GetCollisionCandidates()))
    for shape, its_ends in ends.items():
        flat = walls | solids if shape in solids else walls
        met = {each for each in flat if frozenset((shape, each)) in meets}
        exclude(scene_graph, its_ends, (each for each in shapes if each not in met))
        exclude(scene_graph, [shape], met)


def leave_pairs_out(scene_graph: SceneGraph, order: Order, facts: ModelFacts) -> None:
    """Keeps pairs apart that can't be planned for, which have no order, if that is allowed."""
    if "pairs" not in facts.fields.allow_ignored:
        return
    inspector: Any = scene_graph.model_inspector()
    apart = [pair for pair in list_pairs(inspector) if order(inspector, pair) is None]
    for pair in apart:
        names = " and ".join(map(inspector.GetName, pair))
        facts.refuse("pairs", f"contact of {names}", "they pass through each other")
    _exclude_pairs(scene_graph, apart)


def note_unlike_friction(scene_graph: SceneGraph, facts: ModelFacts) -> None:
    """Notes pairs of an MJCF for which MuJoCo would combine friction otherwise than Drake does."""
    inspector: Any = scene_graph.model_inspector()
    found = []
    for pair in list_pairs(inspector):
        materials = map(inspector.GetProximityProperties, pair)
        frictions = {each.GetProperty(*FRICTION).dynamic_friction() for each in materials}
        if len(frictions) > 1 and order_pair(inspector, pair) is not None:
            found.append(name_pair(inspector, pair))
    if found:
        facts.notes.append(
            "2 μ₁ μ₂ / (μ₁ + μ₂) counts where two shapes' friction differs, not the larger μ or "
            f"that of the higher priority, as in MuJoCo: {'; '.join(dict.fromkeys(found))}"
        )
