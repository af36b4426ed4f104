"""Positions of a tree as a manifold, in compiled code: q ⊕ δ and q ⊖ q."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.dynamics.spatial import (
    exp_quaternion,
    log_quaternion,
    multiply_quaternions,
)
from drake_aigto.dynamics.tree_tables import QUATERNION, RPY, TreeTables
from drake_aigto.kernels import borrowing


@borrowing
def add_tangent(tree: TreeTables, q: Floats, delta: Floats, moved: Floats) -> None:
    """Computes q ⊕ δ: links turned by rotation vectors in F, and moved."""
    for i in range(tree.parents.size):
        first, at, kind = tree.dofs[i], tree.positions[i], tree.kinds[i]
        if kind in (QUATERNION, RPY):
            _turn_link(tree, i, q, delta, moved)
        else:
            for k in range(tree.dofs[i + 1] - first):
                moved[at + k] = q[at + k] + delta[tree.velocities[first + k]]


@borrowing
def _turn_link(tree: TreeTables, i: int, q: Floats, delta: Floats, moved: Floats) -> None:
    """Computes the positions of a link turned by a rotation vector, a unit quaternion if any."""
    first, at = tree.dofs[i], tree.positions[i]
    x, y, z = delta[tree.velocities[first]], delta[tree.velocities[first + 1]], 0.0
    z = delta[tree.velocities[first + 2]]
    a, b, c, d = exp_quaternion(x, y, z)
    w, x, y, z = read_turn(tree, i, q)
    w, x, y, z = multiply_quaternions(a, b, c, d, w, x, y, z)
    if tree.kinds[i] == QUATERNION:
        length = np.sqrt(w * w + x * x + y * y + z * z)
        moved[at], moved[at + 1] = w / length, x / length
        moved[at + 2], moved[at + 3] = y / length, z / length
        return
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    moved[at + 1] = np.arcsin(min(max(2 * (w * y - x * z), -1.0), 1.0))
    moved[at] = roll + 2 * np.pi * np.round((q[at] - roll) / (2 * np.pi))
    moved[at + 2] = yaw + 2 * np.pi * np.round((q[at + 2] - yaw) / (2 * np.pi))


@borrowing
def read_turn(tree: TreeTables, i: int, q: Floats) -> tuple[float, float, float, float]:
    """Returns the quaternion of a link that turns about three axes."""
    at = tree.positions[i]
    if tree.kinds[i] == QUATERNION:
        return q[at], q[at + 1], q[at + 2], q[at + 3]
    c, s = np.cos(q[at] / 2), np.sin(q[at] / 2)
    cp, sp = np.cos(q[at + 1] / 2), np.sin(q[at + 1] / 2)
    cy, sy = np.cos(q[at + 2] / 2), np.sin(q[at + 2] / 2)
    w, x, y, z = multiply_quaternions(cp, 0.0, sp, 0.0, c, s, 0.0, 0.0)
    return multiply_quaternions(cy, 0.0, 0.0, sy, w, x, y, z)


@borrowing
def subtract_positions(tree: TreeTables, after: Floats, before: Floats, delta: Floats) -> None:
    """Computes the shortest δ with before ⊕ δ = after."""
    for i in range(tree.parents.size):
        first, at, kind = tree.dofs[i], tree.positions[i], tree.kinds[i]
        if kind in (QUATERNION, RPY):
            w, x, y, z = read_turn(tree, i, before)
            a, b, c, d = read_turn(tree, i, after)
            w, x, y, z = multiply_quaternions(a, b, c, d, w, -x, -y, -z)
            x, y, z = log_quaternion(w, x, y, z)
            delta[tree.velocities[first]], delta[tree.velocities[first + 1]] = x, y
            delta[tree.velocities[first + 2]] = z
        else:
            for k in range(tree.dofs[i + 1] - first):
                delta[tree.velocities[first + k]] = after[at + k] - before[at + k]
