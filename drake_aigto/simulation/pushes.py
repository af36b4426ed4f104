"""What contacts push with that last, with friction, in modes that are given."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.simulation.coulomb import Mode
from drake_aigto.simulation.friction_modes import RANK, calc_directions
from drake_aigto.world import World


class Push(NamedTuple):
    """How contacts push."""

    acceleration: Floats  # v̇, shape (…, nv)
    forces: Floats  # f_n and f_t, shape (…, 2k) [N]
    size: Any  # the determinant that forces are divided by, without unit


def calc_push(
    world: World, x: Floats, control: Floats, held: Ints, modes: Sequence[Mode], friction: Floats
) -> Push:
    """Returns how contacts push.

    Args:
        world: the mechanism.
        x: states (q, v), shape (…, 2 nv).
        control: u, shape (nu,), or (…, nu).
        held: which contacts are closed, k of them.
        modes: whether each sticks or slips, and in which direction.
        friction: μ of each, shape (k,).
    """
    n = world.num_positions
    q, v = x[..., :n], x[..., n:]
    free = world.calc_acceleration(q, v, control)
    if not len(held):
        return Push(free, np.empty((*free.shape[:-1], 0)), np.ones(free.shape[:-1]))
    rows, turning = stack_rows(world, q, held), calc_contact_turning(world, q, v, held)
    vanish, shares = calc_directions(modes, friction)
    kicks = np.linalg.solve(world.calc_mass_matrix(q), np.swapaxes(rows, -1, -2))
    pushes = rows[..., vanish, :] @ kicks @ shares.T
    rates = (rows @ free[..., np.newaxis])[..., 0] + turning
    unknown = -(np.linalg.pinv(pushes, RANK) @ rates[..., vanish, np.newaxis])[..., 0]
    forces = unknown @ shares
    sizes = np.prod(np.diagonal(rows @ kicks, axis1=-2, axis2=-1)[..., vanish], axis=-1)
    acceleration = free + (kicks @ forces[..., np.newaxis])[..., 0]
    return Push(acceleration, forces, np.linalg.det(pushes) / sizes)


def stack_rows(world: World, q: Floats, held: Ints) -> Floats:
    """Returns [J; T] of contacts, shape (…, 2k, nv), at q of shape (…, nq)."""
    J, T = world.calc_contact_jacobian(q), world.rubbing.calc_tangent_jacobian(q)
    return np.concatenate([J[..., held, :], T[..., held, :]], axis=-2)


def calc_contact_turning(world: World, q: Floats, v: Floats, held: Ints) -> Floats:
    """Returns [J̇ v; Ṫ v] of contacts, shape (…, 2k) [m/s²]."""
    turning = world.calc_contact_bias(q, v), world.rubbing.calc_tangent_bias(q, v)
    return np.concatenate([each[..., held] for each in turning], axis=-1)
