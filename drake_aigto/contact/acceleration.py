"""Accelerations of a mechanism between compliant walls, with friction, in compiled code."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.contact.laws import calc_deeper, calc_stiffness, find_gap
from drake_aigto.contact.tables import (
    COEFFICIENT,
    GIVE,
    PACE,
    RADIUS,
    SOURCE,
    SPIN,
    STICTION,
    Mechanics,
    MechanicsMemory,
)
from drake_aigto.dynamics import share_friction
from drake_aigto.kernels import borrow, borrowing, kernel


@borrowing
def triangle(n: int, i: int, j: int) -> int:
    """Returns the place of entry (i, j) of a symmetric matrix in its upper triangle, by rows."""
    low, high = min(i, j), max(i, j)
    return low * n - low * (low - 1) // 2 + high - low


@borrowing
def find_row(n: int, m: int, k: int) -> int:
    """Returns where row k begins: J_k of a contact, or T of friction k − m; of w, ∂M/∂q."""
    return n * (n + 1) // 2 + n + m + k * n


@borrowing
def find_slope(n: int, m: int, w: int, k: int, i: int, c: int) -> int:
    """Returns where the derivative of entry i of row k by q_c is; of k = w, what is behind all."""
    half = n * (n + 1) // 2
    first = find_row(n, m, w) + half * n + 2 * n * n
    if k < m:
        return first + k * half + triangle(n, i, c)
    return first + m * half + (k - m) * n * n + i * n + c


@borrowing
def run_tape(
    code: Ints, numbers: Floats, x: Floats, has_slopes: bool, values: Floats, sums: Floats
) -> None:
    """Computes the sums at x that change, and their derivatives if asked.

    Args:
        code: of the tape.
        numbers: of the tape.
        x: the coordinates, shape (n,).
        has_slopes: whether the derivatives are computed, too.
        values: memory for all values with a place.
        sums: the result, shape (Z,); those that never change are there already.
    """
    num_products, num_sums = (code[1], code[3]) if has_slopes else (code[2], code[4])
    values[0] = 1.0
    for i in range(x.size):
        values[1 + i] = x[i]
    at, read, number = 1 + x.size, 5, 0
    for _ in range(code[0]):
        y = numbers[number] * x[code[read]] + numbers[number + 1]
        values[at] = np.cos(y)
        values[at + 1] = np.sin(y)
        at, read, number = at + 2, read + 1, number + 2
    for _ in range(num_products):
        values[at] = values[code[read]] * values[code[read + 1]]
        at, read = at + 1, read + 2
    read = 5 + code[0] + 2 * code[1]
    for _ in range(num_sums):
        total, z, count = 0.0, code[read], code[read + 1]
        read += 2
        for _ in range(count):
            total += numbers[number] * values[code[read]]
            read, number = read + 1, number + 1
        sums[z] = total


@kernel
def evaluate_tape(code: Ints, numbers: Floats, x: Floats, values: Floats, sums: Floats) -> None:
    """Computes all sums at x that change, see `run_tape`."""
    run_tape(code, numbers, x, True, values, sums)


@borrowing
def factor_mass(n: int, sums: Floats, L: Floats) -> None:
    """Factors M = L Lᵀ, which the tape has computed; 1 / L_ii takes the place of L_ii."""
    at = 0
    for i in range(n):
        for j in range(i, n):
            total = sums[at]
            at += 1
            for k in range(i):
                total -= L[i, k] * L[j, k]
            L[j, i] = 1.0 / np.sqrt(total) if j == i else total * L[i, i]


@borrowing
def divide_by_mass(n: int, L: Floats, y: Floats) -> None:
    """Replaces each row of y by M⁻¹ times it."""
    for c in range(y.shape[0]):
        for i in range(n):
            for k in range(i):
                y[c, i] -= L[i, k] * y[c, k]
            y[c, i] *= L[i, i]
        for i in range(n - 1, -1, -1):
            for k in range(i + 1, n):
                y[c, i] -= L[k, i] * y[c, k]
            y[c, i] *= L[i, i]


@borrowing
def find_foremost(first: int, last: int, phi: int, sums: Floats) -> int:
    """Returns the contact of a solid whose face the sphere is farthest in front of."""
    foremost = first
    for i in range(first + 1, last):
        if sums[phi + i] > sums[phi + foremost]:
            foremost = i
    return foremost


@borrowing
def accelerate(
    mechanics: Mechanics,
    x: Floats,
    u: Floats,
    eps: float,
    has_slopes: bool,
    memory: MechanicsMemory,
) -> None:
    """Computes v̇ at a state x = (q, v), and ∂v̇/∂(q, v, u) if asked."""
    actuation, frictions = mechanics.actuation, mechanics.frictions
    sums, factor, acceleration = memory.sums, memory.factor, memory.acceleration
    n, nu = actuation.shape
    run_tape(mechanics.code, mechanics.numbers, x, has_slopes, memory.values, sums)
    bias, code = n * (n + 1) // 2, mechanics.code
    is_constant = code[3] == 0 or code[5 + code[0] + 2 * code[1]] >= bias
    if not is_constant or factor[0, 0] == 0.0:  # A constant M is factored once.
        factor_mass(n, sums, factor)
    for i in range(n):
        total = -sums[bias + i]
        for j in range(nu):
            total += actuation[i, j] * u[j]
        acceleration[0, i] = total
    _push(mechanics, x, eps, memory)
    if frictions.shape[0] > 0:
        _add_friction(mechanics, x, eps, memory)
    divide_by_mass(n, factor, acceleration)
    if has_slopes:
        _differentiate(mechanics, x, memory)


@borrowing
def _push(mechanics: Mechanics, x: Floats, eps: float, memory: MechanicsMemory) -> None:
    """Computes contact forces and their derivatives by φ and φ̇, and adds Jᵀ f to the total."""
    contacts, solids = mechanics.contacts, mechanics.solids
    sums, force, total = memory.sums, memory.force, memory.acceleration
    n, m = total.shape[1], contacts.shape[0]
    phi = n * (n + 1) // 2 + n
    for s in range(solids.size - 1):
        for i in range(solids[s], solids[s + 1]):
            force[i, 0] = force[i, 1] = force[i, 2] = force[i, 4] = 0.0
            force[i, 3] = 1.0
        i = find_foremost(solids[s], solids[s + 1], phi, sums)
        row, rate = phi + m + i * n, 0.0
        for j in range(n):
            rate += sums[row + j] * x[n + j]
        distance, lever = find_gap(contacts[i, 3], sums[phi + i])
        rate *= lever
        root = np.sqrt(distance * distance + eps * eps)
        stiffness = calc_stiffness(contacts[i, 0], contacts[i, GIVE], eps)
        brake = 1.0 - contacts[i, 1] * rate
        if stiffness == 0.0 or brake <= 0.0 or root == 0.0:
            continue
        # Without cancellation where nothing touches.
        is_in = distance <= 0.0
        depth = (root - distance) / 2 if is_in else eps * eps / (2 * (root + distance))
        force[i, 0] = stiffness * depth * brake
        force[i, 1] = -stiffness * depth / root * brake
        force[i, 2] = -stiffness * depth * contacts[i, 1]
        if contacts[i, 3] > 0.0:
            bend = -(lever**3) / contacts[i, 3]
            force[i, 3], force[i, 4] = lever, bend
            force[i, 1] = lever**2 * force[i, 1] + bend * (force[i, 0] + force[i, 2] * rate)
            force[i, 0] *= lever
            force[i, 2] *= lever**2
        for j in range(n):
            total[0, j] += force[i, 0] * sums[row + j]


@borrowing
def _differentiate(mechanics: Mechanics, x: Floats, memory: MechanicsMemory) -> None:
    """Computes ∂v̇/∂(q, v, u) = M⁻¹ (∂r − ∂M v̇), with M v̇ = r."""
    actuation, frictions = mechanics.actuation, mechanics.frictions
    sums, force, slopes = memory.sums, memory.force, memory.slopes
    n, nu = actuation.shape
    m, half = force.shape[0], n * (n + 1) // 2
    slope_of_mass = find_row(n, m, m + frictions.shape[0])
    slope_of_bias = slope_of_mass + half * n
    for c in range(2 * n):
        for i in range(n):
            slopes[c, i] = -sums[slope_of_bias + 2 * n * i + c]
    for j in range(nu):
        for i in range(n):
            slopes[2 * n + j, i] = actuation[i, j]
    at = slope_of_mass
    for i in range(n):
        for j in range(i, n):
            for c in range(n):
                slope = sums[at]
                at += 1
                slopes[c, i] -= slope * memory.acceleration[0, j]
                if j != i:
                    slopes[c, j] -= slope * memory.acceleration[0, i]
    for i in range(m):
        if force[i, 0] != 0.0:
            _differentiate_force(i, mechanics, x, memory)
    if frictions.shape[0] > 0:
        _differentiate_friction(mechanics, x, memory)
    divide_by_mass(n, memory.factor, slopes)


@borrowing
def _differentiate_force(i: int, mechanics: Mechanics, x: Floats, memory: MechanicsMemory) -> None:
    """Adds ∂(J_iᵀ f_i)/∂(q, v), transposed."""
    sums, force, slopes = memory.sums, memory.force, memory.slopes
    n, m = slopes.shape[1], force.shape[0]
    row, bends = find_row(n, m, i), find_slope(n, m, m + mechanics.frictions.shape[0], i, 0, 0)
    for c in range(n):
        rate = 0.0
        for j in range(n):
            bend = sums[bends + triangle(n, j, c)]
            rate += bend * x[n + j]
            slopes[c, j] += force[i, 0] * bend
        by_position = force[i, 1] * sums[row + c] + force[i, 2] * rate
        by_velocity = force[i, 2] * sums[row + c]
        for j in range(n):
            slopes[c, j] += by_position * sums[row + j]
            slopes[n + c, j] += by_velocity * sums[row + j]


@borrowing
def find_friction(frictions: Floats, contact: int) -> int:
    """Returns the index of a contact's friction, or −1 without friction."""
    for r in range(frictions.shape[0]):
        if frictions[r, SOURCE] == contact:
            return r
    return -1


