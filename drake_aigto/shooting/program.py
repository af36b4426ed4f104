"""A shooting problem as the tables that compiled code reads."""

from __future__ import annotations

from typing import Any

import numpy as np

from drake_aigto.shooting.question import ShootingQuestion
from drake_aigto.shooting.tables import CHORDAL, EXACT, FLOW, MODULO, Bounds, Program, Task
from drake_aigto.world import TaskCost

# A control's curvature counts as small below this share of the cost's scale per its own squared.
_FLOOR = 1e-6


def make_program(problem: ShootingQuestion, substeps: int) -> Program:
    """Returns the tables of a problem, its multipliers zero."""
    N = len(problem.times) - 1
    program = Program(
        mechanics=problem.mechanism.mechanics,
        task=_make_task(problem.cost),
        bounds=_make_bounds(problem),
        kinds=np.full(N, FLOW),
        steps=np.diff(problem.times),
        times=problem.times,
        substeps=substeps,
    )
    return _copy(program)


def _copy(table: Any) -> Any:
    """Returns a copy whose arrays are all writable: what cannot be written is of another type.

    Code would be compiled once more for it.
    """
    if isinstance(table, tuple):
        return type(table)(*map(_copy, table))
    return np.array(table, order="C") if isinstance(table, np.ndarray) else table


def _make_task(cost: TaskCost) -> Task:
    n = len(cost.goal)
    final = np.zeros((2 * n, 2 * n))
    final[:n, :n], final[n:, n:] = cost.QT, cost.QTv
    errors = np.where(cost.is_modulo, MODULO, np.where(cost.is_chordal, CHORDAL, EXACT))
    running = np.concatenate([cost.Q, cost.Qv])
    return Task(
        control=cost.R,
        running=running,
        final=(final + final.T) / 2,
        errors=np.concatenate([errors, np.full(n, EXACT)]),
        goal=np.concatenate([cost.goal, cost.goal_velocity]),
        times=cost.times,
        reference=np.hstack([cost.positions, cost.velocities]),
    )


def _make_bounds(problem: ShootingQuestion) -> Bounds:
    """Returns bounds at knots after the first, the hard goal among them."""
    N, nx = len(problem.times) - 1, len(problem.start)
    m, nu = problem.mechanism.num_contacts, problem.mechanism.num_controls
    lower, upper = np.repeat(problem.state_bounds[:, np.newaxis], N + 1, axis=1)
    is_hard = np.isfinite(problem.hard_goal)
    lower[-1, is_hard] = upper[-1, is_hard] = problem.hard_goal[is_hard]
    is_bounded = np.any(np.isfinite(lower) | np.isfinite(upper), axis=1)
    is_bounded[0] = False
    norm, (low, high) = problem.control_norm, problem.control_bounds
    if nu == 1:
        low, high = np.maximum(low, -norm), np.minimum(high, norm)
    floor = _FLOOR * problem.cost_scale / problem.control_scales**2
    return Bounds(
        lower=lower,
        upper=upper,
        weights=problem.scales**-2,
        multipliers=np.zeros((N + 1, nx)),
        is_any=bool(np.any(is_bounded)),
        is_bounded=is_bounded,
        lower_distance=np.full((N + 1, m), -np.inf),
        upper_distance=np.full((N + 1, m), np.inf),
        distance_weight=problem.length**-2,
        distance_multipliers=np.zeros((N + 1, m)),
        is_distance_bounded=np.zeros(N + 1, dtype=bool),
        lower_control=np.tile(low, (N, 1)),
        upper_control=np.tile(high, (N, 1)),
        norm=norm,
        floors=np.tile(floor, (N, 1)),
    )
