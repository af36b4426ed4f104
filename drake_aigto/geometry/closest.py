"""Distance and witness points of two shapes, with derivatives, in closed form.

Each pair comes down to a ball of A, which may have no radius, against a shape B: the ball itself,
an end of a capsule, the lowest corner of a box or a hull, or the lowest point of a cylinder's rim,
which slides along A as A turns. Capsules whose axes are closest between their ends do not.
"""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.geometry import balls
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
    balls.clear(out.by_turn)
    balls.clear(out.foot_by_turn)
    kind, other, size_a, size_b = shapes.kinds[a], shapes.kinds[b], shapes.sizes[a], shapes.sizes[b]
    Ra, pa, Rb, pb = rotations[a], places[a], rotations[b], places[b]
    c, radius = out.c, 0.0
    balls.copy(pa, c)
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
            balls.reach_hull(c, radius, faces, Rb, pb, out)
            return
    elif kind == CAPSULE:  # Its lower end.
        radius = size_a[0]
        balls.move_along(pa, Ra, -np.sign(balls.turn_back(Ra, Rb, 2)) * size_a[1], c)
    elif kind == BOX:  # Its lowest corner.
        for i in range(3):
            side = -size_a[i] if balls.turn_back(Ra, Rb, i) > 0.0 else size_a[i]
            for k in range(3):
                c[k] += side * Ra[k, i]
    else:
        balls.find_lowest(shapes.faces[shapes.spans[a] : shapes.spans[a + 1]], Ra, Rb, c)
    balls.reach_ball(c, radius, other, Rb, pb, size_b, out)


@borrowing
def _reach_rim(
    Ra: Floats, pa: Floats, size: Floats, Rb: Floats, pb: Floats, half: Floats, out: Closest
) -> None:
    """Computes what is closest of a cylinder and a half space: a point of its lower rim.

    With m the components of the normal across the axis and t the unit vector along the rim, A's
    turn by ω slides that point by −r t (t × n · ω)/‖m‖.
    """
    c, n, radius = out.c, out.n, size[0]
    x, y = balls.turn_back(Ra, Rb, 0), balls.turn_back(Ra, Rb, 1)
    across = max(np.sqrt(x * x + y * y), balls.TINY)
    along = -size[1] * np.sign(balls.turn_back(Ra, Rb, 2))
    for k in range(3):
        c[k] = pa[k] + along * Ra[k, 2] - radius * (x * Ra[k, 0] + y * Ra[k, 1]) / across
    balls.reach_ball(c, 0.0, HALF_SPACE, Rb, pb, half, out)
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


# The square of the sine of the angle between axes below which they are parallel.
_PARALLEL = 1e-12


