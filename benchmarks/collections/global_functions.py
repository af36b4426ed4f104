"""The test functions of the global-optimization literature, polynomial or with sin and cos.

Each is written from its formula, at the box and with the minimum that its source gives, or with the
better one where the source errs.
"""

from __future__ import annotations

import itertools
from functools import partial
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from benchmarks.collections.known_optimum import GlobalProblem, Part
from benchmarks.collections.scalable_functions import (
    JAMIL,
    LAGUNA,
    scalable_problems,
    sparse_problems,
)


def global_problems() -> tuple[GlobalProblem, ...]:
    """Return all test functions, those of few variables first."""
    sparse = [problem for problem in sparse_problems() if problem.name != "Rosenbrock n=10"]
    return (*planar_problems(), *spatial_problems(), *scalable_problems(), *sparse)


def planar_problems() -> tuple[GlobalProblem, ...]:
    """Return the functions of two variables."""
    tabled = (
        GlobalProblem(
            name,
            box,
            minimum,
            minimizers,
            [Part(function, [0, 1]) for function in summands],
            source,
        )
        for name, box, minimum, minimizers, summands, source in _PLANAR
    )
    return (*tabled, judge())


def judge() -> GlobalProblem:
    """A nonlinear regression, Σ (x_1 + a_i x_2 + b_i x_2² − c_i)², with two local minima."""
    return GlobalProblem(
        "Judge",
        (-10.0, 10.0),
        16.081730132960388,
        [0.8647872863320523, 1.2357484987520928],
        [Part(lambda x, y, a, b, c: (x + a * y + b * y**2 - c) ** 2, [0, 1], _JUDGE.T)],
        "Judge et al. (1985), The Theory and Practice of Econometrics, 2nd ed., Wiley",
    )


# Rows a, b, c.
_JUDGE = np.array(
    [
        (
            *(0.286, 0.973, 0.384, 0.276, 0.973, 0.543, 0.957, 0.948, 0.543, 0.797),
            *(0.936, 0.889, 0.006, 0.828, 0.399, 0.617, 0.939, 0.784, 0.072, 0.889),
        ),
        (
            *(0.645, 0.585, 0.310, 0.058, 0.455, 0.779, 0.259, 0.202, 0.028, 0.099),
            *(0.142, 0.296, 0.175, 0.180, 0.842, 0.039, 0.103, 0.620, 0.158, 0.704),
        ),
        (
            *(4.284, 4.149, 3.877, 0.533, 2.211, 2.389, 2.145, 3.231, 1.998, 1.379),
            *(2.106, 1.428, 1.011, 2.179, 2.858, 1.388, 1.651, 1.593, 1.046, 2.152),
        ),
    ]
)


def _goldstein_price(x: Any, y: Any) -> Any:
    first = (x + y + 1.0) ** 2 * (
        19.0 - 14.0 * x + 3.0 * x**2 - 14.0 * y + 6.0 * x * y + 3.0 * y**2
    )
    second = (2.0 * x - 3.0 * y) ** 2 * (
        18.0 - 32.0 * x + 12.0 * x**2 + 48.0 * y - 36.0 * x * y + 27.0 * y**2
    )
    return (1.0 + first) * (30.0 + second)


def _deckkers_aarts(x: Any, y: Any) -> Any:
    square = x**2 + y**2
    return 1e5 * x**2 + y**2 - square**2 + 1e-5 * square**4


def _freudenstein_roth(x: Any, y: Any) -> Any:
    first = x - 13.0 + ((5.0 - y) * y - 2.0) * y
    second = x - 29.0 + ((y + 1.0) * y - 14.0) * y
    return first**2 + second**2


def _wayburn_seader2(x: Any, y: Any) -> Any:
    return (1.613 - 4.0 * (x - 0.3125) ** 2 - 4.0 * (y - 1.625) ** 2) ** 2 + (y - 1.0) ** 2


_WAYBURN = 0.5 * np.sqrt(1.613 - 4.0 * 0.625**2)

