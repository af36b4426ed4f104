"""Hock and Schittkowski's polynomial programs of two and three variables, with global optima.

Hock & Schittkowski (1981), Test Examples for Nonlinear Programming Codes, Springer LNEMS 187.
Left out: what has sin, exp, log or quotients (`function_programs`); 8, which has no cost; and 13,
whose constraints are tangent, so that points feasible to 1e-8 cost 0.004 less. Variables without
bounds are given ±10, or as much as the optimum needs.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from numpy.typing import ArrayLike

from benchmarks.collections.known_optimum import ConstrainedProblem, Rows, no_rows

_INF = 10.0  # in place of no bound


def small_hock_schittkowski() -> tuple[ConstrainedProblem, ...]:
    """Return those of two and three variables."""
    return (*_in_the_plane(), *_in_space())


def hs(
    number: int,
    box: tuple[ArrayLike, ArrayLike],
    minimum: float,
    minimizers: ArrayLike,
    costs: Callable[..., Any],
    equalities: Rows = no_rows,
    inequalities: Rows = no_rows,
) -> ConstrainedProblem:
    """Return a problem of the book; arguments as in `ConstrainedProblem`."""
    return ConstrainedProblem(
        f"HS {number}",
        box,
        minimum,
        minimizers,
        costs,
        equalities=equalities,
        inequalities=inequalities,
        source=f"Hock & Schittkowski (1981), problem {number}",
    )


def _rosenbrock(x: Any, y: Any) -> Any:
    return 100.0 * (y - x**2) ** 2 + (1.0 - x) ** 2


def _in_the_plane() -> tuple[ConstrainedProblem, ...]:
    r3, r7 = math.sqrt(3.0), math.sqrt(7.0)
    a = math.sqrt(598.0 / 1200.0)
    hs2 = 2.0 * a * math.cos(math.acos(1.0 / (400.0 * a**3)) / 3.0)
    b = (7.5 * math.sqrt(6.0) + math.sqrt(338.5)) ** (1.0 / 3.0)
    hs11 = (b - 1.0 / b) / math.sqrt(6.0)
    hs19 = 5.0 - math.sqrt(100.0 - (14.095 - 5.0) ** 2)
    box = (-_INF, _INF)
    positive = (0.0, _INF)
    return (
        hs(1, ([-_INF, -1.5], _INF), 0.0, [1.0, 1.0], _rosenbrock),
        hs(2, ([-_INF, 1.5], _INF), _rosenbrock(hs2, 1.5), [hs2, 1.5], _rosenbrock),
        hs(3, ([-_INF, 0.0], _INF), 0.0, [0.0, 0.0], lambda x, y: y + 1e-5 * (y - x) ** 2),
        hs(4, ([1.0, 0.0], _INF), 8.0 / 3.0, [1.0, 0.0], lambda x, y: (x + 1.0) ** 3 / 3.0 + y),
        hs(6, box, 0.0, [1.0, 1.0], lambda x, y: (1.0 - x) ** 2, lambda x, y: [10.0 * (y - x**2)]),
        hs(
            10,
            box,
            -1.0,
            [0.0, 1.0],
            lambda x, y: x - y,
            inequalities=lambda x, y: [1.0 - 3.0 * x**2 + 2.0 * x * y - y**2],
        ),
        hs(
            11,
            box,
            (hs11 - 5.0) ** 2 + hs11**4 - 25.0,
            [hs11, hs11**2],
            lambda x, y: (x - 5.0) ** 2 + y**2 - 25.0,
            inequalities=lambda x, y: [y - x**2],
        ),
        hs(
            12,
            box,
            -30.0,
            [2.0, 3.0],
            lambda x, y: 0.5 * x**2 + y**2 - x * y - 7.0 * x - 7.0 * y,
            inequalities=lambda x, y: [25.0 - 4.0 * x**2 - y**2],
        ),
        hs(
            14,
            box,
            9.0 - 2.875 * r7,
            [(r7 - 1.0) / 2.0, (r7 + 1.0) / 4.0],
            lambda x, y: (x - 2.0) ** 2 + (y - 1.0) ** 2,
            lambda x, y: [x - 2.0 * y + 1.0],
            lambda x, y: [1.0 - 0.25 * x**2 - y**2],
        ),
        hs(
            15,
            (-_INF, [0.5, _INF]),
            306.5,
            [0.5, 2.0],
            _rosenbrock,
            inequalities=lambda x, y: [x * y - 1.0, x + y**2],
        ),
        hs(
            16,
            ([-0.5, -_INF], [0.5, 1.0]),
            0.25,
            [0.5, 0.25],
            _rosenbrock,
            inequalities=lambda x, y: [x + y**2, x**2 + y],
        ),
        hs(
            17,
            ([-0.5, -_INF], [0.5, 1.0]),
            1.0,
            [0.0, 0.0],
            _rosenbrock,
            inequalities=lambda x, y: [y**2 - x, x**2 - y],
        ),
        hs(
            18,
            ([2.0, 0.0], 50.0),
            5.0,
            [math.sqrt(250.0), math.sqrt(2.5)],
            lambda x, y: 0.01 * x**2 + y**2,
            inequalities=lambda x, y: [x * y - 25.0, x**2 + y**2 - 25.0],
        ),
        hs(
            19,
            ([13.0, 0.0], 100.0),
            (14.095 - 10.0) ** 3 + (hs19 - 20.0) ** 3,
            [14.095, hs19],
            lambda x, y: (x - 10.0) ** 3 + (y - 20.0) ** 3,
            inequalities=lambda x, y: [
                (x - 5.0) ** 2 + (y - 5.0) ** 2 - 100.0,
                82.81 - (y - 5.0) ** 2 - (x - 6.0) ** 2,
            ],
        ),
        hs(
            20,
            ([-0.5, -_INF], [0.5, _INF]),
            81.5 - 25.0 * r3,
            [0.5, r3 / 2.0],
            _rosenbrock,
            inequalities=lambda x, y: [x + y**2, x**2 + y, x**2 + y**2 - 1.0],
        ),
        hs(
            21,
            ([2.0, -50.0], 50.0),
            -99.96,
            [2.0, 0.0],
            lambda x, y: 0.01 * x**2 + y**2 - 100.0,
            inequalities=lambda x, y: [10.0 * x - y - 10.0],
        ),
        hs(
            22,
            box,
            1.0,
            [1.0, 1.0],
            lambda x, y: (x - 2.0) ** 2 + (y - 1.0) ** 2,
            inequalities=lambda x, y: [2.0 - x - y, y - x**2],
        ),
        hs(
            23,
            (-50.0, 50.0),
            2.0,
            [1.0, 1.0],
            lambda x, y: x**2 + y**2,
            inequalities=lambda x, y: [
                x + y - 1.0,
                x**2 + y**2 - 1.0,
                9.0 * x**2 + y**2 - 9.0,
                x**2 - y,
                y**2 - x,
            ],
        ),
        hs(
            24,
            positive,
            -1.0,
            [3.0, r3],
            lambda x, y: ((x - 3.0) ** 2 - 9.0) * y**3 / (27.0 * r3),
            inequalities=lambda x, y: [x / r3 - y, x + r3 * y, 6.0 - x - r3 * y],
        ),
    )


def _in_space() -> tuple[ConstrainedProblem, ...]:
    r2, r3 = math.sqrt(2.0), math.sqrt(3.0)
    box = (-_INF, _INF)
    positive = (0.0, _INF)
    return (
        hs(
            26,
            box,
            0.0,
            [1.0, 1.0, 1.0],
            lambda x, y, z: [(x - y) ** 2, (y - z) ** 4],
            lambda x, y, z: [(1.0 + y**2) * x + z**4 - 3.0],
        ),
        hs(
            27,
            box,
            0.04,
            [-1.0, 1.0, 0.0],
            lambda x, y, z: 0.01 * (x - 1.0) ** 2 + (y - x**2) ** 2,
            lambda x, y, z: [x + z**2 + 1.0],
        ),
        hs(
            28,
            box,
            0.0,
            [0.5, -0.5, 0.5],
            lambda x, y, z: (x + y) ** 2 + (y + z) ** 2,
            lambda x, y, z: [x + 2.0 * y + 3.0 * z - 1.0],
        ),
        hs(
            29,
            box,
            -16.0 * r2,
            [[4.0, 2.0 * r2, 2.0], [4.0, -2.0 * r2, -2.0], [-4.0, 2.0 * r2, -2.0]],
            lambda x, y, z: -x * y * z,
            inequalities=lambda x, y, z: [48.0 - x**2 - 2.0 * y**2 - 4.0 * z**2],
        ),
        hs(
            30,
            ([1.0, -10.0, -10.0], 10.0),
            1.0,
            [1.0, 0.0, 0.0],
            lambda x, y, z: x**2 + y**2 + z**2,
            inequalities=lambda x, y, z: [x**2 + y**2 - 1.0],
        ),
        hs(
            31,
            ([-10.0, 1.0, -10.0], [10.0, 10.0, 1.0]),
            6.0,
            [1.0 / r3, r3, 0.0],
            lambda x, y, z: 9.0 * x**2 + y**2 + 9.0 * z**2,
            inequalities=lambda x, y, z: [x * y - 1.0],
        ),
        hs(
            32,
            positive,
            1.0,
            [0.0, 0.0, 1.0],
            lambda x, y, z: (x + 3.0 * y + z) ** 2 + 4.0 * (x - y) ** 2,
            lambda x, y, z: [1.0 - x - y - z],
            lambda x, y, z: [6.0 * y + 4.0 * z - x**3 - 3.0],
        ),
        hs(
            33,
            (0.0, [_INF, _INF, 5.0]),
            r2 - 6.0,
            [0.0, r2, r2],
            lambda x, y, z: (x - 1.0) * (x - 2.0) * (x - 3.0) + z,
            inequalities=lambda x, y, z: [z**2 - y**2 - x**2, x**2 + y**2 + z**2 - 4.0],
        ),
        hs(
            35,
            positive,
            1.0 / 9.0,
            [4.0 / 3.0, 7.0 / 9.0, 4.0 / 9.0],
            lambda x, y, z: (
                9.0
                - 8.0 * x
                - 6.0 * y
                - 4.0 * z
                + 2.0 * x**2
                + 2.0 * y**2
                + z**2
                + 2.0 * x * y
                + 2.0 * x * z
            ),
            inequalities=lambda x, y, z: [3.0 - x - y - 2.0 * z],
        ),
        hs(
            36,
            (0.0, [20.0, 11.0, 42.0]),
            -3300.0,
            [20.0, 11.0, 15.0],
            lambda x, y, z: -x * y * z,
            inequalities=lambda x, y, z: [72.0 - x - 2.0 * y - 2.0 * z],
        ),
        hs(
            37,
            (0.0, 42.0),
            -3456.0,
            [24.0, 12.0, 12.0],
            lambda x, y, z: -x * y * z,
            inequalities=lambda x, y, z: [72.0 - x - 2.0 * y - 2.0 * z, x + 2.0 * y + 2.0 * z],
        ),
        hs(
            60,
            box,
            0.0325682002513,
            [1.104859024, 1.196674194, 1.535262257],
            lambda x, y, z: [(x - 1.0) ** 2, (x - y) ** 2, (y - z) ** 4],
            lambda x, y, z: [x * (1.0 + y**2) + z**4 - 4.0 - 3.0 * r2],
        ),
        hs(
            61,
            box,
            -143.6461422,
            [5.326770157, -2.118998639, 3.210464239],
            lambda x, y, z: 4.0 * x**2 + 2.0 * y**2 + 2.0 * z**2 - 33.0 * x + 16.0 * y - 24.0 * z,
            lambda x, y, z: [3.0 * x - 2.0 * y**2 - 7.0, 4.0 * x - z**2 - 11.0],
        ),
        hs(
            63,
            positive,
            961.7151721291149,
            [3.512121341459166, 0.21698794149263062, 3.5521711553471205],
            lambda x, y, z: 1000.0 - x**2 - 2.0 * y**2 - z**2 - x * y - x * z,
            lambda x, y, z: [8.0 * x + 14.0 * y + 7.0 * z - 56.0, x**2 + y**2 + z**2 - 25.0],
        ),
        hs(
            65,
            ([-4.5, -4.5, -5.0], [4.5, 4.5, 5.0]),
            0.953528856804766,
            [3.6504617252275393, 3.6504617252368674, 4.620417555289745],
            lambda x, y, z: (x - y) ** 2 + (x + y - 10.0) ** 2 / 9.0 + (z - 5.0) ** 2,
            inequalities=lambda x, y, z: [48.0 - x**2 - y**2 - z**2],
        ),
    )
