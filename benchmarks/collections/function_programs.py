"""Constrained programs of the literature with sin, exp, log, roots and quotients, global optima.

Of Hock & Schittkowski (1981), Test Examples for Nonlinear Programming Codes, Springer LNEMS 187,
and of others that are named. Variables without bounds are given some that the optimum is within;
those under a logarithm or a quotient a lower one above 0, where the source has 0.
"""

from __future__ import annotations

import math
from typing import Any

from pydrake.math import cos, exp, log, sin, sqrt

from benchmarks.collections.hock_schittkowski import hs
from benchmarks.collections.known_optimum import ConstrainedProblem

LIANG = (
    "Liang et al. (2006), Problem Definitions and Evaluation Criteria for the CEC 2006 Special "
    "Session on Constrained Real-Parameter Optimization"
)


def function_programs() -> tuple[ConstrainedProblem, ...]:
    """Return all of them."""
    return (*_few_variables(), *_many_variables(), *_power_lines(), *_of_engineering())


def _few_variables() -> tuple[ConstrainedProblem, ...]:
    third = math.pi / 3.0
    return (
        hs(
            5,
            ([-1.5, -3.0], [4.0, 3.0]),
            -math.sqrt(3.0) / 2.0 - third,
            [0.5 - third, -0.5 - third],
            lambda x, y: sin(x + y) + (x - y) ** 2 - 1.5 * x + 2.5 * y + 1.0,
        ),
        hs(
            7,
            (-10.0, 10.0),
            -math.sqrt(3.0),
            [0.0, math.sqrt(3.0)],
            lambda x, y: log(1.0 + x**2) - y,
            lambda x, y: [(1.0 + x**2) ** 2 + y**2 - 4.0],
        ),
        hs(
            9,
            (-10.0, 10.0),
            -0.5,
            [-3.0, -4.0],
            lambda x, y: sin(math.pi * x / 12.0) * cos(math.pi * y / 16.0),
            lambda x, y: [4.0 * x - 3.0 * y],
        ),
        hs(
            34,
            (0.0, [100.0, 100.0, 10.0]),
            -math.log(math.log(10.0)),
            [math.log(math.log(10.0)), math.log(10.0), 10.0],
            lambda x, y, z: -x,
            inequalities=lambda x, y, z: [y - exp(x), z - exp(y)],
        ),
        hs(
            62,
            (0.0, 1.0),
            -26272.51448732092,
            [0.6178126377169472, 0.3282022716240034, 0.05398509065947027],
            _hs62,
            lambda x, y, z: [x + y + z - 1.0],
        ),
        hs(
            66,
            (0.0, [100.0, 100.0, 10.0]),
            0.5181632741815213,
            [0.18412648792285555, 1.2021678731970382, 3.3273223225990285],
            lambda x, y, z: 0.2 * z - 0.8 * x,
            inequalities=lambda x, y, z: [y - exp(x), z - exp(y)],
        ),
        ConstrainedProblem(
            "g06",
            ([13.0, 0.0], 100.0),
            4.095**3 - (15.0 + math.sqrt(100.0 - 9.095**2)) ** 3,
            [14.095, 5.0 - math.sqrt(100.0 - 9.095**2)],
            lambda x, y: (x - 10.0) ** 3 + (y - 20.0) ** 3,
            inequalities=lambda x, y: [
                (x - 5.0) ** 2 + (y - 5.0) ** 2 - 100.0,
                82.81 - (x - 6.0) ** 2 - (y - 5.0) ** 2,
            ],
            source=LIANG,
        ),
        ConstrainedProblem(
            "g08",
            (0.1, 10.0),
            -0.09582504141803581,
            [1.2279713527640506, 4.245373366458857],
            lambda x, y: -(sin(2.0 * math.pi * x) ** 3) * sin(2.0 * math.pi * y) / (x**3 * (x + y)),
            inequalities=lambda x, y: [y - x**2 - 1.0, x - 1.0 - (y - 4.0) ** 2],
            source=f"{LIANG}; x ≥ 0.1, as its formula is not defined at 0",
        ),
        ConstrainedProblem(
            "g15",
            (0.0, 10.0),
            961.7151721300515,
            [3.5121213418753925, 0.2169879415151328, 3.5521711548264276],
            lambda x, y, z: 1000.0 - x**2 - 2.0 * y**2 - z**2 - x * y - x * z,
            equalities=lambda x, y, z: [
                x**2 + y**2 + z**2 - 25.0,
                8.0 * x + 14.0 * y + 7.0 * z - 56.0,
            ],
            source=LIANG,
        ),
    )


