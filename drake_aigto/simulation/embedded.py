"""Steps of a Runge-Kutta method that estimates its own error, compiled."""

from __future__ import annotations

from typing import Any

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import (
    Mechanics,
    MechanicsMemory,
    TreeMechanics,
    TreeMechanicsMemory,
    accelerate,
    accelerate_bodies,
    of_tree,
)
from drake_aigto.dynamics import turn_positions
from drake_aigto.kernels import borrow, borrowing, kernel

# More steps are no motion any more, but numbers that run away.
MOST_STEPS = 1_000_000

# Dormand & Prince (1980), "A family of embedded Runge-Kutta formulae": the rule of order 5, and its
# difference to that of order 4.
_A = np.array(
    [
        [0, 0, 0, 0, 0, 0],
        [1 / 5, 0, 0, 0, 0, 0],
        [3 / 40, 9 / 40, 0, 0, 0, 0],
        [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
        [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
_E = np.array([71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])


def _find_rates_of_bodies(
    mechanics: TreeMechanics, x: Floats, u: Floats, rates: Floats, memory: TreeMechanicsMemory
) -> None:
    """Computes ẋ of a state x = (q, v) of a tree."""
    n, nq = mechanics.tree.up.size, mechanics.num_positions
    accelerate_bodies(mechanics, x[:nq], x[nq:], u, 0.0, False, memory)
    turn_positions(mechanics.tree, x[:nq], x[nq:], rates[:nq])
    for i in range(n):
        rates[nq + i] = memory.acceleration[0, i]


@of_tree(_find_rates_of_bodies)
def _find_rates(
    mechanics: Mechanics, x: Floats, u: Floats, rates: Floats, memory: MechanicsMemory
) -> None:
    """Computes ẋ of a state x = (q, v), of sums or of a tree."""
    n = x.size // 2
    accelerate(mechanics, x, u, 0.0, False, memory)
    for i in range(n):
        rates[i], rates[n + i] = x[n + i], memory.acceleration[0, i]


@kernel
def integrate(
    tables: Any,
    x: Floats,
    u: Floats,
    length: float,
    most: float,
    step: float,
    tolerance: float,
    memory: Any,
    rows: Floats,
) -> tuple[float, float, int]:
    """Moves x on for a time [s] under one control, or until rows are full: times, x and ẋ.

    No step is longer than the most. Returns how long it moved, the next step, 0 if steps vanish,
    and the number of rows.
    """
    tables, memory = borrow(tables), borrow(memory)
    nx, done, h, count, tries = x.size, 0.0, min(step, most, length), 0, 0
    y, K = np.empty(nx), np.empty((7, nx))
    _find_rates(tables, x, u, K[0], memory)
    while tries < MOST_STEPS:
        tries += 1
        is_last = done + h >= length
        used = length - done if is_last else h
        for s in range(1, 7):
            for i in range(nx):
                total = 0.0
                for r in range(s):
                    total += _A[s, r] * K[r, i]
                y[i] = x[i] + used * total
            _find_rates(tables, y, u, K[s], memory)
        error = 0.0
        for i in range(nx):
            total = 0.0
            for s in range(7):
                total += _E[s] * K[s, i]
            error = max(error, abs(used * total) / (1.0 + abs(y[i])))
        if not np.isfinite(error):
            return done, 0.0, count
        scale = 0.9 * (tolerance / max(error, 1e-30)) ** 0.2
        if error > tolerance:
            h = used * max(scale, 0.2)
            continue
        _keep(rows[count], done, x, K[0])
        done, count = length if is_last else done + used, count + 1
        for i in range(nx):
            x[i], K[0, i] = y[i], K[6, i]
        h = max(h, used * min(scale, 4.0)) if is_last else used * min(scale, 4.0)
        h = min(h, most)
        if is_last or count == rows.shape[0] - 1:
            _keep(rows[count], done, x, K[0])
            return done, h, count + 1
    return done, 0.0, count


@borrowing
def _keep(row: Floats, time: float, x: Floats, rates: Floats) -> None:
    row[0] = time
    for i in range(x.size):
        row[1 + i], row[1 + x.size + i] = x[i], rates[i]
