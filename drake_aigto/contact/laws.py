"""Contact laws: rigid ones with restitution, or springs; friction of both; numbers and kernels."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
import scipy  # Not scipy.optimize, which takes a tenth of a second and few need.

from drake_aigto.arrays import ArrayRecord, Floats, read_only
from drake_aigto.kernels import borrowing
from drake_aigto.world import Scenario, SpaceWorld, World

# Centers of spheres closer than a micron, by rounding, count as that far apart [m²].
NO_ROOM = 1e-12
# Least restitution: no finite dissipation takes all of the speed.
LEAST_RESTITUTION = 1e-3
# This close to 1 the equation for the dissipation cancels, and its series is exact to 1e-8.
_NEARLY_ELASTIC = 1e-4


class _Law(ArrayRecord):
    """What contact laws have in common: numbers of each contact, shape (m,); none given: zero."""

    friction: Floats

    def __post_init__(self) -> None:
        """Makes the arrays read-only."""
        first, *_ = vars(self).values()
        for name, value in list(vars(self).items()):
            given = value if len(value) else np.zeros_like(first)
            object.__setattr__(self, name, read_only(given))

    @property
    def has_friction(self) -> bool:
        """Whether any contact has friction."""
        return bool(self.friction.any())


@dataclass(frozen=True, eq=False)
class RigidLaw(_Law):
    """Rigid walls with instantaneous impacts: φ̇⁺ = −e φ̇⁻, |p_t| ≤ μ p_n.

    Attributes:
        restitution: e of each contact, shape (m,), in [0, 1].
        friction: μ of each contact, shape (m,); none given: zero.
    """

    restitution: Floats
    friction: Floats = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, eq=False)
class CompliantLaw(_Law):
    """Springs with Hunt-Crossley's dissipation and friction, as Drake's point contact has them.

        f = k x max(0, 1 + d ẋ),    x = max(0, −φ),    ẋ = −φ̇,    f_t = −μ f σ(s / v_s)

    Of two shapes k = k₁ k₂ / (k₁ + k₂) and d = (k₂ d₁ + k₁ d₂) / (k₁ + k₂). Of two spheres that
    move about each other, whose φ = (l² − R²) / 2R is not the distance l − R of their surfaces
    (l from center to center, R the sum of radii), that distance takes the place of φ above, and f
    is the force times R/l = ∂l/∂φ, so that Jᵀ f acts on q.

    Friction acts in the middle of the overlap. With the distance ψ of surfaces its lever about a
    sphere's center is r + ψ/2 in place of r, and l/R times that where J is R/l times too long:

        s = (T − δ W) v R/l,    δ = ψ/2 + ψ/R (r + ψ/2)    (1/R = 0 on a flat wall)

    with T of rigid walls and W of `Rubbing`, and (T − δ W)ᵀ f_t acts on q.

    Attributes:
        stiffness: k of each contact, shape (m,) [N/m].
        dissipation: d of each contact, shape (m,) [s/m].
        friction: μ of each contact, shape (m,); none given: zero.
        reaches: R of two spheres that move about each other, else 0, shape (m,) [m]; none given:
            zero.
        radii: r of the sphere that touches, shape (m,) [m]; none given: zero.
    """

    stiffness: Floats
    dissipation: Floats
    friction: Floats = field(default_factory=lambda: np.zeros(0))
    reaches: Floats = field(default_factory=lambda: np.zeros(0))
    radii: Floats = field(default_factory=lambda: np.zeros(0))

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


def contact_law(world: World, scenario: Scenario) -> ContactLaw:
    """Returns the law of a world's contacts, rigid or compliant by the scenario.

    Raises:
        ModelError: a shape lacks stiffness or dissipation for compliant contact, or Drake's plant
            would have a different force (`World.springs`); or friction acts where a sphere can
            slide in two directions.
    """
    if scenario.contact == "rigid":
        return RigidLaw(world.restitutions(scenario), world.friction_coefficients(scenario))
    springs = world.springs
    friction = world.friction_coefficients(scenario)
    radii = np.array([contact.radius for contact in world.contacts])
    return CompliantLaw(springs.stiffness, springs.dissipation, friction, springs.reaches, radii)


def calc_pushes(world: World, law: ContactLaw, q: Floats, v: Floats) -> Floats:
    """Returns the forces of contacts in states (…, n) each, shape (…, m) [N]: of rigid ones 0."""
    if isinstance(law, RigidLaw):
        return np.zeros((*q.shape[:-1], world.num_contacts))
    return law.calc_forces(world.calc_signed_distance(q), world.calc_contact_rate(q, v))


def calc_tangents(world: World, law: CompliantLaw, q: Floats) -> tuple[Floats, Floats]:
    """Returns T − δ W of compliant contacts, shape (…, m, n), and R/l, shape (…, m)."""
    distances = world.calc_signed_distance(q)
    gaps, _, levers = law.find_gaps(distances, distances)
    curvatures = np.divide(1.0, law.reaches, out=np.zeros_like(law.reaches), where=law.reaches > 0)
    deeper = _calc_deeper(curvatures, law.radii, gaps)[..., np.newaxis]
    return world.rubbing.calc_tangent_jacobian(q) - deeper * world.rubbing.spins, levers


def _calc_deeper(curvature: Any, radius: Any, gap: Any) -> Any:
    """Returns δ, by which a sphere's lever is longer [m], of 1/R, r and ψ."""
    return gap / 2 + curvature * gap * (radius + gap / 2)


