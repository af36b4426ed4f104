"""What a `Tree` is asked for, in compiled code: its accelerations, with their derivatives.

After Singh, Russo & Wensing (2022), "Efficient analytical derivatives of rigid-body dynamics using
spatial vector algebra", for axes that are fixed in the parent. With I of a link and all beyond it,
f its force, S of its own degrees of freedom, T = V × S and U = A × S + V × T:

    ∂f/∂δ = S ×* f + 2B T + I U,    ∂f/∂v = 2B S + I (Ṡ + T),    ∂f/∂v̇ = I S

by its own degrees of freedom and those of links before it. 2B x = x ×* I V + V ×* I x − I (V × x)
is made of 12 numbers in the world's frame, which add up over links as I does:

    2B = [[T, 0], [−2 P×, 0]],    T = 2 [ω×] J − tr(J) [ω×] − 2 [h×][w×]

with h and J first and second moments of mass, (ω, w) the velocity, and P the momentum.
"""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.dynamics.recursions import (
    factor,
    find_stiction,
    gather,
    place_tree,
    push_joints,
    share_friction,
    solve,
    solve_rows,
    spread,
)
from drake_aigto.dynamics.spatial import (
    add_cross_force,
    add_tangent,
    apply_inertia,
    cross_motion,
    dot,
    multiply_quaternions,
    rotate,
    subtract_positions,
)
from drake_aigto.dynamics.tree_tables import (
    ALL_SLOPES,
    BY_SPEED,
    NO_SLOPES,
    QUATERNION,
    RPY,
    TreeMemory,
    TreeTables,
)
from drake_aigto.kernels import borrow, borrowing, kernel


@borrowing
def accelerate(
    tree: TreeTables,
    q: Floats,
    v: Floats,
    u: Floats,
    eps: float,
    has_slopes: bool,
    memory: TreeMemory,
) -> None:
    """Computes v̇ in `force`, and ∂v̇/∂(δ, v, u) in `slopes` if asked, by degrees of freedom."""
    asked = ALL_SLOPES if has_slopes else NO_SLOPES
    begin_tree(tree, q, memory)
    push_tree(tree, q, v, u, eps, asked, memory)
    move_tree(tree, asked, memory)


@borrowing
def begin_tree(tree: TreeTables, q: Floats, memory: TreeMemory) -> None:
    """Computes all that q decides alone, and M's factor, for `push_tree` at any v."""
    place_tree(tree, q, memory)
    factor(tree.up, memory.mass)


@borrowing
def push_tree(
    tree: TreeTables, q: Floats, v: Floats, u: Floats, eps: float, asked: int, memory: TreeMemory
) -> None:
    """Computes velocities of links, and forces of joints in `force`, with the `slopes` asked for.

    Other generalized forces may be added to both before `move_tree`.
    """
    spread(tree, v, memory)
    push_joints(tree, q, u, eps, memory)
    if asked != NO_SLOPES:
        prepare_slopes(tree, memory)
        differentiate_joints(tree, eps, asked, memory)
    for t in range(tree.thruster_links.size):
        thrust = u[u.size - tree.thruster_links.size + t]
        _thrust(tree, t, thrust, asked == ALL_SLOPES, memory)


@borrowing
def _thrust(tree: TreeTables, t: int, u: float, has_slopes: bool, memory: TreeMemory) -> None:
    """Adds the force of a thruster, which turns with its link, and its derivatives if asked.

    With F the wrench, δ_j turns and moves it by S_j ×* F, and S_i as well if j is of a link before
    i's: then S_i · F stays as it is.
    """
    link, unit, F, turned = tree.thruster_links[t], tree.thrusts[t], memory.room[0], memory.room[1]
    pose = memory.poses[link]
    column = memory.slopes.shape[1] - tree.thruster_links.size + t
    F[0], F[1], F[2] = rotate(pose, unit[0], unit[1], unit[2])
    F[3], F[4], F[5] = rotate(pose, unit[3], unit[4], unit[5])
    F[0] += pose[10] * F[5] - pose[11] * F[4]
    F[1] += pose[11] * F[3] - pose[9] * F[5]
    F[2] += pose[9] * F[4] - pose[10] * F[3]
    j = tree.dofs[link + 1] - 1
    while j >= 0:
        by_u = dot(memory.motions[j], F)
        memory.force[j] += by_u * u
        if has_slopes:
            memory.slopes[j, column] += by_u
            for k in range(6):
                turned[k] = 0.0
            add_cross_force(memory.motions[j], F, turned)
            i = tree.dofs[tree.links[j] + 1] - 1
            while i >= 0:
                memory.slopes[i, j] += u * dot(memory.motions[i], turned)
                i = tree.up[i]
        j = tree.up[j]


