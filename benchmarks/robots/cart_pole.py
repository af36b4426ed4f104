"""The cart-pole between soft walls: questions, and a judge that shares nothing with the planner.

The mechanics are written out by hand from the Lagrangian: a cart at a, a massless rod of length l
with the mass m at its tip, which hangs down at θ = 0 and is at p = a + l sin θ; springs of
stiffness k that push where the tip is beyond ±d.

    (M + m) ä + m l (cos θ θ̈ − sin θ θ̇²) = u + f
    m l (l θ̈ + cos θ ä + g sin θ)        = l cos θ f,    f = k max(0, −d − p) − k max(0, p − d)

    J = ∫ 20 a² + 20 (2 + 2 cos θ) + 0.05 θ̇² + 0.05 u² dt + 10 a² + 10 (2 + 2 cos θ) + 0.025 θ̇² |_T

Parameters, costs, bounds and ten starts are those of SPOT's push-bot (Kang, Liu, Yang, "Global
contact-rich planning with sparsity-rich SDP relaxations", arXiv 2502.02829): its sums over steps of
0.05 s as integrals. Its mechanics have no mass in the force at the tip, at which steps of 0.05 s
would be unstable otherwise (k/m dt² = 5 > 4); these have.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from drake_aigto.jit import inner, kernel

DURATION = 1.5  # [s]
CART, TIP = 1.0, 0.1  # masses [kg]
LENGTH = 0.8  # [m]
GRAVITY = 9.8  # [m/s²]
STIFFNESS = 200.0  # [N/m]
LARGEST_POSITION, LARGEST_FORCE = 1.0, 20.0  # of the cart [m], of the control [N]
RUNNING = np.array([20.0, 20.0, 0.05, 0.05])  # of a², 2 + 2 cos θ, θ̇², u²
FINAL = np.array([10.0, 10.0, 0.025])  # of the first three
# Scenario → where its walls are [m].
WALLS: Mapping[str, float] = {"cart_pole/soft_06": 0.6, "cart_pole/soft_10": 1.0}
# How deep in a wall a start may be [m]: deeper, the spring throws the tip at tens of metres a
# second, and no step that is in use resolves it.
DEEPEST = 0.1
# How far out of its range the cart may be in what counts as a solution [m]: 1 % of the range, as
# costs count as the same within 1 %.
LARGEST_EXCESS = 0.01
# Of the judge [s]: 1/1400 of the tip's period at a wall.
_STEP = 1e-4

# a, ȧ, θ, θ̇ of the starts in SPOT's table of random tests.
SPOT_STARTS = np.array(
    [
        [0.7740, -0.6848, 0.2446, 1.2363],
        [0.8605, 0.9412, -0.7293, -2.8090],
        [0.1206, 0.9143, 0.5484, -1.3385],
        [0.8677, -0.0292, 0.6817, -2.7230],
        [0.6007, 0.6006, 0.2808, -2.4172],
        [0.0927, -0.7162, 0.4049, 1.9407],
        [0.2646, -0.1565, 0.3819, 1.1690],
        [0.5195, 0.8315, -0.1693, -1.0974],
        [0.9096, 0.5844, 0.2442, 2.7013],
        [0.9166, 0.9190, -0.5165, -2.7933],
    ]
)


class Question(NamedTuple):
    """A start between the walls of a scenario."""

    scenario: str
    number: int
    start: tuple[float, float, float, float]  # a, ȧ, θ, θ̇

    @property
    def wall(self) -> float:
        """Distance d of either wall from the middle [m]."""
        return WALLS[self.scenario]

    @property
    def is_deep(self) -> bool:
        """Whether the tip starts deeper in a wall than random starts may."""
        return bool(tip_of(np.array(self.start)) > self.wall + DEEPEST)


class Judgment(NamedTuple):
    """What becomes of a control."""

    cost: float  # J
    excess: float  # how far the cart leaves its range [m]; the control is clipped to its own

    @property
    def is_solution(self) -> bool:
        """Whether the cart stays where it may."""
        return self.excess <= LARGEST_EXCESS

    @property
    def score(self) -> float:
        """J of a solution, else infinite."""
        return self.cost if self.is_solution else np.inf


def tip_of(state: np.ndarray) -> float:
    """Returns p [m]."""
    return float(state[0] + LENGTH * np.sin(state[2]))


def make_questions(scenario: str, count: int = 60, seed: int = 16) -> list[Question]:
    """Returns SPOT's ten starts, and others of its distribution that are not deep in a wall."""
    rng = np.random.default_rng(seed)
    starts = list(SPOT_STARTS[:count])
    while len(starts) < count:
        start = rng.uniform([0.0, -1.0, -np.pi / 4, -3.0], [0.95, 1.0, np.pi / 4, 3.0])
        if tip_of(start) <= WALLS[scenario] + DEEPEST:
            starts.append(start)
    return [Question(scenario, k, tuple(start.tolist())) for k, start in enumerate(starts)]


