"""Bodies that touch in space: forces of all pairs of shapes, and their derivatives, compiled.

The law is Drake's, of continuous point contact:

    f_n = k x (1 + d ẋ)₊,    x = (−φ)₊,    ẋ = −φ̇,    f = f_n (n − μ σ(‖v_t‖ / v_s) v_t / ‖v_t‖)

acts on A at C = (p_A + p_B)/2, and −f on B: n is the normal from B to A, p_A and p_B are witness
points, v = v_A − v_B is the relative velocity of the material at C, φ̇ = n · v, v_t = v − φ̇ n, and σ
that of `calc_friction_share`. While a search is on, φ is known to a width w = ε × share (logistic
noise), v_t to a speed ε / T, and springs that are wide are soft:

    x = w log(1 + exp(−φ / w)),    k min(1, g / w) for k,    v_s² + (ε / T)² for v_s²

which is the law itself at ε = 0. With k from afar, light bodies would be thrown.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.geometry import (
    Closest,
    Shapes,
    find_closest,
    is_apart,
    make_closest,
    place_shapes,
)
from drake_aigto.kernels import inner, kernel

# Columns of `TouchTable.law`.
STIFFNESS, DISSIPATION, FRICTION, STICTION, SHARE, GIVE = range(6)
# Beyond this many widths ε a depth is below e⁻³² ε: no contact.
_FAR = 32.0


class TouchTable(NamedTuple):
    """Pairs of shapes that may touch, P of them, on the bodies of a tree with n velocities."""

    shapes: Shapes
    pairs: Ints  # shapes A and B of each, A's kind the lower number, shape (P, 2)
    law: Floats  # k [N/m], d [s/m], μ, v_s [m/s], share, g [m] of each pair, shape (P, 6)
    # Degrees of freedom that move A or B but not both; of pair i from starts[i] to starts[i + 1].
    starts: Ints  # shape (P + 1,)
    chain: Ints
    signs: Floats  # 1 for A, −1 for B
    carries: Bools  # whether degree of freedom j moves the axis of i, [j, i], shape (n, n)


class TouchRoom(NamedTuple):
    """Room for an evaluation of all pairs."""

    rotations: Floats  # of shapes in the world, shape (G, 3, 3)
    places: Floats  # of the same, shape (G, 3) [m]
    closest: Closest  # of one pair
    J: Floats  # velocities of the material at C by each of a chain's, shape (n, 3)
    vectors: Floats  # v, f, f / f_n, and others, shape (12, 3)
    found: Floats  # φ, f_n, and C, of each pair, shape (P, 5); f_n is 0 of pairs that do not touch
    spare: Floats  # a force that nobody reads, shape (n,)


def make_touch_room(table: TouchTable) -> TouchRoom:
    """Returns room for an evaluation."""
    G, n = len(table.shapes.kinds), len(table.carries)
    sizes = (n, 3), (12, 3), (len(table.pairs), 5), (n,)
    rooms = [np.zeros(size) for size in sizes]
    return TouchRoom(np.zeros((G, 3, 3)), np.zeros((G, 3)), make_closest(), *rooms)


@inner
def cross(a: Floats, b: Floats, out: Floats) -> None:
    """Computes a × b."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@inner
