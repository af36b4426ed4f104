"""Recursions over a tree, in compiled code: kinematics, forces, mass matrix, its factor; frames.

Composite rigid bodies (Featherstone 2008, "Rigid Body Dynamics Algorithms", chapter 6), all in the
world's frame, in which what belongs to links is added without transforms.

A frame that is off its goal, at p with axes r_c, whose goals are p* and g_c, costs with
E = Σ r_c g_cᵀ

    Σ w_k (p − p*)_k² + w (3 − tr E) = Σ w_k (p − p*)_k² + w (2 sin(θ/2))²

By a turn δω about the world's axes tr E falls by Σ (g_c × r_c) · δω, and the same cost is that of
the residuals (r_c − g_c) √(w/2), so that its Gauss-Newton Hessian by δω is 2 w.
"""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.dynamics.spatial import (
    add_cross_force,
    apply_inertia,
    cross_motion,
    dot,
    move_inertia,
    multiply,
    rotate,
    turn_about,
    turn_by_quaternion,
    turn_by_rpy,
)
from drake_aigto.dynamics.tree_tables import (
    PRISMATIC,
    QUATERNION,
    RPY,
    SCREW,
    TRANSLATION,
    FrameTable,
    TreeMemory,
    TreeTables,
)
from drake_aigto.kernels import borrow, borrowing, kernel

_OWN, _ALL = 10, 22  # Numbers of an inertia; with T and the momentum of `tree_slopes`.


@borrowing
def place(tree: TreeTables, i: int, q: Floats, memory: TreeMemory) -> None:
    """Computes the pose of link i, and its motions S."""
    frame, pose = memory.frames[i], memory.poses[i]
    _place_frame(tree, i, memory)
    kind, at = tree.kinds[i], tree.positions[i]
    axis, x, y, z = tree.axes[i], 0.0, 0.0, 0.0
    if kind == TRANSLATION:
        x, y, z = q[at], q[at + 1], q[at + 2]
    elif kind in (PRISMATIC, SCREW):
        along = q[at] if kind == PRISMATIC else q[at] * tree.pitches[i]
        x, y, z = along * axis[0], along * axis[1], along * axis[2]
    if kind in (PRISMATIC, SCREW, TRANSLATION):
        x, y, z = rotate(frame, x, y, z)
        pose[9], pose[10], pose[11] = pose[9] + x, pose[10] + y, pose[11] + z
    if kind in (PRISMATIC, TRANSLATION):
        for k in range(9):
            pose[k] = frame[k]
    else:
        turn = memory.room[0]
        if kind == QUATERNION:
            turn_by_quaternion(q[at], q[at + 1], q[at + 2], q[at + 3], turn)
        elif kind == RPY:
            turn_by_rpy(q[at], q[at + 1], q[at + 2], turn)
        else:
            turn_about(axis, q[at], turn)
        multiply(frame, turn, pose)
    _find_motions(tree, i, memory)


@borrowing
def _place_frame(tree: TreeTables, i: int, memory: TreeMemory) -> None:
    """Computes the rotation of the frame F that link i moves in, and its position as the link's."""
    frame, pose, parent = memory.frames[i], memory.poses[i], tree.parents[i]
    rotation, offset = tree.rotations[i], tree.offsets[i]
    if parent < 0:
        for k in range(9):
            frame[k] = rotation[k]
        for k in range(3):
            pose[9 + k] = offset[k]
    else:
        base = memory.poses[parent]
        multiply(base, rotation, frame)
        x, y, z = rotate(base, offset[0], offset[1], offset[2])
        pose[9], pose[10], pose[11] = base[9] + x, base[10] + y, base[11] + z