def _hs62(x: Any, y: Any, z: Any) -> list[Any]:
    return [
        -32.174 * weight * log((part * first + rest + 0.03) / (share * first + rest + 0.03))
        for weight, part, share, first, rest in (
            (255.0, 1.0, 0.09, x, y + z),
            (280.0, 1.0, 0.07, y, z),
            (290.0, 1.0, 0.13, z, 0.0),
        )
    ]


def _many_variables() -> tuple[ConstrainedProblem, ...]:
    return (
        hs(
            55,
            (0.0, [1.0, 10.0, 10.0, 1.0, 10.0, 10.0]),
            19.0 / 3.0,
            [0.0, 4.0 / 3.0, 5.0 / 3.0, 1.0, 2.0 / 3.0, 1.0 / 3.0],
            lambda a, b, c, d, e, f: a + 2.0 * b + 4.0 * e + exp(a * d),
            lambda a, b, c, d, e, f: [
                a + 2.0 * b + 5.0 * e - 6.0,
                a + b + c - 3.0,
                d + e + f - 2.0,
                a + d - 1.0,
                b + e - 2.0,
                c + f - 2.0,
            ],
        ),
        hs(
            56,
            ([0.0] * 3 + [0.0] * 4, [10.0] * 3 + [math.pi / 2.0] * 4),
            -3.456,
            [2.4, 1.2, 1.2, *(math.asin(math.sqrt(k / 7.0)) for k in (4, 2, 2)), math.pi / 2.0],
            lambda a, b, c, *_: -a * b * c,
            lambda a, b, c, d, e, f, g: [
                a - 4.2 * sin(d) ** 2,
                b - 4.2 * sin(e) ** 2,
                c - 4.2 * sin(f) ** 2,
                a + 2.0 * b + 2.0 * c - 7.2 * sin(g) ** 2,
            ],
        ),
        hs(
            72,
            (1e-3, [4e5, 3e5, 2e5, 1e5]),
            727.679357778771,
            [193.4074274833534, 179.54707566770813, 185.01806342385746, 168.70679120385194],
            lambda a, b, c, d: 1.0 + a + b + c + d,
            inequalities=lambda a, b, c, d: [
                0.0401 - 4.0 / a - 2.25 / b - 1.0 / c - 0.25 / d,
                0.010085 - 0.16 / a - 0.36 / b - 0.64 / c - 0.64 / d,
            ],
        ),
        hs(
            73,
            (0.0, 1.0),
            29.894378159143354,
            [0.6355215686350695, 0.0, 0.3127018807515236, 0.0517765506134068],
            lambda a, b, c, d: 24.55 * a + 26.75 * b + 39.0 * c + 40.5 * d,
            lambda a, b, c, d: [a + b + c + d - 1.0],
            lambda a, b, c, d: [
                2.3 * a + 5.6 * b + 11.1 * c + 1.3 * d - 5.0,
                12.0 * a
                + 11.9 * b
                + 41.8 * c
                + 52.1 * d
                - 21.0
                - 1.645 * sqrt(0.28 * a**2 + 0.19 * b**2 + 20.5 * c**2 + 0.62 * d**2),
            ],
        ),
        *(_hs80(number) for number in (80, 81)),
        _hs104(),
        _hs110(),
        _hs112(),
    )