# name, box, minimum, minimizers, summands, source
_PLANAR: tuple[tuple[Any, ...], ...] = (
    (
        "Himmelblau",
        (-5.0, 5.0),
        0.0,
        [
            [3.0, 2.0],
            [-2.8051180869527448, 3.1313125182505730],
            [-3.7793102533777469, -3.2831859912861695],
            [3.5844283403304917, -1.8481265269644034],
        ],
        (lambda x, y: (x**2 + y - 11.0) ** 2, lambda x, y: (x + y**2 - 7.0) ** 2),
        JAMIL,
    ),
    (
        "three-hump camel",
        (-5.0, 5.0),
        0.0,
        [0.0, 0.0],
        (lambda x, y: 2.0 * x**2 - 1.05 * x**4 + x**6 / 6.0 + x * y + y**2,),
        JAMIL,
    ),
    (
        "six-hump camel",
        (-5.0, 5.0),
        -1.0316284534898774,
        [[0.08984201310031806, -0.7126564030207396], [-0.08984201310031806, 0.7126564030207396]],
        (lambda x, y: 4.0 * x**2 - 2.1 * x**4 + x**6 / 3.0 + x * y - 4.0 * y**2 + 4.0 * y**4,),
        JAMIL,
    ),
    ("Goldstein-Price", (-2.0, 2.0), 3.0, [0.0, -1.0], (_goldstein_price,), JAMIL),
    (
        "Beale",
        (-4.5, 4.5),
        0.0,
        [3.0, 0.5],
        (
            lambda x, y: (1.5 - x + x * y) ** 2,
            lambda x, y: (2.25 - x + x * y**2) ** 2,
            lambda x, y: (2.625 - x + x * y**3) ** 2,
        ),
        JAMIL,
    ),
    (
        "Deckkers-Aarts",
        (-20.0, 20.0),
        -24776.51834231768,
        [[0.0, 14.945112151891959], [0.0, -14.945112151891959]],
        (_deckkers_aarts,),
        JAMIL + "; it prints -24777 at (0, ±15), rounded",
    ),
    (
        "Price 3",
        (-50.0, 50.0),
        0.0,
        [[1.0, 1.0], [0.3413075033535242, 0.11649081184541596]],
        (
            lambda x, y: 100.0 * (y - x**2) ** 2,
            lambda x, y: 6.0 * (6.4 * (y - 0.5) ** 2 - x - 0.6) ** 2,
        ),
        JAMIL + "; it prints the minimizers of Price 1",
    ),
    (
        "Price 4",
        (-50.0, 50.0),
        0.0,
        [[0.0, 0.0], [2.0, 4.0], [1.4643521196636986, -2.5060127607816622]],
        (lambda x, y: (2.0 * x**3 * y - y**3) ** 2, lambda x, y: (6.0 * x - y**2 + y) ** 2),
        JAMIL,
    ),
    ("Freudenstein-Roth", (-10.0, 10.0), 0.0, [5.0, 4.0], (_freudenstein_roth,), JAMIL),
    (
        "Zettl",
        (-5.0, 10.0),
        -0.0037912372204688977,
        [-0.029895985050660382, 0.0],
        (lambda x, y: (x**2 + y**2 - 2.0 * x) ** 2 + 0.25 * x,),
        JAMIL,
    ),
    (
        "Zirilli",
        (-10.0, 10.0),
        -0.35238607380003645,
        [-1.0466805318046022, 0.0],
        (lambda x, y: 0.25 * x**4 - 0.5 * x**2 + 0.1 * x + 0.5 * y**2,),
        JAMIL,
    ),
    (
        "Wayburn-Seader 1",
        (-5.0, 5.0),
        0.0,
        [[1.0, 2.0], [1.5968041538769333, 0.8063916922461335]],
        (lambda x, y: (x**6 + y**4 - 17.0) ** 2, lambda x, y: (2.0 * x + y - 4.0) ** 2),
        JAMIL,
    ),
    (
        "Wayburn-Seader 2",
        (-500.0, 500.0),
        0.0,
        [[0.3125 - _WAYBURN, 1.0], [0.3125 + _WAYBURN, 1.0]],
        (_wayburn_seader2,),
        JAMIL + "; it prints (0.2, 1) and (0.425, 1), rounded",
    ),
    (
        "El-Attar-Vidyasagar-Dutta",
        (-500.0, 500.0),
        1.7127803548622034,
        [3.4091868221900614, -2.171433036284005],
        (
            lambda x, y: (x**2 + y - 10.0) ** 2,
            lambda x, y: (x + y**2 - 7.0) ** 2,
            lambda x, y: (x**2 + y**3 - 1.0) ** 2,
        ),
        JAMIL + "; it prints 0.470427 at (2.842503, 1.920175)",
    ),
)


