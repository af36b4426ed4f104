"""States and rates in compiled code, whatever the dynamics: a tape of sums, or a tree.

Numba chooses by the type of the tables as it compiles, and so one descent serves both, of which
neither contains the other. States of tapes are flat: x = z, with n positions and as many
velocities. Within a stage of a tree, the state is y = (δ, v) with q = q_k ⊕ δ about the positions
at its start. So turns are rotation vectors, far from a whole turn, and Runge-Kutta steps are those
of any vector:

    δ̇ = D(δ)⁻¹ v,    v̇ = a(q_k ⊕ δ, v, u)

with D the left Jacobian of links that turn about three axes, and 1 of others.
"""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import (
    Mechanics,
    MechanicsMemory,
    TreeMechanics,
    TreeMechanicsMemory,
    accelerate,
    accelerate_at_once,
    accelerate_bodies,
    begin_bodies,
    of_tree,
    only_of,
)
from drake_aigto.dynamics import (
    QUATERNION,
    FrameTable,
    TreeTables,
    add_frame_costs,
    add_tangent,
    find_rate,
    find_turning,
    multiply_quaternions,
    read_turn,
    subtract_positions,
)
from drake_aigto.kernels import borrowing


def accelerate_tree(
    mechanics: TreeMechanics,
    z: Floats,
    y: Floats,
    u: Floats,
    eps: float,
    has_slopes: bool,
    memory: TreeMechanicsMemory,
) -> None:
    """Computes v̇ at y = (δ, v) about z, and ∂v̇/∂(δ, v, u) if asked, as the plant orders them."""
    tree, found = mechanics.tree, memory.tree.slopes
    n, velocities = tree.up.size, tree.velocities
    add_tangent(tree, z, y, memory.position)
    accelerate_bodies(mechanics, memory.position, y[n:], u, eps, has_slopes, memory)
    if not has_slopes:
        return
    for c in range(found.shape[1]):
        column = c if c >= 2 * n else velocities[c % n] + c // n * n
        for s in range(n):
            memory.slopes[column, velocities[s]] = found[s, c]
    for i in range(tree.parents.size):
        if tree.kinds[i] >= QUATERNION:
            first, D = velocities[tree.dofs[i]], memory.turning
            find_turning(y[first], y[first + 1], y[first + 2], D)
            for s in range(n):
                a, b, c = (
                    memory.slopes[first, s],
                    memory.slopes[first + 1, s],
                    memory.slopes[first + 2, s],
                )
                for k in range(3):
                    memory.slopes[first + k, s] = a * D[k] + b * D[3 + k] + c * D[6 + k]


@borrowing
def begin_step(
    mechanics: TreeMechanics, z: Floats, y: Floats, eps: float, memory: TreeMechanicsMemory
) -> None:
    """Computes all that δ of y about z decides alone, for `accelerate_step` at any v."""
    add_tangent(mechanics.tree, z, y, memory.position)
    begin_bodies(mechanics, memory.position, eps, memory)


@borrowing
def accelerate_step(
    mechanics: TreeMechanics, y: Floats, u: Floats, eps: float, memory: TreeMechanicsMemory
) -> None:
    """Computes v̇ at y, and ∂v̇/∂v in `slopes`, as the plant orders them."""
    tree, found = mechanics.tree, memory.tree.slopes
    n, velocities = tree.up.size, tree.velocities
    accelerate_at_once(mechanics, memory.position, y[n:], u, eps, memory)
    for c in range(n):
        for s in range(n):
            memory.slopes[n + velocities[c], velocities[s]] = found[s, n + c]


def enter_tree(mechanics: TreeMechanics, z: Floats, x: Floats) -> None:
    """Computes (δ, v) at the start of a stage."""
    n = mechanics.tree.up.size
    first = mechanics.num_positions
    for i in range(n):
        x[i], x[n + i] = 0.0, z[first + i]


def leave_tree(
    mechanics: TreeMechanics,
    z: Floats,
    x: Floats,
    has_slopes: bool,
    F: Floats,
    after: Floats,
    memory: TreeMechanicsMemory,
) -> None:
    """Computes the state after a stage, and turns the rows of F with its links."""
    tree, n, first = mechanics.tree, mechanics.tree.up.size, mechanics.num_positions
    add_tangent(tree, z, x, after)
    for i in range(n):
        after[first + i] = x[n + i]
    for i in range(tree.parents.size if has_slopes else 0):
        if tree.kinds[i] >= QUATERNION:
            at = tree.velocities[tree.dofs[i]]
            find_turning(x[at], x[at + 1], x[at + 2], memory.turning)
            turn_rows(at, memory.turning, F)


