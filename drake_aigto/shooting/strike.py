"""Impacts on rigid walls that rub, in a mode that is given: impulses and their derivatives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.jit import inner
from drake_aigto.shooting.layout import find_rows, triangle
from drake_aigto.shooting.mechanism import divide_by_mass
from drake_aigto.shooting.rubbing import COEFFICIENT, SOURCE

# What the rows of `StrikeMemory.mobility` are.
_A, _B, _C, _RATE, _SLIP = range(5)


class StrikeMemory(NamedTuple):
    """Room for one impact, and its result.

    Attributes:
        kicks: M⁻¹ [Jᵀ Tᵀ], transposed, shape (2, n).
        mobility: a, b and c of `simulation.coulomb.Mobility`, φ̇ and s before, shape (5, 1 + 2n):
            each, and its derivatives by (q, v).
        impulse: p_n and p_t likewise, shape (2, 1 + 2n).
        cone: what is at least 0 in the mode likewise, shape (2, 1 + 2n) [m/s].
    """

    kicks: Floats
    mobility: Floats
    impulse: Floats
    cone: Floats


def make_strike_memory(n: int) -> StrikeMemory:
    """Returns room for impacts of n coordinates."""
    size = 1 + 2 * n
    return StrikeMemory(np.zeros((2, n)), *(np.zeros((rows, size)) for rows in (5, 2, 2)))


@inner
def find_rub(rubs: Floats, contact: int) -> int:
    """Returns which friction is that of a contact, or −1 if it does not rub."""
    for r in range(rubs.shape[0]):
        if rubs[r, SOURCE] == contact:
            return r
    return -1


@inner
def strike(
    contact: int,
    m: int,
    rubs: Floats,
    rub: int,
    mode: int,
    restitution: float,
    z: Floats,
    has_slopes: bool,
    sums: Floats,
    factor: Floats,
    memory: StrikeMemory,
) -> None:
    """Computes the impulses of an impact with Coulomb's friction that ends in a mode.

        φ̇⁺ = −e φ̇,   s⁺ = 0,            |p_t| ≤ μ p_n          stick, mode 0
        φ̇⁺ = −e φ̇,   p_t = −σ μ p_n,    σ s ≥ 0,  σ s⁺ ≥ 0     slip all along, mode σ = ±1

    With φ̇⁺ = φ̇ + a p_n + b p_t and s⁺ = s + b p_n + c p_t both are linear in the velocity. They are
    what Routh's construction leads to (`simulation.coulomb`) where the inequalities hold, which
    `StrikeMemory.cone` has as speeds. It takes the sums at the state, those of all slopes if
    derivatives are asked for, and M's factor.
    """
    n, of = memory.kicks.shape[1], memory.mobility
    normal, _ = find_rows(n, m, contact)
    tangent = sums.size - (rubs.shape[0] - rub) * n
    for i in range(n):
        memory.kicks[0, i], memory.kicks[1, i] = sums[normal + i], sums[tangent + i]
    divide_by_mass(n, factor, memory.kicks)
    for row in range(5):
        of[row, 0] = 0.0
    for i in range(n):
        J, T = sums[normal + i], sums[tangent + i]
        of[_A, 0] += J * memory.kicks[0, i]
        of[_B, 0] += J * memory.kicks[1, i]
        of[_C, 0] += T * memory.kicks[1, i]
        of[_RATE, 0] += J * z[n + i]
        of[_SLIP, 0] += T * z[n + i]
    if has_slopes:
        _differentiate_mobility(contact, m, rubs.shape[0], rub, z, sums, memory)
    columns = of.shape[1] if has_slopes else 1
    if mode == 0:
        _stick(rubs[rub, COEFFICIENT], 1 + restitution, columns, memory)
    else:
        _slide(rubs[rub, COEFFICIENT], 1 + restitution, mode, columns, memory)


@inner
def _differentiate_mobility(
    contact: int, m: int, num_rubs: int, rub: int, z: Floats, sums: Floats, memory: StrikeMemory
) -> None:
    n, of, kicks = memory.kicks.shape[1], memory.mobility, memory.kicks
    normal, bends = find_rows(n, m, contact)
    mass, _ = find_rows(n, m, m)
    tangent = sums.size - (num_rubs - rub) * n
    turns = sums.size - num_rubs * n - (num_rubs - rub) * n * n
    for c in range(n):
        for row in range(5):
            of[row, 1 + c] = of[row, 1 + n + c] = 0.0
        of[_RATE, 1 + n + c], of[_SLIP, 1 + n + c] = sums[normal + c], sums[tangent + c]
        for i in range(n):
            bend, turn = sums[bends + triangle(n, i, c)], sums[turns + i * n + c]
            of[_A, 1 + c] += 2 * bend * kicks[0, i]
            of[_B, 1 + c] += bend * kicks[1, i] + turn * kicks[0, i]
            of[_C, 1 + c] += 2 * turn * kicks[1, i]
            of[_RATE, 1 + c] += bend * z[n + i]
            of[_SLIP, 1 + c] += turn * z[n + i]
        at = mass + c
        for i in range(n):
            for j in range(i, n):
                slope = sums[at] if i == j else 2 * sums[at]
                at += n
                of[_A, 1 + c] -= slope * kicks[0, i] * kicks[0, j]
                mixed = kicks[0, i] * kicks[1, j] + kicks[0, j] * kicks[1, i]
                of[_B, 1 + c] -= slope * mixed / 2
                of[_C, 1 + c] -= slope * kicks[1, i] * kicks[1, j]


@inner
def _stick(friction: float, gain: float, columns: int, memory: StrikeMemory) -> None:
    """Computes impulses after which nothing slips, and c (μ p_n ∓ p_t)."""
    of, p, cone = memory.mobility, memory.impulse, memory.cone
    a, b, c = of[_A, 0], of[_B, 0], of[_C, 0]
    det = a * c - b * b
    for k in range(columns):
        rate, slip = -gain * of[_RATE, k], -of[_SLIP, k]
        if k > 0:
            rate -= of[_A, k] * p[0, 0] + of[_B, k] * p[1, 0]
            slip -= of[_B, k] * p[0, 0] + of[_C, k] * p[1, 0]
        p[0, k] = (c * rate - b * slip) / det
        p[1, k] = (a * slip - b * rate) / det
        for side in range(2):
            sign = 2 * side - 1
            cone[side, k] = c * (friction * p[0, k] + sign * p[1, k])
            if k > 0:
                cone[side, k] += of[_C, k] * (friction * p[0, 0] + sign * p[1, 0])


@inner
def _slide(friction: float, gain: float, mode: int, columns: int, memory: StrikeMemory) -> None:
    """Computes impulses while slip has one direction σ, and σ s before and after."""
    of, p, cone = memory.mobility, memory.impulse, memory.cone
    along = -mode * friction
    slope = of[_A, 0] + along * of[_B, 0]
    for k in range(columns):
        rate = -gain * of[_RATE, k]
        if k > 0:
            rate -= (of[_A, k] + along * of[_B, k]) * p[0, 0]
        p[0, k] = rate / slope
        p[1, k] = along * p[0, k]
        after = of[_SLIP, k] + of[_B, 0] * p[0, k] + of[_C, 0] * p[1, k]
        if k > 0:
            after += of[_B, k] * p[0, 0] + of[_C, k] * p[1, 0]
        cone[0, k], cone[1, k] = mode * of[_SLIP, k], mode * after


@inner
def differentiate_strike(
    contact: int,
    m: int,
    num_rubs: int,
    rub: int,
    sums: Floats,
    factor: Floats,
    memory: StrikeMemory,
    slopes: Floats,
) -> None:
    """Computes the derivative of M⁻¹ (Jᵀ p_n + Tᵀ p_t) by (q, v), transposed."""
    n, kicks, p = memory.kicks.shape[1], memory.kicks, memory.impulse
    _, bends = find_rows(n, m, contact)
    mass, _ = find_rows(n, m, m)
    turns = sums.size - num_rubs * n - (num_rubs - rub) * n * n
    for c in range(n):
        for i in range(n):
            bend, turn = sums[bends + triangle(n, i, c)], sums[turns + i * n + c]
            slopes[c, i] = bend * p[0, 0] + turn * p[1, 0]
        at = mass + c
        for i in range(n):
            for j in range(i, n):
                slope = sums[at]
                at += n
                slopes[c, i] -= slope * (kicks[0, j] * p[0, 0] + kicks[1, j] * p[1, 0])
                if j != i:
                    slopes[c, j] -= slope * (kicks[0, i] * p[0, 0] + kicks[1, i] * p[1, 0])
    divide_by_mass(n, factor, slopes[:n])
    for c in range(2 * n):
        for i in range(n):
            if c >= n:
                slopes[c, i] = 0.0
            slopes[c, i] += kicks[0, i] * p[0, 1 + c] + kicks[1, i] * p[1, 1 + c]
