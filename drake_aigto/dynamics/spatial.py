"""Spatial algebra in compiled code: rotations by rows, and vectors (angular, linear) in one frame.

Motions are about the frame's origin: (ω, velocity of the body's point there); forces are (moment
about it, force). Inertias are (m, m c, xx, xy, yy, xz, yz, zz of the inertia about it).
"""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.dynamics.tree_tables import QUATERNION, RPY, TreeTables
from drake_aigto.kernels import borrowing

# Angles below which series replace sin θ/θ and the like: the next term is below 1e-17.
_SMALL = 1e-4
# The same of closed forms that cancel: next terms are below 1e-15.
_NEARLY_STILL = 0.1


@borrowing
def multiply(A: Floats, B: Floats, C: Floats) -> None:
    """Computes the product C = A B of 3 × 3 matrices."""
    for i in range(3):
        for j in range(3):
            C[3 * i + j] = A[3 * i] * B[j] + A[3 * i + 1] * B[3 + j] + A[3 * i + 2] * B[6 + j]


@borrowing
def rotate(R: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Returns R times a vector."""
    return (
        R[0] * x + R[1] * y + R[2] * z,
        R[3] * x + R[4] * y + R[5] * z,
        R[6] * x + R[7] * y + R[8] * z,
    )


@borrowing
def turn_about(axis: Floats, angle: float, R: Floats) -> None:
    """Computes R of a turn about an axis of unit length (Rodrigues)."""
    x, y, z = axis[0], axis[1], axis[2]
    c, s = np.cos(angle), np.sin(angle)
    k = 1.0 - c
    R[0], R[1], R[2] = c + k * x * x, k * x * y - s * z, k * x * z + s * y
    R[3], R[4], R[5] = k * x * y + s * z, c + k * y * y, k * y * z - s * x
    R[6], R[7], R[8] = k * x * z - s * y, k * y * z + s * x, c + k * z * z


@borrowing
def turn_by_quaternion(w: float, x: float, y: float, z: float, R: Floats) -> None:
    """Computes R of a quaternion, of any length but 0."""
    s = 2.0 / (w * w + x * x + y * y + z * z)
    R[0], R[1], R[2] = 1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)
    R[3], R[4], R[5] = s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)
    R[6], R[7], R[8] = s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)


@borrowing
def turn_by_rpy(roll: float, pitch: float, yaw: float, R: Floats) -> None:
    """Computes R = R_z(yaw) R_y(pitch) R_x(roll)."""
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    R[0], R[1], R[2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    R[3], R[4], R[5] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    R[6], R[7], R[8] = -sp, cp * sr, cp * cr


@borrowing
def cross_motion(v: Floats, s: Floats, out: Floats) -> None:
    """Computes v × s of motions."""
    out[0] = v[1] * s[2] - v[2] * s[1]
    out[1] = v[2] * s[0] - v[0] * s[2]
    out[2] = v[0] * s[1] - v[1] * s[0]
    out[3] = v[1] * s[5] - v[2] * s[4] + v[4] * s[2] - v[5] * s[1]
    out[4] = v[2] * s[3] - v[0] * s[5] + v[5] * s[0] - v[3] * s[2]
    out[5] = v[0] * s[4] - v[1] * s[3] + v[3] * s[1] - v[4] * s[0]


@borrowing
def add_cross_force(v: Floats, f: Floats, out: Floats) -> None:
    """Adds v ×* f, the rate of a force, or momentum, that moves along with v."""
    out[0] += v[1] * f[2] - v[2] * f[1] + v[4] * f[5] - v[5] * f[4]
    out[1] += v[2] * f[0] - v[0] * f[2] + v[5] * f[3] - v[3] * f[5]
    out[2] += v[0] * f[1] - v[1] * f[0] + v[3] * f[4] - v[4] * f[3]
    out[3] += v[1] * f[5] - v[2] * f[4]
    out[4] += v[2] * f[3] - v[0] * f[5]
    out[5] += v[0] * f[4] - v[1] * f[3]


@borrowing
def dot(a: Floats, b: Floats) -> float:
    """Returns the product of a motion and a force."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5]


@borrowing
def apply_inertia(B: Floats, v: Floats, out: Floats) -> None:
    """Computes B v, the momentum of a motion."""
    m, x, y, z = B[0], B[1], B[2], B[3]
    out[0] = B[4] * v[0] + B[5] * v[1] + B[7] * v[2] + y * v[5] - z * v[4]
    out[1] = B[5] * v[0] + B[6] * v[1] + B[8] * v[2] + z * v[3] - x * v[5]
    out[2] = B[7] * v[0] + B[8] * v[1] + B[9] * v[2] + x * v[4] - y * v[3]
    out[3] = m * v[3] - y * v[2] + z * v[1]
    out[4] = m * v[4] - z * v[0] + x * v[2]
    out[5] = m * v[5] - x * v[1] + y * v[0]


@borrowing
def move_inertia(pose: Floats, m: float, center: Floats, J: Floats, B: Floats) -> None:
    """Computes the inertia B of a body in the world from its mass, center, and moments J about it.

    The pose is R by rows, and p; J is xx, xy, yy, xz, yz, zz in the body's frame, as the center is.
    """
    x, y, z = rotate(pose, center[0], center[1], center[2])
    x, y, z = pose[9] + x, pose[10] + y, pose[11] + z
    a0, a1, a2 = rotate(pose, J[0], J[1], J[3])  # Columns of R J.
    b0, b1, b2 = rotate(pose, J[1], J[2], J[4])
    c0, c1, c2 = rotate(pose, J[3], J[4], J[5])
    B[0], B[1], B[2], B[3] = m, m * x, m * y, m * z
    B[4] = a0 * pose[0] + b0 * pose[1] + c0 * pose[2] + m * (y * y + z * z)
    B[5] = a0 * pose[3] + b0 * pose[4] + c0 * pose[5] - m * x * y
    B[6] = a1 * pose[3] + b1 * pose[4] + c1 * pose[5] + m * (x * x + z * z)
    B[7] = a0 * pose[6] + b0 * pose[7] + c0 * pose[8] - m * x * z
    B[8] = a1 * pose[6] + b1 * pose[7] + c1 * pose[8] - m * y * z
    B[9] = a2 * pose[6] + b2 * pose[7] + c2 * pose[8] + m * (x * x + y * y)


@borrowing
def multiply_quaternions(
    aw: float, ax: float, ay: float, az: float, bw: float, bx: float, by: float, bz: float
) -> tuple[float, float, float, float]:
    """Returns the product of two quaternions, the turn b followed by a."""
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


@borrowing
def exp_quaternion(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Returns the unit quaternion of a rotation vector."""
    square = x * x + y * y + z * z
    angle = np.sqrt(square)
    half = 0.5 - square / 48 if angle < _SMALL else np.sin(angle / 2) / angle
    return np.cos(angle / 2), half * x, half * y, half * z


@borrowing
def log_quaternion(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Returns the shortest rotation vector of a quaternion, of any length but 0."""
    sine = np.sqrt(x * x + y * y + z * z)
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    ratio = 2.0 / w if sine < 1e-9 * w else 2.0 * np.arctan2(sine, w) / sine
    return ratio * x, ratio * y, ratio * z


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
    x, y = delta[tree.velocities[first]], delta[tree.velocities[first + 1]]
    a, b, c, d = exp_quaternion(x, y, delta[tree.velocities[first + 2]])
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


@borrowing
def find_turning(x: float, y: float, z: float, D: Floats) -> None:
    """Computes D, 3 × 3, by rows: exp(δ + dδ) = exp(D dδ) exp(δ), the left Jacobian.

    D = 1 + (1 − cos θ)/θ² [δ×] + (θ − sin θ)/θ³ [δ×]² with θ = ‖δ‖.
    """
    square = x * x + y * y + z * z
    if square < _NEARLY_STILL * _NEARLY_STILL:
        a = 0.5 - square / 24 * (1 - square / 30 * (1 - square / 56))
        b = 1 / 6 - square / 120 * (1 - square / 42 * (1 - square / 72))
    else:
        angle = np.sqrt(square)
        a, b = (1 - np.cos(angle)) / square, (angle - np.sin(angle)) / (square * angle)
    D[0], D[1], D[2] = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    D[3], D[4], D[5] = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
    D[6], D[7], D[8] = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)


@borrowing
def find_rate(delta: Floats, turn: Floats, rate: Floats, by_delta: Floats, by_turn: Floats) -> None:
    """Computes δ̇ = D⁻¹ ω of a turn at ω, shape (3,), and its derivatives by δ and ω, by rows.

    D⁻¹ ω = ω − ½ δ × ω + c δ × (δ × ω),    c = (1 − θ/2 cot θ/2)/θ²
    """
    x, y, z = delta[0], delta[1], delta[2]
    square, along = x * x + y * y + z * z, x * turn[0] + y * turn[1] + z * turn[2]
    if square < _NEARLY_STILL * _NEARLY_STILL:
        c = 1 / 12 + square / 720 * (1 + square / 42 * (1 + square / 40))
        bend = 1 / 360 + square / 7560 * (1 + 0.0375 * square)
    else:
        angle = np.sqrt(square)
        cot = 1 / np.tan(angle / 2)
        c = (1 - angle / 2 * cot) / square
        bend = (-2 * c - cot / (2 * angle) + (1 + cot * cot) / 4) / square
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        across = delta[j] * turn[k] - delta[k] * turn[j]
        bent = delta[i] * along - turn[i] * square
        rate[i] = turn[i] - across / 2 + c * bent
        for m in range(3):
            by_turn[3 * i + m] = c * delta[i] * delta[m] + (1 - c * square if i == m else 0.0)
            by_delta[3 * i + m] = (
                c * (delta[i] * turn[m] - 2 * turn[i] * delta[m] + (along if i == m else 0.0))
                + bend * bent * delta[m]
            )
        by_turn[3 * i + j] += delta[k] / 2
        by_turn[3 * i + k] -= delta[j] / 2
        by_delta[3 * i + j] -= turn[k] / 2
        by_delta[3 * i + k] += turn[j] / 2
