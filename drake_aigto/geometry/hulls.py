"""Convex hulls with many faces, before balls and half spaces, in compiled code."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.geometry.cores import clear, copy, dot, lie_on_face, reach_core, turn_back
from drake_aigto.geometry.shapes import Closest
from drake_aigto.kernels import borrowing

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
