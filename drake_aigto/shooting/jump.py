"""Where a phase starts: an impact on a rigid wall, and the phase's duration."""

from __future__ import annotations

from drake_aigto.arrays import Floats, Ints
from drake_aigto.jit import inner
from drake_aigto.shooting.flow import clear
from drake_aigto.shooting.layout import triangle
from drake_aigto.shooting.mechanism import divide_by_mass, factor_mass
from drake_aigto.shooting.strike import StrikeMemory, differentiate_strike, find_rub, strike
from drake_aigto.shooting.tape import run_tape


@inner
def jump(
    code: Ints,
    numbers: Floats,
    contacts: Floats,
    rubs: Floats,
    contact: int,
    is_held: bool,
    mode: int,
    nx: int,
    z: Floats,
    duration: float,
    has_slopes: bool,
    values: Floats,
    sums: Floats,
    factor: Floats,
    kick: Floats,
    slopes: Floats,
    room: StrikeMemory,
    after: Floats,
    F: Floats,
    l1: Floats,
    l2: Floats,
) -> None:
    """Computes the state (q, v⁺, τ, t) after the start of a phase; with derivatives if asked.

    The contact is that which is hit, or negative; what is held from then on loses all of its speed,
    whatever its restitution; what rubs ends the impact in a mode (`strike`); the duration, a
    control, becomes τ.
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
    if contact < 0:
        return
    n, m = nx // 2, contacts.shape[0]
    run_tape(code, numbers, z[:nx], has_slopes, values, sums)
    factor_mass(n, sums, factor)
    restitution, rub = 0.0 if is_held else contacts[contact, 2], find_rub(rubs, contact)
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
    row = n * (n + 1) // 2 + n + m + contact * n
    for i in range(n):
        kick[0, i] = sums[row + i]
    divide_by_mass(n, factor, kick)
    inverse_mass, rate = 0.0, 0.0
    for i in range(n):
        inverse_mass += sums[row + i] * kick[0, i]
        rate += sums[row + i] * z[n + i]
    gain = -(1 + restitution) / inverse_mass
    for i in range(n):
        after[n + i] += kick[0, i] * gain * rate
    if has_slopes:
        _differentiate(n, m, contact, row, z, gain, rate, inverse_mass, sums, factor, kick, slopes)
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
    m: int,
    contact: int,
    row: int,
    z: Floats,
    gain: float,
    rate: float,
    inverse_mass: float,
    sums: Floats,
    factor: Floats,
    kick: Floats,
    slopes: Floats,
) -> None:
    """Computes the derivative of M⁻¹ Jᵀ p by (q, v), transposed, with p = gain·J v."""
    half = n * (n + 1) // 2
    mass = half + n + m + m * n
    bends = mass + half * n + 2 * n * n + contact * half
    impulse = gain * rate
    for c in range(n):
        turn, bend_kick, at = 0.0, 0.0, mass + c
        for i in range(n):
            bend = sums[bends + triangle(n, i, c)]
            turn += bend * z[n + i]
            bend_kick += 2 * bend * kick[0, i]
            slopes[c, i] = bend * impulse
        for i in range(n):
            for j in range(i, n):
                slope, twice = sums[at], 1.0 if i == j else 2.0
                at += n
                slopes[c, i] -= slope * kick[0, j] * impulse
                if j != i:
                    slopes[c, j] -= slope * kick[0, i] * impulse
                bend_kick -= twice * slope * kick[0, i] * kick[0, j]
        slopes[n + c, 0] = gain * (turn - rate * bend_kick / inverse_mass)
    # The changes of p by q, kept above while the rows by q are divided.
    divide_by_mass(n, factor, slopes[:n])
    for c in range(n):
        change = slopes[n + c, 0]
        for i in range(n):
            slopes[c, i] += kick[0, i] * change
            slopes[n + c, i] = kick[0, i] * gain * sums[row + c]
