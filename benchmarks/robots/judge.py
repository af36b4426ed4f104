"""What becomes of a control: a simulation of the equations of `mechanics`, and what it costs.

The classic Runge-Kutta method, in steps that end where a wall is hit. Where walls are rigid, a hit
is Newton's: of the walls S that are touched,

    M (v⁺ − v⁻) = J_Sᵀ p,    J_S v⁺ = −e J_S v⁻,    p ≥ 0;

what leaves a wall more slowly than `_REST` stays on it, until the wall would have to pull. Walls
that yield push by their stiffness times the depth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from benchmarks.robots.mechanics import Tables, make_tables, write_tables
from benchmarks.robots.setting import Setting, Weights, setting_of
from drake_aigto.kernels import inner, kernel
from drake_aigto.world import Scenario

# How far out of a range, or off a hard goal, what counts as a solution may be: 1 % of the range, as
# costs count as the same within 1 %.
LARGEST_EXCESS = 0.01
# Steps [s]: 1/1400 of a cart-pole's period at a soft wall; and where nothing is stiff.
_SOFT_STEP, _STEP = 1e-4, 5e-4
_REST = 1e-4  # [m/s]
_THICKNESS = 1e-10  # of a wall [m]: rounding
_MOST_TOUCHES = 500


class Control(NamedTuple):
    """A control that is held between times."""

    times: np.ndarray  # (L + 1,) [s]
    values: np.ndarray  # (L, nu) [N, N m]

    @classmethod
    def even(cls, values: np.ndarray, duration: float) -> Control:
        """Returns a control that is held for equal times."""
        return cls(np.linspace(0.0, duration, len(values) + 1), values)


class Judgment(NamedTuple):
    """What becomes of a control."""

    cost: float  # J
    excess: float  # how far it leaves its ranges or misses a hard goal, in parts of the range
    touches: int  # of rigid walls

    @property
    def score(self) -> float:
        """J of what stays where it may, else infinite."""
        return self.cost if self.excess <= LARGEST_EXCESS else np.inf


class Law(NamedTuple):
    """What moves, and what it costs."""

    number: int  # of the mechanism
    wall: float
    stiffness: float  # 0: rigid
    restitution: float
    weights: Weights


def judge(scenario: Scenario, control: Control) -> Judgment:
    """Returns what becomes of a control, which is clipped to its bounds and to the duration."""
    setting = setting_of(scenario)
    mechanism, values = setting.mechanism, np.asarray(control.values, dtype=float)
    values = np.clip(values, -mechanism.force, mechanism.force)
    norms = np.linalg.norm(values, axis=1, keepdims=True)
    values = values * np.minimum(1.0, setting.norm / np.maximum(norms, 1e-9))
    law = Law(
        mechanism.number, mechanism.wall, setting.stiffness, setting.restitution, setting.weights
    )
    times = np.minimum(control.times, setting.duration)
    times[-1] = setting.duration
    longest = _SOFT_STEP if setting.stiffness else _STEP
    tables = make_tables(mechanism)
    end, cost, extremes, touches = simulate(law, tables, setting.start, times, values, longest)
    excess = find_excess(setting, end, extremes)
    return Judgment(cost if np.isfinite(cost) else np.inf, excess, touches)


def find_excess(setting: Setting, end: np.ndarray, extremes: np.ndarray) -> float:
    """Returns how far a motion leaves its ranges or misses a hard goal, in parts of the range."""
    (low, high), (least, most) = setting.ranges, extremes
    worst = np.max(np.maximum(low - least, most - high) / setting.units, initial=0.0)
    if setting.is_hard:
        goal = setting.weights.goal
        worst = max(worst, np.abs(end[: goal.size] - goal).max())
    return float(worst)


@inner
def _solve(a: np.ndarray, b: np.ndarray, size: int) -> None:
    """Solves a x = b in place, by elimination with pivots."""
    for k in range(size):
        pivot = k
        for i in range(k + 1, size):
            if abs(a[i, k]) > abs(a[pivot, k]):
                pivot = i
        for j in range(k, size):
            a[k, j], a[pivot, j] = a[pivot, j], a[k, j]
        b[k], b[pivot] = b[pivot], b[k]
        for i in range(k + 1, size):
            part = a[i, k] / a[k, k]
            for j in range(k, size):
                a[i, j] -= part * a[k, j]
            b[i] -= part * b[k]
    for k in range(size - 1, -1, -1):
        for j in range(k + 1, size):
            b[k] -= a[k, j] * b[j]
        b[k] /= a[k, k]


@inner
def _solve_on_walls(out: Tables, on: np.ndarray, a: np.ndarray, b: np.ndarray) -> None:
    """Solves M x = b₁ + J_Sᵀ p, J_S x = b₂; b has x, and p of each wall, 0 of those not in S.

    b₂ stands at its wall's place behind b₁.
    """
    n, m = out.force.size, on.size
    a[:] = 0.0
    for i in range(n):
        for j in range(n):
            a[i, j] = out.mass[i, j]
    for k in range(m):
        if on[k]:
            for j in range(n):
                a[j, n + k] = -out.normal[k, j]
                a[n + k, j] = out.normal[k, j]
        else:
            a[n + k, n + k], b[n + k] = 1.0, 0.0
    _solve(a, b, n + m)


@inner
def _slope(
    law: Law,
    out: Tables,
    x: np.ndarray,
    u: np.ndarray,
    on: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    rate: np.ndarray,
) -> None:
    """Writes the rates of q, v and the cost; b ends with what the walls push with."""
    n, w = out.force.size, law.weights
    write_tables(law.number, x[:n], x[n : 2 * n], u, law.wall, out)
    for i in range(n):
        b[i] = out.force[i]
    for k in range(on.size):
        b[n + k] = -out.curve[k]
        if law.stiffness > 0.0 and out.gap[k] < 0.0:
            for i in range(n):
                b[i] -= law.stiffness * out.gap[k] * out.normal[k, i]
    _solve_on_walls(out, on, a, b)
    rate[2 * n] = 0.0
    for i in range(n):
        rate[i], rate[n + i] = x[n + i], b[i]
        rate[2 * n] += w.position[i] * _square(w, x, i)
        rate[2 * n] += w.velocity[i] * (x[n + i] - w.goal_velocity[i]) ** 2
    for i in range(u.size):
        rate[2 * n] += w.control[i] * u[i] ** 2


@inner
def _square(w: Weights, x: np.ndarray, i: int) -> float:
    """Returns the square of a position's error."""
    error = x[i] - w.goal[i]
    return 2.0 - 2.0 * np.cos(error) if w.is_chordal[i] else error * error


