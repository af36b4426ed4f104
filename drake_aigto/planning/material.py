"""What a contact is made of in Drake: stiffness, and dissipation for a given restitution."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from pydrake.geometry import GeometryId, ProximityProperties, RoleAssign
from scipy.optimize import brentq

from drake_aigto.errors import ModelError
from drake_aigto.planning.contact_motion import ContactMotion

if TYPE_CHECKING:
    import numpy.typing as npt
    from pydrake.systems.framework import Context

    from drake_aigto.world import World

_STIFFNESS = ("material", "point_contact_stiffness")
_DISSIPATION = ("material", "hunt_crossley_dissipation")

# No finite dissipation takes all of the speed; below this restitution it is this.
LEAST_RESTITUTION = 1e-3
# This close to 1 the equation for the dissipation cancels, and its series is exact to 1e-8.
_NEARLY_ELASTIC = 1e-4


def contact_delay(world: World, q: npt.NDArray[np.float64] | None = None) -> float:
    """Returns how long an elastic contact lasts, π √(m / k) [s].

    A rigid wall turns the ball round at once. Drake's compliant one, of stiffness k, keeps it for
    half a period of mass m on spring k, which delays all that follows.

    Args:
        world: k = k₁ k₂ / (k₁ + k₂) comes from the material of its two shapes, and
            m = (J M⁻¹ Jᵀ)⁻¹ from its mass matrix.
        q: where J is taken, shape (nq,) [m]; the plant's default if None.

    Raises:
        ModelError: a shape has no stiffness.
    """
    if q is None:
        q = world.plant.GetDefaultPositions()
    return math.pi * math.sqrt(ContactMotion(world).calc_mass(q) / _calc_stiffness(world))


def calc_dissipation(restitution: float, speed: float) -> float:
    """Returns the Hunt-Crossley dissipation that makes an impact's restitution e [s/m].

    With f = k x (1 + d ẋ) an impact at speed v returns e v where y = d v solves

        y − ln(1 + y) = −e y − ln(1 − e y)

    so that it depends on the speed: other impacts have another restitution.

    Args:
        restitution: e in [0, 1]; below 1e-3 it is taken for 1e-3.
        speed: v > 0 [m/s].
    """
    e = max(restitution, LEAST_RESTITUTION)
    if 1 - e < _NEARLY_ELASTIC:
        return 1.5 * (1 - e**2) / (1 + e**3) / speed

    def excess(z: float) -> float:
        # With z = −ln(1 − e y), which stays apart from its end where e y is 1 to rounding.
        y = -math.expm1(-z) / e
        return y - math.log1p(y) + e * y - z

    z = brentq(excess, _NEARLY_ELASTIC / 10, 2 / e + 2, xtol=1e-15)
    return -math.expm1(-z) / e / speed


def set_dissipation(world: World, root: Context, dissipation: float) -> None:
    """Gives both shapes of the contact a Hunt-Crossley dissipation [s/m], in this context only."""
    context = world.scene_graph.GetMyMutableContextFromRoot(root)
    inspector = world.scene_graph.model_inspector()
    for shape in _find_shapes(world):
        properties = ProximityProperties(inspector.GetProximityProperties(shape))
        properties.UpdateProperty(*_DISSIPATION, dissipation)
        world.scene_graph.AssignRole(
            context, world.plant.get_source_id(), shape, properties, RoleAssign.kReplace
        )


def _calc_stiffness(world: World) -> float:
    """Returns the stiffness of both shapes in series, k₁ k₂ / (k₁ + k₂) [N/m]."""
    inspector = world.scene_graph.model_inspector()
    compliance = 0.0
    for shape in _find_shapes(world):
        properties = inspector.GetProximityProperties(shape)
        if not properties.HasProperty(*_STIFFNESS):
            raise ModelError(
                f"collision shape {inspector.GetName(shape)!r}",
                got="no stiffness, so Drake's default, which hardly rebounds",
                expected="<drake:point_contact_stiffness>",
                remedy="Give both shapes 2e9 N/m, and <drake:hunt_crossley_dissipation> 0, for a "
                "nearly rigid, elastic wall.",
            )
        compliance += 1 / properties.GetProperty(*_STIFFNESS)
    return 1 / compliance


def _find_shapes(world: World) -> tuple[GeometryId, GeometryId]:
    """Returns the two shapes of the world's contact: those whose distance is φ."""
    root = world.create_context()
    q = world.plant.GetPositions(world.plant.GetMyContextFromRoot(root))
    (distance,) = world.calc_signed_distance(q)
    query = world.scene_graph.get_query_output_port().Eval(
        world.scene_graph.GetMyContextFromRoot(root)
    )
    candidates = world.scene_graph.model_inspector().GetCollisionCandidates()

    def error(shapes: tuple[GeometryId, GeometryId]) -> float:
        return abs(query.ComputeSignedDistancePairClosestPoints(*shapes).distance - distance)

    return min(sorted(candidates, key=lambda pair: [i.get_value() for i in pair]), key=error)