@borrowing
def move_tree(tree: TreeTables, asked: int, memory: TreeMemory) -> None:
    """Replaces forces, and their derivatives, by v̇ and its own."""
    n, columns = memory.slopes.shape
    gather(tree, asked != NO_SLOPES, memory)
    solve(tree.up, memory.mass, memory.force)
    if asked == BY_SPEED:
        differentiate(tree, False, memory)
        solve_rows(tree.up, memory.mass, memory.slopes, n, 2 * n)
    elif asked == ALL_SLOPES:
        differentiate(tree, True, memory)
        solve_rows(tree.up, memory.mass, memory.slopes, 0, columns)


@borrowing
def prepare_slopes(tree: TreeTables, memory: TreeMemory) -> None:
    """Computes T of 2B of each link, after `spread`, and before `gather` adds it up."""
    for i in range(tree.parents.size):
        B, C, V = memory.inertias[i], memory.composites[i], memory.velocities[i]
        for s in range(tree.dofs[i], tree.dofs[i + 1]):
            cross_motion(V, memory.motions[s], memory.turns[s])
        if tree.masses[i] == 0.0:
            continue
        x, y, z = B[1], B[2], B[3]
        a, b, c = V[0], V[1], V[2]
        trace, along = B[4] + B[6] + B[9], 2 * (x * V[3] + y * V[4] + z * V[5])
        C[10] = 2 * (b * B[7] - c * B[5] - V[3] * x) + along
        C[11] = 2 * (b * B[8] - c * B[6] - V[3] * y) + trace * c
        C[12] = 2 * (b * B[9] - c * B[8] - V[3] * z) - trace * b
        C[13] = 2 * (c * B[4] - a * B[7] - V[4] * x) - trace * c
        C[14] = 2 * (c * B[5] - a * B[8] - V[4] * y) + along
        C[15] = 2 * (c * B[7] - a * B[9] - V[4] * z) + trace * a
        C[16] = 2 * (a * B[5] - b * B[4] - V[5] * x) + trace * b
        C[17] = 2 * (a * B[6] - b * B[5] - V[5] * y) - trace * a
        C[18] = 2 * (a * B[8] - b * B[7] - V[5] * z) + along


@borrowing
def differentiate_joints(tree: TreeTables, eps: float, asked: int, memory: TreeMemory) -> None:
    """Computes the derivatives of what `push_joints` computes."""
    n, slopes, is_all = tree.up.size, memory.slopes, asked == ALL_SLOPES
    for s in range(n):
        for c in range(0 if is_all else n, 2 * n):
            slopes[s, c] = 0.0
        for j in range(tree.actuation.shape[1] if is_all else 0):
            slopes[s, 2 * n + j] = tree.actuation[s, j]
        slopes[s, n + s] = -tree.damping[s]
        if tree.friction[s] > 0.0:
            speed = find_stiction(tree, s, eps)
            _, slope = share_friction(memory.v[s] / speed)
            slopes[s, n + s] -= tree.friction[s] * slope / speed
    for i in range(tree.parents.size if is_all else 0):
        if tree.stiffnesses[i] != 0.0:
            slopes[tree.dofs[i], tree.dofs[i]] = -tree.stiffnesses[i]


@borrowing
def differentiate(tree: TreeTables, is_all: bool, memory: TreeMemory) -> None:
    """Takes off the derivatives of h + M v̇ at the v̇ that is in `force`, all or those by v."""
    if is_all:
        _spread_accelerations(tree, memory)
    for i in range(tree.parents.size - 1, -1, -1):
        for s in range(tree.dofs[i], tree.dofs[i + 1]):
            _differentiate_motion(tree, i, s, is_all, memory)
        parent = tree.parents[i]
        if parent >= 0 and is_all:
            for k in range(6):
                memory.forces[parent, k] += memory.forces[i, k]


