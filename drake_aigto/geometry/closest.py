"""Distance and witness points of two shapes, with derivatives, in closed form.

Each pair comes down to a ball of A, which may have no radius, against a shape B: the ball itself,
an end of a capsule, the lowest corner of a box or a hull, or the lowest point of a cylinder's rim,
which slides along A as A turns. Capsules whose axes are closest between their ends do not (`rods`).
"""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.geometry.balls import reach_ball
from drake_aigto.geometry.cores import TINY, clear, copy, move_along, turn_back
from drake_aigto.geometry.hulls import find_lowest, reach_hull
from drake_aigto.geometry.rods import reach_capsule_and_box, reach_capsules
from drake_aigto.geometry.shapes import (
    BALL,
    BOX,
    CAPSULE,
    CYLINDER,
    HALF_SPACE,
    HULL,
    Closest,
    Shapes,
)
from drake_aigto.kernels import borrowing


@borrowing
def place_shapes(shapes: Shapes, poses: Floats, rotations: Floats, places: Floats) -> None:
    """Computes where shapes are in the world, from poses of bodies: R by rows and p, (L, 12).

    Axes of balls stay as they are.
    """
    for g in range(shapes.kinds.size):
        body, R, p = shapes.bodies[g], shapes.rotations[g], shapes.places[g]
        if body < 0:
            for i in range(3):
                places[g, i] = p[i]
                for j in range(3):
                    rotations[g, i, j] = R[i, j]
            continue
        pose = poses[body]
        for i in range(3):
            u, v, w = pose[3 * i], pose[3 * i + 1], pose[3 * i + 2]
            places[g, i] = pose[9 + i] + u * p[0] + v * p[1] + w * p[2]
            for j in range(3 if shapes.kinds[g] != BALL else 0):
                rotations[g, i, j] = u * R[0, j] + v * R[1, j] + w * R[2, j]


@borrowing
def is_apart(
    kinds: tuple[int, int], bounds: tuple[float, float], Ra: Floats, pa: Floats, Rb: Floats,
    pb: Floats, reach: float
) -> bool:  # fmt: skip
    """Returns whether two shapes are farther apart than a reach [m], by spheres about them."""
    x, y, z = pa[0] - pb[0], pa[1] - pb[1], pa[2] - pb[2]
    if kinds[1] == HALF_SPACE:
        height = Rb[0, 2] * x + Rb[1, 2] * y + Rb[2, 2] * z
        return bool(height > bounds[0] + reach)
    most = bounds[0] + bounds[1] + reach
    return bool(x * x + y * y + z * z > most * most)


@borrowing
def find_closest(
    shapes: Shapes, a: int, b: int, rotations: Floats, places: Floats, out: Closest
) -> None:
    """Computes what is closest of two shapes, the kind of the first one the lower number.

    Args:
        shapes: all shapes.
        a: A.
        b: B.
        rotations: axes of shapes in the world, shape (G, 3, 3).
        places: origins of these, shape (G, 3) [m].
        out: becomes the result.
    """
    clear(out.by_turn)
    clear(out.foot_by_turn)
    kind, other, size_a, size_b = shapes.kinds[a], shapes.kinds[b], shapes.sizes[a], shapes.sizes[b]
    Ra, pa, Rb, pb = rotations[a], places[a], rotations[b], places[b]
    c, radius = out.c, 0.0
    copy(pa, c)
    if kind == CAPSULE and other == CAPSULE:
        reach_capsules(Ra, pa, size_a, Rb, pb, size_b, out)
        return
    if kind == CAPSULE and other == BOX:
        reach_capsule_and_box(Ra, pa, size_a, Rb, pb, size_b, out)
        return
    if kind == CYLINDER:
        _reach_rim(Ra, pa, size_a, Rb, pb, size_b, out)
        return
    if kind == BALL:
        radius = size_a[0]
        if other == HULL:
            faces = shapes.faces[shapes.spans[b] : shapes.spans[b + 1]]
            reach_hull(c, radius, faces, Rb, pb, out)
            return
    elif kind == CAPSULE:  # Its lower end.
        radius = size_a[0]
        move_along(pa, Ra, -np.sign(turn_back(Ra, Rb, 2)) * size_a[1], c)
    elif kind == BOX:  # Its lowest corner.
        for i in range(3):
            side = -size_a[i] if turn_back(Ra, Rb, i) > 0.0 else size_a[i]
            for k in range(3):
                c[k] += side * Ra[k, i]
    else:
        find_lowest(shapes.faces[shapes.spans[a] : shapes.spans[a + 1]], Ra, Rb, c)
    reach_ball(c, radius, other, Rb, pb, size_b, out)


@borrowing
def _reach_rim(
    Ra: Floats, pa: Floats, size: Floats, Rb: Floats, pb: Floats, half: Floats, out: Closest
) -> None:
    """Computes what is closest of a cylinder and a half space: a point of its lower rim.

    With m the components of the normal across the axis and t the unit vector along the rim, A's
    turn by ω slides that point by −r t (t × n · ω)/‖m‖.
    """
    c, n, radius = out.c, out.n, size[0]
    x, y = turn_back(Ra, Rb, 0), turn_back(Ra, Rb, 1)
    across = max(np.sqrt(x * x + y * y), TINY)
    along = -size[1] * np.sign(turn_back(Ra, Rb, 2))
    for k in range(3):
        c[k] = pa[k] + along * Ra[k, 2] - radius * (x * Ra[k, 0] + y * Ra[k, 1]) / across
    reach_ball(c, 0.0, HALF_SPACE, Rb, pb, half, out)
    for j in range(3):
        u, w = (j + 1) % 3, (j + 2) % 3
        lever = _along_rim(Ra, x, y, u) * n[w] - _along_rim(Ra, x, y, w) * n[u]
        for i in range(3):
            slide = radius * _along_rim(Ra, x, y, i) * lever / across**3
            out.foot_by_turn[i, j] = -slide


@borrowing
def _along_rim(R: Floats, x: float, y: float, k: int) -> float:
    """Returns component k of t ‖m‖."""
    return float(x * R[k, 1] - y * R[k, 0])
