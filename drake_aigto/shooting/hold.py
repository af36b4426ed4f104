"""Rigid contacts that are closed at once: their forces and impulses.

Rates along rows k of C vanish: J_k of contacts k < m, and behind them T of sticking contacts, one
for each friction. Columns of Dᵀ are directions of forces: Jᵀ and Tᵀ, or, of a contact that slips
along σ, Jᵀ − μ σ Tᵀ. `closed` says which rows count, shape (w,), w = m + R, and `leans` has −μ σ of
each contact, shape (m,), 0 for sticking contacts and without friction.
"""

from __future__ import annotations

from drake_aigto.arrays import Bools, Floats
from drake_aigto.contact import (
    Mechanics,
    MechanicsMemory,
    divide_by_mass,
    factor_mass,
    find_friction,
    find_row,
    find_slope,
    only_of,
    run_tape,
)
from drake_aigto.kernels import borrowing
from drake_aigto.linear import factor_in_place, solve_factors
from drake_aigto.shooting.tables import Program

# Pivots of C M⁻¹ Dᵀ are at least this part of its diagonal: contacts may be redundant.
_RIDGE = 1e-12


@borrowing
def _clasp(
    closed: Bools, leans: Floats, n: int, mechanics: Mechanics, memory: MechanicsMemory
) -> None:
    """Computes M⁻¹ D_kᵀ of rows that are closed, and factors C M⁻¹ Dᵀ.

    They are rows of `support` and of `grip`: zeros and rows of the identity if not closed.
    """
    sums, support, grip = memory.sums, memory.support, memory.grip
    m, w = leans.size, closed.size
    for k in range(w):
        row, lean, along = find_row(n, m, k), 0.0, 0
        if k < m and leans[k] != 0.0:
            lean, along = leans[k], find_row(n, m, m + find_friction(mechanics.frictions, k))
        for j in range(n):
            support[k, j] = sums[row + j] + lean * sums[along + j] if closed[k] else 0.0
    divide_by_mass(n, memory.factor, support[:w])
    for k in range(w):
        row = find_row(n, m, k)
        for j in range(w):
            are_closed = closed[k] and closed[j]
            total = 1.0 if k == j and not are_closed else 0.0
            for i in range(n if are_closed else 0):
                total += sums[row + i] * support[j, i]
            grip[k, j] = total
    factor_in_place(w, _RIDGE, grip)


@borrowing
def _turn(
    closed: Bools, leans: Floats, n: int, mechanics: Mechanics, memory: MechanicsMemory
) -> None:
    """Computes the derivative of M⁻¹ Dᵀ λ by q at constant λ, transposed, after `_clasp`.

    λ is the last row of `grip`, the derivative fills the last n rows of `support`.
    """
    sums, support, grip = memory.sums, memory.support, memory.grip
    m, w = leans.size, closed.size
    mass, total = find_row(n, m, w), support[w]
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
                slope[i] += grip[w, k] * sums[find_slope(n, m, w, k, i, c)]
            if k < m and leans[k] != 0.0:
                row, pull = m + find_friction(mechanics.frictions, k), leans[k] * grip[w, k]
                for i in range(n):
                    slope[i] += pull * sums[find_slope(n, m, w, row, i, c)]
        for i in range(n):
            for j in range(i, n):
                slope[i] -= sums[at] * total[j]
                if j != i:
                    slope[j] -= sums[at] * total[i]
                at += n
    divide_by_mass(n, memory.factor, support[w + 1 :])


@borrowing
def hold_contacts(
    closed: Bools,
    leans: Floats,
    x: Floats,
    has_slopes: bool,
    mechanics: Mechanics,
    memory: MechanicsMemory,
) -> None:
    """Adds the effect of held contacts to the acceleration.

        v̇ = a + M⁻¹ Dᵀ λ,   C v̇ + Ċ v = 0,   λ = −(C M⁻¹ Dᵀ)⁻¹ (C a + Ċ v)

    Without friction, that is Gauss's principle of least constraint. It takes the acceleration a
    without them, as `accelerate` leaves it with the sums of all slopes, and a's derivative by
    (q, v, u) if asked; then that of λ is computed, too, shape (2n + nu, w). λ becomes the last row
    of `grip`.
    """
    sums, support, acceleration = memory.sums, memory.support, memory.acceleration
    n, m, w, forces = acceleration.shape[1], leans.size, closed.size, memory.grip[closed.size]
    _clasp(closed, leans, n, mechanics, memory)
    for k in range(w):
        forces[k], row = 0.0, find_row(n, m, k)
        for i in range(n if closed[k] else 0):
            forces[k] -= sums[row + i] * acceleration[0, i]
            for j in range(n):
                bend = sums[find_slope(n, m, w, k, i, j)]
                forces[k] -= bend * x[n + i] * x[n + j]
    solve_factors(w, memory.grip, forces)
    for k in range(w):
        for i in range(n):
            acceleration[0, i] += support[k, i] * forces[k]
    if has_slopes:
        _turn(closed, leans, n, mechanics, memory)
        _differentiate_hold(closed, m, x, memory)