@inner
def _step(
    law: Law,
    out: Tables,
    x: np.ndarray,
    u: np.ndarray,
    on: np.ndarray,
    step: float,
    a: np.ndarray,
    b: np.ndarray,
    rates: np.ndarray,
    y: np.ndarray,
) -> None:
    """Writes the state a step later into y, and the gaps there."""
    _slope(law, out, x, u, on, a, b, rates[0])
    for k in range(1, 4):
        part = step if k == 3 else step / 2
        for i in range(x.size):
            y[i] = x[i] + part * rates[k - 1, i]
        _slope(law, out, y, u, on, a, b, rates[k])
    for i in range(x.size):
        middle = rates[1, i] + rates[2, i]
        y[i] = x[i] + step / 6 * (rates[0, i] + 2 * middle + rates[3, i])
    n = out.force.size
    write_tables(law.number, y[:n], y[n : 2 * n], u, law.wall, out)


@inner
def _find_hit(law: Law, out: Tables, on: np.ndarray) -> int:
    """Returns the wall that is deepest entered, of those that it isn't on; -1 if none."""
    deepest = -1
    for k in range(on.size):
        is_in = law.stiffness == 0.0 and not on[k] and out.gap[k] < -_THICKNESS
        if is_in and (deepest < 0 or out.gap[k] < out.gap[deepest]):
            deepest = k
    return deepest


@inner
def _calc_rate(law: Law, out: Tables, x: np.ndarray, u: np.ndarray, wall: int) -> float:
    """Returns how fast a wall's gap grows [m/s], and leaves the tables of that state."""
    n, rate = out.force.size, 0.0
    write_tables(law.number, x[:n], x[n : 2 * n], u, law.wall, out)
    for i in range(n):
        rate += out.normal[wall, i] * x[n + i]
    return rate


@inner
def _find_bottom(
    law: Law,
    out: Tables,
    x: np.ndarray,
    u: np.ndarray,
    on: np.ndarray,
    step: float,
    a: np.ndarray,
    b: np.ndarray,
    rates: np.ndarray,
    y: np.ndarray,
) -> float:
    """Returns when a wall is deepest entered that is left again within a step, else its end."""
    for k in range(on.size):
        if law.stiffness > 0.0 or on[k]:
            continue
        rate = _calc_rate(law, out, x, u, k)
        # Where something lets go, it is at the wall but for rounding, and enters nothing.
        if out.gap[k] < 0.0 or out.gap[k] + step * rate >= -_THICKNESS:
            continue
        low, high = 0.0, step
        for _ in range(50):
            middle = (low + high) / 2
            _step(law, out, x, u, on, middle, a, b, rates, y)
            if _calc_rate(law, out, y, u, k) < 0.0:
                low = middle
            else:
                high = middle
        _step(law, out, x, u, on, low, a, b, rates, y)
        if _find_hit(law, out, on) >= 0:
            return low
    return step