def dot(a: Floats, b: Floats) -> float:
    """Returns a · b."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@inner
def meet(table: TouchTable, pair: int, reach: float, room: TouchRoom) -> bool:
    """Computes what is closest of a pair, unless it is farther apart than a reach [m]."""
    shapes, (a, b) = table.shapes, (table.pairs[pair, 0], table.pairs[pair, 1])
    kinds, bounds = (shapes.kinds[a], shapes.kinds[b]), (shapes.bounds[a], shapes.bounds[b])
    Ra, pa, Rb, pb = room.rotations[a], room.places[a], room.rotations[b], room.places[b]
    if is_apart(kinds, bounds, Ra, pa, Rb, pb, reach):
        return False
    find_closest(kinds[0], Ra, pa, shapes.sizes[a], kinds[1], Rb, pb, shapes.sizes[b], room.closest)
    return bool(room.closest.numbers[0] < reach)


@inner
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


@inner
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
    for pair in range(table.pairs.shape[0]):
        room.found[pair, 1] = 0.0
        if meet(table, pair, _FAR * eps * table.law[pair, SHARE], room):
            _push_pair(table, pair, S, v, eps, pace, has_slopes, room, force, slopes)


@inner
def _push_pair(
    table: TouchTable, pair: int, S: Floats, v: Floats, eps: float, pace: float, has_slopes: bool,
    room: TouchRoom, force: Floats, slopes: Floats,
) -> None:  # fmt: skip
    """Adds the same of one pair, whose closest points are known."""
    law, near, found, J = table.law[pair], room.closest, room.found[pair], room.J
    speed, f, unit = room.vectors[0], room.vectors[1], room.vectors[2]
    first, last, n = table.starts[pair], table.starts[pair + 1], near.n
    distance, swap = near.numbers[0], near.numbers[1]
    C = found[2:]
    for k in range(3):
        C[k] = near.foot[k] + distance * n[k] / 2
        speed[k] = 0.0
    for a in range(first, last):
        i, s, row = table.chain[a], swap * table.signs[a], J[a - first]
        cross(S[i], C, row)
        for k in range(3):
            row[k] += S[i, 3 + k]
            speed[k] += s * row[k] * v[i]
    width = eps * law[SHARE]
    rate, (depth, by_distance) = dot(n, speed), find_depth(distance, width)
    stiffness, brake = law[STIFFNESS], 1.0 - law[DISSIPATION] * rate
    if width > law[GIVE]:
        stiffness *= law[GIVE] / width
    normal = stiffness * depth * brake
    if normal <= 0.0 or brake <= 0.0:
        return
    found[0], found[1] = distance, normal
    slip = np.sqrt(max(dot(speed, speed) - rate * rate, 0.0))
    slow = np.sqrt(law[STICTION] ** 2 + (eps * pace) ** 2)
    drag, bend = _rub(slip / slow)
    drag, bend = law[FRICTION] * drag / slow, law[FRICTION] * bend / slow**3
    for k in range(3):  # f = f_n · unit
        unit[k] = n[k] - drag * (speed[k] - rate * n[k])
        f[k] = normal * unit[k]
    for a in range(first, last):
        force[table.chain[a]] += swap * table.signs[a] * dot(J[a - first], f)
    if has_slopes:
        by_rate = -stiffness * depth * law[DISSIPATION]
        law_slopes = stiffness * by_distance * brake, by_rate, normal, drag, bend
        _differentiate(table, pair, S, v, rate, law_slopes, room, slopes)


@inner
def _rub(y: float) -> tuple[float, float]:
    """Returns h = σ(y)/y and h′/y, of a slip in parts of the stiction speed."""
    if y < 1.0:
        return y * y * (10.0 - 15.0 * y + 6.0 * y * y), 20.0 - 45.0 * y + 24.0 * y * y
    return 1.0 / y, -1.0 / (y * y * y)


@inner
def _differentiate(
    table: TouchTable, pair: int, S: Floats, v: Floats, rate: float,
    law_slopes: tuple[float, float, float, float, float], room: TouchRoom, slopes: Floats,
) -> None:  # fmt: skip
    """Adds ∂(Jᵀ f)/∂(q, v) of a pair.

    As velocity j moves its body by S_j, the axis S_i of velocities that it carries turns with it, C
    moves by δC, and so

        δJ_i = ω_i × δC + (ω_j × J_i − ω_i × J_j  if j carries i)
    """
    near, J, vectors, n = room.closest, room.J, room.vectors, table.carries.shape[0]
    f, moved, beyond, turn, df = vectors[1], vectors[3], vectors[4], vectors[5], vectors[6]
    dC, dn, dv, carried, lever = (vectors[7], vectors[8], vectors[9], vectors[10], vectors[11])
    first, last, swap = table.starts[pair], table.starts[pair + 1], near.numbers[1]
    for k in range(3):
        turn[k] = 0.0
    for a in range(first, last):
        i = table.chain[a]
        for k in range(3):
            turn[k] += swap * table.signs[a] * S[i, k] * v[i]
    for b in range(first, last):
        j, s, row = table.chain[b], swap * table.signs[b], J[b - first]
        distance = s * dot(near.n, row)
        _move_witness(S[j], s, near, vectors)
        for k in range(3):
            dC[k] += (distance * near.n[k] + near.numbers[0] * dn[k]) / 2
            moved[k] = beyond[k] = 0.0
        for a in range(first, last):  # Sums of v J and v ω that j carries.
            i = table.chain[a]
            if table.signs[a] == table.signs[b] and table.carries[j, i]:
                for k in range(3):
                    moved[k] += s * v[i] * J[a - first, k]
                    beyond[k] += s * v[i] * S[i, k]
        cross(turn, dC, dv)
        cross(S[j], moved, carried)
        cross(beyond, row, lever)
        for k in range(3):
            dv[k] += carried[k] - lever[k]
        _change_force(distance, rate, law_slopes, near.n, True, vectors)
        # f · δJ_i = ω_i · (δC × f) + J_i · (f × ω_j) − ω_i · (J_j × f)
        cross(dC, f, moved)
        cross(f, S[j], carried)
        cross(row, f, lever)
        for a in range(first, last):
            i, side, total = table.chain[a], swap * table.signs[a], 0.0
            for k in range(3):
                total += J[a - first, k] * df[k] + S[i, k] * moved[k]
            if table.signs[a] == table.signs[b] and table.carries[j, i]:
                total += dot(J[a - first], carried) - dot(S[i], lever)
            slopes[i, j] += side * total
        for k in range(3):
            dv[k] = s * row[k]
        _change_force(0.0, rate, law_slopes, near.n, False, vectors)
        for a in range(first, last):
            side = swap * table.signs[a]
            slopes[table.chain[a], n + j] += side * dot(J[a - first], df)


@inner
def _move_witness(S: Floats, side: float, near: Closest, vectors: Floats) -> None:
    """Computes δn and δ(foot), as A (side 1) or B (−1) moves by S."""
    moved, foot, dn = vectors[3], vectors[7], vectors[8]
    cross(S, near.c, moved)
    for k in range(3):
        moved[k] += S[3 + k]
    for i in range(3):
        dn[i] = side * (dot(near.by_place[i], moved) + dot(near.by_turn[i], S))
        foot[i] = side * (dot(near.foot_by_place[i], moved) + dot(near.foot_by_turn[i], S))
    if side < 0.0:
        cross(S, near.n, moved)
        for i in range(3):
            dn[i] += moved[i]
        cross(S, near.foot, moved)
        for i in range(3):
            foot[i] += moved[i] + S[3 + i]


@inner
def _change_force(
    distance: float, rate: float, law_slopes: tuple[float, float, float, float, float], n: Floats,
    turns: bool, vectors: Floats,
) -> None:  # fmt: skip
    """Computes δf for δφ, δn (if n turns) and δv, which are in the vectors."""
    by_distance, by_rate, normal, drag, bend = law_slopes
    speed, unit, df, dn, dv = vectors[0], vectors[2], vectors[6], vectors[8], vectors[9]
    change = dot(n, dv) + (dot(speed, dn) if turns else 0.0)  # of φ̇
    # Half of δ‖v_t‖², of which φ̇ δn is a part.
    along = 0.0
    for k in range(3):
        slip = speed[k] - rate * n[k]
        along += slip * (dv[k] - (rate * dn[k] if turns else 0.0))
    more = by_distance * distance + by_rate * change
    for k in range(3):
        slip = speed[k] - rate * n[k]
        slid = dv[k] - change * n[k] - (rate * dn[k] if turns else 0.0)
        df[k] = more * unit[k] - normal * (drag * slid + bend * along * slip)
        if turns:
            df[k] += normal * dn[k]


@kernel
def evaluate_push(
    table: TouchTable, poses: Floats, S: Floats, v: Floats,
    eps: float, pace: float, has_slopes: bool, room: TouchRoom, force: Floats, slopes: Floats,
) -> None:  # fmt: skip
    """Does what `push` does, for Python."""
    push(table, poses, S, v, eps, pace, has_slopes, room, force, slopes)