@borrowing
def turn_rows(at: int, D: Floats, rows: Floats) -> None:
    """Replaces three rows by D times them."""
    for c in range(rows.shape[1]):
        x, y, z = rows[at, c], rows[at + 1, c], rows[at + 2, c]
        for k in range(3):
            rows[at + k, c] = D[3 * k] * x + D[3 * k + 1] * y + D[3 * k + 2] * z


@only_of(TreeMechanics)
def bend(
    mechanics: TreeMechanics,
    y: Floats,
    has_slopes: bool,
    slope: Floats,
    Y: Floats,
    K: Floats,
    memory: TreeMechanicsMemory,
) -> None:
    """Replaces v by δ̇ = D⁻¹ v where links turn, and its derivatives K, those of y being Y."""
    tree, n = mechanics.tree, mechanics.tree.up.size
    by_delta, by_turn = memory.by_delta, memory.by_turn
    for i in range(tree.parents.size):
        if tree.kinds[i] < QUATERNION:
            continue
        at = tree.velocities[tree.dofs[i]]
        find_rate(y[at:], y[n + at :], slope[at:], by_delta, by_turn)
        for c in range(Y.shape[1] if has_slopes else 0):
            for k in range(3):
                total = 0.0
                for m in range(3):
                    total += by_delta[3 * k + m] * Y[at + m, c]
                    total += by_turn[3 * k + m] * Y[n + at + m, c]
                K[at + k, c] = total


@borrowing
def find_turn_error(
    tree: TreeTables, i: int, q: Floats, about: Floats, error: Floats, J: Floats
) -> None:
    """Computes 2 sin(θ/2) times the axis of the turn of link i from one q to another, and ∂/∂δ."""
    a, b, c, d = read_turn(tree, i, about)
    w, x, y, z = read_turn(tree, i, q)
    size = np.sqrt((a * a + b * b + c * c + d * d) * (w * w + x * x + y * y + z * z))
    w, x, y, z = multiply_quaternions(w, x, y, z, a, -b, -c, -d)
    size = size if w >= 0.0 else -size
    w, x, y, z = w / size, x / size, y / size, z / size
    error[0], error[1], error[2] = 2 * x, 2 * y, 2 * z
    J[0], J[1], J[2] = w, z, -y
    J[3], J[4], J[5] = -z, w, x
    J[6], J[7], J[8] = y, -x, w


def compare_tree(
    mechanics: TreeMechanics,
    row: Floats,
    next_row: Floats,
    share: float,
    z: Floats,
    y: Floats,
    off: Floats,
    memory: TreeMechanicsMemory,
) -> None:
    """Computes how far y about z is off a state between two, as velocities are ordered.

    Turns are off by chords, whose derivatives by δ are kept in `errors`.
    """
    tree, n, first = mechanics.tree, mechanics.tree.up.size, mechanics.num_positions
    about, q = memory.reference, memory.position
    add_tangent(tree, z, y, q)
    for i in range(first + n):
        about[i] = row[i] + share * (next_row[i] - row[i])
    for i in range(tree.parents.size):
        at, places = tree.positions[i], tree.velocities[tree.dofs[i] : tree.dofs[i + 1]]
        if tree.kinds[i] >= QUATERNION:
            find_turn_error(tree, i, q, about, off[places[0] :], memory.errors[i])
        else:
            for k in range(places.size):
                off[places[k]] = q[at + k] - about[at + k]
    for i in range(n):
        off[n + i] = y[n + i] - about[first + i]


@only_of(TreeMechanics)
def turn_error_rows(
    mechanics: TreeMechanics, y: Floats, Y: Floats, memory: TreeMechanicsMemory
) -> None:
    """Makes derivatives of δ those of errors, where links turn."""
    tree = mechanics.tree
    for i in range(tree.parents.size):
        if tree.kinds[i] >= QUATERNION:
            at = tree.velocities[tree.dofs[i]]
            find_turning(y[at], y[at + 1], y[at + 2], memory.turning)
            turn_rows(at, memory.turning, Y)
            turn_rows(at, memory.errors[i], Y)