@inner
def _release(
    law: Law,
    out: Tables,
    x: np.ndarray,
    u: np.ndarray,
    on: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    rate: np.ndarray,
) -> None:
    """Leaves walls that would have to pull."""
    n = out.force.size
    while np.any(on):
        _slope(law, out, x, u, on, a, b, rate)
        least = np.argmin(b[n:])
        if b[n + least] >= 0.0:
            return
        on[least] = False


@inner
def _hit(
    law: Law,
    out: Tables,
    x: np.ndarray,
    u: np.ndarray,
    on: np.ndarray,
    wall: int,
    a: np.ndarray,
    b: np.ndarray,
) -> None:
    """Changes velocities as an impact does, and says which walls it stays on."""
    n = out.force.size
    write_tables(law.number, x[:n], x[n : 2 * n], u, law.wall, out)
    before = out.normal @ x[n : 2 * n]
    on[wall] = True
    while np.any(on):
        for i in range(n):
            b[i] = 0.0
            for j in range(n):
                b[i] += out.mass[i, j] * x[n + j]
        for k in range(on.size):
            b[n + k] = -law.restitution * before[k]
        _solve_on_walls(out, on, a, b)
        least = np.argmin(b[n:])
        if b[n + least] >= 0.0:
            for i in range(n):
                x[n + i] = b[i]
            break
        on[least] = False
    for k in range(on.size):
        on[k] = on[k] and -law.restitution * before[k] < _REST


@kernel
def simulate(
    law: Law,
    out: Tables,
    start: np.ndarray,
    times: np.ndarray,
    controls: np.ndarray,
    longest: float,
) -> tuple[np.ndarray, float, np.ndarray, int]:
    """Returns q and v at the end (2n,), J, the least and most of q and v (2, 2n), and touches.

    Args:
        law: what moves.
        out: room for its tables.
        start: q and v (2n,).
        times: (L + 1,) [s].
        controls: (L, nu).
        longest: step [s].
    """
    n, m = out.force.size, out.gap.size
    extremes = np.empty((2, 2 * n))
    x, y, b = np.zeros(2 * n + 1), np.zeros(2 * n + 1), np.zeros(n + m)
    a, rates, on = np.zeros((n + m, n + m)), np.zeros((4, 2 * n + 1)), np.zeros(m, dtype=np.bool_)
    touches = 0
    for i in range(2 * n):
        x[i] = extremes[0, i] = extremes[1, i] = start[i]
    for k in range(controls.shape[0]):
        u, held = controls[k], times[k + 1] - times[k]
        steps = max(1, int(np.ceil(held / longest - 1e-9)))
        for _ in range(steps):
            left = held / steps
            while left > 0.0 and touches <= _MOST_TOUCHES:
                _release(law, out, x, u, on, a, b, rates[0])
                bottom = _find_bottom(law, out, x, u, on, left, a, b, rates, y)
                _step(law, out, x, u, on, bottom, a, b, rates, y)
                if _find_hit(law, out, on) < 0:
                    x[:] = y
                    break
                low, high = 0.0, bottom
                for _ in range(50):
                    middle = (low + high) / 2
                    _step(law, out, x, u, on, middle, a, b, rates, y)
                    if _find_hit(law, out, on) < 0:
                        low = middle
                    else:
                        high = middle
                _step(law, out, x, u, on, high, a, b, rates, y)
                wall = _find_hit(law, out, on)
                _step(law, out, x, u, on, low, a, b, rates, y)
                x[:] = y
                _hit(law, out, x, u, on, wall, a, b)
                left, touches = left - low, touches + 1
            for i in range(2 * n):
                extremes[0, i] = min(extremes[0, i], x[i])
                extremes[1, i] = max(extremes[1, i], x[i])
    cost, w = x[2 * n], law.weights
    for i in range(n):
        cost += w.final_position[i] * _square(w, x, i)
        cost += w.final_velocity[i] * (x[n + i] - w.goal_velocity[i]) ** 2
    return x[: 2 * n], cost if touches <= _MOST_TOUCHES else np.inf, extremes, touches
