"""Friction in compiled code: of joints, and of contacts that push."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydrake.symbolic import Expression

from drake_aigto.arrays import Floats
from drake_aigto.jit import inner
from drake_aigto.shooting.layout import find_rows, triangle
from drake_aigto.world import CompliantLaw, ContactLaw, World

# Expressions of q, shape (n,).
Row: TypeAlias = NDArray[Any]

# In `Rub.numbers` and `Mechanics.rubs`.
SOURCE, COEFFICIENT, STICTION, BRAKE, PACE = range(5)


class Rub(NamedTuple):
    """One friction, −Tᵀ c N σ(s / w), with s = T(q) v and σ of `calc_friction_share`.

    Of two spheres that move about each other, s is T v R/l (see `CompliantLaw`).

    Its stiction speed w is that of the world, smoothed over a length ε as contact forces are, and
    no slower than what it takes from s in one Runge-Kutta step h, for steps not to swing about
    rest: w² = max(v_s, a h)² + (ε/T)², with T the duration.

    Attributes:
        row: T(q).
        numbers: which contact's force N is, or −1 where N = 1; c; v_s [m/s, rad/s]; a, by which
            friction slows s [m/s², rad/s²], of contacts per speed of approach [1/s]; 1/T [1/s],
            which a program sets (`fit_to_steps`).
    """

    row: Row
    numbers: tuple[float, ...]


def list_rubs(world: World, law: ContactLaw) -> list[Rub]:
    """Returns the friction of a world's joints and of its walls, which, rigid, rub in impacts."""
    rubs = [] if world.dry_friction is None else list(_list_dry(world, world.dry_friction))
    if isinstance(law, CompliantLaw) and law.rubs:
        rubs += _list_touching(world, law)
    elif law.rubs:
        for i in np.flatnonzero(law.friction).tolist():
            numbers = float(i), law.friction[i], world.stiction_speed, 0.0, 0.0
            rubs.append(Rub(world.rubbing.tangents[i], numbers))
    return rubs


def _list_dry(world: World, friction: Floats) -> Iterator[Rub]:
    along = np.vectorize(Expression)(np.eye(len(friction)))
    mobility = np.diag(np.linalg.inv(world.calc_mass_matrix(world.plant.GetDefaultPositions())))
    for i in np.flatnonzero(friction > 0).tolist():
        F = friction[i]
        yield Rub(along[i], (-1.0, F, world.stiction_speed, F * mobility[i], 0.0))


def _list_touching(world: World, law: CompliantLaw) -> Iterator[Rub]:
    """Yields that of contacts, whose brake is per speed of approach: that of a half swing."""
    q = world.plant.GetDefaultPositions()
    J, T = world.calc_contact_jacobian(q), world.rubbing.calc_tangent_jacobian(q, yields=True)
    M = world.calc_mass_matrix(q)
    along, across = (np.einsum("ij,ji->i", A, np.linalg.solve(M, A.T)) for A in (T, J))
    rates = law.friction * np.sqrt(law.stiffness) * along / np.sqrt(np.maximum(across, along))
    for i in np.flatnonzero(law.friction > 0).tolist():
        numbers = float(i), law.friction[i], world.stiction_speed, rates[i], 0.0
        yield Rub(world.rubbing.soft_tangents[i], numbers)


def fit_to_steps(rubs: Floats, step: float, duration: float, speed: float) -> Floats:
    """Returns the numbers of rubs, shape (R, 5), for Runge-Kutta steps of a length [s].

    Contacts are approached at about the speed [m/s].
    """
    fitted, is_dry = rubs.copy(), rubs[:, SOURCE] < 0
    brakes = rubs[:, BRAKE] * np.where(is_dry, 1.0, speed)
    fitted[:, STICTION] = np.maximum(rubs[:, STICTION], brakes * step)
    fitted[:, PACE] = 1 / duration
    return fitted


@inner
def find_rub(rubs: Floats, contact: int) -> int:
    """Returns which friction is that of a contact, or −1 if it does not rub."""
    for r in range(rubs.shape[0]):
        if rubs[r, SOURCE] == contact:
            return r
    return -1


@inner
def rub_all(
    rubs: Floats, x: Floats, eps: float, sums: Floats, force: Floats, rub: Floats, total: Floats
) -> None:
    """Computes friction and its derivatives by s and N, and adds Tᵀ times it to the total."""
    n = total.shape[1]
    row = sums.size - rubs.shape[0] * n
    for r in range(rubs.shape[0]):
        slip, normal, lever = 0.0, 1.0, 1.0
        for j in range(n):
            slip += sums[row + j] * x[n + j]
        source = int(rubs[r, SOURCE])
        if source >= 0:
            normal, lever = force[source, 0], force[source, 3]
        speed = np.sqrt(rubs[r, STICTION] ** 2 + (eps * rubs[r, PACE]) ** 2)
        y = lever * slip / speed
        size = abs(y)
        share, slope = np.sign(y), 0.0
        if size < 1.0:
            share = y * y * y * (10.0 - 15.0 * size + 6.0 * y * y)
            slope = 30.0 * y * y * (1.0 - size) ** 2
        rub[r, 2] = -rubs[r, COEFFICIENT] * share
        rub[r, 0] = rub[r, 2] * normal
        rub[r, 1] = -rubs[r, COEFFICIENT] * normal * slope * lever / speed
        for j in range(n):
            total[0, j] += rub[r, 0] * sums[row + j]
        row += n


@inner
def differentiate_rubs(
    rubs: Floats, x: Floats, sums: Floats, force: Floats, rub: Floats, slopes: Floats
) -> None:
    """Adds ∂(Tᵀ times friction)/∂(q, v), transposed."""
    n, m, count = slopes.shape[1], force.shape[0], rubs.shape[0]
    row = sums.size - count * n
    turn = row - count * n * n
    for r in range(count):
        source = int(rubs[r, SOURCE])
        for c in range(n):
            rate, slip, by_normal, by_speed = 0.0, 0.0, 0.0, 0.0
            for j in range(n):
                rate += sums[turn + j * n + c] * x[n + j]
                slip += sums[row + j] * x[n + j]
                slopes[c, j] += rub[r, 0] * sums[turn + j * n + c]
            if source >= 0:
                normal, bends = find_rows(n, m, source)
                by_normal = force[source, 1] * sums[normal + c]
                for j in range(n):
                    by_normal += force[source, 2] * sums[bends + triangle(n, j, c)] * x[n + j]
                by_speed = force[source, 2] * sums[normal + c]
                rate += slip * force[source, 4] / force[source, 3] * sums[normal + c]
            by_position = rub[r, 1] * rate + rub[r, 2] * by_normal
            by_velocity = rub[r, 1] * sums[row + c] + rub[r, 2] * by_speed
            for j in range(n):
                slopes[c, j] += by_position * sums[row + j]
                slopes[n + c, j] += by_velocity * sums[row + j]
        row, turn = row + n, turn + n * n
