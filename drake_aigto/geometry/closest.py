"""Distance and witness points of two shapes, with derivatives, in closed form.

Each pair comes down to a ball of A, which may have no radius, against a shape B: the ball itself,
an end of a capsule, the lowest corner of a box, or the lowest point of a cylinder's rim, which
slides along A as A turns. Two capsules whose axes cross are the one case that does not.
"""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.geometry.shapes import BALL, BOX, CAPSULE, HALF_SPACE, Closest, Shapes
from drake_aigto.kernels import borrowing

# Cores that are nearer than this have no direction between them [m].
_TINY = 1e-12
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
    kind_a: int, Ra: Floats, pa: Floats, size_a: Floats,
    kind_b: int, Rb: Floats, pb: Floats, size_b: Floats, out: Closest,
) -> None:  # fmt: skip
    """Computes what is closest of two shapes, the kind of the first one the lower number.

    Args:
        kind_a: of A.
        Ra: its axes in the world, shape (3, 3).
        pa: its origin in the world, shape (3,) [m].
        size_a: see `Shapes`, shape (3,) [m].
        kind_b: of B.
        Rb: as above.
        pb: as above.
        size_b: as above.
        out: becomes the result.
    """
    _clear(out.by_turn)
    _clear(out.foot_by_turn)
    c = out.c
    if kind_a == BALL:
        _copy(pa, c)
        _reach_ball(c, size_a[0], kind_b, Rb, pb, size_b, out)
    elif kind_a == CAPSULE and kind_b == CAPSULE:
        _reach_capsules(Ra, pa, size_a, Rb, pb, size_b, out)
    elif kind_a == CAPSULE:  # Its lower end.
        _move_along(pa, Ra, -np.sign(_turn_back(Ra, Rb, 2)) * size_a[1], c)
        _reach_ball(c, size_a[0], kind_b, Rb, pb, size_b, out)
    elif kind_a == BOX:  # Its lowest corner.
        _copy(pa, c)
        for i in range(3):
            side = -size_a[i] if _turn_back(Ra, Rb, i) > 0.0 else size_a[i]
            for k in range(3):
                c[k] += side * Ra[k, i]
        _reach_ball(c, 0.0, kind_b, Rb, pb, size_b, out)
    else:
        _reach_rim(Ra, pa, size_a, Rb, pb, size_b, out)


@borrowing
def _clear(matrix: Floats) -> None:
    for i in range(3):
        for j in range(3):
            matrix[i, j] = 0.0


@borrowing
def _copy(source: Floats, target: Floats) -> None:
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
def _turn_back(Ra: Floats, Rb: Floats, i: int) -> float:
    """Returns the component along axis i of A of the normal of a half space."""
    return float(Ra[0, i] * Rb[0, 2] + Ra[1, i] * Rb[1, 2] + Ra[2, i] * Rb[2, 2])


@borrowing
def _move_along(p: Floats, R: Floats, by: float, out: Floats) -> None:
    """Computes the point that is moved along the z axis."""
    for k in range(3):
        out[k] = p[k] + by * R[k, 2]


@borrowing
def _reach_ball(
    c: Floats, radius: float, kind: int, R: Floats, p: Floats, size: Floats, out: Closest
) -> None:
    """Computes what is closest of a ball with center c and a shape B."""
    if kind == HALF_SPACE:
        height = R[0, 2] * (c[0] - p[0]) + R[1, 2] * (c[1] - p[1]) + R[2, 2] * (c[2] - p[2])
        for k in range(3):
            out.n[k] = R[k, 2]
        _lie_on_face(c, height, radius, out)
    elif kind == BOX:
        _reach_box(c, radius, R, p, size, out)
    else:
        half = size[1] if kind == CAPSULE else 0.0
        t = R[0, 2] * (c[0] - p[0]) + R[1, 2] * (c[1] - p[1]) + R[2, 2] * (c[2] - p[2])
        slides = abs(t) < half
        _move_along(p, R, min(max(t, -half), half), out.foot)
        for i in range(3):
            for j in range(3):
                out.foot_by_place[i, j] = R[i, 2] * R[j, 2] if slides else 0.0
        _reach_core(c, radius, size[0], R, out)


@borrowing
def _lie_on_face(c: Floats, height: float, radius: float, out: Closest) -> None:
    """Fills in the rest of a ball before a flat face, of known normal and height of its center."""
    n = out.n
    out.distance[0] = height - radius
    for i in range(3):
        out.foot[i] = c[i] - height * n[i]
        for j in range(3):
            out.by_place[i, j] = 0.0
            out.foot_by_place[i, j] = (1.0 if i == j else 0.0) - n[i] * n[j]


@borrowing
def _reach_core(c: Floats, radius: float, wall: float, R: Floats, out: Closest) -> None:
    """Fills in the rest of a ball before the nearest point of a core, which is in `foot`.

    With P the projection on directions in which that point slides along the core (which n is
    across), l the distance of c from it and r the radius about the core,

        ∂n/∂c = (1 − n nᵀ − P) / l,    ∂(foot)/∂c = P + r ∂n/∂c
    """
    n, foot, P = out.n, out.foot, out.foot_by_place
    distance = np.sqrt((c[0] - foot[0]) ** 2 + (c[1] - foot[1]) ** 2 + (c[2] - foot[2]) ** 2)
    for k in range(3):  # Of concentric balls any direction will do.
        n[k] = (c[k] - foot[k]) / distance if distance > _TINY else R[k, 0]
    distance = max(distance, _TINY)
    out.distance[0] = distance - radius - wall
    for i in range(3):
        foot[i] += wall * n[i]
        for j in range(3):
            across = (1.0 if i == j else 0.0) - n[i] * n[j] - P[i, j]
            out.by_place[i, j] = across / distance
            P[i, j] += wall * out.by_place[i, j]


@borrowing
def _reach_box(c: Floats, radius: float, R: Floats, p: Floats, half: Floats, out: Closest) -> None:
    """Computes what is closest of a ball and a box: a face, an edge or a corner."""
    foot, P = out.foot, out.foot_by_place
    _clear(P)
    _copy(p, foot)
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
        _reach_core(c, radius, 0.0, R, out)
        return
    for k in range(3):
        out.n[k] = side * R[k, nearest]
    _lie_on_face(c, -room, radius, out)


@borrowing
def _reach_rim(
    Ra: Floats, pa: Floats, size: Floats, Rb: Floats, pb: Floats, half: Floats, out: Closest
) -> None:
    """Computes what is closest of a cylinder and a half space: a point of its lower rim.

    With m the components of the normal across the axis and t the unit vector along the rim, A's
    turn by ω slides that point by −r t (t × n · ω)/‖m‖.
    """
    c, n, radius = out.c, out.n, size[0]
    x, y = _turn_back(Ra, Rb, 0), _turn_back(Ra, Rb, 1)
    across = max(np.sqrt(x * x + y * y), _TINY)
    along = -size[1] * np.sign(_turn_back(Ra, Rb, 2))
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
    _move_along(pa, Ra, s, c)
    if abs(s) >= half_a or sine <= _PARALLEL:
        _reach_ball(c, size_a[0], CAPSULE, Rb, pb, size_b, out)
    elif abs(t) >= half_b:
        _move_along(pb, Rb, t, c)
        _reach_ball(c, size_b[0], CAPSULE, Ra, pa, size_a, out)
        _turn_round(size_b[0], out)
    else:
        _move_along(pb, Rb, t, out.foot)
        _clear(out.foot_by_place)
        _reach_core(c, size_a[0], size_b[0], Ra, out)
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
    _clear(out.by_place)
