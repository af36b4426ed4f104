"""Bodies that touch in space: forces of all pairs of shapes, and their derivatives, compiled.

The law is Drake's, of continuous point contact:

    f_n = k x (1 + d ẋ)₊,    x = (−φ)₊,    ẋ = −φ̇,    f = f_n (n − μ σ(‖v_t‖ / v_s) v_t / ‖v_t‖)

acts on A at C = (p_A + p_B)/2, and −f on B: n is the normal from B to A, p_A and p_B are witness
points, v = v_A − v_B is the relative velocity of the material at C, φ̇ = n · v, v_t = v − φ̇ n, and σ
that of `calc_friction_share`. While a search is on, φ is known to a width w = ε × share (logistic
noise), v_t to a speed ε / T, and springs that are wide are soft:

    x = w log(1 + exp(−φ / w)),    k min(1, g / w) for k,    v_s² + (ε / T)² for v_s²

which is the law itself at ε = 0. With k from afar, light bodies would be thrown. In Runge-Kutta
steps v_s is no slower than a f_n, a slip's change in one of them (`TreeMechanism.fit`), lest slips
oscillate about rest; at a = 0 it is the law's own.

All pairs of shapes on the same two bodies add up to one wrench F = (C × f, f) on A about the
world's origin, and to 6 × 6 matrices K and G, its derivatives as A moves and as its velocity
changes: degrees of freedom, which may be many, count once for all of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.contact.laws import calc_stiffness
from drake_aigto.dynamics import add_cross_force, cross_motion
from drake_aigto.dynamics import dot as power
from drake_aigto.geometry import (
    Closest,
    Shapes,
    cross,
    dot,
    find_closest,
    is_apart,
    make_closest,
    place_shapes,
)
from drake_aigto.kernels import borrowing

# Columns of `TouchTable.law`.
STIFFNESS, DISSIPATION, FRICTION, STICTION, SHARE, GIVE, SLOWING = range(7)
# Beyond this many widths ε a depth is below e⁻³² ε: no contact.
_FAR = 32.0


class TouchTable(NamedTuple):
    """Pairs of shapes that may touch, P of them, on the bodies of a tree with n velocities.

    Couples are two bodies, A and B, that have pairs; there are W of them.
    """

    shapes: Shapes
    pairs: Ints  # shapes A and B of each, A's kind the lower number, shape (P, 2)
    law: Floats  # k [N/m], d [s/m], μ, v_s [m/s], share, g [m], and a of each pair, shape (P, 7)
    couples: Ints  # that of each pair, shape (P,)
    # Degrees of freedom that move A or B but not both; of couple i from starts[i] to starts[i + 1].
    starts: Ints  # shape (W + 1,)
    chain: Ints
    signs: Floats  # 1 for A, −1 for B
    carries: Bools  # whether degree of freedom j moves the axis of i, [j, i], shape (n, n)


class TouchRoom(NamedTuple):
    """Room for an evaluation of all pairs."""

    rotations: Floats  # of shapes in the world, shape (G, 3, 3)
    places: Floats  # of the same, shape (G, 3) [m]
    closest: Closest  # of one pair
    speeds: Floats  # velocities of A relative to B, shape (W, 6)
    wrenches: Floats  # F of couples, shape (W, 6)
    by_move: Floats  # K, transposed, shape (W, 6, 6)
    by_speed: Floats  # G, transposed, shape (W, 6, 6)
    vectors: Floats  # v, f, ∂f/∂f_n, and others, shape (8, 3)
    by_vectors: Floats  # ∂f/∂v and ∂f/∂n of one pair, shape (2, 3, 3)
    moves: Floats  # δF of one pair by six moves, shape (6, 6)
    motions: Floats  # of one degree of freedom, shape (5, 6)
    found: Floats  # φ, f_n, and C, of each pair, shape (P, 5); f_n is 0 of pairs that do not touch


def make_touch_room(table: TouchTable) -> TouchRoom:
    """Returns room for an evaluation."""
    G, W = len(table.shapes.kinds), len(table.starts) - 1
    sizes = (W, 6), (W, 6), (W, 6, 6), (W, 6, 6), (8, 3), (2, 3, 3), (6, 6), (5, 6)
    rooms = [np.zeros(size) for size in (*sizes, (len(table.pairs), 5))]
    return TouchRoom(np.tile(np.eye(3), (G, 1, 1)), np.zeros((G, 3)), make_closest(), *rooms)


@borrowing
def meet(table: TouchTable, pair: int, reach: float, room: TouchRoom) -> bool:
    """Computes what is closest of a pair, unless it is farther apart than a reach [m]."""
    shapes, (a, b) = table.shapes, (table.pairs[pair, 0], table.pairs[pair, 1])
    kinds, bounds = (shapes.kinds[a], shapes.kinds[b]), (shapes.bounds[a], shapes.bounds[b])
    Ra, pa, Rb, pb = room.rotations[a], room.places[a], room.rotations[b], room.places[b]
    if is_apart(kinds, bounds, Ra, pa, Rb, pb, reach):
        return False
    find_closest(shapes, a, b, room.rotations, room.places, room.closest)
    return bool(room.closest.distance[0] < reach)


@borrowing
def measure_distance(
    table: TouchTable, pair: int, S: Floats, room: TouchRoom, slope: Floats
) -> float:
    """Returns φ of a pair whose shapes are placed [m]; computes ∂φ/∂δ by degrees of freedom.

    That is the power of a unit force along its normal.
    """
    near, F, w = room.closest, room.moves[0], table.couples[pair]
    meet(table, pair, np.inf, room)
    for k in range(6):
        F[k] = 0.0
    _add_moments(near.foot, near.n, F)
    for i in range(S.shape[0]):
        slope[i] = 0.0
    for a in range(table.starts[w], table.starts[w + 1]):
        slope[table.chain[a]] = table.signs[a] * power(S[table.chain[a]], F)
    return float(near.distance[0])


@borrowing
def find_depth(distance: float, eps: float) -> tuple[float, float]:
    """Returns x and ∂x/∂φ."""
    if eps == 0.0:
        return (-distance, -1.0) if distance < 0.0 else (0.0, 0.0)
    y = distance / eps
    if y > 0.0:
        small = np.exp(-y)
        return eps * np.log1p(small), -small / (1.0 + small)
    small = np.exp(y)
    return eps * np.log1p(small) - distance, -1.0 / (1.0 + small)


@borrowing
def push(
    table: TouchTable, poses: Floats, S: Floats, v: Floats,
    eps: float, pace: float, has_slopes: bool, room: TouchRoom, force: Floats, slopes: Floats,
) -> None:  # fmt: skip
    """Adds Jᵀ f of all pairs to a generalized force, and its derivatives by (q, v) if asked.

    Args:
        table: the pairs.
        poses: of bodies in the world, R by rows and p, shape (L, 12).
        S: motion of each velocity, turn and then the material at the origin, in the world's frame,
            shape (n, 6).
        v: velocities, shape (n,).
        eps: ε [m].
        pace: 1/T [1/s].
        has_slopes: whether derivatives are asked for.
        room: memory; `found` is a result, too.
        force: Jᵀ f is added, shape (n,).
        slopes: ∂(Jᵀ f)/∂(q, v) is added, in the tangent space, shape (n, 2n).
    """
    place_shapes(table.shapes, poses, room.rotations, room.places)
    for w in range(table.starts.size - 1):
        _begin_couple(table, w, S, v, room)
    for pair in range(table.pairs.shape[0]):
        room.found[pair, 1] = 0.0
        if meet(table, pair, _FAR * eps * table.law[pair, SHARE], room):
            _push_pair(table, pair, eps, pace, has_slopes, room)
    for w in range(table.starts.size - 1):
        F = room.wrenches[w]
        if F[3] == 0.0 and F[4] == 0.0 and F[5] == 0.0:
            continue
        for a in range(table.starts[w], table.starts[w + 1]):
            force[table.chain[a]] += table.signs[a] * power(S[table.chain[a]], F)
        if has_slopes:
            _spread(table, w, S, v, room, slopes)


@borrowing
def _begin_couple(table: TouchTable, w: int, S: Floats, v: Floats, room: TouchRoom) -> None:
    """Computes the relative velocity of two bodies, and makes sums zero."""
    V, F, K, G = room.speeds[w], room.wrenches[w], room.by_move[w], room.by_speed[w]
    for k in range(6):
        V[k] = F[k] = 0.0
        for j in range(6):
            K[k, j] = G[k, j] = 0.0
    for a in range(table.starts[w], table.starts[w + 1]):
        i = table.chain[a]
        for k in range(6):
            V[k] += table.signs[a] * v[i] * S[i, k]


@borrowing
def _push_pair(
    table: TouchTable, pair: int, eps: float, pace: float, has_slopes: bool, room: TouchRoom
) -> None:
    """Adds the wrench of one pair, whose closest points are known."""
    law, near, found, w = table.law[pair], room.closest, room.found[pair], table.couples[pair]
    speed, f, unit, slip = room.vectors[0], room.vectors[1], room.vectors[2], room.vectors[3]
    n, distance, V, C = near.n, near.distance[0], room.speeds[w], found[2:]
    for k in range(3):
        C[k] = near.foot[k] + distance * n[k] / 2
    cross(V, C, speed)
    for k in range(3):
        speed[k] += V[3 + k]
    width = eps * law[SHARE]
    rate, (depth, by_distance) = dot(n, speed), find_depth(distance, width)
    stiffness = calc_stiffness(law[STIFFNESS], law[GIVE], width)
    brake = 1.0 - law[DISSIPATION] * rate
    normal = stiffness * depth * brake
    if normal <= 0.0 or brake <= 0.0:
        return
    found[0], found[1] = distance, normal
    for k in range(3):
        slip[k] = speed[k] - rate * n[k]
    change = law[SLOWING] * normal
    slow = np.sqrt(max(law[STICTION], change) ** 2 + (eps * pace) ** 2)
    squares = dot(slip, slip)
    drag, bend = _rub(np.sqrt(squares) / slow)
    drag, bend = law[FRICTION] * drag / slow, law[FRICTION] * bend / slow**3
    for k in range(3):
        f[k] = normal * (n[k] - drag * slip[k])
    _add_moments(C, f, room.wrenches[w])
    if has_slopes:
        by_normal = drag
        if change > law[STICTION]:
            by_normal -= (drag + bend * squares) * (change / slow) ** 2
        for k in range(3):  # ∂f/∂f_n
            unit[k] = n[k] - by_normal * slip[k]
        by_rate = -stiffness * depth * law[DISSIPATION]
        law_slopes = stiffness * by_distance * brake, by_rate, normal, drag, bend
        _differentiate(w, C, rate, law_slopes, room)


@borrowing
def _add_moments(C: Floats, f: Floats, wrench: Floats) -> None:
    """Adds the wrench of a force at C."""
    wrench[0] += C[1] * f[2] - C[2] * f[1]
    wrench[1] += C[2] * f[0] - C[0] * f[2]
    wrench[2] += C[0] * f[1] - C[1] * f[0]
    for k in range(3):
        wrench[3 + k] += f[k]


@borrowing
def _rub(y: float) -> tuple[float, float]:
    """Returns h = σ(y)/y and h′/y, of a slip in parts of the stiction speed."""
    if y < 1.0:
        return y * y * (10.0 - 15.0 * y + 6.0 * y * y), 20.0 - 45.0 * y + 24.0 * y * y
    return 1.0 / y, -1.0 / (y * y * y)


@borrowing
def _differentiate(
    w: int, C: Floats, rate: float, law_slopes: tuple[float, float, float, float, float],
    room: TouchRoom,
) -> None:  # fmt: skip
    """Adds the derivatives of a pair's wrench, as A moves, and as it speeds up.

    With t the slip v − φ̇ n, u = ∂f/∂f_n, and ω the relative turn,

        ∂f/∂v = (∂f_n/∂φ̇) u nᵀ − f_n (drag (1 − n nᵀ) + bend t tᵀ)
        ∂f/∂n = (∂f_n/∂φ̇) u vᵀ + f_n (1 + drag (n vᵀ + φ̇ 1) + bend φ̇ t tᵀ)
        δf = (∂f_n/∂φ) u δφ + ∂f/∂n δn + ∂f/∂v (ω × δC),    δC = δ(foot) + (n δφ + φ δn) / 2
    """
    by_distance, by_rate, normal, drag, bend = law_slopes
    near, vectors, moves = room.closest, room.vectors, room.moves
    speed, f, unit, slip = vectors[0], vectors[1], vectors[2], vectors[3]
    dn, dC, dv, df, n = vectors[4], vectors[5], vectors[6], vectors[7], near.n
    by_v, by_n = room.by_vectors[0], room.by_vectors[1]
    for i in range(3):
        along = by_rate * unit[i] + normal * drag * n[i]
        for j in range(3):
            one, bent = (1.0 if i == j else 0.0), normal * bend * slip[i] * slip[j]
            by_v[i, j] = along * n[j] - normal * drag * one - bent
            by_n[i, j] = along * speed[j] + normal * (1.0 + drag * rate) * one + rate * bent
    for j in range(6):  # Along three axes at c, and round them.
        distance = n[j] if j < 3 else 0.0
        for k in range(3):
            dn[k] = near.by_place[k, j] if j < 3 else near.by_turn[k, j - 3]
            dC[k] = near.foot_by_place[k, j] if j < 3 else near.foot_by_turn[k, j - 3]
            dC[k] += (distance * n[k] + near.distance[0] * dn[k]) / 2
        cross(room.speeds[w], dC, dv)
        for k in range(3):
            df[k] = by_distance * distance * unit[k] + dot(by_n[k], dn) + dot(by_v[k], dv)
        cross(dC, f, dv)
        for k in range(3):
            moves[j, k], moves[j, 3 + k] = dv[k], 0.0
        _add_moments(C, df, moves[j])
    for j in range(3):
        for k in range(6):
            room.by_move[w, j, k] += moves[3 + j, k]
    _add_moves(near.c, moves, room.by_move[w])
    for j in range(3):
        for k in range(3):
            df[k] = by_v[k, j]
        for k in range(6):
            moves[j, k] = 0.0
        _add_moments(C, df, moves[j])
    _add_moves(C, moves, room.by_speed[w])


@borrowing
def _add_moves(p: Floats, moves: Floats, out: Floats) -> None:
    """Adds derivatives along three axes at p to those by motions, which turn about the origin."""
    for j in range(3):
        u, v = (j + 1) % 3, (j + 2) % 3
        for k in range(6):
            out[j, k] += p[u] * moves[v, k] - p[v] * moves[u, k]
            out[3 + j, k] += moves[j, k]


@borrowing
def _spread(
    table: TouchTable, w: int, S: Floats, v: Floats, room: TouchRoom, slopes: Floats
) -> None:
    """Adds ∂(Jᵀ f)/∂(q, v) of a couple.

    Velocity j of A moves A by S_j, and velocities V_j of A that it carries turn with it. Moving B
    is moving both, whereby F goes along, and A back. With V that of A relative to B,

        δF = K S_j + G (S_j × V_j)                          of A,
        δF = S_j ×* F − K S_j − G (S_j × (V + V_j))         of B,
        δ(S_i · F) = S_i · (δF − S_j ×* F  if j carries i)
    """
    F, K, G, V = room.wrenches[w], room.by_move[w], room.by_speed[w], room.speeds[w]
    motions = room.motions
    beyond, turned, along, dF, by_speed = motions[0], motions[1], motions[2], motions[3], motions[4]
    first, last, n = table.starts[w], table.starts[w + 1], table.carries.shape[0]
    for b in range(first, last):
        j, s = table.chain[b], table.signs[b]
        for k in range(6):
            beyond[k] = V[k] if s < 0.0 else 0.0
            along[k] = dF[k] = by_speed[k] = 0.0
        for a in range(first, last):
            i = table.chain[a]
            if table.signs[a] == s and table.carries[j, i]:
                for k in range(6):
                    beyond[k] += v[i] * S[i, k]
        cross_motion(S[j], beyond, turned)
        add_cross_force(S[j], F, along)
        for m in range(6):
            for k in range(6):
                dF[k] += s * (K[m, k] * S[j, m] + G[m, k] * turned[m])
                by_speed[k] += s * G[m, k] * S[j, m]
        for k in range(6):
            dF[k] += along[k] if s < 0.0 else 0.0
        for a in range(first, last):
            i, side = table.chain[a], table.signs[a]
            total = power(S[i], dF)
            if side == s and table.carries[j, i]:
                total -= power(S[i], along)
            slopes[i, j] += side * total
            slopes[i, n + j] += side * power(S[i], by_speed)
