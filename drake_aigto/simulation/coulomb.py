"""Impacts with Coulomb's friction in a plane, in closed form."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats


class Mode(IntEnum):
    """How a contact goes on: the sign of its slip velocity, or that it opens."""

    BACKWARD = -1
    STICK = 0
    FORWARD = 1
    OPEN = 2


class Mobility(NamedTuple):
    """What impulses at a contact change: φ̇ by a p_n + b p_t, and the slip s by b p_n + c p_t.

    a = J M⁻¹ Jᵀ > 0, b = J M⁻¹ Tᵀ and c = T M⁻¹ Tᵀ with a c > b²; or b = c = 0, where nothing can
    slide [1/kg].
    """

    a: float
    b: float
    c: float

    @classmethod
    def of(cls, normal: Floats, tangent: Floats, mass_matrix: Floats) -> Mobility:
        """Returns that of a contact's rows J and T, shape (nv,), at a mass matrix (nv, nv)."""
        rows = np.array([normal, tangent])
        inverse = (rows @ np.linalg.solve(mass_matrix, rows.T)).tolist()
        return cls(inverse[0][0], inverse[0][1], inverse[1][1])


class Impulse(NamedTuple):
    """The impulse of an impact, and how the contact ends it."""

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
    """Returns what an impact with Coulomb's friction does, by Routh's construction.

    While the normal impulse grows from 0 the tangential one follows Coulomb's law at each instant,

        dp_t = −μ sign(s) dp_n    while it slips,    |dp_t| ≤ μ dp_n and ds = 0    while it sticks,

    so that φ̇ and s move along straight lines (E. J. Routh, "Dynamics of a system of rigid bodies",
    part I, 1905, ch. VIII). Slip that has ended goes on as stick where μ c ≥ |b|, or else turns
    round. It is over as φ̇ is −e times what it was (Newton), or as the normal impulse has returned
    e² of the work that it took (W. J. Stronge, "Rigid body collisions with friction", Proc. R. Soc.
    A 431, 1990), whichever comes first. Both come at once where b = 0, as for round bodies, without
    friction, and where slip goes one way to the end. Elsewhere Newton's rule alone may make energy
    from nothing; with both, kinetic energy never grows. Where b = 0,

        p_n = −(1 + e) φ̇ / a,    p_t = −s/c,    but no more than μ p_n in size.

    Args:
        mobility: of the contact.
        rate: φ̇ before, < 0 [m/s].
        slip: s before [m/s].
        restitution: e, in [0, 1].
        friction: μ ≥ 0.
    """
    later = _find_way_from_stick(mobility, friction)
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
    """Returns how an impact goes on while it slips."""
    along = -friction * mode
    return _Way(mode, along, mobility.a + along * mobility.b)


def _find_way_from_stick(mobility: Mobility, friction: float) -> _Way:
    """Returns how an impact goes on from where the slip velocity is zero."""
    a, b, c = mobility
    if friction * c >= abs(b):
        return _Way(Mode.STICK, -b / c if c else 0.0, a - b**2 / c if c else a)
    return _slide(mobility, Mode(int(math.copysign(1, b))), friction)


def _find_rest(first: float, later: float, rate: float, until: float, restitution: float) -> float:
    """Returns the normal impulse after the slip has ended, by that time no end of the impact.

    Args:
        first: dφ̇ / dp_n until then [1/kg].
        later: the same after it, above 0 [1/kg].
        rate: φ̇ before the impact, < 0 [m/s].
        until: p_n as the slip ends [N s].
        restitution: e.
    """
    now, goal = rate + first * until, -restitution * rate
    if now < 0:  # It is still compressed.
        taken = now**2 / (2 * later) - until * (rate + now) / 2
        return (-now + min(goal, restitution * math.sqrt(2 * later * taken))) / later
    left = max(0.0, (goal**2 - now**2) / (2 * first))  # of the work that may be returned
    reached = math.sqrt(now**2 + 2 * later * left)
    return max(0.0, min(goal, reached) - now) / later
