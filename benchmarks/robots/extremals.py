"""The optima of the pendulum and its wall, by Pontryagin's principle: two numbers are left.

    θ̈ = u − g sin θ,    ω⁺ = −e ω⁻ where sin θ = −d,    J = R ∫ u² dt + w (θ(T) − goal)²

Between touches ü = −g cos θ u; at one, as the angle of the touch is given and its time is not,
u⁺ = −u⁻/e and H = −u² + 2 u g sin θ + 2 u̇ ω is the same before and after. So u(0) and u̇(0) tell
the rest, however many touches there are: they are searched on a grid, its least valleys are
polished, and the least J is taken for the optimum. It may miss optima that graze the wall or rest
on it, for which the principle has other conditions.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.optimize import minimize

from benchmarks.robots.judge import Control
from benchmarks.robots.worlds import Question, setting_of
from drake_aigto.kernels import inner, kernel

_GRAVITY = 9.81  # [m/s²]
_WALLS = (-np.pi / 6, 7 * np.pi / 6)  # θ [rad], both sides of the same wall
# The search: points a side of two grids, the first one for a bound on J, by which the second one is
# as large as any better motion's torque, and how much larger; of the second, where w is a part of
# itself so that no valley falls between its points, how many are polished.
_FIRST, _POINTS, _MARGIN, _SOFTER, _VALLEYS = 121, 301, 1.5, 0.1, 24
# Steps of a roll-out: on grids, and of a polish.
_COARSE, _FINE = 150, 800
_MOST_TOUCHES = 40
_HELD = 5e-3  # for which its torque is held in the end [s]


def find_extremals(question: Question) -> Iterator[tuple[float, Control]]:
    """Yields J and the torque of the extremals that the search finds, better and better ones."""
    setting = setting_of(question)
    w = setting.weights
    data = np.array(
        [
            *setting.start,
            w.goal[0],
            setting.restitution,
            setting.duration,
            w.control[0],
            w.final_position[0],
        ]
    )
    best = np.inf
    for start, simplex in _find_valleys(data):
        found = minimize(
            lambda x: _extremal(data, x[0], x[1], _FINE),
            start,
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "xatol": 1e-7, "fatol": 1e-9, "maxfev": 400},
        )
        if found.fun < best:
            best = found.fun
            held = int(np.ceil(setting.duration / _HELD))
            torque = _sample(data, found.x[0], found.x[1], held)
            yield best, Control.even(torque[:, None], setting.duration)


def _find_valleys(data: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yields where polishes begin, and a simplex about it."""
    bound = _extremal(data, 0.0, 0.0, _COARSE)
    for points in (_FIRST, _POINTS):
        # A swing of amplitude A costs R A² T/2, and its rate is √g A at most.
        largest = _MARGIN * np.sqrt(2 * bound / data[4] / data[5])
        torques = np.linspace(-largest, largest, points)
        costs, least = _grid(data, torques, np.sqrt(_GRAVITY) * torques, _COARSE, _SOFTER)
        bound = min(bound, least)
    scale = torques[1] - torques[0]
    for row, column in _find_minima(costs):
        start = np.array([torques[row], np.sqrt(_GRAVITY) * torques[column]])
        yield start, start + scale / 2 * np.array([[0, 0], [1, 0], [0, 3]])


def _find_minima(costs: np.ndarray) -> np.ndarray:
    """Returns the places of the least local minima of a grid, (K, 2)."""
    padded = np.pad(costs, 1, constant_values=np.inf)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    places = np.argwhere(np.isfinite(costs) & (costs <= windows.min(axis=(2, 3))))
    order = np.argsort(costs[tuple(places.T)])
    return places[order[:_VALLEYS]]


@inner
def _slope(x: np.ndarray, out: np.ndarray) -> None:
    """Writes the rates of θ, ω, u, u̇ and ∫ u²."""
    out[0], out[1] = x[1], x[2] - _GRAVITY * np.sin(x[0])
    out[2], out[3], out[4] = x[3], -_GRAVITY * np.cos(x[0]) * x[2], x[2] ** 2


