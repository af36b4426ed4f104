"""Impact maps: Newton's law for several contacts at once, and Coulomb's friction at one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats
from drake_aigto.contact.laws import RigidLaw
from drake_aigto.dynamics import ConstantInertia
from drake_aigto.errors import OptionsError
from drake_aigto.world import World

# Least eigenvalue of J_C M⁻¹ J_Cᵀ in units of their masses, 1 if they are not coupled.
_DEPENDENT = 1e-9
# An impact is at the edge of its mode if sticking takes this part of the available friction, or if
# the slip that remains is this part of the approach's speed.
_EDGE = 0.02
# If a c − b² is below this part of a c, motions along the wall also leave it: mechanisms of one
# coordinate never stick.
_STIFF = 1e-9


class Mode(IntEnum):
    """Mode of a contact: the sign of its slip velocity, or that it opens."""

    BACKWARD = -1
    STICK = 0
    FORWARD = 1
    OPEN = 2


class Mobility(NamedTuple):
    """Mobility of a contact: impulses change φ̇ by a p_n + b p_t, the slip s by b p_n + c p_t.

    a = J M⁻¹ Jᵀ > 0, b = J M⁻¹ Tᵀ and c = T M⁻¹ Tᵀ with a c > b²; or b = c = 0, where nothing can
    slide [1/kg].
    """

    a: float
    b: float
    c: float

    @classmethod
    def of(cls, normal: Floats, tangent: Floats, mass_matrix: Floats) -> Mobility:
        """Returns the mobility for rows J and T, shape (nv,), and a mass matrix (nv, nv)."""
        rows = np.array([normal, tangent])
        inverse = (rows @ np.linalg.solve(mass_matrix, rows.T)).tolist()
        return cls(inverse[0][0], inverse[0][1], inverse[1][1])


class Impulse(NamedTuple):
    """The impulse of an impact, and the mode at its end."""

    normal: float  # p_n ≥ 0 [N s]
    tangent: float  # p_t [N s]
    mode: Mode


class _Way(NamedTuple):
    """A part of an impact in which slip has one direction."""

    mode: Mode
    friction: float  # dp_t / dp_n
    slope: float  # dφ̇ / dp_n [1/kg]


def calc_impulse(
    mobility: Mobility, rate: float, slip: float, restitution: float, friction: float
) -> Impulse:
    """Returns the impulse of an impact with Coulomb's friction, by Routh's construction.

    While the normal impulse grows from 0 the tangential one follows Coulomb's law at each instant,

        dp_t = −μ sign(s) dp_n    while it slips,    |dp_t| ≤ μ dp_n and ds = 0    while it sticks,

    so that φ̇ and s move along straight lines (E. J. Routh, "Dynamics of a system of rigid bodies",
    part I, 1905, ch. VIII). Slip that has ended becomes stick if μ c ≥ |b|, or else reverses. The
    impact ends as φ̇ is −e times what it was (Newton), or as the normal impulse has returned
    e² of the work that it took (W. J. Stronge, "Rigid body collisions with friction", Proc. R. Soc.
    A 431, 1990), whichever comes first. Both come at once where b = 0, as for round bodies, without
    friction, and if slip keeps its direction to the end. Otherwise Newton's rule alone may create
    energy; with both, kinetic energy never grows. Where b = 0,

        p_n = −(1 + e) φ̇ / a,    p_t = −s/c,    but no more than μ p_n in size.

    Args:
        mobility: of the contact.
        rate: φ̇ before, < 0 [m/s].
        slip: s before [m/s].
        restitution: e, in [0, 1].
        friction: μ ≥ 0.
    """
    a, b, c = mobility
    if friction * c >= abs(b):  # After the slip velocity is zero.
        later = _Way(Mode.STICK, -b / c if c else 0.0, a - b**2 / c if c else a)
    else:
        later = _slide(mobility, Mode(int(math.copysign(1, b))), friction)
    way, until = later, 0.0
    if slip:
        way = _slide(mobility, Mode(int(math.copysign(1, slip))), friction)
        braking = -(mobility.b + mobility.c * way.friction) / slip
        until = 1 / braking if braking > 0 else math.inf
    whole = -(1 + restitution) * rate / way.slope if way.slope > 0 else math.inf
    if whole <= until or way is later:
        return Impulse(whole, whole * way.friction, way.mode)
    rest = _find_rest(way.slope, later.slope, rate, until, restitution)
    return Impulse(until + rest, until * way.friction + rest * later.friction, later.mode)


def calc_velocity_after(
    mass_matrix: Floats,
    rows: tuple[Floats, Floats],
    velocity: Floats,
    restitution: float,
    friction: float,
) -> Floats:
    """Returns v⁺ = v + M⁻¹ (Jᵀ p_n + Tᵀ p_t) after an impact (`calc_impulse`), shape (nv,).

    Args:
        mass_matrix: M, shape (nv, nv).
        rows: J and T of the contact, shape (nv,) each.
        velocity: v before, shape (nv,).
        restitution: e, in [0, 1].
        friction: μ ≥ 0.
    """
    J, T = rows
    rate, slip = float(J @ velocity), float(T @ velocity)
    impulse = calc_impulse(Mobility.of(J, T, mass_matrix), rate, slip, restitution, friction)
    push = J * impulse.normal + T * impulse.tangent
    return np.asarray(velocity + np.linalg.solve(mass_matrix, push))


def _slide(mobility: Mobility, mode: Mode, friction: float) -> _Way:
    """Returns the part of an impact while it slips."""
    along = -friction * mode
    return _Way(mode, along, mobility.a + along * mobility.b)


def _find_rest(first: float, later: float, rate: float, until: float, restitution: float) -> float:
    """Returns the normal impulse of an impact whose slip ends before it, at p_n = `until` [N s].

    The rate is φ̇ before the impact; dφ̇ / dp_n is first one, later another above 0 [1/kg].
    """
    now, goal = rate + first * until, -restitution * rate
    if now < 0:  # It is still compressed.
        taken = now**2 / (2 * later) - until * (rate + now) / 2
        return (-now + min(goal, restitution * math.sqrt(2 * later * taken))) / later
    left = max(0.0, (goal**2 - now**2) / (2 * first))  # of the work that may be returned
    reached = math.sqrt(now**2 + 2 * later * left)
    return max(0.0, min(goal, reached) - now) / later


@dataclass(frozen=True, eq=False)
class JointImpact:
    """Newton's law for contacts that are struck together.

        v⁺ = R v⁻ = v⁻ + M⁻¹ J_Cᵀ p,    p = P v⁻ = −(J_C M⁻¹ J_Cᵀ)⁻¹ (I + E) J_C v⁻

    so that J_C v⁺ = −E J_C v⁻. Contacts that rest take part: their impulse keeps them at rest.
    If contacts are coupled, J_C M⁻¹ J_Cᵀ not diagonal, it is a convention: successive impacts
    would end in other velocities, which depend on their order.

    Attributes:
        impulses: P, shape (c, nv) [kg].
        velocities: R, shape (nv, nv).
        coupled: which contacts have an impulse that depends on another one's speed, shape (c,).
    """

    impulses: Floats
    velocities: Floats
    coupled: Bools

    @classmethod
    @lru_cache(maxsize=64)  # A search needs the same few repeatedly.
    def of(
        cls, inertia: ConstantInertia, contacts: tuple[int, ...], restitutions: tuple[float, ...]
    ) -> JointImpact:
        """Returns the impact of c of all contacts, given their restitutions.

        Raises:
            OptionsError: J_C has dependent rows: how they share an impulse is not defined.
        """
        chosen = list(contacts)
        J, kicks = inertia.jacobian[chosen], inertia.kicks[chosen].T
        # In units of the contacts' own masses.
        root = np.sqrt(inertia.masses[chosen])
        coupling = root[:, np.newaxis] * (J @ kicks) * root
        if np.linalg.eigvalsh(coupling)[0] < _DEPENDENT:
            raise OptionsError(
                "sequence",
                got=f"{len(J)} contacts at once that can't all be distinguished",
                expected="contacts with independent Jacobians",
                remedy="Leave out those that the others imply.",
            )
        closing = (1 + np.asarray(restitutions))[:, np.newaxis] * J
        impulses = -root[:, np.newaxis] * np.linalg.solve(coupling, root[:, np.newaxis] * closing)
        others = np.abs(coupling - np.diag(np.diag(coupling)))
        return cls(
            impulses=impulses,
            velocities=np.eye(J.shape[1]) + kicks @ impulses,
            coupled=np.any(others > _DEPENDENT, axis=1),
        )


def read_mode(world: World, law: RigidLaw, contact: int, q: Floats, v: Floats) -> int:
    """Returns the mode at the end of an impact: 0 for stick or no friction, else the slip's sign.

    A contact that leaves the wall counts as if it approached at that speed.
    """
    friction = float(law.friction[contact])
    if not friction:
        return 0
    mobility, rate, slip = _measure(world, contact, q, v)
    speed = max(abs(rate), np.finfo(float).tiny)
    return int(calc_impulse(mobility, -speed, slip, law.restitution[contact], friction).mode)


def find_other_mode(
    world: World, law: RigidLaw, contact: int, mode: int, q: Floats, v: Floats
) -> int | None:
    """Returns the mode that an impact is at the edge to, if any, by the state before."""
    friction = float(law.friction[contact])
    if not friction:
        return None
    mobility, rate, slip = _measure(world, contact, q, v)
    e = float(law.restitution[contact])
    if mode != Mode.STICK:
        along = -mode * friction
        p = -(1 + e) * rate / (mobility.a + along * mobility.b)
        after = slip + (mobility.b + along * mobility.c) * p
        return int(Mode.STICK) if mode * after <= _EDGE * abs(rate) else None
    a, b, c = mobility
    room = a * c - b**2
    if room <= _STIFF * a * c:
        return -1 if slip < 0 else 1
    normal = ((1 + e) * -rate * c + b * slip) / room
    tangent = (b * (1 + e) * rate - a * slip) / room
    is_at_edge = abs(tangent) >= (1 - _EDGE) * friction * normal
    return -int(np.sign(tangent)) if is_at_edge else None


def _measure(world: World, contact: int, q: Floats, v: Floats) -> tuple[Mobility, float, float]:
    """Returns φ̇ and s, which impulses change."""
    J = world.calc_contact_jacobian(q)[contact]
    T = world.rubbing.calc_tangent_jacobian(q)[contact]
    return Mobility.of(J, T, world.calc_mass_matrix(q)), float(J @ v), float(T @ v)


def calc_saltation(
    jump: Floats, before: Floats, after: Floats, normal: Floats, slowest: float = 0.0
) -> Floats:
    """Returns the saltation matrix of an event at g(x) = 0, shape (2n, 2n).

        Ξ = D + (f⁺ − D f⁻) ∇gᵀ / (∇gᵀ f⁻)

    A deviation x̃ before the event is Ξ x̃ after it, to first order: an event that is −g̃/ġ late
    has that much longer the rates before it, D f⁻, and that much shorter those after it, f⁺.

    Args:
        jump: D = ∂x⁺/∂x⁻, shape (2n, 2n).
        before: f⁻, the rates of x before it, shape (2n,).
        after: f⁺, those after it, shape (2n,).
        normal: ∇g, shape (2n,).
        slowest: if g changes more slowly, relative to the rates, Ξ is D: its time is undetermined.
    """
    pace = float(normal @ before)
    if abs(pace) <= slowest * float(np.linalg.norm(normal) * np.linalg.norm(before)):
        return jump
    return jump + np.outer(after - jump @ before, normal) / pace
