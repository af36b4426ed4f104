"""Compiled code of what moves between walls that yield and rub."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.jit import inner, kernel
from drake_aigto.world.sum_kernels import divide_by_masses, evaluate_sums

# Factors, waves, members and coefficients (`evaluate_sums`).
Sums: TypeAlias = tuple[Ints, Floats, Ints, Floats]


class SpringTables(NamedTuple):
    """Equations and law as arrays: n coordinates, m contacts.

    Attributes:
        dynamics: M, h, φ and J of (q, v), row by row.
        tangents: T of q, row by row.
        stiffness: see `CompliantLaw`, shape (m,), as the next three.
        dissipation: see there.
        friction: see there.
        reaches: see there.
        no_room: the least l² of two spheres [m²].
        dry_friction: of each coordinate, shape (n,) [N, N m].
        stiction_speed: v_s [m/s, rad/s].
    """

    dynamics: Sums
    tangents: Sums
    stiffness: Floats
    dissipation: Floats
    friction: Floats
    reaches: Floats
    no_room: float
    dry_friction: Floats
    stiction_speed: float


@inner
def _calc_share(speed: float) -> float:
    """Returns σ of a speed in parts of v_s (`calc_friction_share`)."""
    x = min(max(speed, -1.0), 1.0)
    return x**3 * (10.0 - 15.0 * abs(x) + 6.0 * x**2)


@inner
def _dot(a: Floats, b: Floats) -> float:
    total = 0.0
    for i in range(b.size):
        total += a[i] * b[i]
    return total


@kernel
def calc_spring_rates(x: Floats, actuation: Floats, pressed: Bools, tables: SpringTables) -> Floats:
    """Returns ẋ of a state x = (q, v), shape (2n,): that of `World.calc_acceleration`.

    There with `CompliantLaw.calc_forces` and `Rubbing.calc_drag`, of the contacts that are pressed;
    what those would pull with counts, so that it is smooth.

    Args:
        x: shape (2n,).
        actuation: B u, shape (n,) [N, N m].
        pressed: which contacts push, shape (m,).
        tables: of the world.
    """
    n, m = x.size // 2, pressed.size
    q, v = x[:n], x[n:]
    values = evaluate_sums(x.reshape(1, -1), *tables.dynamics)[0]
    masses, bias = values[: n * n], values[n * n : n * n + n]
    distances = values[n * n + n : n * n + n + m]
    normals = values[n * n + n + m :].reshape(m, n)
    rates, force = np.empty(2 * n), np.empty(n)
    for i in range(n):
        rates[i] = v[i]
        share = _calc_share(v[i] / tables.stiction_speed)
        force[i] = actuation[i] - bias[i] - tables.dry_friction[i] * share
    tangents, has_tangents = normals, False
    for c in range(m):
        if not pressed[c]:
            continue
        lever, gap, reach = 1.0, distances[c], tables.reaches[c]
        if reach > 0.0:
            apart = np.sqrt(max(reach**2 + 2.0 * reach * gap, tables.no_room))
            lever, gap = reach / apart, apart - reach
        speed = _dot(normals[c], v) * lever
        push = -tables.stiffness[c] * gap * (1.0 - tables.dissipation[c] * speed) * lever
        drag = 0.0
        if tables.friction[c] > 0.0:
            if not has_tangents:
                tangents = evaluate_sums(q.reshape(1, -1), *tables.tangents)[0].reshape(m, n)
                has_tangents = True
            slip = _dot(tangents[c], v) * lever / tables.stiction_speed
            drag = tables.friction[c] * push * _calc_share(slip)
        for i in range(n):
            force[i] += normals[c, i] * push
            if drag != 0.0:
                force[i] -= tangents[c, i] * drag
    rates[n:] = divide_by_masses(masses.reshape(1, -1), force.reshape(1, -1))[0]
    return rates
