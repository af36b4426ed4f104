"""Motion along a rigid wall that is held: what its force does to the acceleration."""

from __future__ import annotations

from drake_aigto.arrays import Floats
from drake_aigto.jit import inner
from drake_aigto.shooting.layout import find_rows, triangle
from drake_aigto.shooting.mechanics import Mechanics, MechanicsMemory
from drake_aigto.shooting.mechanism import accelerate, divide_by_mass


@inner
def hold(
    contact: int,
    num_contacts: int,
    x: Floats,
    has_slopes: bool,
    sums: Floats,
    factor: Floats,
    support: Floats,
    by_force: Floats,
    acceleration: Floats,
    slopes: Floats,
) -> float:
    """Returns the force of a contact that is held, and adds what it does to the acceleration.

        v̇ = a + M⁻¹ Jᵀ λ,   J v̇ + J̇ v = 0,   λ = −(J a + J̇ v) / (J M⁻¹ Jᵀ)

    Gauss's principle of least constraint. It takes the acceleration a without it, as `accelerate`
    leaves it with the sums of all slopes, and a's derivative by (q, v, u) if asked; then that of λ
    is computed, too, shape (2n + nu,). Room is `support`, shape (1 + n, n).
    """
    n, m = acceleration.shape[1], num_contacts
    row, bends = find_rows(n, m, contact)
    for j in range(n):
        support[0, j] = sums[row + j]
    divide_by_mass(n, factor, support[:1])
    inverse_mass, off = 0.0, 0.0
    for i in range(n):
        inverse_mass += sums[row + i] * support[0, i]
        off += sums[row + i] * acceleration[0, i]
        for j in range(n):
            off += sums[bends + triangle(n, i, j)] * x[n + i] * x[n + j]
    force = -off / inverse_mass
    if has_slopes:
        _differentiate(
            contact,
            m,
            x,
            force,
            inverse_mass,
            sums,
            factor,
            support,
            by_force,
            acceleration,
            slopes,
        )
    for i in range(n):
        acceleration[0, i] += support[0, i] * force
    return force


@inner
def _differentiate(
    contact: int,
    m: int,
    x: Floats,
    force: float,
    inverse_mass: float,
    sums: Floats,
    factor: Floats,
    support: Floats,
    by_force: Floats,
    acceleration: Floats,
    slopes: Floats,
) -> None:
    """Computes the derivatives of λ, and adds those of M⁻¹ Jᵀ λ to the acceleration's."""
    n = acceleration.shape[1]
    row, bends = find_rows(n, m, contact)
    # Behind those of all contacts.
    mass, turns = find_rows(n, m, m)
    turns += contact * n
    # The derivative of M⁻¹ Jᵀ by q, transposed, below M⁻¹ Jᵀ itself.
    for c in range(n):
        at = mass + c
        for i in range(n):
            support[1 + c, i] = sums[bends + triangle(n, i, c)]
        for i in range(n):
            for j in range(i, n):
                support[1 + c, i] -= sums[at] * support[0, j]
                if j != i:
                    support[1 + c, j] -= sums[at] * support[0, i]
                at += n
    divide_by_mass(n, factor, support[1:])
    for c in range(by_force.size):
        off = 0.0
        for i in range(n):
            off += sums[row + i] * slopes[c, i]
        if c < n:
            off += sums[turns + c]
            for i in range(n):
                bend = sums[bends + triangle(n, i, c)]
                off += bend * (acceleration[0, i] + force * support[0, i])
                off += force * sums[row + i] * support[1 + c, i]
        elif c < 2 * n:
            for i in range(n):
                off += 2 * sums[bends + triangle(n, i, c - n)] * x[n + i]
        by_force[c] = -off / inverse_mass
    for c in range(by_force.size):
        for i in range(n):
            slopes[c, i] += support[0, i] * by_force[c]
            if c < n:
                slopes[c, i] += support[1 + c, i] * force


@inner
def press(
    mechanics: Mechanics,
    contact: int,
    x: Floats,
    u: Floats,
    has_slopes: bool,
    memory: MechanicsMemory,
) -> float:
    """Returns the force of a contact that is held at a state; the memory has its derivative.

    It has v̇ and ∂v̇/∂(q, v, u), too.
    """
    code, numbers, _, actuation, contacts, solids, rubs = mechanics
    values, sums, factor, force, rub, acceleration, slopes, support, by_force = memory
    accelerate(
        code,
        numbers,
        actuation,
        contacts,
        solids,
        rubs,
        x,
        u,
        0.0,
        True,
        values,
        sums,
        factor,
        force,
        rub,
        acceleration,
        slopes,
    )
    return hold(
        contact,
        contacts.shape[0],
        x,
        has_slopes,
        sums,
        factor,
        support,
        by_force,
        acceleration,
        slopes,
    )