@borrowing
def _spread_accelerations(tree: TreeTables, memory: TreeMemory) -> None:
    """Computes accelerations, U, and the forces of single links."""
    for i in range(tree.parents.size):
        parent, A, V = tree.parents[i], memory.accelerations[i], memory.velocities[i]
        f, momentum = memory.forces[i], memory.room[0]
        for k in range(3):
            A[k], A[3 + k] = 0.0, -tree.gravity[i, k]
        if parent >= 0:
            for k in range(6):
                A[k] = memory.accelerations[parent, k]
        first, last = tree.dofs[i], tree.dofs[i + 1]
        for s in range(first, last):
            for k in range(6):
                A[k] += memory.motions[s, k] * memory.force[s] + memory.rates[s, k] * memory.v[s]
        for s in range(first, last):
            U, S, T = memory.bends[s], memory.motions[s], memory.turns[s]
            cross_motion(V, T, momentum)
            cross_motion(A, S, U)
            for k in range(6):
                U[k] += momentum[k]
        apply_inertia(memory.inertias[i], A, f)
        apply_inertia(memory.inertias[i], V, momentum)
        add_cross_force(V, momentum, f)


@borrowing
def _differentiate_motion(
    tree: TreeTables, i: int, s: int, is_all: bool, memory: TreeMemory
) -> None:
    """Takes off derivatives by s of forces of links before, and those of s's by them."""
    C, f, n, up = memory.composites[i], memory.forces[i], tree.up.size, tree.up
    S, T, t, slopes = memory.motions[s], memory.turns[s], memory.momenta[s], memory.slopes
    rate, by_v, by_q = memory.room[0], memory.room[1], memory.room[2]
    for k in range(6):
        rate[k] = memory.rates[s, k] + T[k]
    apply_inertia(C, rate, by_v)
    _add_twice_B(C, S, by_v)
    if is_all:
        apply_inertia(C, memory.bends[s], by_q)
        _add_twice_B(C, T, by_q)
        add_cross_force(S, f, by_q)
    p, q, r = 2 * C[19], 2 * C[20], 2 * C[21]
    x = C[10] * S[0] + C[13] * S[1] + C[16] * S[2] + q * S[5] - r * S[4]
    y = C[11] * S[0] + C[14] * S[1] + C[17] * S[2] + r * S[3] - p * S[5]
    z = C[12] * S[0] + C[15] * S[1] + C[18] * S[2] + p * S[4] - q * S[3]
    j = tree.dofs[i + 1] - 1
    while j >= tree.dofs[i]:
        if is_all:
            slopes[j, s] -= dot(memory.motions[j], by_q)
        slopes[j, n + s] -= dot(memory.motions[j], by_v)
        j -= 1
    j = up[tree.dofs[i]]
    while j >= 0:
        R, B = memory.rates[j], memory.turns[j]
        M, U = memory.motions[j], memory.bends[j]
        if is_all:
            slopes[j, s] -= dot(M, by_q)
            slopes[s, j] -= x * B[0] + y * B[1] + z * B[2] + dot(t, U)
        slopes[j, n + s] -= dot(M, by_v)
        slopes[s, n + j] -= x * M[0] + y * M[1] + z * M[2] + dot(t, R) + dot(t, B)
        j = up[j]


@borrowing
def _add_twice_B(C: Floats, x: Floats, out: Floats) -> None:
    """Adds 2B x."""
    a, b, c = x[0], x[1], x[2]
    out[0] += C[10] * a + C[11] * b + C[12] * c
    out[1] += C[13] * a + C[14] * b + C[15] * c
    out[2] += C[16] * a + C[17] * b + C[18] * c
    out[3] -= 2 * (C[20] * c - C[21] * b)
    out[4] -= 2 * (C[21] * a - C[19] * c)
    out[5] -= 2 * (C[19] * b - C[20] * a)


@kernel
def calc_masses(tree: TreeTables, q: Floats, memory: TreeMemory) -> Floats:
    """Returns M of each state, shape (K, n n)."""
    tree, memory = borrow(tree), borrow(memory)
    n = tree.up.size
    found = np.zeros((q.shape[0], n * n))
    for k in range(q.shape[0]):
        place_tree(tree, q[k], memory)
        for s in range(n):
            j = s
            while j >= 0:
                row, column = tree.velocities[s], tree.velocities[j]
                found[k, row * n + column] = found[k, column * n + row] = memory.mass[s, j]
                j = tree.up[j]
    return found


