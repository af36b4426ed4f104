"""Materials of shapes, as Drake's plant uses them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.geometry import GeometryId, ProximityProperties, RoleAssign, SceneGraph, SourceId
from pydrake.multibody.plant import (
    CalcContactFrictionFromSurfaceProperties,
    CoulombFriction,
    MultibodyPlant,
)
from pydrake.systems.framework import Context, Diagram

from drake_aigto.arrays import Floats, read_only
from drake_aigto.errors import ModelError
from drake_aigto.world.diagram import create_root
from drake_aigto.world.pairs import ReachableFace

FRICTION = ("material", "coulomb_friction")
STIFFNESS = ("material", "point_contact_stiffness")
DISSIPATION = ("material", "hunt_crossley_dissipation")
_COMPLIANCE = ("hydroelastic", "compliance_type")

# Property → what Drake takes where a model gives none, and what to write for it.
_UNGIVEN = {
    STIFFNESS: (
        "so Drake's default, which hardly rebounds",
        "stiffness: {}",
        "2e9 N/m for contact: rigid, far less for compliant contact, such as 1e4",
    ),
    DISSIPATION: (
        "so Drake's default, 50 s/m",
        "dissipation: 0",
        "0 s/m for a wall that returns all energy",
    ),
}


class SpringMaterial(NamedTuple):
    """Numbers of compliant contacts, shape (m,) each (`CompliantLaw` has the letters)."""

    stiffness: Floats  # k [N/m]
    dissipation: Floats  # d [s/m]
    reaches: Floats  # R of two spheres that move about each other, else 0 [m]


def read_springs(scene_graph: SceneGraph, reachable: Sequence[ReachableFace]) -> SpringMaterial:
    """Returns stiffness and dissipation of contacts as their shapes have it.

        k = k₁ k₂ / (k₁ + k₂),    d = (k₂ d₁ + k₁ d₂) / (k₁ + k₂)

    Raises:
        ModelError: a shape lacks stiffness or dissipation; or the force is not what Drake
            simulates: of several faces of one box, and where both shapes are hydroelastic.
    """
    for each in reachable:
        _check_simulated(scene_graph, each)
    springs = combine_springs(
        scene_graph, [(each.face.pair, each.face.shapes) for each in reachable]
    )
    return springs._replace(reaches=np.array([each.reach for each in reachable]))


def combine_springs(
    scene_graph: SceneGraph, pairs: Sequence[tuple[str, tuple[GeometryId, GeometryId]]]
) -> SpringMaterial:
    """Returns the same of named pairs of shapes, whatever they are; reaches are 0.

    Raises:
        ModelError: a shape lacks stiffness or dissipation, or both shapes are hydroelastic.
    """
    stiffness, dissipation = [], []
    for name, shapes in pairs:
        _check_points(scene_graph, name, shapes)
        (k1, d1), (k2, d2) = (read_given(scene_graph, shape, *_UNGIVEN) for shape in shapes)
        stiffness.append(1 / (1 / k1 + 1 / k2))
        dissipation.append((k2 * d1 + k1 * d2) / (k1 + k2))
    return SpringMaterial(read_only(stiffness), np.array(dissipation), np.zeros(len(pairs)))


def read_stiffness(scene_graph: SceneGraph, reachable: Sequence[ReachableFace]) -> Floats:
    """Returns k₁ k₂ / (k₁ + k₂) of contacts, shape (m,) [N/m].

    Raises:
        ModelError: a shape has none.
    """
    pairs = [
        [read_given(scene_graph, shape, STIFFNESS)[0] for shape in each.face.shapes]
        for each in reachable
    ]
    return read_only([1 / sum(1 / k for k in pair) for pair in pairs])


def read_property(
    scene_graph: SceneGraph, shape: GeometryId, name: tuple[str, str]
) -> float | None:
    """Returns the stiffness [N/m] or the dissipation [s/m] of a shape; None where none is given."""
    inspector: Any = scene_graph.model_inspector()
    properties = inspector.GetProximityProperties(shape)
    return float(properties.GetProperty(*name)) if properties.HasProperty(*name) else None


def read_materials(
    scene_graph: SceneGraph, shapes: Iterable[GeometryId]
) -> tuple[float | None, ...]:
    """Returns the stiffness of shapes, then their dissipation; None where none is given."""
    names = STIFFNESS, DISSIPATION
    return tuple(read_property(scene_graph, shape, name) for name in names for shape in shapes)


def read_given(scene_graph: SceneGraph, shape: GeometryId, *names: tuple[str, str]) -> list[float]:
    """Returns properties of a shape that has to have them.

    Raises:
        ModelError: the model lacks some; all of them are named.
    """
    found = {name: read_property(scene_graph, shape, name) for name in names}
    if lacking := [name for name, value in found.items() if value is None]:
        defaults, entries, usual = zip(*(_UNGIVEN[name] for name in lacking), strict=True)
        inspector: Any = scene_graph.model_inspector()
        body = inspector.GetName(inspector.GetFrameId(shape))
        # Only compliant contact asks for dissipation, too.
        given = ", ".join(entries).format("1e4" if DISSIPATION in names else "2e9")
        missing = zip((name[1].split("_")[-1] for name in lacking), defaults, strict=True)
        raise ModelError(
            f"collision shape {inspector.GetName(shape)!r} of {body!r}",
            got="; ".join(f"no {each}, {default}" for each, default in missing),
            expected=" and ".join(f"<drake:{name[1]}>" for name in lacking),
            remedy="Give both shapes theirs, in the model or by the scenario's material: "
            f"{{'*': {{{given}}}}}: {'; '.join(usual)}.",
        )
    return [value for value in found.values() if value is not None]


def read_material(scene_graph: SceneGraph, root: Context, shape: GeometryId) -> ProximityProperties:
    """Returns a shape's properties in a context, with Drake's defaults for those it lacks."""
    context = scene_graph.GetMyContextFromRoot(root)
    query: Any = scene_graph.get_query_output_port().Eval(context)
    return ProximityProperties(query.inspector().GetProximityProperties(shape))


def set_material(
    scene_graph: SceneGraph,
    source: SourceId,
    root: Context,
    shape: GeometryId,
    name: tuple[str, str],
    value: object,
) -> None:
    """Changes a property of a shape, in this context only, unless it has that value already."""
    properties = read_material(scene_graph, root, shape)
    if properties.HasProperty(*name) and properties.GetProperty(*name) == value:
        return
    properties.UpdateProperty(*name, value)
    context = scene_graph.GetMyMutableContextFromRoot(root)
    scene_graph.AssignRole(context, source, shape, properties, RoleAssign.kReplace)


def change_material(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    shape: GeometryId,
    values: Mapping[tuple[str, str], object],
) -> None:
    """Changes properties of a shape, in the model; values that are None stay."""
    inspector: Any = scene_graph.model_inspector()
    properties = ProximityProperties(inspector.GetProximityProperties(shape))
    for name, value in values.items():
        if value is not None:
            properties.UpdateProperty(*name, value)
    source: Any = plant.get_source_id()
    scene_graph.AssignRole(source, shape, properties, RoleAssign.kReplace)


def read_frictions(
    scene_graph: SceneGraph, diagram: Diagram, pairs: Iterable[tuple[GeometryId, GeometryId]]
) -> list[float]:
    """Returns the dynamic μ of pairs of shapes, 2 μ₁ μ₂ / (μ₁ + μ₂), with defaults of Drake."""
    root = create_root(diagram)  # Drake's defaults are in contexts only.
    found = []
    for pair in pairs:
        materials = [read_material(scene_graph, root, shape) for shape in pair]
        # What `GetProperty` returns lives no longer than the properties.
        surfaces = [material.GetProperty(*FRICTION) for material in materials]
        found.append(CalcContactFrictionFromSurfaceProperties(*surfaces).dynamic_friction())
    return found


def scale_friction(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    diagram: Diagram,
    shapes: Iterable[GeometryId],
    factor: float,
) -> None:
    """Gives shapes times as large coefficients of friction, in the model."""
    root = create_root(diagram)  # Drake's defaults are in contexts only.
    for shape in dict.fromkeys(shapes):
        material = read_material(scene_graph, root, shape)
        own = material.GetProperty(*FRICTION)  # It lives no longer than the properties.
        value = CoulombFriction(factor * own.static_friction(), factor * own.dynamic_friction())
        change_material(plant, scene_graph, shape, {FRICTION: value})


def impose_friction(
    scene_graph: SceneGraph,
    source: SourceId,
    root: Context,
    shapes: Iterable[GeometryId],
    friction: float | None,
) -> None:
    """Gives shapes one coefficient for sticking and sliding, in this context only.

    Args:
        scene_graph: of the shapes.
        source: of the shapes, the plant's.
        root: of the whole diagram.
        shapes: that slide.
        friction: μ; None: static coefficients become the dynamic ones.
    """
    for shape in dict.fromkeys(shapes):
        properties = read_material(scene_graph, root, shape)
        own = properties.GetProperty(*FRICTION)  # It lives no longer than the properties.
        value = own.dynamic_friction() if friction is None else friction
        if (own.static_friction(), own.dynamic_friction()) != (value, value):
            material = CoulombFriction(value, value)
            set_material(scene_graph, source, root, shape, FRICTION, material)


def _check_simulated(scene_graph: SceneGraph, reachable: ReachableFace) -> None:
    """Refuses a contact of which Drake's force is another function than `CompliantLaw`'s."""
    face, contact = reachable.face, reachable.contact
    if contact.name == face.pair:
        _check_points(scene_graph, face.pair, face.shapes)
        return
    inspector: Any = scene_graph.model_inspector()
    got = "a box of which several faces can be reached"
    remedy = (
        "Take contact: rigid, where the face before the sphere counts; or give joints limits "
        "that keep the sphere before one face; or put spheres at the box's corners, and leave "
        f"it out by ignored_shapes: [{inspector.GetName(face.shapes[1])}]."
    )
    expected = "a sphere against a half space, or against one face of a box"
    raise ModelError(f"compliant contact of {face.pair}", got, expected, remedy)


def _check_points(
    scene_graph: SceneGraph, name: str, shapes: tuple[GeometryId, GeometryId]
) -> None:
    """Refuses two hydroelastic shapes, which do not touch in a point."""
    inspector: Any = scene_graph.model_inspector()
    of_shapes = (inspector.GetProximityProperties(shape) for shape in shapes)
    if all(each.HasProperty(*_COMPLIANCE) for each in of_shapes):
        raise ModelError(
            f"compliant contact of {name}",
            got="hydroelastic shapes, whose force is that of a pressure field",
            expected="point contact",
            remedy="Leave <drake:compliant_hydroelastic> or <drake:rigid_hydroelastic> out of one.",
        )
