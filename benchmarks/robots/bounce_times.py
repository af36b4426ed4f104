"""The optima of the pendulum and its wall, by a fine search over when it bounces and how fast.

Between touches u = θ̈ + g sin θ, so a flight is least squares in θ at equal knots:

    A(θ₀, ω₀, θ₁, ω₁, τ) = min ∫ (θ̈ + g sin θ)² dt,    θ(0), θ̇(0), θ(τ), θ̇(τ) given

and the last one, whose end is free, has w (θ − goal)²/R besides. Dynamic programming over touches
finds the least sum of flights by the number of touches and by the first one, at times and speeds
on a grid; its least local minima are polished, all times and speeds together. A touch without
speed grazes; a flight beyond the wall is none. Pontryagin's principle is not used: it led to the
same optima. The wall's upper side, beyond the hinge, bounds flights, but none bounces there.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from benchmarks.robots.judge import Control
from benchmarks.robots.worlds import Question, setting_of
from drake_aigto.kernels import inner, kernel

_GRAVITY = 9.81  # [m/s²]
_WALL, _BEYOND = -np.pi / 6, 7 * np.pi / 6  # θ at both sides of the same wall [rad]
# The grid: times of touches [s], speeds before them [rad/s]; and knots of a flight, at least
# and apart [s].
_STEP, _FASTEST, _SPEEDS = 0.02, 8.0, 25
_LEAST_KNOTS, _APART = 8, 0.03
_MOST_TOUCHES = 6
# How many of the grid's minima are polished; knots of each flight then; the shortest one [s]; and
# the price of a flight beyond the wall [1/rad²].
_POLISHED, _FINE, _SHORTEST, _PRICE = 10, 120, 1e-3, 1e4
_ITERATIONS = 60  # of Newton's method in a flight
_ON_WALL = 1e-6  # [rad]: no farther beyond it than this
# A touch slower than this [rad/s] passes the wall so far off [rad]: its replay is not to touch.
_SLOW, _PASSING = 1e-3, 1e-4


class Task(NamedTuple):
    """A question, with the price of missing its goal in units of the torque's."""

    angle: float  # [rad]
    speed: float  # [rad/s]
    goal: float  # [rad]
    price: float  # w/R
    duration: float  # [s]
    restitution: float


class Leg(NamedTuple):
    """A flight: where it starts and how fast, where it is to end, how fast, and when."""

    angle: float  # [rad]
    speed: float  # [rad/s]
    target: float  # [rad]
    end: float  # [rad/s]; NaN is free, its angle too, whose distance from the target is priced
    time: float  # [s]


def find_bounces(question: Question) -> Iterator[tuple[float, Control]]:
    """Yields J and the torque of the motions that the search finds, better and better ones."""
    setting = setting_of(question)
    w = setting.weights
    weight = float(w.control[0])
    task = Task(
        angle=float(setting.start[0]),
        speed=float(setting.start[1]),
        goal=float(w.goal[0]),
        price=float(w.final_position[0]) / weight,
        duration=setting.duration,
        restitution=setting.restitution,
    )
    best = np.inf
    for touches in _search(task):
        cost, touches = _polish(task, touches)
        if cost < best:
            best = cost
            yield weight * cost, _find_torque(task, touches)


def _search(task: Task) -> list[np.ndarray]:
    """Returns touches (m, 2) that may be optimal: the time since the one before, and the speed.

    The least flights without a touch, and what is least on the grid, in the order of their costs.
    """
    count = round(task.duration / _STEP)
    speeds = np.linspace(0.0, _FASTEST, _SPEEDS)
    between = _between(task.restitution)[:count]
    first, rest = _list_ends(task, speeds, count)
    none = np.empty((0, 2))
    found = [(_sum_up(task, none), none)]
    choices: list[np.ndarray] = []
    for _ in range(_MOST_TOUCHES):
        for place in _find_minima(first + rest):
            path = [tuple(place)]
            for choice in reversed(choices):
                path.append(tuple(choice[path[-1]]))
            times = _STEP * np.array([1 + row for row, _ in path])
            touches = np.column_stack([np.diff(times, prepend=0.0), speeds[[i for _, i in path]]])
            found.append(((first + rest)[path[0]], touches))
        rest, choice = _step_back(between, rest)
        choices.append(choice)
    return [touches for _, touches in sorted(found, key=lambda each: each[0])[:_POLISHED]]