def _hs80(number: int) -> ConstrainedProblem:
    """The same optimum, with a penalty in the cost or without."""
    weight = 0.5 if number == 81 else 0.0
    best = [-1.7171435703944475, 1.59570969018363, 1.827245752927074]
    best += [-0.7636430781843198, -0.7636430781839268]

    def costs(a: Any, b: Any, c: Any, d: Any, e: Any) -> list[Any]:
        penalty = [-weight * (a**3 + b**3 + 1.0) ** 2] if weight else []
        return [exp(a * b * c * d * e), *penalty]

    return hs(
        number,
        ([-2.3, -2.3, -3.2, -3.2, -3.2], [2.3, 2.3, 3.2, 3.2, 3.2]),
        0.05394984777027188,
        best,
        costs,
        lambda a, b, c, d, e: [
            a**2 + b**2 + c**2 + d**2 + e**2 - 10.0,
            b * c - 5.0 * d * e,
            a**3 + b**3 + 1.0,
        ],
    )


def _hs104() -> ConstrainedProblem:
    def inequalities(a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any) -> list[Any]:
        cost = 0.4 * a**0.67 * g**-0.67 + 0.4 * b**0.67 * h**-0.67 + 10.0 - a - b
        return [
            1.0 - 0.0588 * e * g - 0.1 * a,
            1.0 - 0.0588 * f * h - 0.1 * a - 0.1 * b,
            1.0 - 4.0 * c / e - 2.0 * c**-0.71 / e - 0.0588 * c**-1.3 * g,
            1.0 - 4.0 * d / f - 2.0 * d**-0.71 / f - 0.0588 * d**-1.3 * h,
            cost - 1.0,
            4.2 - cost,
        ]

    best = [6.46511402837355, 2.232708647983079, 0.6673974912873686, 0.5957564229002391]
    best += [5.9326756779078185, 5.527234564976812, 1.0133220089016433, 0.4006682291256251]
    return hs(
        104,
        (0.1, 10.0),
        3.9511634401018836,
        best,
        lambda a, b, c, d, e, f, g, h: [
            0.4 * a**0.67 * g**-0.67,
            0.4 * b**0.67 * h**-0.67,
            10.0 - a - b,
        ],
        inequalities=inequalities,
    )


def _hs110() -> ConstrainedProblem:
    return hs(
        110,
        (2.001, 9.999),
        -45.778469707446305,
        [9.35026583306935] * 10,
        lambda *x: [
            *(log(x_i - 2.0) ** 2 + log(10.0 - x_i) ** 2 for x_i in x),
            -(math.prod(x) ** 0.2),
        ],
    )


def _hs112() -> ConstrainedProblem:
    """Chemical equilibrium: Σ x_j (c_j + log(x_j / Σ x)) is least."""
    numbers = [-6.089, -17.164, -34.054, -5.914, -24.721]
    numbers += [-14.986, -24.1, -10.708, -26.662, -22.179]
    best = [0.04066808718024913, 0.14773035231543216, 0.7831533573756146, 0.0014142199117506422]
    best += [0.48524664766908976, 0.0006931721490701209, 0.027399312600999873]
    best += [0.01794727930471233, 0.03731436471504298, 0.0968713212885872]
    return hs(
        112,
        (1e-6, 2.0),
        -47.76109085936587,
        best,
        lambda *x: [x_j * (c_j + log(x_j / sum(x))) for c_j, x_j in zip(numbers, x, strict=True)],
        lambda *x: [
            x[0] + 2.0 * x[1] + 2.0 * x[2] + x[5] + x[9] - 2.0,
            x[3] + 2.0 * x[4] + x[5] + x[6] - 1.0,
            x[2] + x[6] + x[7] + 2.0 * x[8] + x[9] - 1.0,
        ],
    )


def _power_lines() -> tuple[ConstrainedProblem, ...]:
    """Return dispatch of two generators over lines, for two largest angles."""
    wide = [679.9453198511983, 1026.0671326104784, 0.11887636449311138, -0.3962335532032057]
    narrow = [776.159026586055, 925.1951384690933, 0.05110892853835341, -0.42889107146164657]
    return (
        _dispatch(74, 0.55, 5126.49810959527, wide),
        _dispatch(75, 0.48, 5174.412695377725, narrow),
    )


