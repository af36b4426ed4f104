"""Costs of frames that are off their goals, with derivatives, in compiled code.

A frame at p with axes r_c, whose goals are p* and g_c, costs with E = Σ r_c g_cᵀ

    Σ w_k (p − p*)_k² + w (3 − tr E) = Σ w_k (p − p*)_k² + w (2 sin(θ/2))²

By a turn δω about the world's axes tr E falls by Σ (g_c × r_c) · δω, and the same cost is that of
the residuals (r_c − g_c) √(w/2), so that its Gauss-Newton Hessian by δω is 2 w.
"""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.dynamics.recursions import place
from drake_aigto.dynamics.spatial import dot, multiply, rotate
from drake_aigto.dynamics.tree_tables import FrameTable, TreeMemory, TreeTables
from drake_aigto.kernels import borrow, borrowing, kernel


@borrowing
def _find_frame(tree: TreeTables, frames: FrameTable, f: int, memory: TreeMemory) -> float:
    """Computes p, p − p* and Σ g_c × r_c in `room[2]`, and returns tr E, where links are placed."""
    link, offset, goal = frames.links[f], frames.offsets[f], frames.goal_rotations[f]
    R, found = memory.room[1], memory.room[2]
    multiply(memory.poses[link], frames.rotations[f], R)
    found[0], found[1], found[2] = rotate(memory.poses[link], offset[0], offset[1], offset[2])
    trace = 0.0
    for k in range(3):
        found[k] += memory.poses[link, 9 + k]
        found[3 + k] = found[k] - frames.goals[f, k]
        a, b = (k + 1) % 3, (k + 2) % 3
        found[6 + k] = 0.0
        for c in range(3):
            trace += R[3 * k + c] * goal[3 * k + c]
            found[6 + k] += goal[3 * a + c] * R[3 * b + c] - goal[3 * b + c] * R[3 * a + c]
    return trace


@borrowing
def add_frame_costs(
    tree: TreeTables,
    frames: FrameTable,
    q: Floats,
    has_slopes: bool,
    l1: Floats,
    l2: Floats,
    memory: TreeMemory,
) -> float:
    """Returns what frames cost at q, and adds derivatives along q ⊕ δ, as v is ordered, if asked.

    Args:
        tree: the joints.
        frames: on its links.
        q: positions, shape (nq, …).
        has_slopes: whether derivatives are asked for.
        l1: the gradient, shape (nv, …).
        l2: the Gauss-Newton Hessian, shape (nv, nv, …).
        memory: room.
    """
    cost = 0.0
    for i in range(tree.parents.size if frames.links.size else 0):
        place(tree, i, q, memory)
    for f in range(frames.links.size):
        w, found, wrench = frames.weights[f], memory.room[2], memory.room[3]
        cost += w[3] * (3.0 - _find_frame(tree, frames, f, memory))
        for k in range(3):
            cost += w[k] * found[3 + k] ** 2
            wrench[k], wrench[3 + k] = w[3] * found[6 + k], 2 * w[k] * found[3 + k]
        if not has_slopes:
            continue
        last = tree.dofs[frames.links[f] + 1] - 1
        _move_wrench(found, wrench)
        _add_powers(tree, last, wrench, memory, l1)
        s = last
        while s >= 0:
            S = memory.motions[s]
            for k in range(3):
                a, b = (k + 1) % 3, (k + 2) % 3
                speed = S[3 + k] + S[a] * found[b] - S[b] * found[a]
                wrench[k], wrench[3 + k] = 2 * w[3] * S[k], 2 * w[k] * speed
            _move_wrench(found, wrench)
            _add_powers(tree, last, wrench, memory, l2[tree.velocities[s]])
            s = tree.up[s]
    return cost


@borrowing
def _move_wrench(p: Floats, wrench: Floats) -> None:
    """Makes the moment about p that about the origin."""
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        wrench[k] += p[a] * wrench[3 + b] - p[b] * wrench[3 + a]


@borrowing
def _add_powers(
    tree: TreeTables, last: int, wrench: Floats, memory: TreeMemory, out: Floats
) -> None:
    """Adds S_s · F of all degrees of freedom that move a link, of which one is the last."""
    s = last
    while s >= 0:
        out[tree.velocities[s]] += dot(memory.motions[s], wrench)
        s = tree.up[s]


@kernel
def measure_frames(tree: TreeTables, frames: FrameTable, q: Floats, memory: TreeMemory) -> Floats:
    """Returns p − p* [m] and cos θ of each frame at states q (K, nq), shape (K, F, 4)."""
    tree, frames, memory = borrow(tree), borrow(frames), borrow(memory)
    errors = np.zeros((q.shape[0], frames.links.size, 4))
    for k in range(q.shape[0]):
        for i in range(tree.parents.size):
            place(tree, i, q[k], memory)
        for f in range(frames.links.size):
            errors[k, f, 3] = (_find_frame(tree, frames, f, memory) - 1.0) / 2
            for i in range(3):
                errors[k, f, i] = memory.room[2, 3 + i]
    return errors
