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

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact.laws import calc_stiffness
from drake_aigto.contact.touch_tables import (
    DISSIPATION,
    FRICTION,
    GIVE,
    SHARE,
    SLOWING,
    STICTION,
    STIFFNESS,
    TouchRoom,
    TouchTable,
)
from drake_aigto.dynamics import ALL_SLOPES, BY_SPEED, NO_SLOPES, add_cross_force, cross_motion
from drake_aigto.dynamics import dot as power
from drake_aigto.geometry import cross, dot, find_closest, is_apart, place_shapes
from drake_aigto.kernels import borrowing

# Beyond this many widths ε a depth is below e⁻³² ε: no contact.
_FAR = 32.0


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
    asked = ALL_SLOPES if has_slopes else NO_SLOPES
    place_shapes(table.shapes, poses, room.rotations, room.places)
    for w in range(table.starts.size - 1):
        _begin_couple(table, w, S, v, room)
    for pair in range(table.pairs.shape[0]):
        if _place_pair(table, pair, eps, room):
            _push_pair(table, pair, eps, pace, asked, room)
    _add_couples(table, S, v, asked, room, force, slopes)


@borrowing
def place_pairs(table: TouchTable, poses: Floats, eps: float, room: TouchRoom) -> None:
    """Computes what poses decide alone, for `push_at_once` at any velocities."""
    place_shapes(table.shapes, poses, room.rotations, room.places)
    for pair in range(table.pairs.shape[0]):
        _place_pair(table, pair, eps, room)


@borrowing
def push_at_once(
    table: TouchTable, S: Floats, v: Floats, eps: float, pace: float, room: TouchRoom,
    force: Floats, slopes: Floats,
) -> None:  # fmt: skip
    """Does what `push` does, with derivatives by v alone, after `place_pairs`."""
    for w in range(table.starts.size - 1):
        _begin_couple(table, w, S, v, room)
    for pair in range(table.pairs.shape[0]):
        if room.found[pair, 0] < np.inf:
            _push_pair(table, pair, eps, pace, BY_SPEED, room)
    _add_couples(table, S, v, BY_SPEED, room, force, slopes)


@borrowing
def _place_pair(table: TouchTable, pair: int, eps: float, room: TouchRoom) -> bool:
    """Computes φ, C and n of a pair, and returns whether it is near enough to push."""
    near, found = room.closest, room.found[pair]
    found[0], found[1] = np.inf, 0.0
    if not meet(table, pair, _FAR * eps * table.law[pair, SHARE], room):
        return False
    found[0] = near.distance[0]
    for k in range(3):
        found[2 + k], found[5 + k] = near.foot[k] + found[0] * near.n[k] / 2, near.n[k]
    return True


@borrowing
def _add_couples(
    table: TouchTable, S: Floats, v: Floats, asked: int, room: TouchRoom, force: Floats,
    slopes: Floats,
) -> None:  # fmt: skip
    """Adds Jᵀ f of all couples, and the derivatives asked for."""
    for w in range(table.starts.size - 1):
        F = room.wrenches[w]
        if F[3] == 0.0 and F[4] == 0.0 and F[5] == 0.0:
            continue
        for a in range(table.starts[w], table.starts[w + 1]):
            force[table.chain[a]] += table.signs[a] * power(S[table.chain[a]], F)
        if asked == BY_SPEED:
            _spread_by_speed(table, w, S, room, slopes)
        elif asked == ALL_SLOPES:
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
    table: TouchTable, pair: int, eps: float, pace: float, asked: int, room: TouchRoom
) -> None:
    """Adds the wrench of one pair, whose closest points are known."""
    law, found, w = table.law[pair], room.found[pair], table.couples[pair]
    speed, f, unit, slip = room.vectors[0], room.vectors[1], room.vectors[2], room.vectors[3]
    distance, C, n, V = found[0], found[2:], found[5:], room.speeds[w]
    cross(V, C, speed)
    for k in range(3):
        speed[k] += V[3 + k]
    width = eps * law[SHARE]
    rate, (depth, by_distance) = dot(n, speed), find_depth(distance, width)
    stiffness = calc_stiffness(law[STIFFNESS], law[GIVE], width)
    brake = 1.0 - law[DISSIPATION] * rate
    normal = stiffness * depth * brake
    found[1] = 0.0
    if normal <= 0.0 or brake <= 0.0:
        return
    found[1] = normal
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
    if asked != NO_SLOPES:
        by_normal = drag
        if change > law[STICTION]:
            by_normal -= (drag + bend * squares) * (change / slow) ** 2
        for k in range(3):  # ∂f/∂f_n
            unit[k] = n[k] - by_normal * slip[k]
        by_rate = -stiffness * depth * law[DISSIPATION]
        law_slopes = stiffness * by_distance * brake, by_rate, normal, drag, bend
        _differentiate(w, found, rate, law_slopes, asked == ALL_SLOPES, room)


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
    w: int, found: Floats, rate: float, law_slopes: tuple[float, float, float, float, float],
    is_all: bool, room: TouchRoom,
) -> None:  # fmt: skip
    """Adds the derivatives of a pair's wrench, as A moves if asked, and as it speeds up.

    With t the slip v − φ̇ n, u = ∂f/∂f_n, and ω the relative turn,

        ∂f/∂v = (∂f_n/∂φ̇) u nᵀ − f_n (drag (1 − n nᵀ) + bend t tᵀ)
        ∂f/∂n = (∂f_n/∂φ̇) u vᵀ + f_n (1 + drag (n vᵀ + φ̇ 1) + bend φ̇ t tᵀ)
        δf = (∂f_n/∂φ) u δφ + ∂f/∂n δn + ∂f/∂v (ω × δC),    δC = δ(foot) + (n δφ + φ δn) / 2
    """
    by_distance, by_rate, normal, drag, bend = law_slopes
    near, vectors, moves, C, n = room.closest, room.vectors, room.moves, found[2:], found[5:]
    speed, f, unit, slip = vectors[0], vectors[1], vectors[2], vectors[3]
    dn, dC, dv, df = vectors[4], vectors[5], vectors[6], vectors[7]
    by_v, by_n = room.by_vectors[0], room.by_vectors[1]
    for i in range(3):
        along = by_rate * unit[i] + normal * drag * n[i]
        for j in range(3):
            one, bent = (1.0 if i == j else 0.0), normal * bend * slip[i] * slip[j]
            by_v[i, j] = along * n[j] - normal * drag * one - bent
            by_n[i, j] = along * speed[j] + normal * (1.0 + drag * rate) * one + rate * bent
    for j in range(6 if is_all else 0):  # Along three axes at c, and round them.
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
    for j in range(3 if is_all else 0):
        for k in range(6):
            room.by_move[w, j, k] += moves[3 + j, k]
    if is_all:
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


@borrowing
def _spread_by_speed(table: TouchTable, w: int, S: Floats, room: TouchRoom, slopes: Floats) -> None:
    """Adds ∂(Jᵀ f)/∂v of a couple (`_spread`)."""
    G, by_speed = room.by_speed[w], room.motions[4]
    first, last, n = table.starts[w], table.starts[w + 1], table.carries.shape[0]
    for b in range(first, last):
        j, s = table.chain[b], table.signs[b]
        for k in range(6):
            by_speed[k] = 0.0
        for m in range(6):
            for k in range(6):
                by_speed[k] += s * G[m, k] * S[j, m]
        for a in range(first, last):
            slopes[table.chain[a], n + j] += table.signs[a] * power(S[table.chain[a]], by_speed)
