"""What shapes are made of, as Drake's plant uses it; and where friction acts."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.geometry import GeometryId, ProximityProperties, RoleAssign, SceneGraph, SourceId
from pydrake.multibody.plant import (
    CalcContactFrictionFromSurfaceProperties,
    CoulombFriction,
    MultibodyPlant,
)
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.framework import Context

from drake_aigto.arrays import Floats
from drake_aigto.errors import ModelError
from drake_aigto.world.contact import SphereAndFace

FRICTION = ("material", "coulomb_friction")
STIFFNESS = ("material", "point_contact_stiffness")
COMPLIANCE = ("hydroelastic", "compliance_type")
DISSIPATION = ("material", "hunt_crossley_dissipation")

# Rates along a face below this part of the largest entry are rounding.
_ROUNDING = 1e-9
# By how much positions differ from their defaults where nothing cancels by chance.
_ANYWHERE = 0.37


def read_friction(
    plant: MultibodyPlant, scene_graph: SceneGraph, root: Context, face: SphereAndFace
) -> CoulombFriction:
    """Returns the friction that acts on a sphere at a face.

    It is what the plant computes with, μ = 2 μ₁ μ₂ / (μ₁ + μ₂): of a shape that gives none, Drake's
    default, which is in contexts only. Where the sphere can't move along the face, as a ball on a
    line across it, friction has nothing to act on, and both coefficients are 0.
    """
    materials = [read_material(scene_graph, root, shape) for shape in face.shapes]
    # What `GetProperty` returns lives no longer than the properties.
    surfaces = [material.GetProperty(*FRICTION) for material in materials]
    friction = CalcContactFrictionFromSurfaceProperties(*surfaces)
    # The dynamic one is never the larger of the two.
    acts = friction.static_friction() > 0 and can_slide(plant, face)
    return friction if acts else CoulombFriction(0.0, 0.0)


def can_slide(plant: MultibodyPlant, face: SphereAndFace) -> bool:
    """Returns whether a sphere's point of contact can move along the face."""
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, find_anywhere(plant))
    body, wall = face.sphere_body.body_frame(), face.face_body.body_frame()
    edges, normal = np.split(face.X_BF.rotation().matrix(), [2], axis=1)
    normal = plant.CalcRelativeTransform(context, body, wall).rotation().matrix() @ normal
    touch = face.p_SC - face.radius * normal[:, 0]
    rates = plant.CalcJacobianTranslationalVelocity(
        context, JacobianWrtVariable.kV, body, touch, wall, wall
    )
    along = edges.T @ rates
    return bool(np.any(np.abs(along) > _ROUNDING * np.max(np.abs(rates), initial=0.0)))


def find_anywhere(plant: MultibodyPlant) -> Floats:
    """Returns positions at which nothing cancels by chance, as it may at the default ones, (nq,).

    There an arm may be stretched out along the normal of a wall.
    """
    return plant.GetDefaultPositions() + _ANYWHERE * np.arange(1, plant.num_positions() + 1)


def set_friction(
    scene_graph: SceneGraph,
    source: SourceId,
    root: Context,
    shape: GeometryId,
    friction: float | None,
) -> None:
    """Gives a shape one coefficient of friction, in this context only; None: its dynamic one."""
    if friction is None:
        own = read_material(scene_graph, root, shape).GetProperty(*FRICTION)
        friction = own.dynamic_friction()
    value = CoulombFriction(friction, friction)
    set_material(scene_graph, source, root, shape, FRICTION, value)


def read_stiffness(scene_graph: SceneGraph, shape: GeometryId) -> float:
    """Returns the stiffness that a model gives a shape [N/m].

    Raises:
        ModelError: it gives none.
    """
    remedy = "Give both shapes theirs: 2e9 N/m for a nearly rigid wall, less for a soft one."
    return _read_given(
        scene_graph, shape, STIFFNESS, "so Drake's default, which hardly rebounds", remedy
    )


def read_dissipation(scene_graph: SceneGraph, shape: GeometryId) -> float:
    """Returns the Hunt-Crossley dissipation that a model gives a shape [s/m].

    Raises:
        ModelError: it gives none.
    """
    remedy = "Give both shapes theirs: 0 s/m, for a wall that returns all energy."
    return _read_given(scene_graph, shape, DISSIPATION, "so Drake's default, 50 s/m", remedy)


def read_materials(
    scene_graph: SceneGraph, shapes: tuple[GeometryId, GeometryId]
) -> tuple[float | None, ...]:
    """Returns stiffness and dissipation that a model gives two shapes; None where it gives none."""
    inspector: Any = scene_graph.model_inspector()
    materials = [inspector.GetProximityProperties(shape) for shape in shapes]
    return tuple(
        float(each.GetProperty(*name)) if each.HasProperty(*name) else None
        for name in (STIFFNESS, DISSIPATION)
        for each in materials
    )


def _read_given(
    scene_graph: SceneGraph, shape: GeometryId, name: tuple[str, str], default: str, remedy: str
) -> float:
    """Returns a property that a shape has to have of its own."""
    inspector: Any = scene_graph.model_inspector()
    properties = inspector.GetProximityProperties(shape)
    if not properties.HasProperty(*name):
        raise ModelError(
            f"collision shape {inspector.GetName(shape)!r}",
            got=f"no {name[1].split('_')[-1]}, {default}",
            expected=f"<drake:{name[1]}>",
            remedy=remedy,
        )
    return float(properties.GetProperty(*name))


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