def calc_slips(world: World, law: ContactLaw, q: Floats, v: Floats) -> Floats:
    """Returns s, shape (…, m) [m/s]: T v of rigid contacts, see `CompliantLaw` for others.

    In space, where it has a direction (`SpaceWorld.calc_slides`), its size.
    """
    if isinstance(world, SpaceWorld):
        return np.asarray(np.linalg.norm(world.calc_slides(q, v), axis=-1))
    if isinstance(law, RigidLaw):
        return world.rubbing.calc_slips(q, v)
    T, levers = calc_tangents(world, law, q)
    return (T @ v[..., np.newaxis])[..., 0] * levers


def calc_dissipation(restitution: float, speed: float) -> float:
    """Returns the Hunt-Crossley dissipation that makes an impact's restitution e [s/m].

    With f = k x (1 + d ẋ) an impact at speed v > 0 [m/s] returns e v if y = d v solves

        y − ln(1 + y) = −e y − ln(1 − e y)

    so that it depends on the speed: other impacts have another restitution. e is at least 1e-3.
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


_deepen = borrowing(_calc_deeper)


@borrowing
def find_gap(reach: float, distance: float) -> tuple[float, float]:
    """Returns the distance of surfaces [m] and ∂l/∂φ at a distance φ (`CompliantLaw.find_gaps`)."""
    if reach == 0.0:
        return distance, 1.0
    apart = np.sqrt(max(reach**2 + 2.0 * reach * distance, NO_ROOM))
    return apart - reach, reach / apart


@borrowing
def calc_stiffness(stiffness: float, give: float, width: float) -> float:
    """Returns the stiffness of a spring that is smoothed over a width, k min(1, g / w) [N/m]."""
    return stiffness * (give / width) if width > give else stiffness


@borrowing
def calc_deeper(reach: float, radius: float, gap: float) -> float:
    """Returns δ at a distance ψ of surfaces (`CompliantLaw`) [m]."""
    return _deepen(1.0 / reach if reach > 0.0 else 0.0, radius, gap)


def calc_mobilities(mass: Floats, rows: Floats) -> Floats:
    """Returns A M⁻¹ Aᵀ of each row of A, shape (m,) [1/kg]: how easily it is moved."""
    return np.asarray(np.einsum("ij,ji->i", rows, np.linalg.solve(mass, rows.T)))


def calc_frequencies(world: World, law: CompliantLaw, q: Floats) -> Floats:
    """Returns √(k J M⁻¹ Jᵀ), at which contacts at q oscillate on their springs, (m,) [rad/s]."""
    distances = world.calc_signed_distance(q)
    _, _, levers = law.find_gaps(distances, distances)
    mobilities = calc_mobilities(world.calc_mass_matrix(q), world.calc_contact_jacobian(q))
    return np.asarray(levers * np.sqrt(law.stiffness * mobilities))


def calc_start_speed(world: World, scenario: Scenario) -> float:
    """Returns the largest speed of contacts with friction that a start has or gets [m/s].

    √(ẋ² + k J M⁻¹ Jᵀ x²),    with x and ẋ of `CompliantLaw`; 0 of rigid contacts
    """
    law = contact_law(world, scenario)
    if not (isinstance(law, CompliantLaw) and law.has_friction):
        return 0.0
    q, v = world.split(scenario.initial_state)
    rates = world.calc_contact_rate(q, v)
    gaps, speeds, _ = law.find_gaps(world.calc_signed_distance(q), rates)
    swings = calc_frequencies(world, law, q) * np.minimum(gaps, 0.0)
    return float(np.max(np.hypot(speeds, swings)))