@borrowing
def _add_friction(mechanics: Mechanics, x: Floats, eps: float, memory: MechanicsMemory) -> None:
    """Computes friction and its derivatives by s and N, and adds Tᵀ times it to v̇, times M."""
    frictions, sums, force, drag = mechanics.frictions, memory.sums, memory.force, memory.drag
    n, m = memory.acceleration.shape[1], force.shape[0]
    row = find_row(n, m, m)
    for r in range(frictions.shape[0]):
        slip, normal, lever = 0.0, 1.0, 1.0
        source = int(frictions[r, SOURCE])
        if source >= 0:
            normal, lever = force[source, 0], force[source, 3]
            _deepen(r, source, mechanics, memory)
        for j in range(n):
            slip += (sums[row + j] - drag[r, 3] * frictions[r, SPIN + j]) * x[n + j]
        speed = np.sqrt(frictions[r, STICTION] ** 2 + (eps * frictions[r, PACE]) ** 2)
        share, slope = share_friction(lever * slip / speed)
        drag[r, 2] = -frictions[r, COEFFICIENT] * share
        drag[r, 0] = drag[r, 2] * normal
        drag[r, 1] = -frictions[r, COEFFICIENT] * normal * slope * lever / speed
        for j in range(n):
            along = sums[row + j] - drag[r, 3] * frictions[r, SPIN + j]
            memory.acceleration[0, j] += drag[r, 0] * along
        row += n