def _find_minima(costs: np.ndarray) -> np.ndarray:
    """Returns the places of the local minima of a table, (K, 2)."""
    windows = np.lib.stride_tricks.sliding_window_view(
        np.pad(costs, 1, constant_values=np.inf), (3, 3)
    )
    return np.argwhere(np.isfinite(costs) & (costs <= windows.min(axis=(2, 3))))


def _polish(task: Task, touches: np.ndarray) -> tuple[float, np.ndarray]:
    """Returns the least sum of flights near these touches, and those."""
    if not len(touches):
        return _sum_up(task, touches), touches

    def cost(x: np.ndarray) -> float:
        return _sum_up(task, x.reshape(-1, 2))

    def rest(x: np.ndarray) -> float:
        return task.duration - _SHORTEST - float(x[::2].sum())

    found = minimize(
        cost,
        touches.ravel(),
        method="SLSQP",
        bounds=[(_SHORTEST, task.duration), (0.0, None)] * len(touches),
        constraints={"type": "ineq", "fun": rest},
        options={"maxiter": 60, "ftol": 1e-9},
    )
    x = found.x if found.fun < cost(touches.ravel()) else touches.ravel()
    return cost(x), x.reshape(-1, 2)


def _list_legs(task: Task, touches: np.ndarray) -> Iterator[Leg]:
    """Yields the flights between touches, and the last one."""
    start = task.angle, task.speed
    for time, fall in touches:
        angle = _WALL + (_PASSING if fall < _SLOW else 0.0)
        yield Leg(*start, angle, -fall, time)
        start = angle, task.restitution * fall
    time = max(_SHORTEST, task.duration - touches[:, 0].sum())
    yield Leg(*start, task.goal, np.nan, time)


def _sum_up(task: Task, touches: np.ndarray) -> float:
    """Returns what all flights cost in units of the torque's price, and leaving."""
    total = 0.0
    for leg in _list_legs(task, touches):
        cost, depth = _fly(*leg, task.price, np.empty(_FINE + 1))
        total += cost + _PRICE * depth**2
    return total


def _find_torque(task: Task, touches: np.ndarray) -> Control:
    """Returns the torque, that of each knot held for half a step before and after it."""
    times, torques, start = [], [], 0.0
    shares = np.arange(_FINE + 1) / _FINE
    for leg in _list_legs(task, touches):
        flight = np.empty(_FINE + 1)
        _fly(*leg, task.price, flight)
        torques.append(_find_torques(flight, leg.speed, leg.end, leg.time / _FINE))
        times.append(start + leg.time * np.maximum(0.0, shares - 0.5 / _FINE))
        start += leg.time
    return Control(np.append(np.concatenate(times), start), np.concatenate(torques)[:, None])


@cache
def _between(restitution: float) -> np.ndarray:
    """Returns A from touch to touch: by time, the speed before the first, and before the second."""
    count = round(1.8 / _STEP)
    return _tabulate(restitution, np.linspace(0.0, _FASTEST, _SPEEDS), count)


@kernel
def _tabulate(restitution: float, speeds: np.ndarray, count: int) -> np.ndarray:
    """Returns A (count, S, S) of flights from the wall to the wall."""
    out = np.empty((count, speeds.size, speeds.size))
    for k in range(count):
        time = (k + 1) * _STEP
        flight = np.empty(_count_knots(time))
        for i in range(speeds.size):
            for j in range(speeds.size):
                start = restitution * speeds[i]
                cost, depth = _fly(_WALL, start, _WALL, -speeds[j], time, 0.0, flight)
                out[k, i, j] = cost if depth <= _ON_WALL else np.inf
    return out


