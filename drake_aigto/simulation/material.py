"""What a contact is made of in Drake: stiffness, and dissipation for a given restitution."""

from __future__ import annotations

import math

import numpy as np
import scipy  # Not scipy.optimize, which takes a tenth of a second and few need.
from pydrake.geometry import GeometryId
from pydrake.systems.framework import Context

from drake_aigto.arrays import Floats
from drake_aigto.simulation.contact_motion import ContactMotion
from drake_aigto.world import World
from drake_aigto.world.material import (
    DISSIPATION,
    STIFFNESS,
    find_anywhere,
    read_stiffness,
    set_material,
)

# No finite dissipation takes all of the speed; below this restitution it is this.
LEAST_RESTITUTION = 1e-3
# This close to 1 the equation for the dissipation cancels, and its series is exact to 1e-8.
_NEARLY_ELASTIC = 1e-4


def contact_delay(world: World) -> float:
    """Returns how long an elastic contact of the world lasts at most, π √(m / k) [s].

    A rigid wall turns the ball round at once. Drake's compliant one, of stiffness k = k₁ k₂ /
    (k₁ + k₂), keeps it for half a period of m = (J_i M⁻¹ J_iᵀ)⁻¹ on a spring, which delays all
    that follows.

    Raises:
        ModelError: a shape has no stiffness.
    """
    return max(contact_delays(world), default=0.0)


def contact_delays(world: World, q: Floats | None = None) -> list[float]:
    """Returns `contact_delay` of each contact [s].

    Where m depends on q it is the one there; without q, the smaller one of two positions, as at
    either a link may be stretched out along a wall's normal, and be felt as a mass without end.
    """
    reader = ContactMotion.reader(world)
    places = (world.plant.GetDefaultPositions(), find_anywhere(world.plant)) if q is None else (q,)
    motions = [reader(np.concatenate([place, np.zeros(len(place))])) for place in places]
    delays = [calc_delays(motion, world.stiffness) for motion in motions]
    return np.min(delays, axis=0).tolist()


def calc_delays(motion: ContactMotion, stiffness: Floats, longest: float = math.inf) -> list[float]:
    """Returns how long contacts of stiffness (m,) [N/m] last here, at most the longest [s]."""
    pairs = zip(motion.masses, stiffness, strict=True)
    return [min(math.pi * math.sqrt(m / k), longest) for m, k in pairs]


def calc_dissipation(restitution: float, speed: float) -> float:
    """Returns the Hunt-Crossley dissipation that makes an impact's restitution e [s/m].

    With f = k x (1 + d ẋ) an impact at speed v > 0 [m/s] returns e v where y = d v solves

        y − ln(1 + y) = −e y − ln(1 − e y)

    so that it depends on the speed: other impacts have another restitution. Below 1e-3, e is
    taken for that.
    """
    e = max(restitution, LEAST_RESTITUTION)
    if 1 - e < _NEARLY_ELASTIC:
        return 1.5 * (1 - e**2) / (1 + e**3) / speed

    def excess(z: float) -> float:
        # With z = −ln(1 − e y), which stays apart from its end where e y is 1 to rounding.
        y = -math.expm1(-z) / e
        return y - math.log1p(y) + e * y - z

    z = scipy.optimize.brentq(excess, _NEARLY_ELASTIC / 10, 2 / e + 2, xtol=1e-15)
    return -math.expm1(-z) / e / speed


def set_dissipation(world: World, root: Context, contact: int, dissipation: float) -> None:
    """Gives a contact a Hunt-Crossley dissipation [s/m], in this context only.

    Drake weighs those of the two shapes by the other one's stiffness. Where one shape belongs to
    other contacts too, as a ball between walls, its own becomes 0 and the other one's makes up for
    it, so that no other contact which is going on is another.
    """
    shapes = world.shapes[contact]
    k = [read_stiffness(world.scene_graph, shape) for shape in shapes]
    alone = [_is_alone(world, shape) for shape in shapes]
    values = [dissipation, dissipation]
    if alone[0] != alone[1]:
        own = alone.index(True)
        values[1 - own] = 0.0
        values[own] = dissipation * (k[0] + k[1]) / k[1 - own]
    source = world.plant.get_source_id()
    for shape, value in zip(shapes, values, strict=True):
        set_material(world.scene_graph, source, root, shape, DISSIPATION, value)


def set_stiffness(world: World, root: Context, contact: int, factor: float) -> None:
    """Gives a contact this part, at most 1, of its own stiffness, in this context only.

    Where one shape belongs to other contacts too, the other one yields for both, so that no other
    contact is another. Where both do, nothing is changed.
    """
    shapes = [shape for shape in world.shapes[contact] if _is_alone(world, shape)]
    whole = world.stiffness[contact]
    source = world.plant.get_source_id()
    for shape in shapes:
        k = read_stiffness(world.scene_graph, shape)
        # 1/k of all is (Σ 1/k_i): what is added to it falls to those that may yield.
        value = 1 / (1 / k + (1 / factor - 1) / whole / len(shapes))
        set_material(world.scene_graph, source, root, shape, STIFFNESS, value)


def _is_alone(world: World, shape: GeometryId) -> bool:
    """Returns whether a shape can touch but one other."""
    return sum(shape in pair for pair in set(world.shapes)) == 1
