"""Where a phase starts: an impact on rigid walls, and the phase's duration."""

from __future__ import annotations

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.jit import inner
from drake_aigto.linear import solve_factored
from drake_aigto.shooting.flow import clear
from drake_aigto.shooting.hold import clasp, turn
from drake_aigto.shooting.layout import find_rows, triangle
from drake_aigto.shooting.mechanism import factor_mass
from drake_aigto.shooting.strike import StrikeMemory, differentiate_strike, find_rub, strike
from drake_aigto.shooting.tape import run_tape


@inner
def jump(
    code: Ints,
    numbers: Floats,
    rubs: Floats,
    contact: int,
    mode: int,
    struck: Bools,
    restitution: float,
    nx: int,
    z: Floats,
    duration: float,
    has_slopes: bool,
    values: Floats,
    sums: Floats,
    factor: Floats,
    slopes: Floats,
    support: Floats,
    grip: Floats,
    by_force: Floats,
    room: StrikeMemory,
    after: Floats,
    F: Floats,
    l1: Floats,
    l2: Floats,
) -> None:
    """Computes the state (q, v⁺, τ, t) after the start of a phase; with derivatives if asked.

        v⁺ = v + M⁻¹ Jᵀ p,   J v⁺ = −e J v,   p = −(1 + e) (J M⁻¹ Jᵀ)⁻¹ J v

    J has the contacts that are struck: the one that is hit, if any, and all that are held from then
    on. What rubs ends the impact in a mode instead (`strike`). The duration, a control, becomes τ.
    """
    nz = z.size
    for i in range(nz):
        after[i] = z[i]
    after[nx] = duration
    if has_slopes:
        clear(l1, l2)
        clear(l1, F)
        for i in range(nz):
            F[i, i] = 1.0
        F[nx, nx], F[nx, nz] = 0.0, 1.0
    if not struck.any():
        return
    n, m = nx // 2, struck.size
    run_tape(code, numbers, z[:nx], has_slopes, values, sums)
    factor_mass(n, sums, factor)
    rub = find_rub(rubs, contact)
    if rub >= 0:
        strike(contact, m, rubs, rub, mode, restitution, z, has_slopes, sums, factor, room)
        for i in range(n):
            for way in range(2):
                after[n + i] += room.kicks[way, i] * room.impulse[way, 0]
        if has_slopes:
            count = rubs.shape[0]
            differentiate_strike(contact, m, count, rub, sums, factor, room, slopes)
            _add_slopes(n, slopes, F)
        return
    clasp(struck, n, sums, factor, support, grip)
    impulses = grip[m]
    for k in range(m):
        impulses[k] = 0.0
        row, _ = find_rows(n, m, k)
        for i in range(n if struck[k] else 0):
            impulses[k] -= (1 + restitution) * sums[row + i] * z[n + i]
    solve_factored(m, grip, impulses)
    for k in range(m):
        for i in range(n):
            after[n + i] += support[k, i] * impulses[k]
    if has_slopes:
        turn(struck, n, sums, factor, support, grip)
        _differentiate(n, struck, restitution, z, after, sums, support, grip, by_force, slopes)
        _add_slopes(n, slopes, F)


@inner
def _add_slopes(n: int, slopes: Floats, F: Floats) -> None:
    """Adds the derivative of the velocity's change by (q, v)."""
    for i in range(n):
        for c in range(2 * n):
            F[n + i, c] += slopes[c, i]


@inner
def _differentiate(
    n: int,
    struck: Bools,
    e: float,
    z: Floats,
    after: Floats,
    sums: Floats,
    support: Floats,
    grip: Floats,
    by_force: Floats,
    slopes: Floats,
) -> None:
    """Computes the derivative of M⁻¹ Jᵀ p by (q, v), transposed."""
    m = struck.size
    for c in range(2 * n):
        for i in range(n):
            slopes[c, i] = support[m + 1 + c, i] if c < n else 0.0
        for k in range(m):
            by_force[c, k] = 0.0
            if not struck[k]:
                continue
            row, bends = find_rows(n, m, k)
            if c >= n:
                by_force[c, k] = -(1 + e) * sums[row + c - n]
                continue
            for i in range(n):
                bend = sums[bends + triangle(n, i, c)]
                by_force[c, k] -= bend * (after[n + i] + e * z[n + i])
                by_force[c, k] -= sums[row + i] * slopes[c, i]
        solve_factored(m, grip, by_force[c])
        for k in range(m):
            for i in range(n):
                slopes[c, i] += support[k, i] * by_force[c, k]
