"""Impacts, rest and release on rigid walls, exactly, while accelerations are constant.

A moment is a time in which v̇ without contact is constant: the whole of a control's interval where
flight is a parabola, or an instant of any mechanism. Events in it are found by roots.

With e < 1 a constant push makes infinitely many impacts in finite time. So the n-th impact at a
contact becomes rest if the hop after it would last less than τ = 1e-6 n T. Pressed by an
acceleration a, that drops a speed of at most a τ/2 and a height of a τ²/8. An impact no faster than
that speed is a touch, and not recorded. Bodies that collapse onto each other without a push stay
together after a thousand impacts within a millionth of T.

Letters as in `ContactMotion`. Wherever they are arguments, walls are all contacts, a phase becomes
the one at the end, an acceleration is v̇ without contact, shape (nv,) [m/s²], a log has one row for
each impact (`make_log`), and still is how fast a contact at rest may seem to move [m/s].
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.contact import Walls, add, calc_time_to_wall, dot, find_size, support
from drake_aigto.kernels import inner, kernel

# Times are parts of the simulated duration T.

# The n-th impact at a contact becomes rest if the hop after it would last less than n times this.
# No more than √(2 / SHORTEST_HOP) ≈ 1,400 hops fit into T then: no Zeno sequence can hang.
SHORTEST_HOP = 1e-6
# This many impacts within this part of T are a collapse, infinitely many: then all that touch stay
# together.
MOST_IMPACTS = 1000
_COLLAPSE = 1e-6
# Impact and rest leave this much air, relative to the largest position or 1 m, so that rounding
# does not put the ball inside.
_AIR = 1e-14
# Rates of a contact at rest below this are rounding, relative to the largest velocity or 1 m/s.
_STILL = 1e-13
# The sum of forces on a contact at rest that is not surely a pull, relative to the accelerations.
_PULLED = 1e-13

# Columns of a log of impacts, before those of q, v and v after it.
TIME, CONTACT, SPEED, PUSH, STATE = range(5)


class HybridState(NamedTuple):
    """The state of a hybrid system, changed in place."""

    q: Floats  # shape (nq,) [m]
    v: Floats  # shape (nv,) [m/s]
    resting: Bools  # which contacts it rests on, shape (m,)
    counts: Floats  # how many impacts each contact had, shape (m,)


def start_phase(state: tuple[Floats, Floats], num_contacts: int) -> HybridState:
    """Returns a state (q, v) at rest on nothing."""
    q, v = np.array(state)
    return HybridState(q, v, np.zeros(num_contacts, dtype=bool), np.zeros(num_contacts))


def copy_phase(phase: HybridState) -> HybridState:
    """Returns a copy, as compiled code changes phases in place."""
    q, v, resting, counts = phase
    return HybridState(q.copy(), v.copy(), resting.copy(), counts.copy())


class Rules(NamedTuple):
    """Rules by which impacts end."""

    restitutions: Floats  # e of each contact, in [0, 1], shape (m,)
    duration: float  # T, how long will be simulated [s]


def make_log(most: int, num_positions: int) -> Floats:
    """Returns a log that has room for a number of impacts; those beyond are counted only."""
    return np.empty((most, STATE + 3 * num_positions))


@inner
def run(
    walls: Walls,
    rules: Rules,
    phase: HybridState,
    acceleration: Floats,
    end: float,
    left: float,
    stops: bool,
    log: Floats,
    logged: int,
) -> int:
    """Change a phase to what it is at the end of a moment; return how many impacts are logged then.

    Impacts are one by one, each where and when the parabolas between them say. If several contacts
    are touched at once, in a corner or by bodies in a row, they take turns until none is approached
    any more, in the order of the world's contacts. That is exact, and the order does not matter,
    where J_i M⁻¹ J_jᵀ = 0.

    The moment ends at `end` and lasts for `left` [s], or ends with the first impact if it `stops`
    there.
    """
    q, v, resting, _ = phase
    m = resting.size
    supported, curves, touched = acceleration.copy(), np.empty((m, 3)), resting.copy()
    burst, burst_left = 0, math.inf
    pulled = _PULLED * find_size(acceleration)
    while True:
        support(walls, resting, acceleration, supported)
        calc_curves(walls, q, v, supported, curves)
        for i in range(m):
            resting[i] = resting[i] and curves[i, 2] <= pulled
        still = _STILL * find_size(v)
        wait, contact, slides = _find_event(walls.firsts, resting, curves, still, left)
        if contact < 0:
            break
        fly(q, v, supported, wait)
        left -= wait
        resting[contact] = False
        if slides:
            _slide_off(walls, q, resting, contact)
        else:
            support(walls, resting, acceleration, supported)
            hits = _hit(walls, rules, phase, supported, end - left, contact, log, logged)
            logged += hits
            if stops and hits > 0:
                end, left = end - left, 0.0
            if burst == 0 or burst_left - left > _COLLAPSE * rules.duration:
                burst, burst_left = 0, left
                for i in range(m):
                    touched[i] = False
            touched[contact] = True
            burst += 1
            if burst == MOST_IMPACTS:
                burst = 0
                # What touches stays together: an impact that returns nothing.
                for i in range(m):
                    resting[i] = resting[i] or touched[i]
                support(walls, resting, v, v)
                _release(walls.jacobian, v, resting)
    fly(q, v, supported, left)
    _settle(walls, q, v, resting)
    return logged


@inner
def fly(q: Floats, v: Floats, acceleration: Floats, time: float) -> None:
    """Move q and v along their parabola, by a time that may be negative."""
    for k in range(q.size):
        later = v[k] + time * acceleration[k]
        q[k] += time / 2 * (v[k] + later)
        v[k] = later


@inner
def calc_curves(walls: Walls, q: Floats, v: Floats, acceleration: Floats, curves: Floats) -> None:
    """Write φ, φ̇ and φ̈ of each contact, shape (m, 3)."""
    jacobian, offset, _, _ = walls
    for i in range(offset.size):
        distance, rate, push = offset[i], 0.0, 0.0
        for k in range(q.size):
            distance += jacobian[i, k] * q[k]
            rate += jacobian[i, k] * v[k]
            push += jacobian[i, k] * acceleration[k]
        curves[i, 0], curves[i, 1], curves[i, 2] = distance, rate, push


@inner
def _find_event(
    firsts: Ints, resting: Bools, curves: Floats, still: float, horizon: float
) -> tuple[float, int, bool]:
    """Find what happens first if φ̈ is constant: when [s], where, and if the ball slides off.

    The contact is −1 if nothing happens within the horizon [s]. A contact at rest that others push
    in is touched at once. From a contact that is rested on the ball slides off where it comes in
    front of another face of the same solid.
    """
    wait, contact, slides = horizon, -1, False
    for solid in range(firsts.size - 1):
        first, last = firsts[solid], firsts[solid + 1]
        is_held = False
        for i in range(first, last):
            is_held = is_held or resting[i]
        if not is_held:
            until, face = _find_entry(curves, first, last, still, wait)
            if face >= 0 and (until < wait or contact < 0):
                wait, contact, slides = until, face, False
            continue
        for i in range(first, last):
            distance, rate, push = curves[i]
            if resting[i]:
                if rate < -still and (wait > 0 or contact < 0):
                    wait, contact, slides = 0.0, i, False
            else:
                until = calc_time_to_wall(max(-distance, 0.0), -rate, -push)
                if until < wait:
                    wait, contact, slides = until, i, True
    return wait, contact, slides


@inner
def _find_entry(
    curves: Floats, first: int, last: int, still: float, horizon: float
) -> tuple[float, int]:
    """Find when a solid is entered: as one of its faces is passed, the others behind.

    One that the ball is at, inside but for rounding, is entered at the face that is nearest.

    Returns:
        How long until then [s], and the face; −1 if never within the horizon.
    """
    if not _may_enter(curves, first, last, horizon):
        return math.inf, -1
    wait, passed = 0.0, -1
    # Each face is passed once at most: what rises from it again never comes back.
    for _ in range(first, last):
        face, height = -1, 0.0 if passed >= 0 else -math.inf
        for i in range(first, last):
            there = curves[i, 0] + wait * (curves[i, 1] + wait / 2 * curves[i, 2])
            if i != passed and there > height:
                face, height = i, there
        if face < 0:
            break
        distance, rate, push = curves[face, 0], curves[face, 1], curves[face, 2]
        if distance <= 0 and wait == 0:
            if rate >= -still and push >= 0:
                return math.inf, -1
            distance = 0.0
        if distance < 0 and rate < 0:  # It rises past 0 before, and never falls again.
            return math.inf, -1
        wait, passed = calc_time_to_wall(distance, rate, push), face
        if wait > horizon:
            return math.inf, -1
    return wait, passed


@inner
def _may_enter(curves: Floats, first: int, last: int, horizon: float) -> bool:
    """Return False only if the ball stays in front of one of these faces for that long."""
    for i in range(first, last):
        if curves[i, 0] > horizon * (abs(curves[i, 1]) + horizon / 2 * abs(curves[i, 2])):
            return False
    return True


@inner
def may_touch(firsts: Ints, resting: Bools, curves: Floats, horizon: float) -> bool:
    """Return False only if the ball is in free flight and touches nothing for that long."""
    found = False
    for i in range(resting.size):
        found = found or resting[i]
    for solid in range(firsts.size - 1):
        found = found or _may_enter(curves, firsts[solid], firsts[solid + 1], horizon)
    return found


@inner
def _slide_off(walls: Walls, q: Floats, resting: Bools, contact: int) -> None:
    """End rest on the solid of a face that the ball has come in front of."""
    firsts = walls.firsts
    for solid in range(firsts.size - 1):
        if firsts[solid] <= contact < firsts[solid + 1]:
            for i in range(firsts[solid], firsts[solid + 1]):
                resting[i] = False
    _lift(walls, q, contact)


@inner
def _lift(walls: Walls, q: Floats, contact: int) -> None:
    """Move the ball from wherever it is to a hair above a face."""
    distance = dot(walls.jacobian, contact, q) + walls.offset[contact]
    add(q, _AIR * find_size(q) - distance, walls.lifts, contact)


@inner
def _hit(
    walls: Walls,
    rules: Rules,
    phase: HybridState,
    others: Floats,
    time: float,
    contact: int,
    log: Floats,
    logged: int,
) -> int:
    """Apply an impact, or bring the contact to rest, given v̇ with the other contacts at rest.

    Returns:
        1 for an impact, 0 for a touch.
    """
    q, v, resting, counts = phase
    jacobian, lifts, n = walls.jacobian, walls.lifts, v.size
    push = dot(jacobian, contact, others)
    speed = max(0.0, -dot(jacobian, contact, v))
    e = rules.restitutions[contact]
    counts[contact] += 1
    shortest_hop = SHORTEST_HOP * rules.duration * counts[contact]
    is_impact = 2 * speed > shortest_hop * abs(push)
    is_logged = is_impact and logged < log.shape[0]
    if is_logged:
        log[logged, TIME], log[logged, CONTACT] = time, contact
        log[logged, SPEED], log[logged, PUSH] = speed, push
        for k in range(n):
            log[logged, STATE + k], log[logged, STATE + n + k] = q[k], v[k]
            after = v[k] + (1 + e) * speed * lifts[contact, k]
            log[logged, STATE + 2 * n + k] = after
    rests = 2 * e * speed <= -shortest_hop * push
    add(v, speed if rests else (1 + e) * speed, lifts, contact)
    _release(jacobian, v, resting)
    resting[contact] = rests
    return 1 if is_impact else 0


@inner
def _release(jacobian: Floats, v: Floats, resting: Bools) -> None:
    """End rest at what the ball moves away from."""
    still = _STILL * find_size(v)
    for i in range(resting.size):
        resting[i] = resting[i] and dot(jacobian, i, v) <= still


@kernel
def advance(
    walls: Walls,
    rules: Rules,
    phase: HybridState,
    acceleration: Floats,
    end: float,
    left: float,
    stops: bool,
    log: Floats,
) -> int:
    """`run` one moment from Python, and return how many impacts there were."""
    return run(walls, rules, phase, acceleration, end, left, stops, log, 0)


@inner
def _settle(walls: Walls, q: Floats, v: Floats, resting: Bools) -> None:
    """Take rounding out: no ball is inside, those at rest are at the wall and stay there."""
    jacobian, offset, lifts, firsts = walls
    for solid in range(firsts.size - 1):
        nearest, height = -1, -math.inf
        for i in range(firsts[solid], firsts[solid + 1]):
            distance = dot(jacobian, i, q) + offset[i]
            # One that is rested on counts, wherever rounding put the ball.
            if distance > height or resting[i]:
                nearest, height = i, -math.inf if resting[i] else distance
            if resting[i]:
                break
        if height < _AIR * find_size(q):
            _lift(walls, q, nearest)
    for i in range(resting.size):
        if resting[i]:
            add(v, -dot(jacobian, i, v), lifts, i)
