"""What a `Tree` is asked for, in compiled code."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.dynamics.manifold import add_tangent, subtract_positions
from drake_aigto.dynamics.recursions import gather, place, push_joints, spread
from drake_aigto.dynamics.spatial import multiply, multiply_quaternions, rotate
from drake_aigto.dynamics.tree_slopes import accelerate
from drake_aigto.dynamics.tree_tables import QUATERNION, RPY, TreeMemory, TreeTables
from drake_aigto.kernels import borrow, kernel


@kernel
def calc_masses(tree: TreeTables, q: Floats, memory: TreeMemory) -> Floats:
    """Returns M of each state, shape (K, n n)."""
    n = tree.up.size
    found, rest = np.zeros((q.shape[0], n * n)), np.zeros(n)
    for k in range(q.shape[0]):
        spread(tree, q[k], rest, memory)
        gather(tree, False, memory)
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
    n = tree.up.size
    found, nothing = np.zeros((q.shape[0], n)), np.zeros(tree.actuation.shape[1])
    for k in range(q.shape[0]):
        spread(tree, q[k], v[k], memory)
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
    found = np.zeros(v.shape)
    for k in range(q.shape[0]):
        accelerate(tree, q[k], v[k], u[k], 0.0, False, memory)
        for s in range(tree.up.size):
            found[k, tree.velocities[s]] = memory.force[s]
    return found


@kernel
def calc_slopes(tree: TreeTables, q: Floats, v: Floats, u: Floats, memory: TreeMemory) -> Floats:
    """Returns ∂v̇/∂(δ, v, u), shape (n, 2n + nu)."""
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
def repeat_accelerations(
    count: int,
    tree: TreeTables,
    q: Floats,
    v: Floats,
    u: Floats,
    has_slopes: bool,
    memory: TreeMemory,
) -> float:
    """Computes v̇ this often, at velocities that change a little, and returns a sum of them."""
    tree, q, v, u, memory = borrow(tree), borrow(q), borrow(v), borrow(u), borrow(memory)
    total = 0.0
    for _ in range(count):
        v[0] += 1e-9
        accelerate(tree, q, v, u, 0.0, has_slopes, memory)
        total += memory.force[0]
    return total


@kernel
def calc_poses(tree: TreeTables, q: Floats, memory: TreeMemory) -> tuple[Floats, Floats]:
    """Returns rotations, by rows, and positions of bodies, shape (B, 9) and (B, 3)."""
    for i in range(tree.parents.size):
        place(tree, i, q, memory)
    R, p = tree.body_rotations.copy(), tree.body_offsets.copy()
    for b in range(p.shape[0]):
        i = tree.body_links[b]
        if i >= 0:
            pose, offset = memory.poses[i], tree.body_offsets[b]
            multiply(pose, tree.body_rotations[b], R[b])
            x, y, z = rotate(pose, offset[0], offset[1], offset[2])
            p[b, 0], p[b, 1], p[b, 2] = pose[9] + x, pose[10] + y, pose[11] + z
    return R, p


@kernel
def turn_positions(tree: TreeTables, q: Floats, v: Floats, rate: Floats) -> None:
    """Computes q̇ = N(q) v."""
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
def add(tree: TreeTables, q: Floats, delta: Floats, moved: Floats) -> None:
    """Computes q ⊕ δ."""
    add_tangent(tree, q, delta, moved)


@kernel
def subtract(tree: TreeTables, after: Floats, before: Floats, delta: Floats) -> None:
    """Computes the shortest δ with before ⊕ δ = after."""
    subtract_positions(tree, after, before, delta)
