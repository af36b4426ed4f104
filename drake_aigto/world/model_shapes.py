"""Collision shapes of a parsed model: names, materials, ends of capsules, and pairs kept apart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydrake.geometry import (
    Capsule,
    CollisionFilterDeclaration,
    GeometryId,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    Role,
    RoleAssign,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant

from drake_aigto.errors import ModelError
from drake_aigto.world.material import FRICTION
from drake_aigto.world.model_facts import ModelFacts, fits
from drake_aigto.world.model_fields import Material
from drake_aigto.world.pair_errors import END, name_pair
from drake_aigto.world.pairs import list_pairs, order_pair
from drake_aigto.world.space_pairs import order_shapes


def set_materials(
    plant: MultibodyPlant, scene_graph: SceneGraph, materials: Mapping[str, Material]
) -> None:
    """Replaces materials of collision shapes, by names or globs."""
    shapes = name_shapes(plant, scene_graph)
    for glob, material in materials.items():
        for shape in pick_shapes("material", [glob], shapes):
            inspector: Any = scene_graph.model_inspector()
            properties = ProximityProperties(inspector.GetProximityProperties(shape))
            given = {
                "point_contact_stiffness": material.stiffness,
                "hunt_crossley_dissipation": material.dissipation,
                "restitution": material.restitution,
                "coulomb_friction": None
                if material.friction is None
                else CoulombFriction(material.friction, material.friction),
            }
            for name, value in given.items():
                if value is not None:
                    properties.UpdateProperty("material", name, value)
            source = plant.get_source_id()
            scene_graph.AssignRole(source, shape, properties, RoleAssign.kReplace)


def name_shapes(
    plant: MultibodyPlant, scene_graph: SceneGraph
) -> dict[GeometryId, tuple[str, str]]:
    """Returns the names of collision shapes: model::shape and model::link::shape."""
    inspector: Any = scene_graph.model_inspector()
    found = {}
    for shape in inspector.GetAllGeometryIds(Role.kProximity):
        full = inspector.GetName(shape).partition(END)[0]
        model, _, name = full.rpartition("::")
        body = plant.GetBodyFromFrameId(inspector.GetFrameId(shape))
        found[shape] = full, f"{model}::{body.name()}::{name}"
    return found


def pick_shapes(
    what: str, globs: tuple[str, ...] | list[str], shapes: dict[GeometryId, tuple[str, str]]
) -> list[GeometryId]:
    """Returns the collision shapes that names or globs choose.

    Raises:
        ModelError: one fits no shape; or a name, which is no glob, fits several.
    """
    found: dict[GeometryId, None] = {}
    known = ", ".join(sorted(full for full, _ in shapes.values())) or "(none)"
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


def keep_apart(plant: MultibodyPlant, scene_graph: SceneGraph, facts: ModelFacts) -> None:
    """Keeps pairs of shapes from colliding, by their names."""
    shapes = {
        full.split("::")[-1]: each for each, (full, _) in name_shapes(plant, scene_graph).items()
    }
    apart = [pair for pair in facts.apart if not set(pair) - set(shapes)]
    _exclude(scene_graph, [(shapes[one], shapes[other]) for one, other in apart])


def _exclude(scene_graph: SceneGraph, pairs: list[tuple[GeometryId, GeometryId]]) -> None:
    """Keeps pairs of shapes from colliding."""
    apart: dict[GeometryId, list[GeometryId]] = {}
    for shape, other in pairs:
        apart.setdefault(shape, []).append(other)
    for shape, others in apart.items():
        filtered = CollisionFilterDeclaration().ExcludeBetween(
            GeometrySet([shape]), GeometrySet(others)
        )
        scene_graph.collision_filter_manager().Apply(filtered)


def add_ends(plant: MultibodyPlant, scene_graph: SceneGraph) -> dict[GeometryId, list[GeometryId]]:
    """Adds a sphere at both ends of each capsule, as far as it may touch; returns them by capsule.

    A capsule touches a half space with its ends alone, whatever its pose.
    """
    inspector: Any = scene_graph.model_inspector()
    found = {}
    for shape in inspector.GetAllGeometryIds(Role.kProximity):
        capsule = inspector.GetShape(shape)
        if not isinstance(capsule, Capsule):
            continue
        # What the inspector returns lives until the next shape is registered.
        half, radius = capsule.length() / 2, capsule.radius()
        X_BG = RigidTransform(inspector.GetPoseInFrame(shape))
        properties = ProximityProperties(inspector.GetProximityProperties(shape))
        name = inspector.GetName(shape).rpartition("::")[2]
        found[shape] = [
            plant.RegisterCollisionGeometry(
                plant.GetBodyFromFrameId(inspector.GetFrameId(shape)),
                X_BG @ RigidTransform([0.0, 0.0, z]),
                Sphere(radius),
                f"{name}{END}{number}",
                properties,
            )
            for number, z in ((1, -half), (2, half))
        ]
    return found


def choose_ends(
    scene_graph: SceneGraph, ends: dict[GeometryId, list[GeometryId]], facts: ModelFacts
) -> None:
    """Lets the ends of a capsule touch half spaces, and the capsule all else.

    Pairs that can't be planned for are kept apart if that is allowed.
    """
    inspector: Any = scene_graph.model_inspector()
    capsule_of = {end: capsule for capsule, pair in ends.items() for end in pair}
    shapes = inspector.GetAllGeometryIds(Role.kProximity)
    kind_of = {shape: type(inspector.GetShape(shape)) for shape in shapes}
    apart = []
    for pair in list_pairs(inspector):
        kinds = [kind_of[shape] for shape in pair]
        is_end = any(shape in capsule_of for shape in pair)
        if HalfSpace in kinds and (is_end or Capsule in kinds):
            is_kept = is_end
        elif is_end:
            is_kept = False
        else:
            is_kept = order_pair(inspector, *pair) is not None
            if not is_kept:
                if "pairs" not in facts.fields.allow_ignored:
                    continue
                _refuse(inspector, pair, facts)
        if not is_kept:
            apart.append(pair)
    _exclude(scene_graph, apart)


def leave_pairs_out(scene_graph: SceneGraph, facts: ModelFacts) -> None:
    """Keeps pairs apart whose distance is not known in space, if that is allowed."""
    inspector: Any = scene_graph.model_inspector()
    for pair in list_pairs(inspector) if "pairs" in facts.fields.allow_ignored else []:
        if order_shapes(inspector, pair) is None:
            _refuse(inspector, pair, facts)
            _exclude(scene_graph, [pair])


def _refuse(inspector: Any, pair: tuple[GeometryId, GeometryId], facts: ModelFacts) -> None:
    """Refuses the contact of a pair, or counts it as left out."""
    names = " and ".join(map(inspector.GetName, pair))
    facts.refuse("pairs", f"contact of {names}", "they pass through each other")


def note_unlike_friction(scene_graph: SceneGraph, facts: ModelFacts) -> None:
    """Notes pairs of an MJCF for which MuJoCo would combine friction otherwise than Drake does."""
    inspector: Any = scene_graph.model_inspector()
    found = []
    for pair in list_pairs(inspector):
        materials = map(inspector.GetProximityProperties, pair)
        frictions = {each.GetProperty(*FRICTION).dynamic_friction() for each in materials}
        if len(frictions) > 1 and order_pair(inspector, *pair) is not None:
            found.append(name_pair(inspector, pair))
    if found:
        facts.notes.append(
            "2 μ₁ μ₂ / (μ₁ + μ₂) counts where two shapes' friction differs, not the larger μ or "
            f"that of the higher priority, as in MuJoCo: {'; '.join(dict.fromkeys(found))}"
        )