def _dispatch(number: int, most: float, minimum: float, best: list[float]) -> ConstrainedProblem:
    """Return the program of a largest angle between the two [rad]."""
    return hs(
        number,
        ([0.0, 0.0, -most, -most], [1200.0, 1200.0, most, most]),
        minimum,
        best,
        lambda p, q, u, v: [3.0 * p + 1e-6 * p**3 + 2.0 * q, 2e-6 / 3.0 * q**3],
        lambda p, q, u, v: [
            1000.0 * sin(-u - 0.25) + 1000.0 * sin(-v - 0.25) + 894.8 - p,
            1000.0 * sin(u - 0.25) + 1000.0 * sin(u - v - 0.25) + 894.8 - q,
            1000.0 * sin(v - 0.25) + 1000.0 * sin(v - u - 0.25) + 1294.8,
        ],
        lambda p, q, u, v: [v - u + most, u - v + most],
    )


def _of_engineering() -> tuple[ConstrainedProblem, ...]:
    root = math.sqrt(2.0)
    return (
        ConstrainedProblem(
            "three-bar truss",
            (0.01, 1.0),
            100.0 * (math.sqrt(2.0) + math.sqrt(6.0) / 2.0),
            [(3.0 + math.sqrt(3.0)) / 6.0, 1.0 / math.sqrt(6.0)],
            lambda x, y: 100.0 * (2.0 * root * x + y),
            inequalities=lambda x, y: [
                1.0 - (root * x + y) / (root * x**2 + 2.0 * x * y),
                1.0 - y / (root * x**2 + 2.0 * x * y),
                1.0 - 1.0 / (x + root * y),
            ],
            source="Ray & Saini (2001), Engineering Optimization 33:735-748, stresses over 2",
        ),
        ConstrainedProblem(
            "tension spring",
            ([0.05, 0.25, 2.0], [0.2, 1.3, 15.0]),
            0.012665232788317778,
            [0.05168906108258022, 0.35671773979511323, 11.288965751867055],
            lambda d, w, n: (n + 2.0) * w * d**2,
            inequalities=lambda d, w, n: [
                w**3 * n / (71785.0 * d**4) - 1.0,
                1.0 - (4.0 * w**2 - d * w) / (12566.0 * (w * d**3 - d**4)) - 1.0 / (5108.0 * d**2),
                140.45 * d / (w**2 * n) - 1.0,
                1.5 - w - d,
            ],
            source="Arora (1989), Introduction to Optimum Design, McGraw-Hill; d ≤ 0.2 and "
            "not 2, as a row has no value where d = w",
        ),
        ConstrainedProblem(
            "speed reducer",
            ([2.6, 0.7, 17.0, 7.3, 7.3, 2.9, 5.0], [3.6, 0.8, 28.0, 8.3, 8.3, 3.9, 5.5]),
            2994.47106614532,
            [3.5, 0.7, 17.0, 7.3, 7.715319911476177, 3.3502146660953356, 5.286654464978468],
            _speed_reducer,
            inequalities=_speed_reducer_rows,
            source="Golinski (1970), Journal of Mechanisms 5:287-309; real teeth, 7.3 ≤ x₅",
        ),
    )


def _speed_reducer(b: Any, m: Any, z: Any, p: Any, q: Any, d: Any, e: Any) -> list[Any]:
    return [
        0.7854 * b * m**2 * (3.3333 * z**2 + 14.9334 * z - 43.0934),
        -1.508 * b * (d**2 + e**2),
        7.4777 * (d**3 + e**3),
        0.7854 * (p * d**2 + q * e**2),
    ]


def _speed_reducer_rows(b: Any, m: Any, z: Any, p: Any, q: Any, d: Any, e: Any) -> list[Any]:
    return [
        1.0 - 27.0 / (b * m**2 * z),
        1.0 - 397.5 / (b * m**2 * z**2),
        1.0 - 1.93 * p**3 / (m * z * d**4),
        1.0 - 1.93 * q**3 / (m * z * e**4),
        1.0 - sqrt((745.0 * p / (m * z)) ** 2 + 16.9e6) / (110.0 * d**3),
        1.0 - sqrt((745.0 * q / (m * z)) ** 2 + 157.5e6) / (85.0 * e**3),
        1.0 - m * z / 40.0,
        1.0 - 5.0 * m / b,
        1.0 - b / (12.0 * m),
        1.0 - (1.5 * d + 1.9) / p,
        1.0 - (1.1 * e + 1.9) / q,
    ]
