"""A ball against each shape: what is closest, with derivatives, in compiled code."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.geometry.cores import clear, copy, cross, dot, lie_on_face, move_along, reach_core
from drake_aigto.geometry.shapes import BOX, CAPSULE, CYLINDER, HALF_SPACE, Closest
from drake_aigto.kernels import borrowing


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
