"""Constrained programs with known global optima, from the literature and random.

The printed minimizers of the literature are given to full accuracy here; the tests try to beat
every one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.collections.function_programs import function_programs
from benchmarks.collections.hock_schittkowski import small_hock_schittkowski
from benchmarks.collections.hock_schittkowski_large import large_hock_schittkowski
from benchmarks.collections.known_optimum import ConstrainedProblem

FLOUDAS = (
    "Floudas & Pardalos (1990), A Collection of Test Problems for Constrained Global Optimization "
    "Algorithms, Springer LNCS 455"
)
LIANG = (
    "Liang et al. (2006), Problem Definitions and Evaluation Criteria for the CEC 2006 Special "
    "Session on Constrained Real-Parameter Optimization"
)


def constrained_problems() -> tuple[ConstrainedProblem, ...]:
    """Return all programs, those of the literature first."""
    planted = (planted_program(n, seed) for n in (5, 10, 20, 50) for seed in range(3))
    return (
        *small_hock_schittkowski(),
        *large_hock_schittkowski(),
        *concave_programs(),
        *nonconvex_programs(),
        *function_programs(),
        *planted,
    )


def concave_programs() -> tuple[ConstrainedProblem, ...]:
    """Return minimizations of concave quadratics over polytopes: optimal at a vertex."""
    return (
        ConstrainedProblem(
            "Floudas-Pardalos 2.1",
            (0.0, 1.0),
            -17.0,
            [1.0, 1.0, 0.0, 1.0, 0.0],
            lambda *x: [
                c * x_i - 50.0 * x_i**2
                for c, x_i in zip((42.0, 44.0, 45.0, 47.0, 47.5), x, strict=True)
            ],
            inequalities=lambda *x: [40.0 - _dot((20.0, 12.0, 11.0, 7.0, 4.0), x)],
            source=FLOUDAS,
        ),
        ConstrainedProblem(
            "Floudas-Pardalos 2.2",
            (0.0, [1.0, 1.0, 1.0, 1.0, 1.0, 20.0]),
            -213.0,
            [0.0, 1.0, 0.0, 1.0, 1.0, 20.0],
            lambda *x: [
                -_dot((10.5, 7.5, 3.5, 2.5, 1.5, 10.0), x),
                *(-0.5 * x_i**2 for x_i in x[:5]),
            ],
            inequalities=lambda *x: [
                6.5 - _dot((6.0, 3.0, 3.0, 2.0, 1.0), x[:5]),
                20.0 - _dot((10.0, 10.0, 1.0), (x[0], x[2], x[5])),
            ],
            source=FLOUDAS,
        ),
        ConstrainedProblem(
            "Floudas-Pardalos 2.3",
            (0.0, [*[1.0] * 9, 100.0, 100.0, 100.0, 1.0]),
            -15.0,
            [*[1.0] * 9, 3.0, 3.0, 3.0, 1.0],
            lambda *x: [*(5.0 * x_i - 5.0 * x_i**2 for x_i in x[:4]), *(-x_i for x_i in x[4:])],
            inequalities=_floudas_23_rows,
            source=FLOUDAS,
        ),
        ConstrainedProblem(
            "Floudas-Pardalos 3.3",
            ([0.0, 0.0, 1.0, 0.0, 1.0, 0.0], [6.0, 6.0, 5.0, 6.0, 5.0, 10.0]),
            -310.0,
            [5.0, 1.0, 5.0, 0.0, 5.0, 10.0],
            lambda *x: [
                -w * (x_i - p) ** 2
                for w, p, x_i in zip(
                    (25.0, 1.0, 1.0, 1.0, 1.0, 1.0), (2.0, 2.0, 1.0, 4.0, 1.0, 4.0), x, strict=True
                )
            ],
            inequalities=lambda a, b, c, d, e, f: [
                (c - 3.0) ** 2 + d - 4.0,
                (e - 3.0) ** 2 + f - 4.0,
                2.0 - a + 3.0 * b,
                2.0 + a - b,
                6.0 - a - b,
                a + b - 2.0,
            ],
            source=FLOUDAS,
        ),
    )


def _floudas_23_rows(*x: Any) -> Sequence[Any]:
    a, b, c, d, e, f, g, h, i, j, k, m, _ = x
    return [
        10.0 - 2.0 * a - 2.0 * b - j - k,
        10.0 - 2.0 * a - 2.0 * c - j - m,
        10.0 - 2.0 * b - 2.0 * c - k - m,
        8.0 * a - j,
        8.0 * b - k,
        8.0 * c - m,
        2.0 * d + e - j,
        2.0 * f + g - k,
        2.0 * h + i - m,
    ]


def nonconvex_programs() -> tuple[ConstrainedProblem, ...]:
    """Return programs whose constraints are nonconvex, bilinear ones of pooling among them."""
    return (
        ConstrainedProblem(
            "Floudas-Pardalos 3.4",
            (0.0, [2.0, 6.0, 3.0]),
            -4.0,
            [0.5, 0.0, 3.0],
            lambda x, y, z: -2.0 * x + y - z,
            inequalities=_floudas_34_rows,
            source=FLOUDAS,
        ),
        ConstrainedProblem(
            "Floudas-Pardalos 4.9",
            (0.0, [2.0, 3.0]),
            -16.73889318445137,
            [0.717536196257693, 1.4698420823391727],
            lambda x, y: -12.0 * x - 7.0 * y + y**2,
            equalities=lambda x, y: [2.0 - 2.0 * x**4 - y],
            source=FLOUDAS,
        ),
        ConstrainedProblem(
            "Floudas-Pardalos 4.10",
            (0.0, [3.0, 4.0]),
            -5.5080132716,
            [2.3295201974, 3.1784930741],
            lambda x, y: -x - y,
            inequalities=lambda x, y: [
                2.0 * x**4 - 8.0 * x**3 + 8.0 * x**2 + 2.0 - y,
                4.0 * x**4 - 32.0 * x**3 + 88.0 * x**2 - 96.0 * x + 36.0 - y,
            ],
            source=FLOUDAS,
        ),
        *(_haverly(*case) for case in _HAVERLY),
        ConstrainedProblem(
            "g03 n=5",
            (0.0, 1.0),
            -1.0,
            [5.0**-0.5] * 5,
            lambda *x: -(5.0**2.5) * math.prod(x),
            equalities=lambda *x: [sum(x_i**2 for x_i in x) - 1.0],
            source=LIANG,
        ),
        ConstrainedProblem(
            "g11",
            (-1.0, 1.0),
            0.75,
            [[0.5**0.5, 0.5], [-(0.5**0.5), 0.5]],
            lambda x, y: x**2 + (y - 1.0) ** 2,
            equalities=lambda x, y: [y - x**2],
            source=LIANG,
        ),
    )


def _floudas_34_rows(x: Any, y: Any, z: Any) -> Sequence[Any]:
    # ‖A x − y₀‖² ≥ ¼ ‖b − z₀‖² with the book's A, y₀, b, z₀.
    rows = (z - 1.5, -y + 0.5, -2.0 * x + y - z + 5.0)
    return [
        sum(row**2 for row in rows) - 0.25 * (9.0 + 1.0 + 4.0),
        4.0 - x - y - z,
        6.0 - 3.0 * y - z,
    ]


# Name, demands for the two products, price of the second crude; profit and flows.
_HAVERLY: tuple[tuple[Any, ...], ...] = (
    ("Haverly 1", 100.0, 200.0, 16.0, 400.0, [0.0, 100.0, 0.0, 100.0, 0.0, 100.0, 1.0]),
    ("Haverly 2", 600.0, 200.0, 16.0, 600.0, [300.0, 0.0, 300.0, 0.0, 300.0, 0.0, 3.0]),
    ("Haverly 3", 100.0, 200.0, 13.0, 750.0, [50.0, 150.0, 0.0, 200.0, 0.0, 0.0, 1.5]),
)


def _haverly(
    name: str, first: float, second: float, price: float, profit: float, flows: list[float]
) -> ConstrainedProblem:
    """Pooling: crudes a (3 % sulfur), b (1 %) are mixed to quality s, crude c (2 %) is added later.

    The pool sends p to a product of at most 2.5 %, q to one of 1.5 %, and c is split into v and w.
    """

    def equalities(a: Any, b: Any, p: Any, q: Any, v: Any, w: Any, s: Any) -> Sequence[Any]:
        return [a + b - p - q, 3.0 * a + b - s * (p + q)]

    def inequalities(a: Any, b: Any, p: Any, q: Any, v: Any, w: Any, s: Any) -> Sequence[Any]:
        return [
            2.5 * (p + v) - s * p - 2.0 * v,
            1.5 * (q + w) - s * q - 2.0 * w,
            first - p - v,
            second - q - w,
        ]

    return ConstrainedProblem(
        name,
        (
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            [first + second, first + second, first, second, first, second, 3.0],
        ),
        -profit,
        flows,
        lambda a, b, p, q, v, w, s: (
            6.0 * a + price * b + 10.0 * (v + w) - 9.0 * (p + v) - 15.0 * (q + w)
        ),
        equalities=equalities,
        inequalities=inequalities,
        source="Haverly (1978), ACM SIGMAP Bulletin 25:19-28",
    )


def planted_program(n: int, seed: int) -> ConstrainedProblem:
    """Return a random sparse program on [−2, 2]ⁿ whose global optimum x* proves itself.

        f = Σ_i (x_i − x*_i)² ((x_i − p_i)² + d_i) + Σ_k μ_k g_k + Σ_k ν_k h_k,
        g ≥ 0,  h = 0,    g(x*) = h(x*) = 0,   μ ≥ 0.

    Wherever g ≥ 0 and h = 0, every summand of f is 0 or more, or vanishes, so f ≥ 0 = f(x*).
    g_k and h_k are random quadratics of two neighbours. In every variable another well has its
    bottom near p_i, about (p_i − x*_i)² d_i above the right one's.
    """
    rng = np.random.default_rng([n, seed])
    best = rng.uniform(-1.5, 1.5, n)
    other = np.where(best > 0.0, best - 2.0, best + 2.0) + rng.uniform(-0.3, 0.3, n)
    depth = rng.uniform(0.05, 0.2, n)
    num_equalities, num_inequalities = max(1, n // 5), max(2, n // 3)
    num_rows = num_equalities + num_inequalities
    first = rng.choice(n - 1, num_rows, replace=False)
    numbers = rng.uniform(-1.0, 1.0, (num_rows, 5))
    weights = rng.uniform(0.0, 1.0, num_rows)
    weights[:num_equalities] = 2.0 * weights[:num_equalities] - 1.0

    def row(k: int, x: Sequence[Any]) -> Any:
        i = first[k]
        return _quadratic(numbers[k], x[i], x[i + 1]) - _quadratic(numbers[k], best[i], best[i + 1])

    def costs(*x: Any) -> Sequence[Any]:
        wells = [(x[i] - best[i]) ** 2 * ((x[i] - other[i]) ** 2 + depth[i]) for i in range(n)]
        return [*wells, *(weights[k] * row(k, x) for k in range(num_rows))]

    return ConstrainedProblem(
        f"planted n={n} seed={seed}",
        (-2.0, 2.0),
        0.0,
        best,
        costs,
        equalities=lambda *x: [row(k, x) for k in range(num_equalities)],
        inequalities=lambda *x: [row(k, x) for k in range(num_equalities, num_rows)],
        source="random; f is 0 or more wherever the constraints hold, by its formula",
    )


def _quadratic(numbers: NDArray[np.float64], x: Any, y: Any) -> Any:
    a, b, c, d, e = numbers.tolist()
    return a * x**2 + b * x * y + c * y**2 + d * x + e * y


def _dot(a: Sequence[float], x: Sequence[Any]) -> Any:
    return sum(a_i * x_i for a_i, x_i in zip(a, x, strict=True))
