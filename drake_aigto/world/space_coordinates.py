"""Coordinates of a tree of joints in space: sums and differences on a manifold."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from drake_aigto.arrays import Bools, Floats, read_only
from drake_aigto.dynamics import PRISMATIC, QUATERNION, RPY, TRANSLATION, Coordinates, Tree


@dataclass(frozen=True, eq=False, repr=False)
class SpaceCoordinates(Coordinates):
    """Positions of joints of any kind, with quaternions of unit length.

    Velocities v are as Drake's plant has them; differences of positions, errors of goals and
    weights are in the tangent space, of shape (nv,).

    Attributes:
        tree: of joints and bodies.
        angular: whether each velocity turns, shape (nv,).
    """

    tree: Tree = field(kw_only=True)
    angular: Bools = field(kw_only=True)

    @property
    def turns(self) -> Bools:
        """Whether each velocity is an angular one, shape (nv,)."""
        return self.angular

    def normalized(self, q: Floats) -> Floats:
        """Returns positions with quaternions of unit length, shape (…, nq)."""
        return self.add(q, np.zeros(self.num_velocities))

    def add(self, q: Floats, delta: Floats) -> Floats:
        """Returns q ⊕ δ, shape (…, nq): links turned by rotation vectors, and moved."""
        q, delta = broadcast_rows(q, delta)
        rows = [self.tree.add(*row) for row in zip(list_rows(q), list_rows(delta), strict=True)]
        return np.array(rows).reshape(q.shape)

    def subtract(self, after: Floats, before: Floats) -> Floats:
        """Returns the shortest δ with before ⊕ δ = after, shape (…, nv), of positions (…, nq)."""
        from drake_aigto.world.space_kernels import subtract_rows

        after, before = np.broadcast_arrays(after, before)
        found = subtract_rows(self.tree, list_rows(after), list_rows(before))
        return found.reshape(*after.shape[:-1], self.num_velocities)

    def measure(self, after: Floats, before: Floats) -> Floats:
        """Returns the same difference for costs, smooth: turns in space by 2 sin(θ/2), not θ."""
        found = self.subtract(after, before)
        for first in self._turns_in_space:
            turn = found[..., first : first + 3]
            angle = np.linalg.norm(turn, axis=-1, keepdims=True)
            turn *= np.sinc(angle / (2 * np.pi))
        return found

    def take_nearest(self, q: Floats, about: Floats) -> Floats:
        """Returns positions as many turns on as bring them nearest to others, shape (…, nq).

        Of both quaternions of a turn that is the one on the other's side.
        """
        found = super().take_nearest(q, about)
        for i in np.flatnonzero(self.tree.kinds == QUATERNION):
            turn = slice(self.tree.positions[i], self.tree.positions[i] + 4)
            dots = np.sum(found[..., turn] * about[..., turn], axis=-1, keepdims=True)
            found[..., turn] *= np.where(dots < 0, -1.0, 1.0)
        return found

    def in_tangent(self, positions: Floats, turn: Floats) -> Floats:
        """Returns numbers of positions (…, nq) by velocities (…, nv); of turns in space `turn`.

        The latter has the shape (…, 1).
        """
        places = self.tree.places
        return np.where(places >= 0, positions[..., places], turn)

    @cached_property
    def _turns_in_space(self) -> list[int]:
        """Where velocities of links that turn about three axes start."""
        kinds, dofs = self.tree.kinds, self.tree.dofs[:-1]
        return [int(self.tree.velocities[dofs[i]]) for i in np.flatnonzero(kinds >= QUATERNION)]

    @property
    def units_of_positions(self) -> tuple[str, ...]:
        """The unit of each position, nq of them; none, "", of the numbers of a quaternion."""
        found = ["rad" if turns else "m" for turns in self.is_hinge]
        for i in np.flatnonzero(self.tree.kinds >= QUATERNION):
            first = int(self.tree.positions[i])
            found[first : first + 4] = [""] * 4
        return tuple(found)

    def middle(self, one: Floats, other: Floats) -> Floats:
        """Returns positions halfway between two, (…, nq)."""
        return self.add(one, self.subtract(other, one) / 2)

    @property
    def origin(self) -> Floats:
        """Positions that are zero, or not turned, shape (nq,)."""
        return self.tree.unturned

    @cached_property
    def rates(self) -> Floats:
        """N(q) of q̇ = N(q) v, c_ij0 + Σ_k c_ijk q_k of velocity i, shape (nv, nq, 1 + nq).

        NaN of angles of roll, pitch and yaw.
        """
        tree, n = self.tree, self.num_positions
        found = np.zeros((self.num_velocities, n, 1 + n))
        for i, velocity in enumerate(np.eye(self.num_velocities)):
            at_zero = tree.calc_position_rate(np.zeros(n), velocity)
            columns = [tree.calc_position_rate(q, velocity) - at_zero for q in np.eye(n)]
            found[i] = np.column_stack([at_zero, *columns])
        for i in np.flatnonzero(tree.kinds == RPY).tolist():
            first, of_link = tree.positions[i], tree.velocities[tree.dofs[i] : tree.dofs[i + 1]]
            found[of_link, first : first + 3] = np.nan
        return found

    def calc_position_rate(self, q: Floats, v: Floats) -> Floats:
        """Returns q̇ = N(q) v, shape (…, nq)."""
        rows = [
            self.tree.calc_position_rate(*row)
            for row in zip(list_rows(q), list_rows(v), strict=True)
        ]
        return np.array(rows).reshape(np.shape(q))


def list_rows(values: Floats) -> Floats:
    """Returns values as writable, contiguous rows."""
    array = np.asarray(values, dtype=float)
    return np.array(array.reshape(-1, array.shape[-1]), order="C")


def broadcast_rows(one: Floats, other: Floats) -> tuple[Floats, Floats]:
    """Returns rows of both at all states of either."""
    shape = np.broadcast_shapes(np.shape(one)[:-1], np.shape(other)[:-1])
    each = (np.broadcast_to(a, (*shape, np.shape(a)[-1])) for a in (one, other))
    first, second = each
    return first, second


def find_angles(tree: Tree) -> tuple[Bools, Bools]:
    """Returns which positions (nq,) and which velocities (nv,) turn."""
    q, v = np.ones(tree.num_positions, dtype=bool), np.ones(tree.num_velocities, dtype=bool)
    for i in np.flatnonzero(np.isin(tree.kinds, (PRISMATIC, TRANSLATION))):
        dofs = slice(tree.dofs[i], tree.dofs[i + 1])
        v[tree.velocities[dofs]] = False
        count, first = tree.dofs[i + 1] - tree.dofs[i], tree.positions[i]
        q[first : first + count] = False
    return read_only(q, bool), read_only(v, bool)
