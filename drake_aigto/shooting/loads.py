"""How much friction there is at rigid contacts: what forces and impulses are compared with."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.shooting.mechanism import Mechanism
from drake_aigto.shooting.rubbing import COEFFICIENT, SOURCE

# What hardly moves away from a wall bears no weight there [1/kg].
_IMMOBILE = 1e-12


def calc_mobilities(mechanism: Mechanism, q: Floats) -> Floats:
    """Returns T M⁻¹ Tᵀ of each contact that rubs, 0 of others, shape (m,) [1/kg]."""
    tangents, (mass, _) = _read_tangents(mechanism, q), mechanism.calc_inertia(q)
    return np.einsum("ij,ji->i", tangents, np.linalg.solve(mass, tangents.T))


def calc_drag(mechanism: Mechanism, q: Floats) -> Floats:
    """Returns the friction of all rigid contacts, each of which bears the weight, (n,) [N, N m].

    That is Σ |T_i| μ_i N_i with N = |J M⁻¹ h| / (J M⁻¹ Jᵀ), whether it touches or not.
    """
    (n, m), of = (len(q), mechanism.num_contacts), mechanism.mechanics
    mass, bias = mechanism.calc_inertia(q)
    first = n * (n + 1) // 2 + n + m
    J = mechanism.calc_sums(q)[first : first + m * n].reshape(m, n)
    kicks, friction = np.linalg.solve(mass, J.T), np.zeros(m)
    for rub in of.rubs:
        if rub[SOURCE] >= 0 and of.contacts[int(rub[SOURCE]), 0] == 0:
            friction[int(rub[SOURCE])] = rub[COEFFICIENT]
    loads = np.abs(bias @ kicks) / np.maximum(np.einsum("ij,ji->i", J, kicks), _IMMOBILE)
    return np.asarray((friction * loads) @ np.abs(_read_tangents(mechanism, q)))


def _read_tangents(mechanism: Mechanism, q: Floats) -> Floats:
    """Returns T of each contact that rubs, zero of others, shape (m, n)."""
    rubs, sums = mechanism.mechanics.rubs, mechanism.calc_sums(q)
    found = np.zeros((mechanism.num_contacts, len(q)))
    rows = sums[len(sums) - len(rubs) * len(q) :].reshape(len(rubs), len(q))
    for T, source in zip(rows, rubs[:, SOURCE].astype(int), strict=True):
        if source >= 0:
            found[source] = T
    return found
