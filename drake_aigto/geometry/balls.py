"""A ball before each shape: what is closest, with derivatives; products of vectors; compiled."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.geometry.shapes import BOX, CAPSULE, CYLINDER, HALF_SPACE, Closest
from drake_aigto.kernels import borrowing

# Cores that are nearer than this have no direction between them [m].
TINY = 1e-12


@borrowing
def clear(matrix: Floats) -> None:
    """Makes a matrix (3, 3) zero."""
    for i in range(3):
        for j in range(3):
            matrix[i, j] = 0.0


@borrowing
def copy(source: Floats, target: Floats) -> None:
    """Copies a vector."""
    for i in range(3):
        target[i] = source[i]


@borrowing
def cross(a: Floats, b: Floats, out: Floats) -> None:
    """Computes a × b of vectors."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@borrowing
def dot(a: Floats, b: Floats) -> float:
    """Returns a · b of vectors."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@borrowing
def turn_back(Ra: Floats, Rb: Floats, i: int) -> float:
    """Returns the component along axis i of A of the normal of a half space."""
    return float(Ra[0, i] * Rb[0, 2] + Ra[1, i] * Rb[1, 2] + Ra[2, i] * Rb[2, 2])


@borrowing
def move_along(p: Floats, R: Floats, by: float, out: Floats) -> None:
    """Computes the point that is moved along the z axis."""
    for k in range(3):
        out[k] = p[k] + by * R[k, 2]


@borrowing
def lie_on_face(c: Floats, height: float, radius: float, out: Closest) -> None:
    """Fills in the rest of a ball before a flat face, of known normal and height of its center."""
    n = out.n
    out.distance[0] = height - radius
    for i in range(3):
        out.foot[i] = c[i] - height * n[i]
        for j in range(3):
            out.by_place[i, j] = 0.0
            out.foot_by_place[i, j] = (1.0 if i == j else 0.0) - n[i] * n[j]


@borrowing
def reach_core(c: Floats, radius: float, wall: float, R: Floats, out: Closest) -> None:
    """Fills in the rest of a ball before the nearest point of a core, which is in `foot`.

    With P the projection on directions in which that point slides along the core (which n is
    across), l the distance of c from it and r the radius about the core,

        ∂n/∂c = (1 − n nᵀ − P) / l,    ∂(foot)/∂c = P + r ∂n/∂c
    """
    n, foot, P = out.n, out.foot, out.foot_by_place
    distance = np.sqrt((c[0] - foot[0]) ** 2 + (c[1] - foot[1]) ** 2 + (c[2] - foot[2]) ** 2)
    for k in range(3):  # Of concentric balls any direction will do.
        n[k] = (c[k] - foot[k]) / distance if distance > TINY else R[k, 0]
    distance = max(distance, TINY)
    out.distance[0] = distance - radius - wall
    for i in range(3):
        foot[i] += wall * n[i]
        for j in range(3):
            across = (1.0 if i == j else 0.0) - n[i] * n[j] - P[i, j]
            out.by_place[i, j] = across / distance
            P[i, j] += wall * out.by_place[i, j]


# A point this share of an edge's length beyond it is over the face: triangles of one face meet.
_BESIDE = 1e-9


@borrowing
def find_lowest(faces: Floats, Ra: Floats, Rb: Floats, c: Floats) -> None:
    """Moves c from a hull's origin to its corner that is lowest over a half space."""
    x, y, z = turn_back(Ra, Rb, 0), turn_back(Ra, Rb, 1), turn_back(Ra, Rb, 2)
    lowest, face, corner = np.inf, 0, 0
    for t in range(faces.shape[0]):
        for j in range(3):
            height = x * faces[t, j, 0] + y * faces[t, j, 1] + z * faces[t, j, 2]
            if height < lowest:
                lowest, face, corner = height, t, j
    for k in range(3):
        c[k] += dot(Ra[k], faces[face, corner])


@borrowing
def reach_hull(c: Floats, radius: float, faces: Floats, R: Floats, p: Floats, out: Closest) -> None:
    """Computes what is closest of a ball and a convex hull: a face, an edge or a corner.

    Only faces that c is in front of count, or if it is inside, the nearest one.
    """
    x, foot, P, trial = out.by_place[0], out.foot, out.foot_by_place, out.by_place[1]
    for i in range(3):
        x[i] = R[0, i] * (c[0] - p[0]) + R[1, i] * (c[1] - p[1]) + R[2, i] * (c[2] - p[2])
    highest, nearest, least, side = -np.inf, 0, np.inf, -1
    for t in range(faces.shape[0]):
        n, corner = faces[t, 3], faces[t, 0]
        height = dot(n, x) - dot(n, corner)
        if height > highest and highest <= 0.0:
            highest, nearest = height, t
        if height > 0.0:
            square, place = _reach_triangle(x, faces[t], height, trial)
            if square < least:
                least, nearest, side = square, t, place
                copy(trial, foot)
    if side < 0:  # A face, from inside or outside.
        n = faces[nearest, 3]
        height = dot(n, x) - dot(n, faces[nearest, 0])
        for k in range(3):
            out.n[k] = dot(R[k], n)
        lie_on_face(c, height, radius, out)
        return
    copy(foot, trial)
    for k in range(3):
        foot[k] = p[k] + dot(R[k], trial)
    clear(P)
    if side < 3:
        a, b, edge = faces[nearest, side], faces[nearest, (side + 1) % 3], out.n
        for k in range(3):
            edge[k] = R[k, 0] * (b[0] - a[0]) + R[k, 1] * (b[1] - a[1]) + R[k, 2] * (b[2] - a[2])
        square = dot(edge, edge)
        for i in range(3):
            for j in range(3):
                P[i, j] = edge[i] * edge[j] / square
    reach_core(c, radius, 0.0, R, out)


