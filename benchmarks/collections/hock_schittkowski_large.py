"""Hock and Schittkowski's polynomial programs of four and more variables, with global optima.

As in `hock_schittkowski`. Left out is 47 too: its (x_2 − x_3)³ falls below the printed 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from benchmarks.collections.hock_schittkowski import hs
from benchmarks.collections.known_optimum import ConstrainedProblem


def large_hock_schittkowski() -> tuple[ConstrainedProblem, ...]:
    """Return those of four to ten variables."""
    return (*_of_four(), *_of_five(), *_of_more())


def _of_four() -> tuple[ConstrainedProblem, ...]:
    r2 = math.sqrt(2.0)
    box = (-10.0, 10.0)
    hs40 = [2.0 ** (-1.0 / 3.0), 2.0**-0.5, 2.0 ** (-11.0 / 12.0), 2.0**-0.25]
    return (
        hs(
            38,
            box,
            0.0,
            [1.0, 1.0, 1.0, 1.0],
            lambda x, y, z, u: (
                100.0 * (y - x**2) ** 2
                + (1.0 - x) ** 2
                + 90.0 * (u - z**2) ** 2
                + (1.0 - z) ** 2
                + 10.1 * ((y - 1.0) ** 2 + (u - 1.0) ** 2)
                + 19.8 * (y - 1.0) * (u - 1.0)
            ),
        ),
        hs(
            39,
            box,
            -1.0,
            [1.0, 1.0, 0.0, 0.0],
            lambda x, y, z, u: -x,
            lambda x, y, z, u: [y - x**3 - z**2, x**2 - y - u**2],
        ),
        hs(
            40,
            box,
            -0.25,
            [hs40, [*hs40[:2], -hs40[2], -hs40[3]]],
            lambda x, y, z, u: -x * y * z * u,
            lambda x, y, z, u: [x**3 + y**2 - 1.0, x**2 * u - z, u**2 - y],
        ),
        hs(
            41,
            (0.0, [1.0, 1.0, 1.0, 2.0]),
            52.0 / 27.0,
            [2.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0, 2.0],
            lambda x, y, z, u: 2.0 - x * y * z,
            lambda x, y, z, u: [x + 2.0 * y + 2.0 * z - u],
        ),
        hs(
            42,
            box,
            28.0 - 10.0 * r2,
            [2.0, 2.0, 0.6 * r2, 0.8 * r2],
            lambda x, y, z, u: (x - 1.0) ** 2 + (y - 2.0) ** 2 + (z - 3.0) ** 2 + (u - 4.0) ** 2,
            lambda x, y, z, u: [x - 2.0, z**2 + u**2 - 2.0],
        ),
        hs(
            43,
            box,
            -44.0,
            [0.0, 1.0, 2.0, -1.0],
            lambda x, y, z, u: (
                x**2 + y**2 + 2.0 * z**2 + u**2 - 5.0 * x - 5.0 * y - 21.0 * z + 7.0 * u
            ),
            inequalities=lambda x, y, z, u: [
                8.0 - x**2 - y**2 - z**2 - u**2 - x + y - z + u,
                10.0 - x**2 - 2.0 * y**2 - z**2 - 2.0 * u**2 + x + u,
                5.0 - 2.0 * x**2 - y**2 - z**2 - 2.0 * x + y + u,
            ],
        ),
        hs(
            44,
            (0.0, 10.0),
            -15.0,
            [0.0, 3.0, 0.0, 4.0],
            lambda x, y, z, u: x - y - z - x * z + x * u + y * z - y * u,
            inequalities=lambda x, y, z, u: [
                8.0 - x - 2.0 * y,
                12.0 - 4.0 * x - y,
                12.0 - 3.0 * x - 4.0 * y,
                8.0 - 2.0 * z - u,
                8.0 - z - 2.0 * u,
                5.0 - z - u,
            ],
        ),
        hs(
            71,
            (1.0, 5.0),
            17.01401728898766,
            [1.0, 4.742999637162256, 3.82114998436479, 1.3794082931250138],
            lambda x, y, z, u: x * u * (x + y + z) + z,
            lambda x, y, z, u: [x**2 + y**2 + z**2 + u**2 - 40.0],
            lambda x, y, z, u: [x * y * z * u - 25.0],
        ),
        hs(
            76,
            (0.0, 10.0),
            -103.0 / 22.0,
            [3.0 / 11.0, 23.0 / 11.0, 0.0, 6.0 / 11.0],
            lambda x, y, z, u: (
                x**2 + 0.5 * y**2 + z**2 + 0.5 * u**2 - x * z + z * u - x - 3.0 * y + z - u
            ),
            inequalities=lambda x, y, z, u: [
                5.0 - x - 2.0 * y - z - u,
                4.0 - 3.0 * x - y - 2.0 * z + u,
                y + 4.0 * z - 1.5,
            ],
        ),
    )


def _of_five() -> tuple[ConstrainedProblem, ...]:
    r2 = math.sqrt(2.0)
    box = (-10.0, 10.0)
    ones = [1.0] * 5

    def three_lines(x: Any, y: Any, z: Any, u: Any, v: Any) -> Sequence[Any]:
        return [x + 3.0 * y, z + u - 2.0 * v, y - v]

    def squares(x: Any, y: Any, z: Any, u: Any, v: Any) -> Sequence[Any]:
        return [(x - y) ** 2, (y + z - 2.0) ** 2, (u - 1.0) ** 2, (v - 1.0) ** 2]

    return (
        hs(
            45,
            (0.0, [1.0, 2.0, 3.0, 4.0, 5.0]),
            1.0,
            [1.0, 2.0, 3.0, 4.0, 5.0],
            lambda x, y, z, u, v: 2.0 - x * y * z * u * v / 120.0,
        ),
        hs(
            48,
            box,
            0.0,
            ones,
            lambda x, y, z, u, v: [(x - 1.0) ** 2, (y - z) ** 2, (u - v) ** 2],
            lambda x, y, z, u, v: [x + y + z + u + v - 5.0, z - 2.0 * (u + v) + 3.0],
        ),
        hs(
            49,
            box,
            0.0,
            ones,
            lambda x, y, z, u, v: [(x - y) ** 2, (z - 1.0) ** 2, (u - 1.0) ** 4, (v - 1.0) ** 6],
            lambda x, y, z, u, v: [x + y + z + 4.0 * u - 7.0, z + 5.0 * v - 6.0],
        ),
        hs(
            50,
            box,
            0.0,
            ones,
            lambda x, y, z, u, v: [(x - y) ** 2, (y - z) ** 2, (z - u) ** 4, (u - v) ** 2],
            lambda x, y, z, u, v: [
                x + 2.0 * y + 3.0 * z - 6.0,
                y + 2.0 * z + 3.0 * u - 6.0,
                z + 2.0 * u + 3.0 * v - 6.0,
            ],
        ),
        hs(
            51,
            box,
            0.0,
            ones,
            squares,
            lambda x, y, z, u, v: [x + 3.0 * y - 4.0, z + u - 2.0 * v, y - v],
        ),
        hs(
            52,
            box,
            1859.0 / 349.0,
            [x / 349.0 for x in (-33.0, 11.0, 180.0, -158.0, 11.0)],
            lambda x, y, z, u, v: [
                (4.0 * x - y) ** 2,
                (y + z - 2.0) ** 2,
                (u - 1.0) ** 2,
                (v - 1.0) ** 2,
            ],
            three_lines,
        ),
        hs(
            53,
            box,
            176.0 / 43.0,
            [x / 43.0 for x in (-33.0, 11.0, 27.0, -5.0, 11.0)],
            squares,
            three_lines,
        ),
        hs(
            78,
            box,
            -2.9197004089677248,
            [
                -1.7171435703323592,
                1.5957096901117527,
                1.8272457530425963,
                -0.7636430781277805,
                -0.7636430782552537,
            ],
            lambda x, y, z, u, v: x * y * z * u * v,
            lambda x, y, z, u, v: [
                x**2 + y**2 + z**2 + u**2 + v**2 - 10.0,
                y * z - 5.0 * u * v,
                x**3 + y**3 + 1.0,
            ],
        ),
        hs(
            79,
            box,
            0.07877682087105692,
            [
                1.1911274561801808,
                1.3626031650962303,
                1.472817931475878,
                1.635016618926845,
                1.679081436350889,
            ],
            lambda x, y, z, u, v: [
                (x - 1.0) ** 2,
                (x - y) ** 2,
                (y - z) ** 2,
                (z - u) ** 4,
                (u - v) ** 4,
            ],
            lambda x, y, z, u, v: [
                x + y**2 + z**3 - 2.0 - 3.0 * r2,
                y - z**2 + u + 2.0 - 2.0 * r2,
                x * v - 2.0,
            ],
        ),
        hs(
            83,
            ([78.0, 33.0, 27.0, 27.0, 27.0], [102.0, 45.0, 45.0, 45.0, 45.0]),
            -30665.538675087817,
            [78.0, 33.0, 29.99525601434483, 45.0, 36.775812910994624],
            lambda x, y, z, u, v: 5.3578547 * z**2 + 0.8356891 * x * v + 37.293239 * x - 40792.141,
            inequalities=_hs83_rows,
        ),
    )


def _hs83_rows(x: Any, y: Any, z: Any, u: Any, v: Any) -> Sequence[Any]:
    first = 85.334407 + 0.0056858 * y * v + 0.0006262 * x * u - 0.0022053 * z * v
    second = 80.51249 + 0.0071317 * y * v + 0.0029955 * x * y + 0.0021813 * z**2 - 90.0
    third = 9.300961 + 0.0047026 * z * v + 0.0012547 * x * z + 0.0019085 * z * u - 20.0
    return [first, 92.0 - first, second, 20.0 - second, third, 5.0 - third]


def _of_more() -> tuple[ConstrainedProblem, ...]:
    # Two corners of 108's regular hexagon, turned by 10°; the optimum is the same at any angle.
    hexagon = [f(math.radians(angle)) for angle in (10.0, 70.0) for f in (math.cos, math.sin)]
    return (
        hs(
            100,
            (-20.0, 20.0),
            680.6300573744016,
            [
                2.330499372886118,
                1.9513723728981054,
                -0.47754139236830745,
                4.365726233651436,
                -0.6244869705342273,
                1.0381310185892414,
                1.5942267116070585,
            ],
            lambda x1, x2, x3, x4, x5, x6, x7: (
                (x1 - 10.0) ** 2
                + 5.0 * (x2 - 12.0) ** 2
                + x3**4
                + 3.0 * (x4 - 11.0) ** 2
                + 10.0 * x5**6
                + 7.0 * x6**2
                + x7**4
                - 4.0 * x6 * x7
                - 10.0 * x6
                - 8.0 * x7
            ),
            inequalities=lambda x1, x2, x3, x4, x5, x6, x7: [
                127.0 - 2.0 * x1**2 - 3.0 * x2**4 - x3 - 4.0 * x4**2 - 5.0 * x5,
                282.0 - 7.0 * x1 - 3.0 * x2 - 10.0 * x3**2 - x4 + x5,
                196.0 - 23.0 * x1 - x2**2 - 6.0 * x6**2 + 8.0 * x7,
                -4.0 * x1**2 - x2**2 + 3.0 * x1 * x2 - 2.0 * x3**2 - 5.0 * x6 + 11.0 * x7,
            ],
        ),
        hs(
            106,
            ([100.0, 1e3, 1e3, *[10.0] * 5], [1e4, 1e4, 1e4, *[1e3] * 5]),
            7049.248020527738,
            [
                579.3066844214467,
                1359.9706680321547,
                5109.9706680741365,
                182.0176995807935,
                295.60117327703455,
                217.9823004192065,
                286.4165263038301,
                395.60117327703455,
            ],
            lambda x1, x2, x3, *_: x1 + x2 + x3,
            inequalities=lambda x1, x2, x3, x4, x5, x6, x7, x8: [
                1.0 - 0.0025 * (x4 + x6),
                1.0 - 0.0025 * (x5 + x7 - x4),
                1.0 - 0.01 * (x8 - x5),
                x1 * x6 - 833.33252 * x4 - 100.0 * x1 + 83333.333,
                x2 * x7 - 1250.0 * x5 - x2 * x4 + 1250.0 * x4,
                x3 * x8 - 1.25e6 - x3 * x5 + 2500.0 * x5,
            ],
        ),
        hs(
            108,
            ([*[-1.0] * 8, 0.0], 1.0),
            -math.sqrt(3.0) / 2.0,
            [*hexagon, *hexagon, 0.0],
            lambda a, b, c, d, e, f, g, h, i: (
                -0.5 * (a * d - b * c + c * i - e * i + e * h - f * g)
            ),
            inequalities=_hs108_rows,
        ),
        hs(
            113,
            (-10.0, 10.0),
            24.306209068179662,
            [
                2.171996371267743,
                2.363682973666496,
                8.773925738470606,
                5.095984487941325,
                0.990654764880567,
                1.4305739787559935,
                1.32164420818573,
                9.828725807905974,
                8.280091670115588,
                8.375926663884497,
            ],
            _hs113_cost,
            inequalities=_hs113_rows,
        ),
    )


def _hs108_rows(
    a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any, i: Any
) -> Sequence[Any]:
    return [
        1.0 - c**2 - d**2,
        1.0 - i**2,
        1.0 - e**2 - f**2,
        1.0 - a**2 - (b - i) ** 2,
        1.0 - (a - e) ** 2 - (b - f) ** 2,
        1.0 - (a - g) ** 2 - (b - h) ** 2,
        1.0 - (c - e) ** 2 - (d - f) ** 2,
        1.0 - (c - g) ** 2 - (d - h) ** 2,
        1.0 - g**2 - (h - i) ** 2,
        a * d - b * c,
        c * i,
        -e * i,
        e * h - f * g,
    ]


def _hs113_cost(*x: Any) -> Any:
    a, b, c, d, e, f, g, h, i, j = x
    return (
        a**2 + b**2 + a * b - 14.0 * a - 16.0 * b + (c - 10.0) ** 2 + 4.0 * (d - 5.0) ** 2
        + (e - 3.0) ** 2 + 2.0 * (f - 1.0) ** 2 + 5.0 * g**2 + 7.0 * (h - 11.0) ** 2
        + 2.0 * (i - 10.0) ** 2 + (j - 7.0) ** 2 + 45.0
    )  # fmt: skip


def _hs113_rows(*x: Any) -> Sequence[Any]:
    a, b, c, d, e, f, g, h, i, j = x
    return [
        105.0 - 4.0 * a - 5.0 * b + 3.0 * g - 9.0 * h,
        -10.0 * a + 8.0 * b + 17.0 * g - 2.0 * h,
        8.0 * a - 2.0 * b - 5.0 * i + 2.0 * j + 12.0,
        120.0 - 3.0 * (a - 2.0) ** 2 - 4.0 * (b - 3.0) ** 2 - 2.0 * c**2 + 7.0 * d,
        40.0 - 5.0 * a**2 - 8.0 * b - (c - 6.0) ** 2 + 2.0 * d,
        30.0 - 0.5 * (a - 8.0) ** 2 - 2.0 * (b - 4.0) ** 2 - 3.0 * e**2 + f,
        -(a**2) - 2.0 * (b - 2.0) ** 2 + 2.0 * a * b - 14.0 * e + 6.0 * f,
        3.0 * a - 6.0 * b - 12.0 * (i - 8.0) ** 2 + 7.0 * j,
    ]