@borrowing
def _differentiate_hold(closed: Bools, m: int, x: Floats, memory: MechanicsMemory) -> None:
    """Computes the derivatives of λ, and adds those of M⁻¹ Dᵀ λ to the acceleration's."""
    sums, support, acceleration = memory.sums, memory.support, memory.acceleration
    by_force, slopes = memory.by_force, memory.slopes
    n, w = acceleration.shape[1], closed.size
    behind = find_slope(n, m, w, w, 0, 0)
    for c in range(slopes.shape[0]):
        if c < n:
            for i in range(n):
                slopes[c, i] += support[w + 1 + c, i]
        for k in range(w):
            by_force[c, k] = 0.0
            if not closed[k]:
                continue
            row = find_row(n, m, k)
            for i in range(n):
                by_force[c, k] -= sums[row + i] * slopes[c, i]
                if c < n:
                    bend = sums[find_slope(n, m, w, k, i, c)]
                    by_force[c, k] -= bend * acceleration[0, i]
                elif c < 2 * n:
                    bend = sums[find_slope(n, m, w, k, i, c - n)]
                    bend += sums[find_slope(n, m, w, k, c - n, i)]
                    by_force[c, k] -= bend * x[n + i]
            if c < n:
                by_force[c, k] -= sums[behind + k * n + c]
        solve_factors(w, memory.grip, by_force[c])
        for k in range(w):
            for i in range(n):
                slopes[c, i] += support[k, i] * by_force[c, k]


@borrowing
def strike(
    closed: Bools,
    leans: Floats,
    restitution: float,
    z: Floats,
    has_slopes: bool,
    mechanics: Mechanics,
    memory: MechanicsMemory,
    after: Floats,
) -> None:
    """Computes an impact of contacts that stick or slip in one direction throughout.

        v⁺ = v + M⁻¹ Dᵀ p,   J v⁺ = −e J v,   T v⁺ = 0 if sticking

    Both v⁺ and p are linear in v. For one contact that is the result of Routh's construction
    (`contact.impacts`) where Coulomb's inequalities hold (`measure_modes`).

    It takes the sums of the tape at z, of all slopes if derivatives are asked for, and the factor
    of M. v⁺ becomes entries n … 2n − 1 of the state after, p the last row of `grip`; its derivative
    by (q, v) that of `by_force`, that of v⁺ − v becomes `slopes`, both transposed.
    """
    sums, support, impulses = memory.sums, memory.support, memory.grip[closed.size]
    n, m, w = support.shape[1], leans.size, closed.size
    _clasp(closed, leans, n, mechanics, memory)
    for k in range(w):
        impulses[k] = 0.0
        row, gain = find_row(n, m, k), 1 + restitution if k < m else 1.0
        for i in range(n if closed[k] else 0):
            impulses[k] -= gain * sums[row + i] * z[n + i]
    solve_factors(w, memory.grip, impulses)
    for i in range(n):
        after[n + i] = z[n + i]
        for k in range(w):
            after[n + i] += support[k, i] * impulses[k]
    if has_slopes:
        _turn(closed, leans, n, mechanics, memory)
        _differentiate_strike(closed, m, restitution, z, after, memory)


@borrowing
def _differentiate_strike(
    closed: Bools, m: int, restitution: float, z: Floats, after: Floats, memory: MechanicsMemory
) -> None:
    """Computes the derivatives of p and of M⁻¹ Dᵀ p by (q, v), transposed."""
    sums, support, by_force, slopes = memory.sums, memory.support, memory.by_force, memory.slopes
    n, w = support.shape[1], closed.size
    for c in range(2 * n):
        for i in range(n):
            slopes[c, i] = support[w + 1 + c, i] if c < n else 0.0
        for k in range(w):
            by_force[c, k] = 0.0
            if not closed[k]:
                continue
            row, e = find_row(n, m, k), restitution if k < m else 0.0
            if c >= n:
                by_force[c, k] = -(1 + e) * sums[row + c - n]
                continue
            for i in range(n):
                bend = sums[find_slope(n, m, w, k, i, c)]
                by_force[c, k] -= bend * (after[n + i] + e * z[n + i])
                by_force[c, k] -= sums[row + i] * slopes[c, i]
        solve_factors(w, memory.grip, by_force[c])
        for k in range(w):
            for i in range(n):
                slopes[c, i] += support[k, i] * by_force[c, k]


@only_of(Mechanics)
def hold_stage(
    mechanics: Mechanics,
    closed: Bools,
    leans: Floats,
    y: Floats,
    has_slopes: bool,
    memory: MechanicsMemory,
) -> None:
    """Adds the effect of held contacts to the acceleration (`hold_contacts`)."""
    hold_contacts(closed, leans, y, has_slopes, mechanics, memory)


@only_of(Mechanics)
def strike_stage(
    mechanics: Mechanics,
    program: Program,
    k: int,
    z: Floats,
    has_slopes: bool,
    F: Floats,
    after: Floats,
    memory: MechanicsMemory,
) -> None:
    """Computes the velocity after a stage's impacts (`strike`), and adds its derivatives."""
    n = memory.slopes.shape[1]
    run_tape(mechanics.code, mechanics.numbers, z[: 2 * n], has_slopes, memory.values, memory.sums)
    factor_mass(n, memory.sums, memory.factor)
    leans, e = program.leans[k], program.restitutions[k]
    strike(program.closed[k], leans, e, z, has_slopes, mechanics, memory, after)
    for i in range(n if has_slopes else 0):
        for c in range(2 * n):
            F[n + i, c] += memory.slopes[c, i]