@borrowing
def _reach_triangle(x: Floats, face: Floats, height: float, out: Floats) -> tuple[float, int]:
    """Computes the point of a triangle nearest to x, which is in front of it by a height [m].

    Returns:
        The square of its distance, and on which edge it is; 3: a corner, −1: none.
    """
    n, least, side, is_over = face[3], np.inf, -1, True
    for e in range(3):
        a, b = face[e], face[(e + 1) % 3]
        u, v, w = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        i, j, k = x[0] - a[0], x[1] - a[1], x[2] - a[2]
        square = u * u + v * v + w * w
        inward = (n[1] * w - n[2] * v) * i + (n[2] * u - n[0] * w) * j + (n[0] * v - n[1] * u) * k
        if inward >= -_BESIDE * square:
            continue
        is_over = False
        along = (u * i + v * j + w * k) / square
        share = min(max(along, 0.0), 1.0)
        off = (i - share * u) ** 2 + (j - share * v) ** 2 + (k - share * w) ** 2
        if off < least:
            least, side = off, e if share == along else 3
            out[0], out[1], out[2] = a[0] + share * u, a[1] + share * v, a[2] + share * w
    if is_over:
        return height * height, -1
    return least, side


@borrowing
def reach_ball(
    c: Floats, radius: float, kind: int, R: Floats, p: Floats, size: Floats, out: Closest
) -> None:
    """Computes what is closest of a ball with center c and a shape B."""
    if kind == HALF_SPACE:
        height = R[0, 2] * (c[0] - p[0]) + R[1, 2] * (c[1] - p[1]) + R[2, 2] * (c[2] - p[2])
        for k in range(3):
            out.n[k] = R[k, 2]
        lie_on_face(c, height, radius, out)
    elif kind == BOX:
        _reach_box(c, radius, R, p, size, out)
    elif kind == CYLINDER:
        _reach_cylinder(c, radius, R, p, size, out)
    else:
        half = size[1] if kind == CAPSULE else 0.0
        t = R[0, 2] * (c[0] - p[0]) + R[1, 2] * (c[1] - p[1]) + R[2, 2] * (c[2] - p[2])
        slides = abs(t) < half
        move_along(p, R, min(max(t, -half), half), out.foot)
        for i in range(3):
            for j in range(3):
                out.foot_by_place[i, j] = R[i, 2] * R[j, 2] if slides else 0.0
        reach_core(c, radius, size[0], R, out)


@borrowing
def _reach_box(c: Floats, radius: float, R: Floats, p: Floats, half: Floats, out: Closest) -> None:
    """Computes what is closest of a ball and a box: a face, an edge or a corner."""
    foot, P = out.foot, out.foot_by_place
    clear(P)
    copy(p, foot)
    nearest, room, is_out = 0, np.inf, False
    for i in range(3):
        x = R[0, i] * (c[0] - p[0]) + R[1, i] * (c[1] - p[1]) + R[2, i] * (c[2] - p[2])
        gap = half[i] - abs(x)
        if gap < room:
            nearest, room, side = i, gap, 1.0 if x >= 0.0 else -1.0
        is_out = is_out or gap < 0.0
        for k in range(3):
            foot[k] += min(max(x, -half[i]), half[i]) * R[k, i]
            for j in range(3 if gap > 0.0 else 0):
                P[k, j] += R[k, i] * R[j, i]
    if is_out:
        reach_core(c, radius, 0.0, R, out)
        return
    for k in range(3):
        out.n[k] = side * R[k, nearest]
    lie_on_face(c, -room, radius, out)


@borrowing
def _reach_cylinder(
    c: Floats, radius: float, R: Floats, p: Floats, size: Floats, out: Closest
) -> None:
    """Computes what is closest of a ball and a cylinder: its side, an end, or a point of its rim.

    A rim's point moves along the rim by r/ρ of what c does, which is ρ away from the axis.
    """
    foot, P, offset = out.foot, out.foot_by_place, out.n
    t = R[0, 2] * (c[0] - p[0]) + R[1, 2] * (c[1] - p[1]) + R[2, 2] * (c[2] - p[2])
    move_along(p, R, t, foot)
    for k in range(3):
        offset[k] = c[k] - foot[k]
    across, end = np.sqrt(dot(offset, offset)), size[1] if t > 0.0 else -size[1]
    if abs(t) < size[1] and across - size[0] > abs(t) - size[1]:
        for i in range(3):
            for j in range(3):
                P[i, j] = R[i, 2] * R[j, 2]
        reach_core(c, radius, size[0], R, out)
    elif across <= size[0]:
        for k in range(3):
            out.n[k] = np.sign(end) * R[k, 2]
        lie_on_face(c, abs(t) - size[1], radius, out)
    else:
        rim, share = out.by_place[0], size[0] / across
        cross(R[:, 2], offset, rim)
        for i in range(3):
            for j in range(3):
                P[i, j] = share * rim[i] * rim[j] / across**2
        move_along(p, R, end, foot)
        for k in range(3):
            foot[k] += share * offset[k]
        reach_core(c, radius, 0.0, R, out)