@borrowing
def _deepen(r: int, source: int, mechanics: Mechanics, memory: MechanicsMemory) -> None:
    """Computes δ of a friction's contact and dδ/dφ; zero between rigid walls."""
    reach, radius = mechanics.contacts[source, 3], mechanics.frictions[r, RADIUS]
    if mechanics.contacts[source, 0] > 0.0:
        n, m = memory.acceleration.shape[1], mechanics.contacts.shape[0]
        gap, lever = find_gap(reach, memory.sums[find_row(n, m, 0) - m + source])
        memory.drag[r, 3] = calc_deeper(reach, radius, gap)
        slope = 0.5 + ((radius + gap) / reach if reach > 0.0 else 0.0)
        memory.drag[r, 4] = slope * lever


@borrowing
def _differentiate_friction(mechanics: Mechanics, x: Floats, memory: MechanicsMemory) -> None:
    """Adds ∂(Tᵀ times friction)/∂(q, v), transposed."""
    frictions, sums, force, drag = mechanics.frictions, memory.sums, memory.force, memory.drag
    slopes, m, count = memory.slopes, force.shape[0], frictions.shape[0]
    n = slopes.shape[1]
    row, turn = find_row(n, m, m), find_slope(n, m, m + count, m, 0, 0)
    for r in range(count):
        source = int(frictions[r, SOURCE])
        for c in range(n):
            rate, slip, by_normal, by_speed = 0.0, 0.0, 0.0, 0.0
            normal, deepening = find_row(n, m, max(source, 0)), 0.0
            if source >= 0:
                deepening = drag[r, 4] * sums[normal + c]
            for j in range(n):
                bend = sums[turn + j * n + c] - deepening * frictions[r, SPIN + j]
                rate += bend * x[n + j]
                slip += (sums[row + j] - drag[r, 3] * frictions[r, SPIN + j]) * x[n + j]
                slopes[c, j] += drag[r, 0] * bend
            if source >= 0:
                bends = find_slope(n, m, m + count, source, 0, 0)
                by_normal = force[source, 1] * sums[normal + c]
                for j in range(n):
                    by_normal += force[source, 2] * sums[bends + triangle(n, j, c)] * x[n + j]
                by_speed = force[source, 2] * sums[normal + c]
                rate += slip * force[source, 4] / force[source, 3] * sums[normal + c]
            along = sums[row + c] - drag[r, 3] * frictions[r, SPIN + c]
            by_position = drag[r, 1] * rate + drag[r, 2] * by_normal
            by_velocity = drag[r, 1] * along + drag[r, 2] * by_speed
            for j in range(n):
                along = sums[row + j] - drag[r, 3] * frictions[r, SPIN + j]
                slopes[c, j] += by_position * along
                slopes[n + c, j] += by_velocity * along
        row, turn = row + n, turn + n * n


@kernel
def accelerate_once(
    mechanics: Mechanics, x: Floats, u: Floats, eps: float, memory: MechanicsMemory
) -> None:
    """Computes v̇ and its derivatives, called by Python."""
    accelerate(borrow(mechanics), x, u, eps, True, borrow(memory))