def spatial_problems() -> tuple[GlobalProblem, ...]:
    """Return the functions of three and four variables that come in no other size."""
    permutations = sorted(set(itertools.permutations((1.0, 2.0, 2.0, 3.0))))
    return (
        GlobalProblem(
            "Mishra 9", (-10.0, 10.0), 0.0, [1.0, 2.0, 3.0], (Part(_mishra9, [0, 1, 2]),), _MISHRA
        ),
        GlobalProblem(
            "Colville", (-10.0, 10.0), 0.0, np.ones(4), (Part(_colville, np.arange(4)),), JAMIL
        ),
        GlobalProblem(
            "Power sum",
            (0.0, 4.0),
            0.0,
            permutations,
            tuple(
                Part(partial(_power_sum, k, b), np.arange(4))
                for k, b in enumerate((8.0, 18.0, 44.0, 114.0), 1)
            ),
            LAGUNA,
        ),
    )


# At the printed minimizer the printed formula is 256.
_MISHRA = JAMIL + "; its second row lacks the x_1 x_2² that makes (1, 2, 3) its solution"


def _mishra9(x: Any, y: Any, z: Any) -> Any:
    a = 2.0 * x**3 + 5.0 * x * y + 4.0 * z - 2.0 * x**2 * z - 18.0
    b = x + y**3 + x * y**2 + x * z**2 - 22.0
    c = 8.0 * x**2 + 2.0 * y * z + 2.0 * y**2 + 3.0 * y**3 - 52.0
    return (a * b**2 * c + a * b * c**2 + b**2 + (x + y - z) ** 2) ** 2


def _colville(x1: Any, x2: Any, x3: Any, x4: Any) -> Any:
    return (
        100.0 * (x1**2 - x2) ** 2
        + (x1 - 1.0) ** 2
        + (x3 - 1.0) ** 2
        + 90.0 * (x3**2 - x4) ** 2
        + 10.1 * ((x2 - 1.0) ** 2 + (x4 - 1.0) ** 2)
        + 19.8 * (x2 - 1.0) * (x4 - 1.0)
    )


def _power_sum(k: int, b: float, *x: Any) -> Any:
    return (sum(x_i**k for x_i in x) - b) ** 2


def random_univariate(degree: int, seed: int) -> GlobalProblem:
    """Return a polynomial of an even degree in one variable on [−2.5, 2.5], its minimum exact.

    Its critical points are drawn, uniform in [−2, 2]: at least one, and an odd number, are real,
    the others complex pairs with imaginary parts in [0.05, 1]. So the minimum is the least value
    over the real ones, once f rises beyond them. Scaled to a range of 1 over them, or over the box
    if there is but one.
    """
    rng = np.random.default_rng([degree, seed])
    num_pairs = int(rng.integers(0, degree // 2))
    pairs = rng.uniform(-2.0, 2.0, num_pairs) + 1j * rng.uniform(0.05, 1.0, num_pairs)
    real = rng.uniform(-2.0, 2.0, degree - 1 - 2 * num_pairs)
    slope = Polynomial.fromroots([*real, *pairs, *pairs.conj()])
    f = Polynomial(slope.coef.real).integ()
    values = f(real if real.size > 1 else np.array([-2.5, *real, 2.5]))
    f = f / np.ptp(values)
    minimizer = real[np.argmin(f(real))]
    return GlobalProblem(
        f"univariate degree={degree} seed={seed}",
        (-2.5, 2.5),
        float(f(minimizer)),
        [minimizer],
        (Part(partial(_horner, tuple(f.coef)), [0]),),
        "random critical points",
    )


def _horner(coefficients: tuple[float, ...], x: Any) -> Any:
    value = 0.0 * x
    for coefficient in reversed(coefficients):
        value = value * x + coefficient
    return value
