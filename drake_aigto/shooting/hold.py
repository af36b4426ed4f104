"""Rigid contacts that are closed at once: what their forces or impulses do to a motion.

Rows k of C are what vanishes: J_k of contacts k < m, and T of what sticks behind them, one for each
friction. Columns of Dᵀ are what pushes for that: Jᵀ and Tᵀ, or, of a contact that slips along σ,
Jᵀ − μ σ Tᵀ. `closed` says which rows count, shape (w,), w = m + R, and `leans` has −μ σ of each
contact, shape (m,), 0 where it sticks or does not rub.
"""

from __future__ import annotations

from drake_aigto.arrays import Bools, Floats
from drake_aigto.jit import inner
from drake_aigto.linear import factor_in_place, solve_factors
from drake_aigto.shooting.layout import find_row, find_rows, find_slope
from drake_aigto.shooting.mechanics import Mechanics, MechanicsMemory
from drake_aigto.shooting.mechanism import accelerate, divide_by_mass
from drake_aigto.shooting.rubbing import find_rub

# Pivots of C M⁻¹ Dᵀ are at least this part of its diagonal: contacts may hold without need what
# others hold.
_RIDGE = 1e-12


@inner
def clasp(
    closed: Bools,
    leans: Floats,
    n: int,
    rubs: Floats,
    sums: Floats,
    factor: Floats,
    support: Floats,
    grip: Floats,
) -> None:
    """Computes M⁻¹ D_kᵀ of rows that are closed, and factors C M⁻¹ Dᵀ.

    Rows of `support`, shape (w + 1 + n, n), and of `grip`, shape (w + 1, w). What is not closed has
    zeros in the one, and a row of the identity in the other.
    """
    m, w, count = leans.size, closed.size, rubs.shape[0]
    for k in range(w):
        row, along = find_row(n, m, sums.size, count, k), 0
        leans_over = k < m and leans[k] != 0.0
        if leans_over:
            along = find_row(n, m, sums.size, count, m + find_rub(rubs, k))
        for j in range(n):
            support[k, j] = sums[row + j] if closed[k] else 0.0
            if closed[k] and leans_over:
                support[k, j] += leans[k] * sums[along + j]
    divide_by_mass(n, factor, support[:w])
    for k in range(w):
        row = find_row(n, m, sums.size, count, k)
        for j in range(w):
            total = 1.0 if k == j else 0.0
            if closed[k] and closed[j]:
                total = 0.0
                for i in range(n):
                    total += sums[row + i] * support[j, i]
            grip[k, j] = total
    factor_in_place(w, _RIDGE, grip)


@inner
def turn(
    closed: Bools,
    leans: Floats,
    n: int,
    rubs: Floats,
    sums: Floats,
    factor: Floats,
    support: Floats,
    grip: Floats,
) -> None:
    """Computes the derivative of M⁻¹ Dᵀ λ by q at constant λ, transposed, after `clasp`.

    λ is the last row of `grip`, the derivative fills the last n rows of `support`.
    """
    m, w, count = leans.size, closed.size, rubs.shape[0]
    mass, _ = find_rows(n, m, m)  # Behind the rows of all contacts.
    total = support[w]
    for j in range(n):
        total[j] = 0.0
        for k in range(w):
            total[j] += grip[w, k] * support[k, j]
    for c in range(n):
        slope, at = support[w + 1 + c], mass + c
        for i in range(n):
            slope[i] = 0.0
        for k in range(w):
            if not closed[k]:
                continue
            for i in range(n):
                slope[i] += grip[w, k] * sums[find_slope(n, m, sums.size, count, k, i, c)]
            if k < m and leans[k] != 0.0:
                row, pull = m + find_rub(rubs, k), leans[k] * grip[w, k]
                for i in range(n):
                    slope[i] += pull * sums[find_slope(n, m, sums.size, count, row, i, c)]
        for i in range(n):
            for j in range(i, n):
                slope[i] -= sums[at] * total[j]
                if j != i:
                    slope[j] -= sums[at] * total[i]
                at += n
    divide_by_mass(n, factor, support[w + 1 :])


@inner
def hold(
    closed: Bools,
    leans: Floats,
    x: Floats,
    has_slopes: bool,
    rubs: Floats,
    sums: Floats,
    factor: Floats,
    support: Floats,
    grip: Floats,
    by_force: Floats,
    acceleration: Floats,
    slopes: Floats,
) -> None:
    """Adds to the acceleration what the forces of contacts do that are held.

        v̇ = a + M⁻¹ Dᵀ λ,   C v̇ + Ċ v = 0,   λ = −(C M⁻¹ Dᵀ)⁻¹ (C a + Ċ v)

    Without friction, that is Gauss's principle of least constraint. It takes the acceleration a
    without them, as `accelerate` leaves it with the sums of all slopes, and a's derivative by
    (q, v, u) if asked; then that of λ is computed, too, shape (2n + nu, w). λ becomes the last row
    of `grip`.
    """
    n, m, w, count = acceleration.shape[1], leans.size, closed.size, rubs.shape[0]
    clasp(closed, leans, n, rubs, sums, factor, support, grip)
    forces = grip[w]
    for k in range(w):
        forces[k] = 0.0
        if closed[k]:
            row = find_row(n, m, sums.size, count, k)
            for i in range(n):
                forces[k] -= sums[row + i] * acceleration[0, i]
                for j in range(n):
                    bend = sums[find_slope(n, m, sums.size, count, k, i, j)]
                    forces[k] -= bend * x[n + i] * x[n + j]
    solve_factors(w, grip, forces)
    for k in range(w):
        for i in range(n):
            acceleration[0, i] += support[k, i] * forces[k]
    if has_slopes:
        turn(closed, leans, n, rubs, sums, factor, support, grip)
        _differentiate(closed, m, x, count, sums, support, grip, by_force, acceleration, slopes)


@inner
def _differentiate(
    closed: Bools,
    m: int,
    x: Floats,
    count: int,
    sums: Floats,
    support: Floats,
    grip: Floats,
    by_force: Floats,
    acceleration: Floats,
    slopes: Floats,
) -> None:
    """Computes the derivatives of λ, and adds those of M⁻¹ Dᵀ λ to the acceleration's."""
    n, w = acceleration.shape[1], closed.size
    _, behind = find_rows(n, m, m)
    for c in range(slopes.shape[0]):
        if c < n:
            for i in range(n):
                slopes[c, i] += support[w + 1 + c, i]
        for k in range(w):
            by_force[c, k] = 0.0
            if not closed[k]:
                continue
            row = find_row(n, m, sums.size, count, k)
            for i in range(n):
                by_force[c, k] -= sums[row + i] * slopes[c, i]
                if c < n:
                    bend = sums[find_slope(n, m, sums.size, count, k, i, c)]
                    by_force[c, k] -= bend * acceleration[0, i]
                elif c < 2 * n:
                    bend = sums[find_slope(n, m, sums.size, count, k, i, c - n)]
                    bend += sums[find_slope(n, m, sums.size, count, k, c - n, i)]
                    by_force[c, k] -= bend * x[n + i]
            if c < n:
                by_force[c, k] -= sums[behind + k * n + c]
        solve_factors(w, grip, by_force[c])
        for k in range(w):
            for i in range(n):
                slopes[c, i] += support[k, i] * by_force[c, k]


@inner
def press(
    mechanics: Mechanics,
    closed: Bools,
    leans: Floats,
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
    hold(
        closed,
        leans,
        x,
        has_slopes,
        rubs,
        sums,
        factor,
        support,
        grip,
        by_force,
        acceleration,
        slopes,
    )