@only_of(TreeMechanics)
def turn_end(mechanics: TreeMechanics, l1: Floats, l2: Floats, memory: TreeMechanicsMemory) -> None:
    """Makes a gradient and a Hessian by errors those by δ, where links turn."""
    tree = mechanics.tree
    for i in range(tree.parents.size):
        if tree.kinds[i] < QUATERNION:
            continue
        at, J = tree.velocities[tree.dofs[i]], memory.errors[i]
        x, y, z = l1[at], l1[at + 1], l1[at + 2]
        for k in range(3):
            l1[at + k] = x * J[k] + y * J[3 + k] + z * J[6 + k]
        for c in range(l2.shape[0]):
            x, y, z = l2[at, c], l2[at + 1, c], l2[at + 2, c]
            for k in range(3):
                l2[at + k, c] = x * J[k] + y * J[3 + k] + z * J[6 + k]
        for c in range(l2.shape[0]):
            x, y, z = l2[c, at], l2[c, at + 1], l2[c, at + 2]
            for k in range(3):
                l2[c, at + k] = x * J[k] + y * J[3 + k] + z * J[6 + k]


@only_of(TreeMechanics)
def add_frames(
    mechanics: TreeMechanics,
    frames: FrameTable,
    z: Floats,
    has_slopes: bool,
    l1: Floats,
    l2: Floats,
    memory: TreeMechanicsMemory,
) -> float:
    """Returns what frames cost, and adds the derivatives by δ if asked."""
    return add_frame_costs(mechanics.tree, frames, z, has_slopes, l1, l2, memory.tree)


def subtract_tree(mechanics: TreeMechanics, z: Floats, before: Floats, off: Floats) -> None:
    """Computes z ⊖ before, of whole states."""
    n, first = mechanics.tree.up.size, mechanics.num_positions
    subtract_positions(mechanics.tree, z, before, off)
    for i in range(n, off.size):
        off[i] = z[first - n + i] - before[first - n + i]


@only_of(TreeMechanics)
def align(mechanics: TreeMechanics, gap: Floats, F: Floats, memory: TreeMechanicsMemory) -> None:
    """Makes derivatives F of the state after a stage those of its gap, D⁻¹ times them."""
    tree = mechanics.tree
    for i in range(tree.parents.size):
        if tree.kinds[i] >= QUATERNION:
            at, room = tree.velocities[tree.dofs[i]], memory.reference
            find_rate(gap[at:], gap[at:], room, memory.by_delta, memory.by_turn)
            turn_rows(at, memory.by_turn, F)


def shift_tree(
    mechanics: TreeMechanics, z: Floats, length: float, off: Floats, memory: TreeMechanicsMemory
) -> None:
    """Moves a state by a part of a tangent vector, in place."""
    n, first, delta = mechanics.tree.up.size, mechanics.num_positions, memory.reference
    for i in range(n):
        delta[i] = length * off[i]
    add_tangent(mechanics.tree, z, delta, z)
    for i in range(n, off.size):
        z[first - n + i] += length * off[i]


@of_tree(accelerate_tree)
def accelerate_stage(
    mechanics: Mechanics,
    z: Floats,
    y: Floats,
    u: Floats,
    eps: float,
    has_slopes: bool,
    memory: MechanicsMemory,
) -> None:
    """Computes v̇ at y within a stage that starts at z, and ∂v̇/∂(y, u) if asked."""
    accelerate(mechanics, y, u, eps, has_slopes, memory)


@of_tree(enter_tree)
def enter(mechanics: Mechanics, z: Floats, x: Floats) -> None:
    """Computes y at the start of a stage."""
    for i in range(x.size):
        x[i] = z[i]


@of_tree(leave_tree)
def leave(
    mechanics: Mechanics,
    z: Floats,
    x: Floats,
    has_slopes: bool,
    F: Floats,
    after: Floats,
    memory: MechanicsMemory,
) -> None:
    """Computes the state after a stage from y, and makes derivatives F of y those of the state."""
    for i in range(x.size):
        after[i] = x[i]


@of_tree(compare_tree)
def compare(
    mechanics: Mechanics,
    row: Floats,
    next_row: Floats,
    share: float,
    z: Floats,
    y: Floats,
    off: Floats,
    memory: MechanicsMemory,
) -> None:
    """Computes how far y is off a state between two."""
    for i in range(off.size):
        off[i] = y[i] - row[i] - share * (next_row[i] - row[i])


@of_tree(subtract_tree)
def subtract(mechanics: Mechanics, z: Floats, before: Floats, off: Floats) -> None:
    """Computes z ⊖ before."""
    for i in range(off.size):
        off[i] = z[i] - before[i]


@of_tree(shift_tree)
def shift(
    mechanics: Mechanics, z: Floats, length: float, off: Floats, memory: MechanicsMemory
) -> None:
    """Moves a state by a part of a tangent vector, in place."""
    for i in range(off.size):
        z[i] += length * off[i]
