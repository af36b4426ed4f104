"""Rigid contacts that are closed at once: what their forces or impulses do to a motion."""

from __future__ import annotations

from drake_aigto.arrays import Bools, Floats
from drake_aigto.jit import inner
from drake_aigto.linear import solve_factored
from drake_aigto.shooting.layout import find_rows, triangle
from drake_aigto.shooting.mechanics import Mechanics, MechanicsMemory
from drake_aigto.shooting.mechanism import accelerate, divide_by_mass

# Pivots of J M⁻¹ Jᵀ are at least this part of its diagonal: contacts may hold without need what
# others hold.
_RIDGE = 1e-12


@inner
def clasp(held: Bools, n: int, sums: Floats, factor: Floats, support: Floats, grip: Floats) -> None:
    """Computes M⁻¹ J_iᵀ of contacts that are held, and factors J M⁻¹ Jᵀ = L Lᵀ.

    Rows of `support`, shape (m + 1 + n, n), and of `grip`, shape (m + 1, m). What is not held has
    zeros in the one, and a row of the identity in the other.
    """
    m = held.size
    for i in range(m):
        row, _ = find_rows(n, m, i)
        for j in range(n):
            support[i, j] = sums[row + j] if held[i] else 0.0
    divide_by_mass(n, factor, support[:m])
    for i in range(m):
        row, _ = find_rows(n, m, i)
        for j in range(i + 1):
            total = 1.0 if i == j else 0.0
            if held[i] and held[j]:
                total = 0.0
                for k in range(n):
                    total += sums[row + k] * support[j, k]
            least = _RIDGE * total
            for k in range(j):
                total -= grip[i, k] * grip[j, k]
            grip[i, j] = max(total, least) ** 0.5 if i == j else total / grip[j, j]


@inner
def turn(held: Bools, n: int, sums: Floats, factor: Floats, support: Floats, grip: Floats) -> None:
    """Computes the derivative of M⁻¹ Jᵀ λ by q at constant λ, transposed, after `clasp`.

    λ is the last row of `grip`, the derivative fills the last n rows of `support`.
    """
    m = held.size
    mass, _ = find_rows(n, m, m)  # Behind the rows of all contacts.
    total = support[m]
    for j in range(n):
        total[j] = 0.0
        for i in range(m):
            total[j] += grip[m, i] * support[i, j]
    for c in range(n):
        slope, at = support[m + 1 + c], mass + c
        for i in range(n):
            slope[i] = 0.0
        for k in range(m):
            if held[k]:
                _, bends = find_rows(n, m, k)
                for i in range(n):
                    slope[i] += grip[m, k] * sums[bends + triangle(n, i, c)]
        for i in range(n):
            for j in range(i, n):
                slope[i] -= sums[at] * total[j]
                if j != i:
                    slope[j] -= sums[at] * total[i]
                at += n
    divide_by_mass(n, factor, support[m + 1 :])


@inner
def hold(
    held: Bools,
    x: Floats,
    has_slopes: bool,
    sums: Floats,
    factor: Floats,
    support: Floats,
    grip: Floats,
    by_force: Floats,
    acceleration: Floats,
    slopes: Floats,
) -> None:
    """Adds to the acceleration what the forces of contacts do that are held.

        v̇ = a + M⁻¹ Jᵀ λ,   J v̇ + J̇ v = 0,   λ = −(J M⁻¹ Jᵀ)⁻¹ (J a + J̇ v)

    Gauss's principle of least constraint. It takes the acceleration a without them, as `accelerate`
    leaves it with the sums of all slopes, and a's derivative by (q, v, u) if asked; then that of λ
    is computed, too, shape (2n + nu, m). λ becomes the last row of `grip`.
    """
    n, m = acceleration.shape[1], held.size
    clasp(held, n, sums, factor, support, grip)
    forces = grip[m]
    for k in range(m):
        forces[k] = 0.0
        if held[k]:
            row, bends = find_rows(n, m, k)
            for i in range(n):
                forces[k] -= sums[row + i] * acceleration[0, i]
                for j in range(n):
                    forces[k] -= sums[bends + triangle(n, i, j)] * x[n + i] * x[n + j]
    solve_factored(m, grip, forces)
    for k in range(m):
        for i in range(n):
            acceleration[0, i] += support[k, i] * forces[k]
    if has_slopes:
        turn(held, n, sums, factor, support, grip)
        _differentiate(held, x, sums, support, grip, by_force, acceleration, slopes)


@inner
def _differentiate(
    held: Bools,
    x: Floats,
    sums: Floats,
    support: Floats,
    grip: Floats,
    by_force: Floats,
    acceleration: Floats,
    slopes: Floats,
) -> None:
    """Computes the derivatives of λ, and adds those of M⁻¹ Jᵀ λ to the acceleration's."""
    n, m = acceleration.shape[1], held.size
    _, behind = find_rows(n, m, m)
    for c in range(slopes.shape[0]):
        if c < n:
            for i in range(n):
                slopes[c, i] += support[m + 1 + c, i]
        for k in range(m):
            by_force[c, k] = 0.0
            if not held[k]:
                continue
            row, bends = find_rows(n, m, k)
            for i in range(n):
                by_force[c, k] -= sums[row + i] * slopes[c, i]
                if c < n:
                    by_force[c, k] -= sums[bends + triangle(n, i, c)] * acceleration[0, i]
                elif c < 2 * n:
                    by_force[c, k] -= 2 * sums[bends + triangle(n, i, c - n)] * x[n + i]
            if c < n:
                by_force[c, k] -= sums[behind + k * n + c]
        solve_factored(m, grip, by_force[c])
        for k in range(m):
            for i in range(n):
                slopes[c, i] += support[k, i] * by_force[c, k]


@inner
def press(
    mechanics: Mechanics,
    held: Bools,
    x: Floats,
    u: Floats,
    has_slopes: bool,
    memory: MechanicsMemory,
) -> None:
    """Computes the forces of contacts that are held at a state, and their derivatives if asked.

    The memory has them, v̇ and ∂v̇/∂(q, v, u).
    """
    code, numbers, _, actuation, contacts, solids, rubs = mechanics
    values, sums, factor, force, rub, acceleration, slopes, support, grip, by_force = memory
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
    hold(held, x, has_slopes, sums, factor, support, grip, by_force, acceleration, slopes)
