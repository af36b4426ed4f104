"""Accelerations of a mechanism in the plane between compliant walls, in compiled code."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.contact.laws import CompliantLaw, calc_deeper, find_gap, find_share
from drake_aigto.dynamics import SumMap, factor_masses, sum_products
from drake_aigto.kernels import borrow, borrowing, kernel
from drake_aigto.linear import solve_factored
from drake_aigto.world import World

# Factors, waves, members and coefficients (`evaluate_sums`).
Sums: TypeAlias = tuple[Ints, Floats, Ints, Floats]


class Springs(NamedTuple):
    """Equations and law as arrays: n coordinates, m contacts.

    Attributes:
        dynamics: M, h, φ and J of (q, v), row by row.
        tangents: T of q, row by row.
        actuation: B, shape (n, nu).
        law: k, d, μ, R and r of `CompliantLaw`, shape (m, 5).
        spins: W of `Rubbing`, shape (m, n).
        dry_friction: of each coordinate, shape (n,) [N, N m].
        stiction_speed: v_s [m/s, rad/s].
    """

    dynamics: Sums
    tangents: Sums
    actuation: Floats
    law: Floats
    spins: Floats
    dry_friction: Floats
    stiction_speed: float

    @classmethod
    def of(cls, world: World, law: CompliantLaw) -> Springs:
        """Returns those of a world and its law."""
        rows = law.stiffness, law.dissipation, law.friction, law.reaches, law.radii
        dry = world.dry_friction
        nothing = SumMap(np.zeros(0, dtype=object), world.positions)
        return cls(
            dynamics=world.dynamics_map.tables,
            tangents=(world.rubbing.tangent_map if law.has_friction else nothing).tables,
            actuation=np.array(world.actuation),
            law=np.column_stack(rows),
            spins=np.array(world.rubbing.spins) if law.has_friction else np.zeros((0, 0)),
            dry_friction=np.zeros(world.num_velocities) if dry is None else np.array(dry),
            stiction_speed=float(world.stiction_speed),
        )


class SpringsMemory(NamedTuple):
    """Room for one state."""

    values: Floats  # of the factors of sums
    sums: Floats  # M, h, φ and J, row by row
    tangents: Floats  # T, row by row
    factor: Floats  # Cholesky's L of M, shape (n, n)
    force: Floats  # M v̇, and then v̇, shape (n,)


def make_springs_memory(springs: Springs) -> SpringsMemory:
    """Returns room for evaluations."""
    n, (dynamics, tangents) = len(springs.actuation), (springs.dynamics, springs.tangents)
    return SpringsMemory(
        values=np.zeros(max(len(dynamics[0]), len(tangents[0]))),
        sums=np.zeros(len(dynamics[3])),
        tangents=np.zeros(len(tangents[3])),
        factor=np.zeros((n, n)),
        force=np.zeros(n),
    )


@borrowing
def accelerate_springs(springs: Springs, x: Floats, u: Floats, memory: SpringsMemory) -> None:
    """Computes v̇ of a state x = (q, v), with the forces and the friction of `CompliantLaw`."""
    sums, tangents, force = memory.sums, memory.tangents, memory.force
    n, m = force.size, springs.law.shape[0]
    sum_products(x, springs.dynamics, memory.values, sums)
    if tangents.size > 0:
        sum_products(x, springs.tangents, memory.values, tangents)
    for i in range(n):
        share = find_share(x[n + i] / springs.stiction_speed)
        force[i] = -sums[n * n + i] - springs.dry_friction[i] * share
        for j in range(u.size):
            force[i] += springs.actuation[i, j] * u[j]
    for c in range(m):
        stiffness, dissipation, friction, reach, radius = springs.law[c]
        gap, lever = find_gap(reach, sums[n * n + n + c])
        if gap >= 0.0:
            continue
        row, rate = n * n + n + m + c * n, 0.0
        for i in range(n):
            rate += sums[row + i] * x[n + i]
        brake = 1.0 - dissipation * rate * lever
        if brake <= 0.0:
            continue
        push, slip = -stiffness * gap * brake * lever, 0.0
        for i in range(n):
            force[i] += sums[row + i] * push
        if friction > 0.0:
            deeper = calc_deeper(reach, radius, gap)
            for i in range(n):
                tangents[c * n + i] -= deeper * springs.spins[c, i]
                slip += tangents[c * n + i] * x[n + i]
            drag = friction * push * find_share(slip * lever / springs.stiction_speed)
            for i in range(n):
                force[i] -= tangents[c * n + i] * drag
    factor_masses(n, sums, memory.factor)
    solve_factored(n, memory.factor, force)


@kernel
def evaluate_springs(springs: Springs, x: Floats, u: Floats, memory: SpringsMemory) -> None:
    """Computes v̇ as the memory's `force`, see `accelerate_springs`."""
    accelerate_springs(borrow(springs), x, u, borrow(memory))