@borrowing
def _find_motions(tree: TreeTables, i: int, memory: TreeMemory) -> None:
    """Computes S of link i: axes fixed in F, through the link's position if they turn."""
    frame, pose, kind = memory.frames[i], memory.poses[i], tree.kinds[i]
    first, last = tree.dofs[i], tree.dofs[i + 1]
    for s in range(first, last):
        S, k = memory.motions[s], s - first
        x, y, z = frame[k], frame[3 + k], frame[6 + k]
        if last == first + 1:
            x, y, z = rotate(frame, tree.axes[i, 0], tree.axes[i, 1], tree.axes[i, 2])
        if kind in (PRISMATIC, TRANSLATION):
            S[0] = S[1] = S[2] = 0.0
            S[3], S[4], S[5] = x, y, z
        else:
            pitch = tree.pitches[i]
            S[0], S[1], S[2] = x, y, z
            S[3] = pose[10] * z - pose[11] * y + pitch * x
            S[4] = pose[11] * x - pose[9] * z + pitch * y
            S[5] = pose[9] * y - pose[10] * x + pitch * z


@borrowing
def place_tree(tree: TreeTables, q: Floats, memory: TreeMemory) -> None:
    """Computes all that q decides alone: poses, motions, inertias, composite bodies, and M."""
    for i in range(tree.parents.size):
        place(tree, i, q, memory)
        B, C = memory.inertias[i], memory.composites[i]
        if tree.masses[i] == 0.0:
            for k in range(_OWN):
                B[k] = 0.0
        else:
            move_inertia(memory.poses[i], tree.masses[i], tree.centers[i], tree.inertias[i], B)
        for k in range(_OWN):
            C[k] = B[k]
    for i in range(tree.parents.size - 1, -1, -1):
        C, parent = memory.composites[i], tree.parents[i]
        for s in range(tree.dofs[i], tree.dofs[i + 1]):
            momentum = memory.momenta[s]
            apply_inertia(C, memory.motions[s], momentum)
            j = s
            while j >= 0:
                memory.mass[s, j] = dot(memory.motions[j], momentum)
                j = tree.up[j]
            memory.mass[s, s] += tree.armature[s]
        if parent >= 0:
            for k in range(_OWN):
                memory.composites[parent, k] += C[k]


@borrowing
def spread(tree: TreeTables, v: Floats, memory: TreeMemory) -> None:
    """Computes velocities, accelerations at v̇ = 0, and forces of single links that are placed."""
    for s in range(tree.up.size):
        memory.v[s] = v[tree.velocities[s]]
    for i in range(tree.parents.size):
        parent, V, A = tree.parents[i], memory.velocities[i], memory.biases[i]
        for k in range(3):
            V[k] = V[3 + k] = A[k] = 0.0
            A[3 + k] = -tree.gravity[i, k]
        if parent >= 0:
            for k in range(6):
                V[k], A[k] = memory.velocities[parent, k], memory.biases[parent, k]
        first, last = tree.dofs[i], tree.dofs[i + 1]
        for s in range(first, last):
            cross_motion(V, memory.motions[s], memory.rates[s])
        for s in range(first, last):
            for k in range(6):
                V[k] += memory.motions[s, k] * memory.v[s]
                A[k] += memory.rates[s, k] * memory.v[s]
        _push_link(tree, i, memory)


@borrowing
def _push_link(tree: TreeTables, i: int, memory: TreeMemory) -> None:
    """Computes the force of the motion of link i, I A + V ×* I V, and its momentum."""
    B, C, f = memory.inertias[i], memory.composites[i], memory.forces[i]
    V, momentum = memory.velocities[i], memory.room[0]
    if tree.masses[i] == 0.0:
        for k in range(_OWN, _ALL):
            C[k] = 0.0
        for k in range(6):
            f[k] = 0.0
        return
    apply_inertia(B, V, momentum)
    apply_inertia(B, memory.biases[i], f)
    add_cross_force(V, momentum, f)
    C[19], C[20], C[21] = momentum[3], momentum[4], momentum[5]