@kernel
def _list_ends(task: Task, speeds: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the first flight's cost and the last one's, by its touch's time and speed."""
    first, last = np.full((2, count, speeds.size), np.inf)
    for k in range(count - 1):
        time = (k + 1) * _STEP
        left = task.duration - time
        here, there = np.empty(_count_knots(time)), np.empty(_count_knots(left))
        for i in range(speeds.size):
            cost, depth = _fly(task.angle, task.speed, _WALL, -speeds[i], time, 0.0, here)
            first[k, i] = cost if depth <= _ON_WALL else np.inf
            start = task.restitution * speeds[i]
            cost, depth = _fly(_WALL, start, task.goal, np.nan, left, task.price, there)
            last[k, i] = cost if depth <= _ON_WALL else np.inf
    return first, last


@kernel
def _step_back(between: np.ndarray, togo: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the least cost with one touch more, and the time and speed of the next one."""
    out = np.full(togo.shape, np.inf)
    choice = np.zeros((*togo.shape, 2), dtype=np.int64)
    for k in range(togo.shape[0]):
        for i in range(togo.shape[1]):
            for later in range(k + 1, togo.shape[0]):
                for j in range(togo.shape[1]):
                    cost = between[later - k - 1, i, j] + togo[later, j]
                    if cost < out[k, i]:
                        out[k, i] = cost
                        choice[k, i, 0], choice[k, i, 1] = later, j
    return out, choice


@inner
def _count_knots(time: float) -> int:
    return max(_LEAST_KNOTS, int(np.ceil(time / _APART))) + 1


@kernel
def _find_torques(flight: np.ndarray, speed: float, end: float, step: float) -> np.ndarray:
    """Returns θ̈ + g sin θ at knots: with central differences, and speeds given at the ends.

    At a free end it is zero, the last knot's row being left to one beyond.
    """
    n = flight.size - 1
    u = np.zeros(n + 1)
    for k in range(n + 1):
        if k == n and np.isnan(end):
            break
        before = flight[1] - 2 * step * speed if k == 0 else flight[k - 1]
        after = flight[n - 1] + 2 * step * end if k == n else flight[k + 1]
        u[k] = (after - 2 * flight[k] + before) / step**2 + _GRAVITY * np.sin(flight[k])
    return u


@inner
def _measure(
    flight: np.ndarray, speed: float, target: float, end: float, step: float, price: float
) -> float:
    """Returns ∫ u² dt by the trapezoid rule, and what the goal's miss costs."""
    u = _find_torques(flight, speed, end, step)
    total = step * (np.sum(u**2) - (u[0] ** 2 + u[-1] ** 2) / 2)
    return total + price * (flight[-1] - target) ** 2 if np.isnan(end) else total


@kernel
def _fly(
    angle: float,
    speed: float,
    target: float,
    end: float,
    time: float,
    price: float,
    flight: np.ndarray,
) -> tuple[float, float]:
    """Returns the least cost of a flight, whose knots it writes, and how far it leaves [rad].

    By Newton's method, where the matrix isn't positive by Gauss and Newton's, from a cubic.
    Without an end's speed (NaN) its angle is free, too, and its distance from the target priced.
    """
    n, is_free = flight.size - 1, np.isnan(end)
    step = time / n
    rate = (target - angle) / time
    for k in range(n + 1):
        s = k / n
        last = rate if is_free else end
        flight[k] = angle + (target - angle) * s * s * (3 - 2 * s)
        flight[k] += time * s * (1 - s) * (speed * (1 - s) - last * s)
    cost = _measure(flight, speed, target, end, step, price)
    trial = flight.copy()
    for _ in range(_ITERATIONS):
        slope, move = _find_move(flight, speed, target, end, step, price)
        part = 1.0
        while part > 1e-6:
            trial[:] = flight - part * move
            after = _measure(trial, speed, target, end, step, price)
            if after <= cost - 1e-4 * part * slope:
                break
            part /= 2
        if part <= 1e-6:
            break
        flight[:], cost = trial, after
        if slope <= 1e-13 * (1e-3 + cost):
            break
    depth = max(np.max(_WALL - flight), np.max(flight - _BEYOND))
    return cost, max(0.0, depth)


@inner
def _find_move(
    flight: np.ndarray, speed: float, target: float, end: float, step: float, price: float
) -> tuple[float, np.ndarray]:
    """Returns how steeply the cost falls along Newton's step, and that step (n + 1,)."""
    n, is_free = flight.size - 1, np.isnan(end)
    u = _find_torques(flight, speed, end, step)
    gradient, curvature = np.zeros(n + 1), np.zeros(n + 1)
    band = np.zeros((n + 1, 3))  # Of Gauss and Newton's matrix: k, k - 1, k - 2.
    beside = 1 / step**2
    for k in range(n if is_free else n + 1):
        weight = 2 * step if 0 < k < n else step
        middle = _GRAVITY * np.cos(flight[k]) - 2 * beside
        left = 0.0 if k == 0 else (2 * beside if k == n else beside)
        right = 0.0 if k == n else (2 * beside if k == 0 else beside)
        curvature[k] -= weight * u[k] * _GRAVITY * np.sin(flight[k])
        gradient[k] += weight * u[k] * middle
        band[k, 0] += weight * middle**2
        if k > 0:
            gradient[k - 1] += weight * u[k] * left
            band[k - 1, 0] += weight * left**2
            band[k, 1] += weight * middle * left
        if k < n:
            gradient[k + 1] += weight * u[k] * right
            band[k + 1, 0] += weight * right**2
            band[k + 1, 1] += weight * middle * right
        if 0 < k < n:
            band[k + 1, 2] += weight * left * right
    if is_free:
        gradient[n] += 2 * price * (flight[n] - target)
        band[n, 0] += 2 * price
    # What is given does not move.
    _hold(0, gradient, curvature, band)
    if not is_free:
        _hold(n, gradient, curvature, band)
    move = gradient.copy()
    exact = band.copy()
    exact[:, 0] += curvature
    if not _solve(exact, move):
        move[:] = gradient
        _solve(band, move)
    return np.sum(gradient * move), move


@inner
def _hold(k: int, gradient: np.ndarray, curvature: np.ndarray, band: np.ndarray) -> None:
    """Holds a knot: its row and column are those of the identity."""
    gradient[k], curvature[k] = 0.0, 0.0
    band[k, 0], band[k, 1], band[k, 2] = 1.0, 0.0, 0.0
    if k + 1 < gradient.size:
        band[k + 1, 1] = 0.0
    if k + 2 < gradient.size:
        band[k + 2, 2] = 0.0


@inner
def _solve(band: np.ndarray, x: np.ndarray) -> bool:
    """Solves by L D Lᵀ in place, and returns whether the matrix is positive."""
    n = x.size
    for k in range(n):
        if k > 1:
            band[k, 1] -= band[k, 2] * band[k - 1, 1]
        for i in range(1, min(k, 2) + 1):
            part = band[k, i] / band[k - i, 0]
            band[k, 0] -= part * band[k, i]
            band[k, i] = part
        if not band[k, 0] > 0.0:
            return False
    for k in range(n):
        for i in range(1, min(k, 2) + 1):
            x[k] -= band[k, i] * x[k - i]
    for k in range(n - 1, -1, -1):
        x[k] /= band[k, 0]
        for i in range(1, min(n - 1 - k, 2) + 1):
            x[k] -= band[k + i, i] * x[k + i]
    return True
