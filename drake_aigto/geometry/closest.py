"""Distance and witness points of two shapes, with derivatives, in closed form.

Each pair comes down to a ball of A, which may have no radius, against a shape B: the ball itself,
an end of a capsule, the lowest corner of a box or a hull, or the lowest point of a cylinder's rim,
which slides along A as A turns. Two capsules whose axes cross are the one case that does not.
"""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.geometry.cores import (
    TINY,
    clear,
    copy,
    cross,
    dot,
    lie_on_face,
    move_along,
    reach_core,
    turn_back,
)
from drake_aigto.geometry.hulls import find_lowest, reach_hull
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

# The square of the sine of the angle between axes below which they are parallel.
_PARALLEL = 1e-12


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
        _reach_capsules(Ra, pa, size_a, Rb, pb, size_b, out)
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
    _reach_ball(c, radius, other, Rb, pb, size_b, out)


@borrowing
def _reach_ball(
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
    _reach_ball(c, 0.0, HALF_SPACE, Rb, pb, half, out)
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


@borrowing
def _reach_capsules(
    Ra: Floats, pa: Floats, size_a: Floats, Rb: Floats, pb: Floats, size_b: Floats, out: Closest
) -> None:
    """Computes what is closest of two capsules: of their axes, two inner points, or an end.

    Points c = pa + s a and pb + t b of segments (Ericson, Real-Time Collision Detection, 5.1.9).
    """
    half_a, half_b, product, to_a, to_b = size_a[1], size_b[1], 0.0, 0.0, 0.0
    for k in range(3):
        product += Ra[k, 2] * Rb[k, 2]
        to_a += Ra[k, 2] * (pb[k] - pa[k])
        to_b += Rb[k, 2] * (pa[k] - pb[k])
    sine = 1.0 - product * product
    s = (to_a + product * to_b) / sine if sine > _PARALLEL else 0.0
    s = min(max(s, -half_a), half_a)
    t = min(max(to_b + s * product, -half_b), half_b)
    s = min(max(to_a + t * product, -half_a), half_a)
    c = out.c
    move_along(pa, Ra, s, c)
    if abs(s) >= half_a or sine <= _PARALLEL:
        _reach_ball(c, size_a[0], CAPSULE, Rb, pb, size_b, out)
    elif abs(t) >= half_b:
        move_along(pb, Rb, t, c)
        _reach_ball(c, size_b[0], CAPSULE, Ra, pa, size_a, out)
        _turn_round(size_b[0], out)
    else:
        move_along(pb, Rb, t, out.foot)
        clear(out.foot_by_place)
        reach_core(c, size_a[0], size_b[0], Ra, out)
        _cross(Ra[:, 2], Rb[:, 2], size_a[0] + size_b[0], size_b[0], out)


@borrowing
def _turn_round(radius: float, out: Closest) -> None:
    """Makes what is closest as a ball of B moves before A that as A moves before this ball.

    A's move is one of both, and back of the ball, whose center c stands still.
    """
    n, by_turn = out.n, out.by_turn
    for k in range(3):
        n[k] = -n[k]
        out.foot[k] = out.c[k] + radius * n[k]
        by_turn[(k + 2) % 3, (k + 1) % 3] = -n[k]
        by_turn[(k + 1) % 3, (k + 2) % 3] = n[k]
    for i in range(3):
        for j in range(3):
            out.foot_by_place[i, j] = radius * out.by_place[i, j]
            out.foot_by_turn[i, j] = radius * by_turn[i, j]


@borrowing
def _cross(a: Floats, b: Floats, radii: float, wall: float, out: Closest) -> None:
    """Fills in derivatives where axes a and b cross at a distance l = φ + radii.

    The normal is that of both, n = ± (a × b)/‖a × b‖, and the foot on b slides by t:

        ∂n/∂ω = ± (1 − n nᵀ)(a bᵀ − (a · b) 1) / ‖a × b‖,    g = n × a
        δt = (g · δc − l g · δn) / (g · b),    δ(foot) = b δt + r δn
    """
    n, by_turn = out.n, out.by_turn
    m, g, across = out.by_place[0], out.by_place[1], out.by_place[2]  # Room, until it becomes 0.
    cross(a, b, m)
    cross(n, a, g)
    size, product, along = np.sqrt(dot(m, m)), dot(a, b), dot(g, b)
    size = size if dot(m, n) > 0.0 else -size
    distance = out.distance[0] + radii
    for j in range(3):
        for i in range(3):
            across[i] = (a[i] * b[j] - (product if i == j else 0.0)) / size
        inward = dot(n, across)
        for i in range(3):
            by_turn[i, j] = across[i] - inward * n[i]
    for j in range(3):
        slide = 0.0
        for i in range(3):
            slide += g[i] * by_turn[i, j]
        for i in range(3):
            out.foot_by_place[i, j] = b[i] * g[j] / along
            out.foot_by_turn[i, j] = wall * by_turn[i, j] - distance * b[i] * slide / along
    clear(out.by_place)