@borrowing
def push_joints(tree: TreeTables, q: Floats, u: Floats, eps: float, memory: TreeMemory) -> None:
    """Computes the generalized forces of controls, springs, dampers and dry friction."""
    for s in range(tree.up.size):
        v = memory.v[s]
        total = -tree.damping[s] * v
        for j in range(u.size):
            total += tree.actuation[s, j] * u[j]
        if tree.friction[s] > 0.0:
            share, _ = share_friction(v / find_stiction(tree, s, eps))
            total -= tree.friction[s] * share
        memory.force[s] = total
    for i in range(tree.parents.size):
        if tree.stiffnesses[i] != 0.0:
            stretch = q[tree.positions[i]] - tree.rests[i]
            memory.force[tree.dofs[i]] -= tree.stiffnesses[i] * stretch


@borrowing
def find_stiction(tree: TreeTables, s: int, eps: float) -> float:
    """Returns the speed below which a joint sticks, smoothed over ε."""
    return np.sqrt(tree.stiction[s] ** 2 + (eps * tree.pace[s]) ** 2)


@borrowing
def share_friction(x: float) -> tuple[float, float]:
    """Returns σ(x), see `calc_friction_share`, and its slope."""
    if abs(x) >= 1.0:
        return np.sign(x), 0.0
    a = abs(x)
    return x**3 * (10.0 - 15.0 * a + 6.0 * x * x), 30.0 * x * x * (1.0 - a) ** 2


@borrowing
def gather(tree: TreeTables, has_slopes: bool, memory: TreeMemory) -> None:
    """Takes forces of motion from the generalized ones; adds up what their derivatives need."""
    for i in range(tree.parents.size - 1, -1, -1):
        C, f, parent = memory.composites[i], memory.forces[i], tree.parents[i]
        for s in range(tree.dofs[i], tree.dofs[i + 1]):
            memory.force[s] -= dot(memory.motions[s], f)
        if parent >= 0:
            for k in range(_OWN, _ALL if has_slopes else _OWN):
                memory.composites[parent, k] += C[k]
            for k in range(6):
                memory.forces[parent, k] += f[k]


@borrowing
def factor(up: Ints, L: Floats) -> None:
    """Factors M = Lᵀ L with the zeros of the tree; 1 / L_kk takes the place of L_kk.

    Featherstone 2008, table 6.3.
    """
    for k in range(up.size - 1, -1, -1):
        L[k, k] = 1.0 / np.sqrt(L[k, k])
        i = up[k]
        while i >= 0:
            L[k, i] *= L[k, k]
            i = up[i]
        i = up[k]
        while i >= 0:
            j = i
            while j >= 0:
                L[i, j] -= L[k, i] * L[k, j]
                j = up[j]
            i = up[i]


@borrowing
def solve(up: Ints, L: Floats, y: Floats) -> None:
    """Replaces a vector by M⁻¹ times it."""
    for i in range(up.size - 1, -1, -1):
        y[i] *= L[i, i]
        j = up[i]
        while j >= 0:
            y[j] -= L[i, j] * y[i]
            j = up[j]
    for i in range(up.size):
        total, j = y[i], up[i]
        while j >= 0:
            total -= L[i, j] * y[j]
            j = up[j]
        y[i] = total * L[i, i]


@borrowing
def solve_rows(up: Ints, L: Floats, Y: Floats, first: int, last: int) -> None:
    """Replaces columns of a matrix by M⁻¹ times them, row by row."""
    for i in range(up.size - 1, -1, -1):
        _scale(L[i, i], Y[i, first:last])
        j = up[i]
        while j >= 0:
            _subtract_row(L[i, j], Y[i, first:last], Y[j, first:last])
            j = up[j]
    for i in range(up.size):
        j = up[i]
        while j >= 0:
            _subtract_row(L[i, j], Y[j, first:last], Y[i, first:last])
            j = up[j]
        _scale(L[i, i], Y[i, first:last])


@borrowing
def _subtract_row(factor: float, x: Floats, y: Floats) -> None:
    for c in range(y.size):
        y[c] -= factor * x[c]


@borrowing
def _scale(factor: float, x: Floats) -> None:
    for c in range(x.size):
        x[c] *= factor


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
