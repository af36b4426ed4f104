"""Programs that are chains of stages with contact: SPOT's push-bot as anyone would write it.

Source: Kang, Liu & Yang, RSS 2025, arXiv:2502.02829.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from pydrake.solvers import MathematicalProgram
from pydrake.symbolic import cos, sin

Form = Literal["equalities", "inequalities", "variables"]

# Cart position [m], speed [m/s], pole angle [rad], its rate [rad/s]: SPOT's ten.
SPOT_STARTS = (
    (0.7740, -0.6848, 0.2446, 1.2363),
    (0.8605, 0.9412, -0.7293, -2.8090),
    (0.1206, 0.9143, 0.5484, -1.3385),
    (0.8677, -0.0292, 0.6817, -2.7230),
    (0.6007, 0.6006, 0.2808, -2.4172),
    (0.0927, -0.7162, 0.4049, 1.9407),
    (0.2646, -0.1565, 0.3819, 1.1690),
    (0.5195, 0.8315, -0.1693, -1.0974),
    (0.9096, 0.5844, 0.2442, 2.7013),
    (0.9166, 0.9190, -0.5165, -2.7933),
)
# Cart and pole [kg], pole [m], gravity [m/s²], stiffness [N/m], largest force and control [N].
_CART, _POLE, _LENGTH, _GRAVITY, _STIFFNESS, _FORCE, _CONTROL = 1.0, 0.1, 0.8, 9.8, 200.0, 100, 20
_STEPS, _DT = 30, 0.05  # [s]
_LARGEST_TURN = np.arccos(0.7)  # [rad] in a step


@dataclass(frozen=True)
class StagedProblem:
    """A program, made anew each time.

    Attributes:
        name: of it.
        prog: makes it.
        roll_out: draws a start x for peers that need a good one, if there is a way to.
        guess: returns the start x of the program's authors, if they have one.
    """

    name: str
    prog: Callable[[], MathematicalProgram]
    roll_out: Callable[[np.random.Generator], np.ndarray] | None = None
    guess: Callable[[], np.ndarray] | None = None


def staged_problems(num_random: int = 50, seed: int = 17) -> Iterator[StagedProblem]:
    """Yields push-bots between far and near walls.

    Args:
        num_random: how many random starts of the push-bot there are, at each distance of the walls.
        seed: of these.
    """
    for wall in (1.0, 0.6):
        for i, start in enumerate(push_bot_starts(wall, num_random, seed)):
            form: Form = ("equalities", "inequalities", "variables")[i % 3]
            name = f"push_bot/{wall:g}/{i}"
            roll_out = partial(push_bot_roll_out, start, wall, form)
            yield StagedProblem(name, partial(push_bot, start, wall, form), roll_out)


def push_bot_starts(wall: float, num_random: int, seed: int) -> list[tuple[float, ...]]:
    """Returns SPOT's ten starts, and random ones of its distribution.

    Starts whose first knots are so deep in a wall that its force is above the bound on forces are
    left out, and drawn again.
    """
    rng = np.random.default_rng(seed)
    starts: list[tuple[float, ...]] = [each for each in SPOT_STARTS if _is_possible(each, wall)]
    last = len(starts) + num_random
    while len(starts) < last:
        low, high = (0.0, -1.0, -np.pi / 4, -3.0), (0.95, 1.0, np.pi / 4, 3.0)
        start = tuple(rng.uniform(low, high).tolist())
        if _is_possible(start, wall):
            starts.append(start)
    return starts


def _is_possible(start: tuple[float, ...], wall: float) -> bool:
    a, v, angle, rate = start
    tip = a + _DT * v + _LENGTH * np.sin(angle + _DT * rate)
    return bool(_STIFFNESS * (abs(tip) - wall) < 0.99 * _FORCE and abs(a + _DT * v) <= 1.0)


def push_bot(
    start: tuple[float, ...], wall: float, form: Form, steps: int = _STEPS
) -> MathematicalProgram:
    """Returns SPOT's push-bot: a cart-pole swings up between soft walls, in its discrete mechanics.

    With a, θ of knots 0 … N + 1, control u and the walls' forces λ₁, λ₂ of steps 1 … N:

        (m_c + m_p) ä + m_p l (sin θ)¨ = u + λ₁ − λ₂
        l (sin Δθ_k − sin Δθ_{k−1})/dt² + (ä + λ₂ − λ₁) cos θ + g sin θ = 0
        0 ≤ λ₁ ⊥ λ₁/k + d + a + l sin θ ≥ 0,    0 ≤ λ₂ ⊥ λ₂/k + d − a − l sin θ ≥ 0

    Args:
        start: a [m], its speed [m/s], θ [rad] (0 hangs down) and its rate [rad/s].
        wall: d [m].
        form: complementarities as λ s = 0, as λ s ≤ 0, or with a variable for s.
        steps: N.
    """
    prog = MathematicalProgram()
    a, angle = (prog.NewContinuousVariables(steps + 2, name) for name in ("a", "angle"))
    u, left, right = (prog.NewContinuousVariables(steps, name) for name in ("u", "left", "right"))
    position, speed, first, rate = start
    knots = np.array([[position, position + _DT * speed], [first, first + _DT * rate]])
    for variables, values in zip((a, angle), knots, strict=True):
        prog.AddBoundingBoxConstraint(values, values, variables[:2])
    prog.AddBoundingBoxConstraint(-1.0, 1.0, a[2:])
    prog.AddBoundingBoxConstraint(-_CONTROL, _CONTROL, u)
    prog.AddBoundingBoxConstraint(0.0, _FORCE, np.concatenate([left, right]))
    for k in range(1, steps + 1):
        force = left[k - 1] - right[k - 1]
        acc = (a[k - 1] - 2 * a[k] + a[k + 1]) / _DT**2
        sines = (sin(angle[k - 1]) - 2 * sin(angle[k]) + sin(angle[k + 1])) / _DT**2
        turns = (sin(angle[k + 1] - angle[k]) - sin(angle[k] - angle[k - 1])) / _DT**2
        prog.AddConstraint((_CART + _POLE) * acc + _POLE * _LENGTH * sines - u[k - 1] - force == 0)
        hangs = _GRAVITY * sin(angle[k])
        prog.AddConstraint(_LENGTH * turns + (acc - force) * cos(angle[k]) + hangs == 0)
        tip = a[k] + _LENGTH * sin(angle[k])
        for push, gap in ((left[k - 1], wall + tip), (right[k - 1], wall - tip)):
            _add_complementarity(prog, push, push / _STIFFNESS + gap, form)
        turn = angle[k + 1] - angle[k]
        prog.AddLinearConstraint(turn, -_LARGEST_TURN, _LARGEST_TURN)
        weight = 10.0 if k == steps else 1.0
        upright = (cos(angle[k]) + 1) ** 2 + sin(angle[k + 1]) ** 2
        prog.AddCost(weight * (a[k + 1] ** 2 + upright + 2 - 2 * cos(turn)))
        prog.AddQuadraticCost((u[k - 1] / _CONTROL) ** 2)
    return prog


def _add_complementarity(prog: MathematicalProgram, force: Any, gap: Any, form: Form) -> None:
    """Adds 0 ≤ λ ⊥ s ≥ 0 for a λ that has its bound."""
    if form == "variables":
        (own,) = prog.NewContinuousVariables(1, "gap")
        prog.AddBoundingBoxConstraint(0.0, np.inf, own)
        prog.AddConstraint(gap - own == 0)
        prog.AddConstraint(force * own == 0)
        return
    prog.AddConstraint(gap >= 0)
    prog.AddConstraint(force * gap == 0 if form == "equalities" else force * gap <= 0)


def push_bot_roll_out(
    start: tuple[float, ...], wall: float, form: Form, rng: np.random.Generator
) -> np.ndarray:
    """Returns x of the motion under a random smooth control, with the springs' own forces."""
    position, speed, first, rate = start
    a, angle = [position, position + _DT * speed], [first, first + _DT * rate]
    count = int(rng.integers(3, 9))
    control = np.interp(
        np.linspace(0.0, 1.0, _STEPS), np.linspace(0.0, 1.0, count), rng.uniform(-1, 1, count)
    )
    u = _CONTROL * rng.uniform(0.0, 1.0) * control
    forces, gaps = np.zeros((2, _STEPS)), []
    for k in range(1, _STEPS + 1):
        tip = a[k] + _LENGTH * np.sin(angle[k])
        forces[:, k - 1] = _STIFFNESS * np.maximum(0.0, [-wall - tip, tip - wall])
        gaps += [
            forces[0, k - 1] / _STIFFNESS + wall + tip,
            forces[1, k - 1] / _STIFFNESS + wall - tip,
        ]
        force = forces[0, k - 1] - forces[1, k - 1]
        before = np.sin(angle[k] - angle[k - 1])
        turn = angle[k] - angle[k - 1]
        for _ in range(8):  # Newton steps, in which the cart's acceleration follows the turn's.
            sines = np.sin(angle[k - 1]) - 2 * np.sin(angle[k]) + np.sin(angle[k] + turn)
            acc = (u[k - 1] + force - _POLE * _LENGTH * sines / _DT**2) / (_CART + _POLE)
            acc_slope = -_POLE * _LENGTH * np.cos(angle[k] + turn) / _DT**2 / (_CART + _POLE)
            cosine = np.cos(angle[k])
            swing = _LENGTH * (np.sin(turn) - before) / _DT**2
            row = swing + (acc - force) * cosine + _GRAVITY * np.sin(angle[k])
            slope = _LENGTH * np.cos(turn) / _DT**2 + acc_slope * cosine
            turn = float(np.clip(turn - row / slope, -_LARGEST_TURN, _LARGEST_TURN))
        angle.append(angle[k] + turn)
        a.append(2 * a[k] - a[k - 1] + _DT**2 * acc)
    return np.concatenate([a, angle, u, *forces, gaps if form == "variables" else []])
