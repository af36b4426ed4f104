"""Friction of a world's joints and contacts as rows of numbers for compiled code."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydrake.symbolic import Expression

from drake_aigto.arrays import Floats
from drake_aigto.contact.laws import CompliantLaw, ContactLaw, calc_tangents
from drake_aigto.contact.tables import BRAKE, PACE, SOURCE, STICTION
from drake_aigto.world import World

# Expressions of q, shape (n,).
Row: TypeAlias = NDArray[Any]


class FrictionTerm(NamedTuple):
    """Friction of a joint or contact, −Tᵀ c N σ(s / w), with s = T(q) v (`calc_friction_share`).

    Of compliant contacts s is (T − δ W) v R/l (see `CompliantLaw`).

    Its stiction speed w is that of the world, smoothed over a length ε as contact forces are, and
    no slower than its change of s in one Runge-Kutta step h, lest steps oscillate about rest: w² =
    max(v_s, a h)² + (ε/T)², with T the duration.

    Attributes:
        row: T(q).
        numbers: the contact of the force N, or −1 for N = 1; c; v_s [m/s, rad/s]; deceleration a
            of s [m/s², rad/s²], for contacts per speed of approach [1/s]; 1/T [1/s], which a
            program sets (`fit_to_steps`); radius r; and W, n numbers.
    """

    row: Row
    numbers: tuple[float, ...]


def list_friction(world: World, law: ContactLaw) -> list[FrictionTerm]:
    """Returns the friction of a world's joints and walls; that of rigid walls is for impacts."""
    n = world.num_velocities
    frictions = [] if world.dry_friction is None else list(_list_dry(world, world.dry_friction))
    if isinstance(law, CompliantLaw) and law.has_friction:
        frictions += _list_touching(world, law)
    elif law.has_friction:
        for i in np.flatnonzero(law.friction).tolist():
            numbers = float(i), law.friction[i], world.stiction_speed, *[0.0] * (3 + n)
            frictions.append(FrictionTerm(world.rubbing.tangents[i], numbers))
    return frictions


def _list_dry(world: World, friction: Floats) -> Iterator[FrictionTerm]:
    along = np.vectorize(Expression)(np.eye(len(friction)))
    mobility = np.diag(np.linalg.inv(world.calc_mass_matrix(world.plant.GetDefaultPositions())))
    none = [0.0] * (2 + len(friction))
    for i in np.flatnonzero(friction > 0).tolist():
        F = friction[i]
        yield FrictionTerm(along[i], (-1.0, F, world.stiction_speed, F * mobility[i], *none))


def _list_touching(world: World, law: CompliantLaw) -> Iterator[FrictionTerm]:
    """Yields the friction of compliant contacts, decelerations per speed of approach."""
    q = world.plant.GetDefaultPositions()
    J, (T, _), M = (
        world.calc_contact_jacobian(q),
        calc_tangents(world, law, q),
        world.calc_mass_matrix(q),
    )
    along, across = (np.einsum("ij,ji->i", A, np.linalg.solve(M, A.T)) for A in (T, J))
    rates = law.friction * np.sqrt(law.stiffness) * along / np.sqrt(np.maximum(across, along))
    for i in np.flatnonzero(law.friction > 0).tolist():
        numbers = float(i), law.friction[i], world.stiction_speed, rates[i], 0.0, law.radii[i]
        yield FrictionTerm(world.rubbing.tangents[i], (*numbers, *world.rubbing.spins[i]))


def fit_to_steps(frictions: Floats, step: float, duration: float, speed: float) -> Floats:
    """Returns the numbers of frictions, shape (R, 6 + n), for Runge-Kutta steps of a length [s].

    Contacts are approached at about the speed [m/s].
    """
    fitted, is_dry = frictions.copy(), frictions[:, SOURCE] < 0
    brakes = frictions[:, BRAKE] * np.where(is_dry, 1.0, speed)
    fitted[:, STICTION] = np.maximum(frictions[:, STICTION], brakes * step)
    fitted[:, PACE] = 1 / duration
    return fitted
