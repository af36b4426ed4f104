"""Problems of shooting whose weights and bounds tests choose, and differences."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from drake_aigto.arrays import Bools, Floats
from drake_aigto.contact import Closed, Mechanics, MechanicsMemory, Mechanism, accelerate
from drake_aigto.kernels import borrow, kernel
from drake_aigto.shooting import Pass, ShootingProblem, descend, hold_contacts
from drake_aigto.world import TaskCost


def weigh(goal: Any, effort: Any, **weights: Any) -> TaskCost:
    """Returns the cost of a control of this weight, one number or nu, and other weights."""
    n = len(goal)
    values: dict[str, Any] = {
        "R": np.atleast_1d(effort),
        **dict.fromkeys(("Q", "Qv", "goal_velocity"), np.zeros(n)),
        **dict.fromkeys(("QT", "QTv"), np.zeros((n, n))),
        "goal": np.array(goal, dtype=float),
        **dict.fromkeys(("is_modulo", "is_chordal"), np.zeros(n, dtype=bool)),
        "times": np.zeros(1),
        "positions": np.array([goal], dtype=float),
        "velocities": np.zeros((1, n)),
    }
    return TaskCost(**(values | weights))


def pose(
    mechanism: Mechanism, cost: TaskCost, start: Any, N: int = 30, T: float = 1.5, **more: Any
) -> ShootingProblem:
    """Returns a problem without bounds, but for what is given."""
    n, nu = mechanism.num_positions, mechanism.num_controls
    free = np.array([[-np.inf], [np.inf]])
    values: dict[str, Any] = {
        "times": np.linspace(0, T, N + 1),
        "start": np.array(start, dtype=float),
        "scales": np.ones(2 * n),
        "state_bounds": np.tile(free, 2 * n),
        "control_bounds": np.tile(free, nu),
        "hard_goal": np.full(2 * n, np.nan),
    }
    return ShootingProblem(mechanism, cost, **(values | more))


def expand_motion(
    program: Any, states: Floats, controls: Floats, smoothing: float, memory: Any
) -> float:
    """Returns a motion's cost; memory has its expansion, to which bounds add next to nothing.

    By the kernel that plans descend with: one of its own would be compiled for tests alone.
    """
    no = False
    settings = Pass(smoothing, 1e-300, 1, np.inf, 1.0, no, np.inf, no, no, no, -1)
    return descend(program, states, controls, True, settings, memory).cost


def check_held(
    press: Callable[[Floats, Floats], tuple[Floats, Floats, Floats, Floats]],
    closed: Closed,
    x: Floats,
    u: Floats,
    tolerances: tuple[float, float, float],
) -> None:
    """Checks forces of closed contacts, v̇, and their derivatives by (q, v, u).

    Args:
        press: returns forces, normal ones first, v̇, derivatives of normal forces, those of v̇.
        closed: the contacts, for what is to be expected.
        x: the state.
        u: the control.
        tolerances: relative of values; relative and absolute of derivatives.
    """
    exact, relative, absolute = tolerances
    forces, acceleration, by_force, slopes = press(x, u)
    wanted = closed.calc_push(x, u)
    expected = np.concatenate([wanted.normal, wanted.tangent])[: len(forces)]
    np.testing.assert_allclose(acceleration, wanted.acceleration, rtol=exact, atol=1e-9)
    np.testing.assert_allclose(forces, expected, rtol=exact, atol=1e-9)
    differences = differ(
        lambda y: np.concatenate(press(y[: len(x)], y[len(x) :])[:2]), np.concatenate([x, u])
    )
    m = len(wanted.normal)
    for found, rows in ((by_force[:m], differences[:m]), (slopes, differences[len(forces) :])):
        np.testing.assert_allclose(found, rows, rtol=relative, atol=absolute)


def differ(calc: Callable[[Floats], Floats], x: Floats, step: float = 1e-6) -> Floats:
    nudges = step * np.eye(len(x))
    return np.array([(calc(x + e) - calc(x - e)) / (2 * step) for e in nudges]).T


@kernel
def evaluate_hold(
    closed: Bools,
    leans: Floats,
    x: Floats,
    u: Floats,
    mechanics: Mechanics,
    memory: MechanicsMemory,
) -> None:
    """Computes v̇ with held contacts, and all derivatives."""
    mechanics, memory = borrow(mechanics), borrow(memory)
    accelerate(mechanics, x, u, 0.0, True, memory)
    if closed.any():
        hold_contacts(closed, leans, x, True, mechanics, memory)
