"""What contacts push with: impulses that return a part of the speed, or springs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from pydrake.geometry import GeometryId, SceneGraph

from drake_aigto.arrays import ArrayRecord, Floats, read_only
from drake_aigto.errors import ModelError
from drake_aigto.world.material import COMPLIANCE, read_dissipation, read_stiffness
from drake_aigto.world.reach import ReachableFace

# Centers of spheres that rounding has brought nearer than a micron count as that far apart [m²].
NO_ROOM = 1e-12


@dataclass(frozen=True, eq=False)
class RigidLaw(ArrayRecord):
    """Walls that nothing enters, and impacts that last no time: φ̇⁺ = −e φ̇⁻, |p_t| ≤ μ p_n.

    Attributes:
        restitution: e of each contact, shape (m,), in [0, 1].
        friction: μ of each contact, shape (m,); none given: zero.
    """

    restitution: Floats
    friction: Floats = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Makes the arrays read-only."""
        if not len(self.friction):
            object.__setattr__(self, "friction", read_only(np.zeros_like(self.restitution)))
        for name in ("restitution", "friction"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def rubs(self) -> bool:
        """Whether any contact has friction."""
        return bool(self.friction.any())


@dataclass(frozen=True, eq=False)
class CompliantLaw(ArrayRecord):
    """Springs with Hunt-Crossley's dissipation and friction, as Drake's point contact has them.

        f = k x max(0, 1 + d ẋ),    x = max(0, −φ),    ẋ = −φ̇,    f_t = −μ f σ(s / v_s)

    Of two shapes k = k₁ k₂ / (k₁ + k₂) and d = (k₂ d₁ + k₁ d₂) / (k₁ + k₂). Of two spheres that
    move about each other, whose φ = (l² − R²) / 2R is not the distance l − R of their surfaces
    (l from center to center, R the sum of radii), that distance takes the place of φ above, and f
    is the force times R/l = ∂l/∂φ, so that Jᵀ f is what acts.

    Attributes:
        stiffness: k of each contact, shape (m,) [N/m].
        dissipation: d of each contact, shape (m,) [s/m].
        friction: μ of each contact, shape (m,); none given: zero.
        reaches: R of two spheres that move about each other, else 0, shape (m,) [m]; none given:
            zero.
    """

    stiffness: Floats
    dissipation: Floats
    friction: Floats = field(default_factory=lambda: np.zeros(0))
    reaches: Floats = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Makes the arrays read-only."""
        for name in ("friction", "reaches"):
            if not len(getattr(self, name)):
                object.__setattr__(self, name, np.zeros_like(self.stiffness))
        for name in ("stiffness", "dissipation", "friction", "reaches"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @classmethod
    def of(cls, scene_graph: SceneGraph, reachable: Sequence[ReachableFace]) -> CompliantLaw:
        """Returns that of the shapes, with what the model says of them.

        Raises:
            ModelError: a shape lacks stiffness or dissipation; or f is not what Drake simulates: of
                several faces of one box, and where both shapes are hydroelastic.
        """
        for each in reachable:
            _check_simulated(scene_graph, each)
        shapes = [each.face.shapes for each in reachable]
        dissipation = [_combine_dissipation(scene_graph, pair) for pair in shapes]
        reaches = np.array([each.reach for each in reachable])
        stiffness = calc_stiffness(scene_graph, shapes)
        return cls(stiffness, np.array(dissipation), reaches=reaches)

    @property
    def rubs(self) -> bool:
        """Whether any contact has friction."""
        return bool(self.friction.any())

    def calc_forces(self, distances: Floats, rates: Floats) -> Floats:
        """Returns f, shape (…, m) [N], given φ (…, m) [m] and φ̇ (…, m) [m/s]."""
        gaps, speeds, levers = self.find_gaps(distances, rates)
        depths = np.maximum(0.0, -gaps)
        return self.stiffness * depths * np.maximum(0.0, 1.0 - self.dissipation * speeds) * levers

    def find_gaps(self, distances: Floats, rates: Floats) -> tuple[Floats, Floats, Floats]:
        """Returns distances of surfaces [m], their rates [m/s] and ∂l/∂φ, shape (…, m) each.

        Args:
            distances: φ, shape (…, m) [m].
            rates: φ̇, shape (…, m) [m/s].
        """
        levers = calc_levers(self.reaches, distances)
        if not self.reaches.any():
            return distances, rates, levers
        gaps = np.where(self.reaches > 0, self.reaches / levers - self.reaches, distances)
        return gaps, rates * levers, levers


def calc_levers(reaches: Floats, distances: Floats) -> Floats:
    """Returns R/l = ∂l/∂φ of two spheres that move about each other, else 1, shape (…, m).

    Args:
        reaches: see `CompliantLaw`, shape (m,) [m].
        distances: φ, shape (…, m) [m].
    """
    R, levers = reaches, np.ones_like(distances)
    apart = np.sqrt(np.maximum(R**2 + 2 * R * distances, NO_ROOM))
    return np.divide(R, apart, out=levers, where=R > 0)


ContactLaw: TypeAlias = RigidLaw | CompliantLaw


def calc_stiffness(
    scene_graph: SceneGraph, shapes: Iterable[tuple[GeometryId, GeometryId]]
) -> Floats:
    """Returns the stiffness of pairs of shapes in series, k₁ k₂ / (k₁ + k₂), shape (m,) [N/m].

    Raises:
        ModelError: a shape has none.
    """
    pairs = ([read_stiffness(scene_graph, shape) for shape in pair] for pair in shapes)
    return read_only([1 / sum(1 / k for k in pair) for pair in pairs])


def _combine_dissipation(scene_graph: SceneGraph, shapes: tuple[GeometryId, GeometryId]) -> float:
    """Returns (k₂ d₁ + k₁ d₂) / (k₁ + k₂) [s/m]."""
    k1, k2 = (read_stiffness(scene_graph, shape) for shape in shapes)
    d1, d2 = (read_dissipation(scene_graph, shape) for shape in shapes)
    return (k2 * d1 + k1 * d2) / (k1 + k2)


def _check_simulated(scene_graph: SceneGraph, reachable: ReachableFace) -> None:
    """Refuses a contact of which Drake's force is another function than ours."""
    face, contact = reachable.face, reachable.contact
    inspector: Any = scene_graph.model_inspector()
    of_shapes = (inspector.GetProximityProperties(shape) for shape in face.shapes)
    if contact.name != face.pair:
        got, remedy = "a box of which several faces can be reached", "Make it of half spaces."
    elif all(each.HasProperty(*COMPLIANCE) for each in of_shapes):
        got = "hydroelastic shapes, whose force is that of a pressure field"
        remedy = "Leave <drake:compliant_hydroelastic> or <drake:rigid_hydroelastic> out of one."
    else:
        return
    expected = "a sphere against a half space, or against one face of a box"
    raise ModelError(f"compliant contact of {face.pair}", got, expected, remedy)