def judge(question: Question, controls: np.ndarray) -> Judgment:
    """Returns what becomes of controls (L,) that are held for L equal times."""
    return _judge(question, controls, _STEP)


def _judge(question: Question, controls: np.ndarray, longest: float) -> Judgment:
    held = DURATION / controls.size
    steps = int(np.ceil(held / longest))
    force = np.clip(np.asarray(controls, dtype=float), -LARGEST_FORCE, LARGEST_FORCE)
    states, cost = roll_out(np.array(question.start), force, question.wall, held / steps, steps)
    excess = max(0.0, float(np.abs(states[:, 0]).max()) - LARGEST_POSITION)
    return Judgment(cost if np.isfinite(cost) else np.inf, excess)


@inner
def _slope(x: np.ndarray, u: float, wall: float, out: np.ndarray) -> None:
    """Writes ȧ, ä, θ̇, θ̈ and the running cost."""
    c, s = np.cos(x[2]), np.sin(x[2])
    p = x[0] + LENGTH * s
    f = STIFFNESS * (max(0.0, -wall - p) - max(0.0, p - wall))
    # The second row over m l; det is of [M + m, m l c; c, l].
    along = u + f + TIP * LENGTH * s * x[3] ** 2
    around = c * f / TIP - GRAVITY * s
    det = LENGTH * (CART + TIP * s**2)
    out[0], out[2] = x[1], x[3]
    out[1] = (LENGTH * along - TIP * LENGTH * c * around) / det
    out[3] = ((CART + TIP) * around - c * along) / det
    out[4] = RUNNING[0] * x[0] ** 2 + RUNNING[1] * (2 + 2 * c)
    out[4] += RUNNING[2] * x[3] ** 2 + RUNNING[3] * u**2


@kernel
def roll_out(
    start: np.ndarray, controls: np.ndarray, wall: float, step: float, steps: int
) -> tuple[np.ndarray, float]:
    """Returns states (L steps + 1, 4) and J: the classic Runge-Kutta method.

    Args:
        start: a, ȧ, θ, θ̇.
        controls: (L,), each held for `steps` steps [N].
        wall: d [m].
        step: [s].
        steps: how many steps a control is held.
    """
    states = np.empty((controls.size * steps + 1, 4))
    x, slopes = np.zeros(5), np.empty((4, 5))
    # Entry by entry: Numba takes seconds to compile the error of slices that do not fit.
    for i in range(4):
        x[i] = states[0, i] = start[i]
    for k in range(controls.size * steps):
        u = controls[k // steps]
        _slope(x, u, wall, slopes[0])
        _slope(x + step / 2 * slopes[0], u, wall, slopes[1])
        _slope(x + step / 2 * slopes[1], u, wall, slopes[2])
        _slope(x + step * slopes[2], u, wall, slopes[3])
        x += step / 6 * (slopes[0] + 2 * slopes[1] + 2 * slopes[2] + slopes[3])
        for i in range(4):
            states[k + 1, i] = x[i]
    final = FINAL[0] * x[0] ** 2 + FINAL[1] * (2 + 2 * np.cos(x[2])) + FINAL[2] * x[3] ** 2
    return states, x[4] + final
