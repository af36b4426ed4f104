"""Balls before flat faces and around cores, and products of vectors, in compiled code."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.geometry.shapes import Closest
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
