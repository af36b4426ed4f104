"""The directions that contacts push in: a net impulse taken apart, without forces as variables."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import scipy  # Not scipy.optimize, which takes a tenth of a second and few need.

from drake_aigto.arrays import Bools, Floats
from drake_aigto.dynamics import ConstantInertia

# Jacobians are parallel, or directions dependent, within this.
_PARALLEL = 1e-9
# How much a push from afar counts against one from nearby, where impulses could be either's.
_AFAR = 0.3


@dataclass(frozen=True, eq=False)
class ImpulseDirections:
    """What of a net impulse p = Σ_i J_iᵀ λ_i readings show: π = R p = G λ.

    Contacts whose Jacobians are parallel share a direction d_a; two opposite walls for one. A
    reading ρ·p is blind to as many independent directions as it can be, so it shows few contacts:

    - of independent directions each has its own reading, R = (D M⁻¹ Dᵀ)⁻¹ D M⁻¹ for the rows D of
      all d_a;
    - of others, such as those of two bodies between two walls, which push in three ways on two
      coordinates, there is a reading for each set of directions that leaves only one free: what
      the first body gets, what the second one gets, and what both get.

    The law λ_i φ_i = dt ε then leaves, for each reading,

        π_a ∏_i φ_i = dt ε Σ_i G_ai ∏_{l≠i} φ_l        over the contacts i with G_ai ≠ 0

    without any λ, and whatever walls are touched, some reading does not see them.

    Attributes:
        jacobians: J, shape (m, nv), constant.
        directions: D, shape (r, nv).
        readers: R, shape (R, nv); R = r if the directions are independent.
        shares: G = R Jᵀ, shape (R, m), the largest of each reading 1.
        masses: ρ M ρᵀ, shape (R,) [kg].
        tangents: basis of the velocities along all walls, J t = 0, shape (nv, nv − rank J).
        are_independent: whether no direction is a combination of others.
    """

    jacobians: Floats
    directions: Floats
    readers: Floats
    shares: Floats
    masses: Floats
    tangents: Floats
    are_independent: bool

    @classmethod
    def of(cls, inertia: ConstantInertia) -> ImpulseDirections:
        """Returns the directions of all contacts."""
        J, inverse = inertia.jacobian, inertia.inverse_mass
        D = _distinct(J)
        _, sizes, basis = np.linalg.svd(J)
        rank = int(np.sum(sizes > _PARALLEL * sizes[0]))
        are_independent = len(D) == rank
        if are_independent:
            R = np.asarray(np.linalg.solve(D @ inverse @ D.T, D @ inverse), dtype=np.float64)
        else:
            R = _readers(D, inverse, rank)
        shares = R @ J.T
        shares[np.abs(shares) < _PARALLEL] = 0.0
        masses = np.array([float(rho @ inertia.mass_matrix @ rho) for rho in R])
        return cls(J, D, R, shares, masses, basis[rank:].T, are_independent)

    def contact_impulses(self, impulses: Floats, distances: Floats, in_force: Bools) -> Floats:
        """Returns λ (K, m) of net impulses p (K, nv) [N s]: the nearest wall that pushes so has it.

        What nothing can push, a pull, is the nearest wall's too. Where directions depend on each
        other, λ ≥ 0 are those that explain p best, pushes from nearby before those from afar.
        Distances φ [m], and which contacts there are, are of shape (K, m).
        """
        if not self.are_independent:
            return np.array(list(map(self._explain, impulses, distances, in_force)))
        found = np.zeros(distances.shape)
        for reader, share in zip(self.readers, self.shares, strict=True):
            pushes = impulses @ reader
            # The last key counts first: those in force, then those that push, then the nearest.
            cannot = np.sign(share) != np.sign(pushes)[:, np.newaxis]
            is_none = ~in_force | (share == 0)
            chosen = np.lexsort((distances, cannot, is_none), axis=1)[:, 0]
            rows = np.flatnonzero(~np.take_along_axis(is_none, chosen[:, np.newaxis], 1)[:, 0])
            found[rows, chosen[rows]] = pushes[rows] / share[chosen[rows]]
        return found

    def _explain(self, impulse: Floats, distances: Floats, in_force: Bools) -> Floats:
        """Returns λ ≥ 0 of one net impulse, shape (m,)."""
        prices = _AFAR * np.abs(distances) / max(np.max(np.abs(distances)), 1e-300)
        matrix = np.vstack([self.jacobians.T, np.diag(prices)]) * in_force
        return scipy.optimize.nnls(matrix, np.append(impulse, np.zeros(len(prices))))[0]


def _readers(directions: Floats, inverse: Floats, rank: int) -> Floats:
    """Returns ρ = M⁻¹ Dᵀ c, each blind to rank − 1 independent directions, once."""
    span = np.linalg.svd(directions @ inverse)[2][:rank].T
    found: list[Floats] = []
    for hidden in itertools.combinations(directions @ span, rank - 1):
        _, sizes, basis = np.linalg.svd(np.reshape(hidden, (rank - 1, rank)))
        if rank > 1 and sizes[-1] < _PARALLEL * sizes[0]:
            continue
        reader = span @ basis[-1]
        seen = directions @ reader
        reader = reader / seen[np.argmax(np.abs(seen))]
        reader[np.abs(reader) < _PARALLEL * np.max(np.abs(reader))] = 0.0
        if not any(np.allclose(reader, other, atol=_PARALLEL) for other in found):
            found.append(reader)
    return np.array(found)


def _distinct(jacobians: Floats) -> Floats:
    """Returns those rows that are parallel to none before them."""
    kept: list[Floats] = []
    for row in jacobians:
        unit = row / np.linalg.norm(row)
        if all(abs(unit @ other) < np.linalg.norm(other) * (1 - _PARALLEL) for other in kept):
            kept.append(row)
    return np.array(kept)