@kernel
def calc_inverse_dynamics(
    tree: TreeTables, q: Floats, v: Floats, acceleration: Floats, memory: TreeMemory
) -> Floats:
    """Returns M v̇ + h of each state, shape (K, n)."""
    tree, memory = borrow(tree), borrow(memory)
    n = tree.up.size
    found, nothing = np.zeros((q.shape[0], n)), np.zeros(tree.actuation.shape[1])
    for k in range(q.shape[0]):
        place_tree(tree, q[k], memory)
        spread(tree, v[k], memory)
        push_joints(tree, q[k], nothing, 0.0, memory)
        gather(tree, False, memory)
        for s in range(n):
            found[k, tree.velocities[s]] -= memory.force[s]
            j = s
            while j >= 0:
                row, column = tree.velocities[s], tree.velocities[j]
                found[k, row] += memory.mass[s, j] * acceleration[k, column]
                if j != s:
                    found[k, column] += memory.mass[s, j] * acceleration[k, row]
                j = tree.up[j]
    return found


@kernel
def calc_accelerations(
    tree: TreeTables, q: Floats, v: Floats, u: Floats, memory: TreeMemory
) -> Floats:
    """Returns v̇ of each state, shape (K, n)."""
    tree, memory = borrow(tree), borrow(memory)
    found = np.zeros(v.shape)
    for k in range(q.shape[0]):
        accelerate(tree, q[k], v[k], u[k], 0.0, False, memory)
        for s in range(tree.up.size):
            found[k, tree.velocities[s]] = memory.force[s]
    return found


@kernel
def calc_slopes(tree: TreeTables, q: Floats, v: Floats, u: Floats, memory: TreeMemory) -> Floats:
    """Returns ∂v̇/∂(δ, v, u), shape (n, 2n + nu)."""
    tree, memory = borrow(tree), borrow(memory)
    n = tree.up.size
    found = np.zeros(memory.slopes.shape)
    accelerate(tree, q, v, u, 0.0, True, memory)
    for s in range(n):
        row = tree.velocities[s]
        for c in range(n):
            found[row, tree.velocities[c]] = memory.slopes[s, c]
            found[row, n + tree.velocities[c]] = memory.slopes[s, n + c]
        for c in range(2 * n, memory.slopes.shape[1]):
            found[row, c] = memory.slopes[s, c]
    return found


@kernel
def turn_positions(tree: TreeTables, q: Floats, v: Floats, rate: Floats) -> None:
    """Computes q̇ = N(q) v."""
    tree = borrow(tree)
    for i in range(tree.parents.size):
        first, at, kind = tree.dofs[i], tree.positions[i], tree.kinds[i]
        x = v[tree.velocities[first]]
        if kind == QUATERNION:
            y, z = v[tree.velocities[first + 1]], v[tree.velocities[first + 2]]
            w, a, b, c = multiply_quaternions(
                0.0, x / 2, y / 2, z / 2, q[at], q[at + 1], q[at + 2], q[at + 3]
            )
            rate[at], rate[at + 1], rate[at + 2], rate[at + 3] = w, a, b, c
        elif kind == RPY:
            y, z = v[tree.velocities[first + 1]], v[tree.velocities[first + 2]]
            c, s = np.cos(q[at + 2]), np.sin(q[at + 2])
            along = (c * x + s * y) / np.cos(q[at + 1])
            rate[at], rate[at + 1] = along, c * y - s * x
            rate[at + 2] = z + np.sin(q[at + 1]) * along
        else:
            for k in range(tree.dofs[i + 1] - first):
                rate[at + k] = v[tree.velocities[first + k]]


@kernel
def add(tree: TreeTables, q: Floats, delta: Floats) -> Floats:
    """Returns q ⊕ δ of rows (K, nq) and (K, nv), shape (K, nq)."""
    tree, found = borrow(tree), np.zeros(q.shape)
    for k in range(q.shape[0]):
        add_tangent(tree, q[k], delta[k], found[k])
    return found


@kernel
def subtract(tree: TreeTables, after: Floats, before: Floats) -> Floats:
    """Returns the shortest δ with before ⊕ δ = after of rows (K, nq) each, shape (K, nv)."""
    tree = borrow(tree)
    found = np.zeros((after.shape[0], tree.up.size))
    for k in range(after.shape[0]):
        subtract_positions(tree, after[k], before[k], found[k])
    return found