@borrowing
def reach_capsules(
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
    balls.move_along(pa, Ra, s, c)
    if abs(s) >= half_a or sine <= _PARALLEL:
        balls.reach_ball(c, size_a[0], CAPSULE, Rb, pb, size_b, out)
    elif abs(t) >= half_b:
        balls.move_along(pb, Rb, t, c)
        balls.reach_ball(c, size_b[0], CAPSULE, Ra, pa, size_a, out)
        _turn_round(size_b[0], out)
    else:
        balls.move_along(pb, Rb, t, out.foot)
        balls.clear(out.foot_by_place)
        balls.reach_core(c, size_a[0], size_b[0], Ra, out)
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
    balls.cross(a, b, m)
    balls.cross(n, a, g)
    size, product, along = np.sqrt(balls.dot(m, m)), balls.dot(a, b), balls.dot(g, b)
    size = size if balls.dot(m, n) > 0.0 else -size
    distance = out.distance[0] + radii
    for j in range(3):
        for i in range(3):
            across[i] = (a[i] * b[j] - (product if i == j else 0.0)) / size
        inward = balls.dot(n, across)
        for i in range(3):
            by_turn[i, j] = across[i] - inward * n[i]
    for j in range(3):
        slide = 0.0
        for i in range(3):
            slide += g[i] * by_turn[i, j]
        for i in range(3):
            out.foot_by_place[i, j] = b[i] * g[j] / along
            out.foot_by_turn[i, j] = wall * by_turn[i, j] - distance * b[i] * slide / along
    balls.clear(out.by_place)


@borrowing
def reach_capsule_and_box(
    Ra: Floats, pa: Floats, size: Floats, Rb: Floats, pb: Floats, half: Floats, out: Closest
) -> None:
    """Computes what is closest of a capsule and a box: of the axis, an end or an inner point.

    The distance of the axis from the box is convex along it, and the slope of its square is linear
    between places where the axis passes the plane of a face; these bracket its zero.
    """
    x, d, c = out.by_place[0], out.by_place[1], out.c
    low, high = -size[1], size[1]
    for i in range(3):
        x[i] = Rb[0, i] * (pa[0] - pb[0]) + Rb[1, i] * (pa[1] - pb[1]) + Rb[2, i] * (pa[2] - pb[2])
        d[i] = Rb[0, i] * Ra[0, 2] + Rb[1, i] * Ra[1, 2] + Rb[2, i] * Ra[2, 2]
    for i in range(3):
        for side in (-half[i], half[i]):
            t = (side - x[i]) / d[i] if d[i] != 0.0 else high
            if low < t < high:
                if _slope(x, d, half, t) < 0.0:
                    low = t
                else:
                    high = t
    at_low, at_high = _slope(x, d, half, low), _slope(x, d, half, high)
    if at_low >= 0.0:
        t = low
    elif at_high <= 0.0:
        t = high
    else:
        t = low - at_low * (high - low) / (at_high - at_low)
    square, outside, free = 0.0, 0, 0
    for i in range(3):
        beyond = abs(x[i] + t * d[i]) - half[i]
        if beyond > 0.0:
            square += beyond * beyond
            outside += 1
        else:
            free = i
    if square <= balls.TINY * balls.TINY:
        _pierce(Ra, pa, size, Rb, pb, half, out)
    elif abs(t) >= size[1] or outside == 1:
        balls.move_along(pa, Ra, t, c)
        balls.reach_ball(c, size[0], BOX, Rb, pb, half, out)
    elif outside == 2:
        _reach_edge(Ra, pa, size, Rb, pb, half, free, out)
    else:
        for k in range(3):
            c[k] = pb[k]
            for i in range(3):
                c[k] += np.copysign(half[i], x[i] + t * d[i]) * Rb[k, i]
        balls.reach_ball(c, 0.0, CAPSULE, Ra, pa, size, out)
        _turn_round(0.0, out)


@borrowing
def _slope(x: Floats, d: Floats, half: Floats, t: float) -> float:
    """Returns half the slope of the squared distance of x + t d from a box."""
    slope = 0.0
    for i in range(3):
        at = x[i] + t * d[i]
        slope += (at - min(max(at, -half[i]), half[i])) * d[i]
    return slope


@borrowing
def _pierce(
    Ra: Floats, pa: Floats, size: Floats, Rb: Floats, pb: Floats, half: Floats, out: Closest
) -> None:
    """Computes what is closest of a box and a capsule whose axis goes through the box.

    The least move that parts axis and box is across a face, where one end is the last inside, or
    across the axis and an edge.
    """
    x, d = out.by_place[0], out.by_place[1]
    nearest, height, is_edge = 0, -np.inf, False
    for i in range(3):
        gap = abs(x[i]) - half[i] - abs(d[i]) * size[1]
        if gap > height:
            nearest, height, is_edge = i, gap, False
    for i in range(3):
        u, w = (i + 1) % 3, (i + 2) % 3
        across = np.sqrt(d[u] ** 2 + d[w] ** 2)
        if across * across > _PARALLEL:
            rooms = half[u] * abs(d[w]) + half[w] * abs(d[u])
            gap = (abs(d[u] * x[w] - d[w] * x[u]) - rooms) / across
            if gap > height:
                nearest, height, is_edge = i, gap, True
    if is_edge:
        _reach_edge(Ra, pa, size, Rb, pb, half, nearest, out)
        return
    side = np.copysign(1.0, x[nearest])
    balls.move_along(pa, Ra, -side * np.copysign(size[1], d[nearest]), out.c)
    for k in range(3):
        out.n[k] = side * Rb[k, nearest]
    balls.lie_on_face(out.c, height, size[0], out)


@borrowing
def _reach_edge(
    Ra: Floats, pa: Floats, size: Floats, Rb: Floats, pb: Floats, half: Floats, i: int, out: Closest
) -> None:
    """Computes what is closest of a capsule's axis and an edge of a box along its direction i."""
    x, d, n, foot = out.by_place[0], out.by_place[1], out.n, out.foot
    u, w = (i + 1) % 3, (i + 2) % 3
    across = np.sqrt(d[u] ** 2 + d[w] ** 2)
    lever = (d[u] * x[w] - d[w] * x[u]) / across
    side = np.copysign(1.0, lever) / across
    n_u, n_w = -side * d[w], side * d[u]
    e_u, e_w = np.copysign(half[u], n_u), np.copysign(half[w], n_w)
    t = ((e_u - x[u]) * d[u] + (e_w - x[w]) * d[w]) / across**2
    balls.move_along(pa, Ra, t, out.c)
    for k in range(3):
        n[k] = n_u * Rb[k, u] + n_w * Rb[k, w]
        foot[k] = pb[k] + e_u * Rb[k, u] + e_w * Rb[k, w] + (x[i] + t * d[i]) * Rb[k, i]
    out.distance[0] = abs(lever) - half[u] * abs(n_u) - half[w] * abs(n_w) - size[0]
    _cross(Ra[:, 2], Rb[:, i], size[0], 0.0, out)
