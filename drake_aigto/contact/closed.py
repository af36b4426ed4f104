"""Closed rigid contacts with friction: their modes (stick, slip, open) and forces."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy  # Not scipy.optimize, which takes a tenth of a second and few need.

from drake_aigto.arrays import Floats, Ints
from drake_aigto.contact.impacts import Mode
from drake_aigto.errors import FrictionError
from drake_aigto.world import World

# Accelerations that differ by less than this, relative to the largest one or 1 m/s², are equal.
_SAME = 1e-7
# Accelerations below this count as 0, as do forces on the mass of a contact, in the same way.
_NOTHING = 1e-12
# Directions count as dependent if their part outside the span of others is below this.
RANK = 1e-9


class Touching(NamedTuple):
    """Contacts that are closed, k of them, and the motion of bodies without them.

    At an instant, with Coulomb's law for each contact,

        x = x₀ + M⁻¹ (Jᵀ f_n + Tᵀ f_t),    0 ≤ f_n ⊥ J x + j ≥ 0,    |f_t| ≤ μ f_n,
        f_t = −μ sign(s) f_n if slipping, or beginning to slip along T x + t.

    For accelerations x = v̇, j = J̇ v and t = Ṫ v; for velocities after plastic impacts x = v⁺,
    j = t = 0, and forces are impulses.
    """

    kicks: Floats  # M⁻¹ [Jᵀ Tᵀ], shape (nv, 2k)
    rows: Floats  # [J; T], shape (2k, nv)
    rates: Floats  # [J x₀ + j; T x₀ + t], shape (2k,)
    friction: Floats  # μ, shape (k,)
    slips: Sequence[int]  # the sign of each slip velocity, 0 where it is none


class Going(NamedTuple):
    """Continuation of closed contacts: change and forces."""

    modes: tuple[Mode, ...]
    change: Floats  # x − x₀, shape (nv,)
    forces: Floats  # f_n and f_t, shape (2k,)


def find_modes(touching: Touching) -> Going:
    """Returns the continuation of closed contacts.

    All combinations of stick, slip and opening are tried: 4ᵏ at the most.

    Raises:
        FrictionError: no combination fits, or several fit with different motions, as may happen
            for rigid bodies (P. Painlevé, "Sur les lois du frottement de glissement", 1895).
    """
    found = next(ways := list_modes(touching), None)
    if found is None:
        raise refuse_modes("none", "a jam, which no finite force explains")
    size = max(1.0, float(np.max(np.abs(touching.rates))))
    for other in ways:
        if np.max(np.abs(touching.rows @ (other.change - found.change))) > _SAME * size:
            raise refuse_modes("several", f"{_name(found)} or {_name(other)}")
    return found


def list_modes(touching: Touching) -> Iterator[Going]:
    """Yields all combinations of modes, stick first, then slip, then opening."""
    choices = [
        _list_choices(slip, mu)
        for slip, mu in zip(touching.slips, touching.friction.tolist(), strict=True)
    ]
    for modes in itertools.product(*choices):
        if (going := _try_modes(touching, modes)) is not None:
            yield going


def calc_directions(modes: Sequence[Mode], friction: Floats) -> tuple[list[int], Floats]:
    """Returns the rows that vanish in modes of k contacts, and the forces for that.

    These are r of [J; T] x, and how much each of as many unknown forces adds to f_n and f_t, shape
    (r, 2k): a slipping contact has f_t = −μ σ f_n.
    """
    k = len(modes)
    closed = [i for i, mode in enumerate(modes) if mode != Mode.OPEN]
    stuck = [i for i in closed if modes[i] == Mode.STICK]
    shares = np.zeros((len(closed) + len(stuck), 2 * k))
    for row, i in enumerate(closed):
        shares[row, [i, k + i]] = 1.0, -friction[i] * modes[i]
    for row, i in enumerate(stuck, len(closed)):
        shares[row, k + i] = 1.0
    return closed + [k + i for i in stuck], shares


def _list_choices(slip: int, friction: float) -> tuple[Mode, ...]:
    """Returns the modes that a contact may have, given the sign of its slip velocity."""
    if friction == 0:  # No force depends on the direction of slip.
        return (Mode(slip or 1), Mode.OPEN)
    if slip:
        return (Mode(slip), Mode.OPEN)
    return (Mode.STICK, Mode.FORWARD, Mode.BACKWARD, Mode.OPEN)


def _try_modes(touching: Touching, modes: tuple[Mode, ...]) -> Going | None:
    """Returns the continuation in these modes, or None if that contradicts the law."""
    vanish, shares = calc_directions(modes, touching.friction)
    delassus = touching.rows @ touching.kicks  # (2k, 2k)
    pushes = delassus[vanish] @ shares.T
    wanted = -touching.rates[vanish]
    unknown, _, rank, _ = np.linalg.lstsq(pushes, wanted, rcond=RANK)
    size = max(1.0, float(np.max(np.abs(touching.rates))))
    if np.any(np.abs(pushes @ unknown - wanted) > 1e3 * _NOTHING * size):
        return None
    if rank < len(vanish) and not _are_allowed(touching, modes, shares.T @ unknown, size):
        most = float(np.max(np.abs(unknown)))
        spread = _spread(touching, modes, shares, pushes, wanted, most)
        unknown = unknown if spread is None else spread
    forces = shares.T @ unknown
    if not _are_allowed(touching, modes, forces, size):
        return None
    rates = touching.rates + delassus @ forces
    k = len(modes)
    for i, (mode, slip) in enumerate(zip(modes, touching.slips, strict=True)):
        begins = mode in (Mode.FORWARD, Mode.BACKWARD) and not slip and touching.friction[i] > 0
        if mode == Mode.OPEN and rates[i] < -_NOTHING * size:
            return None
        if begins and mode * rates[k + i] < -_NOTHING * size:
            return None
    return Going(modes, touching.kicks @ forces, forces)


def _are_allowed(touching: Touching, modes: tuple[Mode, ...], forces: Floats, size: float) -> bool:
    """Returns whether contacts push, and sticking ones within their cones."""
    normal, tangent = np.split(forces, 2)
    weights = 1 / np.maximum(np.diag(touching.rows @ touching.kicks)[: len(modes)], _NOTHING)
    least = -_NOTHING * size * weights
    return bool(
        np.all(normal >= least) and np.all(touching.friction * normal - np.abs(tangent) >= least)
    )


def _spread(
    touching: Touching,
    modes: tuple[Mode, ...],
    shares: Floats,
    pushes: Floats,
    wanted: Floats,
    most: float,
) -> Floats | None:
    """Returns forces of redundant contacts, as far inside of their cones as possible.

    They are not unique, but the motion is: a block on two feet stays if any forces hold it. None
    has to be farther inside than the most, as bodies may be wedged with any force.
    """
    k, (r, _) = len(modes), shares.shape
    stuck = [i for i in range(k) if modes[i] == Mode.STICK]
    closed = [i for i in range(k) if modes[i] != Mode.OPEN]
    normal, tangent = shares.T[:k], shares.T[k:]
    cones = [normal[closed]]
    for sign in (1.0, -1.0):
        cones.append(touching.friction[stuck, np.newaxis] * normal[stuck] + sign * tangent[stuck])
    margins = np.vstack(cones)  # (…, r) @ unknown ≥ the margin, which is as large as it can be.
    bounds = np.hstack([-margins, np.ones((len(margins), 1))])
    found = scipy.optimize.linprog(
        np.append(np.zeros(r), -1.0),
        A_ub=bounds,
        b_ub=np.zeros(len(margins)),
        A_eq=np.hstack([pushes, np.zeros((len(pushes), 1))]),
        b_eq=wanted,
        bounds=[(None, None)] * r + [(None, most)],
    )
    if not found.success:
        return None
    near = found.x[:r]  # It meets its rows to 1e-7.
    return np.asarray(near + np.linalg.lstsq(pushes, wanted - pushes @ near, rcond=RANK)[0])


def _name(going: Going) -> str:
    """Returns a mode of each contact, in words."""
    return ", ".join(mode.name.lower() for mode in going.modes)


def refuse_modes(count: str, which: str) -> FrictionError:
    """Returns the error of contacts without a continuation, or with several."""
    return FrictionError(
        "contact with friction (Painlevé)",
        got=f"{count} of the ways in which rigid bodies can go on: {which}",
        expected="one",
        remedy="Lower the friction, or ask for contact: compliant, which always has an answer.",
    )


class Push(NamedTuple):
    """Forces of k closed contacts, and the acceleration with them.

    Attributes:
        acceleration: v̇, shape (…, nv).
        normal: f_n, shape (…, k) [N].
        tangent: f_t, shape (…, k) [N].
        block: C M⁻¹ Dᵀ, by which forces are found (`Closed`), shape (…, r, r).
        mobility: diag(C M⁻¹ Cᵀ), shape (…, r).
    """

    acceleration: Floats
    normal: Floats
    tangent: Floats
    block: Floats
    mobility: Floats

    def calc_size(self) -> Any:
        """Returns the determinant that forces are divided by, without unit, shape (…)."""
        return np.linalg.det(self.block) / np.prod(self.mobility, axis=-1)


@dataclass(frozen=True, eq=False)
class Closed:
    """Closed contacts, each in a mode: rates along C vanish, by forces along columns of Dᵀ.

        M v̇ + h = B u + Dᵀ λ,    C v̇ + Ċ v = 0

    Rows of C are J, and T of sticking contacts. Columns of Dᵀ are Jᵀ and Tᵀ, or Jᵀ − μ σ Tᵀ of
    contacts that slip along σ.

    Attributes:
        world: the mechanism.
        contacts: which are closed, k of them.
        modes: whether each sticks or slips, and in which direction.
        friction: μ of each, shape (k,).
    """

    world: World
    contacts: Ints
    modes: tuple[Mode, ...]
    friction: Floats

    @cached_property
    def directions(self) -> tuple[list[int], Floats]:
        """Rows of [J; T] that vanish, and shares of forces (`calc_directions`)."""
        return calc_directions(self.modes, self.friction)

    @cached_property
    def _is_smooth(self) -> bool:
        """Whether no contact has friction, so that only J counts."""
        return not self.friction.any()

    def calc_push(self, x: Floats, control: Floats) -> Push:
        """Returns forces in states (q, v), (…, 2 nv), under controls (nu,) or (…, nu)."""
        world, n, k = self.world, self.world.num_positions, len(self.contacts)
        q, v = x[..., :n], x[..., n:]  # A tenth of the time of `np.split`.
        free = world.calc_acceleration(q, v, control)
        if not k:
            none = np.empty((*free.shape[:-1], 0))
            return Push(free, none, none, np.empty((*none.shape, 0)), none)
        if self._is_smooth:
            rows = world.calc_contact_jacobian(q)[..., self.contacts, :]
            turning = world.calc_contact_bias(q, v)[..., self.contacts]
            vanish, shares = list(range(k)), np.eye(k)
        else:
            rows = stack_rows(world, q, self.contacts)
            turning = calc_contact_turning(world, q, v, self.contacts)
            vanish, shares = self.directions
        kicks = np.linalg.solve(world.calc_mass_matrix(q), np.swapaxes(rows, -1, -2))
        block = rows[..., vanish, :] @ kicks @ shares.T
        rates = (rows @ free[..., np.newaxis])[..., 0] + turning
        unknown = -(np.linalg.pinv(block, RANK) @ rates[..., vanish, np.newaxis])[..., 0]
        forces = unknown @ shares
        mobility = np.diagonal(rows @ kicks, axis1=-2, axis2=-1)[..., vanish]
        acceleration = free + (kicks @ forces[..., np.newaxis])[..., 0]
        tangent = np.zeros_like(forces) if self._is_smooth else forces[..., k:]
        return Push(acceleration, forces[..., :k], tangent, block, mobility)

    def calc_arrest(self, q: Floats) -> tuple[Floats, Floats]:
        """Returns M⁻¹ Dᵀ (C M⁻¹ Dᵀ)⁻¹, shape (nv, r), and C, shape (r, nv), at q (nq,)."""
        rows, M = stack_rows(self.world, q, self.contacts), self.world.calc_mass_matrix(q)
        vanish, shares = self.directions
        pushes, C = np.linalg.solve(M, rows.T @ shares.T), rows[vanish]
        return pushes @ np.linalg.pinv(C @ pushes, RANK), C

    def stop(self, q: Floats, v: Floats) -> Floats:
        """Returns velocities after a plastic impact of all contacts, shape (nv,)."""
        if not len(self.contacts):
            return v
        arrest, C = self.calc_arrest(q)
        return np.asarray(v - arrest @ (C @ v))


def stack_rows(world: World, q: Floats, held: Ints) -> Floats:
    """Returns [J; T] of contacts, shape (…, 2k, nv), at q of shape (…, nq)."""
    J, T = world.calc_contact_jacobian(q), world.rubbing.calc_tangent_jacobian(q)
    return np.concatenate([J[..., held, :], T[..., held, :]], axis=-2)


def calc_contact_turning(world: World, q: Floats, v: Floats, held: Ints) -> Floats:
    """Returns [J̇ v; Ṫ v] of contacts, shape (…, 2k) [m/s²]."""
    turning = world.calc_contact_bias(q, v), world.rubbing.calc_tangent_bias(q, v)
    return np.concatenate([each[..., held] for each in turning], axis=-1)
