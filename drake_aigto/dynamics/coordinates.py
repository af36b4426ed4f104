"""Coordinates of a mechanism, and sums and differences of its states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_aigto.arrays import Bools, Floats


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Positions q and velocities v of a mechanism of hinges and sliders, where q̇ = v.

    A world whose positions are a manifold, with quaternions of unit length, has its own sums and
    differences: q ⊕ δ and the δ of least size between two positions, both in the tangent space.

    Attributes:
        is_hinge: whether each position is an angle [rad], shape (nq,); other ones are lengths [m].
        positions: the variables q, shape (nq,) [m, rad].
        velocities: the variables v, shape (nv,) [m/s, rad/s].
    """

    is_hinge: Bools
    positions: NDArray[Any]
    velocities: NDArray[Any]

    @property
    def num_positions(self) -> int:
        """The number of generalized positions, nq."""
        return len(self.positions)

    @property
    def position_unit(self) -> str:
        """The unit of positions, "m" or "rad", or both as "m, rad"."""
        return ", ".join(unit for unit in ("m", "rad") if unit in self.units)

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of each coordinate's way, "m" or "rad", nv of them."""
        return tuple("rad" if turns else "m" for turns in self.turns)

    @property
    def units_of_positions(self) -> tuple[str, ...]:
        """The unit of each position, nq of them; none, "", of the numbers of a quaternion."""
        return self.units

    @property
    def num_velocities(self) -> int:
        """The number of generalized velocities, nv = nq."""
        return len(self.velocities)

    @property
    def turns(self) -> Bools:
        """Whether each velocity is an angular one, shape (nv,)."""
        return self.is_hinge

    def normalized(self, q: Floats) -> Floats:
        """Returns positions that can be, shape (…, nq): all are."""
        return q

    def split(self, states: Floats) -> tuple[Floats, Floats]:
        """Returns positions (…, nq) and velocities (…, nv) of states, one after the other."""
        return states[..., : self.num_positions], states[..., self.num_positions :]

    def add(self, q: Floats, delta: Floats) -> Floats:
        """Returns positions (…, nq) moved by δ, which is a velocity for 1 s, (…, nv)."""
        return np.add(q, delta)

    def subtract(self, after: Floats, before: Floats) -> Floats:
        """Returns the difference of positions, shape (…, nv), a velocity for 1 s."""
        return np.subtract(after, before)

    def take_nearest(self, q: Floats, about: Floats) -> Floats:
        """Returns positions as many turns on as bring them nearest to others, shape (…, nq)."""
        turns = np.where(self.is_hinge, 2 * np.pi * np.round((q - about) / (2 * np.pi)), 0.0)
        return np.asarray(q - turns)

    def calc_error(self, x: Floats, planned: Floats) -> Floats:
        """Returns by how much states differ, δ and ṽ, shape (…, 2 nv); turns to the nearest."""
        (q, v), (about, speed) = self.split(x), self.split(planned)
        return np.concatenate([self.subtract(self.take_nearest(q, about), about), v - speed], -1)

    def in_tangent(self, positions: Floats, turn: Floats) -> Floats:
        """Returns numbers of positions (…, nq) by velocities (…, nv); of turns in space `turn`."""
        return positions

    def measure(self, after: Floats, before: Floats) -> Floats:
        """Returns the same difference for costs."""
        return self.subtract(after, before)

    def middle(self, one: Floats, other: Floats) -> Floats:
        """Returns positions halfway between two, (…, nq)."""
        return (other + one) / 2

    @property
    def origin(self) -> Floats:
        """Positions that are zero, or not turned, shape (nq,)."""
        return np.zeros(self.num_positions)

    @property
    def rates(self) -> Floats:
        """N(q) of q̇ = N(q) v, c_ij0 + Σ_k c_ijk q_k of velocity i, shape (nv, nq, 1 + nq).

        NaN where it is no such sum.
        """
        return np.dstack([np.eye(self.num_positions), np.zeros((self.num_positions,) * 3)])

    def calc_position_rate(self, q: Floats, v: Floats) -> Floats:
        """Returns q̇, shape (…, nq)."""
        return np.broadcast_to(v, np.shape(q))
