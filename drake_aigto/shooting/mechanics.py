"""A mechanism as tables of numbers for compiled code, and room to evaluate them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from drake_aigto.arrays import Floats, Ints


class Mechanics(NamedTuple):
    """What compiled code knows of a mechanism.

    Attributes:
        code: of a `Tape` of M (upper triangle, by rows), h, φ, J; then of ∂M/∂q, ∂h/∂(q, v), ∂J/∂q
            (upper triangle), and where walls are rigid of vᵀ (∂²J/∂q²) v, by contacts, and of
            vᵀ ∂(∂T/∂q)/∂q v; then of ∂T/∂q, and of T, the rows of what rubs.
        numbers: of the same.
        constants: of the same.
        actuation: B, shape (n, nu).
        contacts: stiffness k [N/m], dissipation d [s/m], restitution e and reach R [m] (see
            `CompliantLaw`) of each, shape (m, 4).
        solids: where the contacts of each solid start, shape (S + 1,).
        rubs: friction, shape (R, 5), see `rubbing`.
    """

    code: Ints
    numbers: Floats
    constants: Floats
    actuation: Floats
    contacts: Floats
    solids: Ints
    rubs: Floats


class MechanicsMemory(NamedTuple):
    """Room for one evaluation.

    Attributes:
        values: of the tape.
        sums: of the tape.
        factor: Cholesky's L of M, shape (n, n).
        force: of each contact, its derivatives by φ and φ̇, ∂l/∂φ (see `CompliantLaw`) and its
            derivative by φ, shape (m, 5).
        rub: of each friction, and its derivatives by s and N, shape (R, 3).
        acceleration: v̇, shape (1, n).
        slopes: ∂v̇/∂(q, v, u), transposed, shape (2n + nu, n).
        support: M⁻¹ D_kᵀ of what is held (`hold`, w = m + R rows), M⁻¹ Dᵀ λ, and its derivative by
            q at constant λ, transposed, shape (w + 1 + n, n).
        grip: the factors of C M⁻¹ Dᵀ, and the forces λ below, shape (w + 1, w).
        by_force: the derivative of λ by (q, v, u), transposed, shape (2n + nu, w).
    """

    values: Floats
    sums: Floats
    factor: Floats
    force: Floats
    rub: Floats
    acceleration: Floats
    slopes: Floats
    support: Floats
    grip: Floats
    by_force: Floats


def copy_writable(table: Any) -> Any:
    """Returns a copy whose arrays are all writable: what cannot be written is of another type.

    Code would be compiled once more for it.
    """
    if isinstance(table, tuple):
        return type(table)(*map(copy_writable, table))
    return np.array(table, order="C") if isinstance(table, np.ndarray) else table


def make_mechanics_memory(mechanics: Mechanics) -> MechanicsMemory:
    """Returns room for evaluations."""
    (n, nu), code, m = mechanics.actuation.shape, mechanics.code, len(mechanics.contacts)
    w = m + len(mechanics.rubs)
    return MechanicsMemory(
        values=np.zeros(1 + 2 * n + 2 * code[0] + code[1]),
        sums=mechanics.constants.copy(),
        factor=np.zeros((n, n)),
        force=np.zeros((m, 5)),
        rub=np.zeros((len(mechanics.rubs), 3)),
        acceleration=np.zeros((1, n)),
        slopes=np.zeros((2 * n + nu, n)),
        support=np.zeros((w + 1 + n, n)),
        grip=np.zeros((w + 1, w)),
        by_force=np.zeros((2 * n + nu, w)),
    )
