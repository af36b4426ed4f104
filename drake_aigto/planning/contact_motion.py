"""How the contacts of a world move, in numbers: distances, rates, and what impulses do."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.optimize import nnls

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from drake_aigto.world import World

    _Array = npt.NDArray[np.float64]


class Clearance(NamedTuple):
    """How far outside of a solid the ball is: in front of that face, of several, by the most."""

    contact: int  # the face
    distance: float  # φ of that face [m]; at most 0 is inside
    rate: float  # φ̇ [m/s]


class ContactMotion:
    """The distances φ of a world's contacts along a motion x = (q, v), and impulses at them.

    A distance that is polynomial in q comes from translations alone. So it is affine, and with the
    constant M all of these are constant:

        φ(q) = J q + φ(0),    φ̇ = J v,    φ̈ = J v̇,    A = J M⁻¹ Jᵀ

    The faces of one box are one solid, which the ball is outside of while it is in front of one of
    them: its clearance is the largest of their φ. Beyond the box's edges that is a sharp corner,
    where Drake's geometry has one that is as round as the ball.

    Attributes:
        jacobian: J, shape (m, nv).
        lifts: M⁻¹ J_iᵀ / A_ii, shape (m, nv): how an impulse at contact i changes v when it changes
            φ̇_i by one.
        masses: what each contact feels, 1 / A_ii, shape (m,) [kg].
        solids: the contacts of each solid.
        solid_of: the solid of each contact.
    """

    def __init__(self, world: World) -> None:
        """Reads what is constant."""
        origin = np.zeros(world.num_positions)
        self._offset = world.calc_signed_distance(origin)
        self._num_contacts = world.num_contacts
        self._mass_matrix = world.mass_matrix_values
        # M = C Cᵀ; columns of C⁻¹ Jᵀ are what impulses do, in units where kinetic energy is ½ ‖·‖².
        self._cholesky = np.linalg.cholesky(self._mass_matrix)
        self.jacobian = world.calc_contact_jacobian(origin)
        # (φ, φ̇) = rows x + (φ(0), 0).
        self._rows = np.kron(np.eye(2), self.jacobian)
        self._origin = np.concatenate([self._offset, np.zeros(self._num_contacts)])
        self._columns = np.linalg.solve(self._cholesky, self.jacobian.T)
        inertias = np.sum(self._columns**2, axis=0)
        self.masses = 1 / inertias
        self.lifts = np.linalg.solve(self._mass_matrix, self.jacobian.T).T / inertias[:, np.newaxis]
        self.solid_of = [contact.solid for contact in world.contacts]
        self.solids = [
            [i for i, solid in enumerate(self.solid_of) if solid == s]
            for s in range(max(self.solid_of) + 1)
        ]

    def calc_distances(self, x: _Array) -> tuple[list[float], list[float]]:
        """Returns φ [m] and φ̇ [m/s] of each contact."""
        both = (self._rows @ x + self._origin).tolist()
        return both[: self._num_contacts], both[self._num_contacts :]

    def calc_clearances(self, x: _Array) -> list[Clearance]:
        """Returns the clearance of each solid."""
        distances, rates = self.calc_distances(x)
        faces = [
            solid[0] if len(solid) == 1 else max(solid, key=distances.__getitem__)
            for solid in self.solids
        ]
        return [Clearance(i, distances[i], rates[i]) for i in faces]

    def calc_depth(self, positions: npt.ArrayLike) -> float:
        """Returns how deep the ball is inside a solid at most, at least 0 [m].

        Args:
            positions: q of K moments, shape (K, nq) [m].
        """
        distances = np.asarray(positions) @ self.jacobian.T + self._offset
        return max(0.0, -min(float(np.min(distances[:, s].max(axis=1))) for s in self.solids))

    def calc_pushes(self, acceleration: _Array) -> list[float]:
        """Returns φ̈ of each contact [m/s²]; negative is into the wall."""
        return (self.jacobian @ acceleration).tolist()

    def calc_supported(self, rates: _Array, contacts: Sequence[int]) -> _Array:
        """Returns the nearest rates of change of v, or of q, that enter none of these contacts.

            minimize ½ (x − r)ᵀ M (x − r)   subject to   J_C x ≥ 0

        For accelerations that is Gauss's principle of least constraint: x = r + M⁻¹ J_Cᵀ λ with
        λ ≥ 0, J_C x ≥ 0, λᵀ J_C x = 0, the forces of rest on frictionless walls. For velocities it
        is an impact that returns nothing.

        Args:
            rates: r, shape (nv,).
            contacts: C.
        """
        if not contacts:
            return rates
        if len(contacts) == 1:
            (i,) = contacts
            return rates - min(float(self.jacobian[i] @ rates), 0.0) * self.lifts[i]
        # λ ≥ 0 of least ‖C⁻¹ J_Cᵀ λ + Cᵀ r‖.
        columns = self._columns[:, list(contacts)]
        forces, _ = nnls(columns, -self._cholesky.T @ rates)
        return rates + np.linalg.solve(self._cholesky.T, columns @ forces)

    def calc_kinetic_energy(self, v: _Array) -> float:
        """Returns ½ vᵀ M v [J]."""
        return float(v @ self._mass_matrix @ v) / 2


def calc_time_to_wall(distance: float, rate: float, push: float) -> float:
    """Returns the first t ≥ 0 at which φ + φ̇ t + φ̈ t²/2 = 0 [s]; infinity if there is none.

    Args:
        distance: φ ≥ 0 [m].
        rate: φ̇ [m/s].
        push: φ̈, taken for constant [m/s²].
    """
    discriminant = rate**2 - 2 * push * distance
    if discriminant < 0:
        return math.inf
    if rate < 0:
        return 2 * distance / (math.sqrt(discriminant) - rate)
    return (math.sqrt(discriminant) + rate) / -push if push < 0 else math.inf