@inner
def _step(x: np.ndarray, step: float, slopes: np.ndarray) -> np.ndarray:
    """Returns the state a step of the classic Runge-Kutta method later."""
    _slope(x, slopes[0])
    _slope(x + step / 2 * slopes[0], slopes[1])
    _slope(x + step / 2 * slopes[1], slopes[2])
    _slope(x + step * slopes[2], slopes[3])
    return x + step / 6 * (slopes[0] + 2 * slopes[1] + 2 * slopes[2] + slopes[3])


@inner
def _beyond(x: np.ndarray) -> float:
    """Returns how far the angle is beyond the nearer wall [rad]."""
    return max(_WALLS[0] - x[0], x[0] - _WALLS[1])


@inner
def _bounce(x: np.ndarray, e: float) -> None:
    """Changes a state as a touch does."""
    turn = _GRAVITY * np.sin(x[0])
    energy = -(x[2] ** 2) + 2 * x[2] * turn + 2 * x[3] * x[1]
    x[1] = -e * x[1]
    x[2] = -x[2] / e
    x[3] = (energy + x[2] ** 2 - 2 * x[2] * turn) / (2 * x[1])


@kernel
def _roll(x: np.ndarray, step: float, steps: int, e: float) -> int:
    """Moves a state on by some steps, and returns how often it touched a wall."""
    slopes = np.empty((4, 5))
    touches = 0
    for _ in range(steps):
        left = step
        while True:
            y = _step(x, left, slopes)
            if _beyond(y) <= 0.0 or touches > _MOST_TOUCHES:
                x[:] = y
                break
            # Where it is at the wall, by halving: it was not beyond when the step began.
            low, high = 0.0, left
            for _ in range(50):
                middle = (low + high) / 2
                if _beyond(_step(x, middle, slopes)) > 0.0:
                    high = middle
                else:
                    low = middle
            x[:] = _step(x, low, slopes)
            _bounce(x, e)
            left -= low
            touches += 1
    return touches


@inner
def _costs(data: np.ndarray, u: float, rate: float, steps: int) -> tuple[float, float]:
    """Returns what u(0), u̇(0) cost under way and at the end; infinite with too many touches."""
    x = np.array([data[0], data[1], u, rate, 0.0])
    touches = _roll(x, data[4] / steps, steps, data[3])
    way, end = data[5] * x[4], data[6] * (x[0] - data[2]) ** 2
    if touches > _MOST_TOUCHES or not np.isfinite(way + end):
        return np.inf, np.inf
    return way, end


@kernel
def _extremal(data: np.ndarray, u: float, rate: float, steps: int) -> float:
    """Returns J of u(0), u̇(0); data are θ, ω, goal, e, T, R and w."""
    way, end = _costs(data, u, rate, steps)
    return way + end


@kernel
def _grid(
    data: np.ndarray, torques: np.ndarray, rates: np.ndarray, steps: int, part: float
) -> tuple[np.ndarray, float]:
    """Returns J with a part of w, of every u(0) with every u̇(0), and the least J with all of it."""
    costs = np.empty((torques.size, rates.size))
    least = np.inf
    for i in range(torques.size):
        for j in range(rates.size):
            way, end = _costs(data, torques[i], rates[j], steps)
            costs[i, j] = way + part * end
            least = min(least, way + end)
    return costs, least


@kernel
def _sample(data: np.ndarray, u: float, rate: float, count: int) -> np.ndarray:
    """Returns the torque in the middle of each of so many equal times, (count,)."""
    x, torque = np.array([data[0], data[1], u, rate, 0.0]), np.empty(count)
    half = data[4] / count / 2
    for k in range(count):
        _roll(x, half / 4, 4, data[3])
        torque[k] = x[2]
        _roll(x, half / 4, 4, data[3])
    return torque
