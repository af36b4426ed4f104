"""Test functions of global optimization that come in any number of variables, some of them sparse.

Each is written from its formula; index 1 of the formula is x[0]. `sparse_problems` are sums whose
summands hold a few neighbours each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve

from benchmarks.collections.known_optimum import GlobalProblem, Part, cos
from drake_aigto.arrays import Floats

JAMIL = "Jamil & Yang (2013), Int. J. Math. Modelling and Numerical Optimisation 4:150-194"
MGH = "Moré, Garbow & Hillstrom (1981), ACM Trans. Math. Software 7:17-41"
LAGUNA = "Laguna & Martí (2005), J. Global Optimization 33:235-255"
LUKSAN = "Lukšan, Matonoha & Vlček (2018), Modified CUTE problems, ICS CAS Prague, TR-1258"


def scalable_problems() -> tuple[GlobalProblem, ...]:
    """Return the functions of any dimension, with sin and cos in Rastrigin's and Lévy's only."""
    in_any: tuple[Callable[[int], GlobalProblem], ...] = (
        styblinski_tang,
        dixon_price,
        qing,
        rosenbrock,
        perm1,
        perm2,
        rastrigin,
        levy,
    )
    return (
        *(make(n) for make in in_any for n in (2, 5, 10)),
        *(powell(n) for n in (4, 8)),
        *(watson(n) for n in (6, 9, 12)),
    )


def sparse_problems(sizes: Iterable[int] = (10, 100, 1000)) -> tuple[GlobalProblem, ...]:
    """Return the sparse functions at each of these numbers of variables, all even."""
    makers = (broyden_banded, broyden_tridiagonal, chained_singular, chained_wood, rosenbrock)
    return tuple(make(n) for make in makers for n in sizes)


def _windows(n: int, width: int, stride: int = 1) -> NDArray[np.intp]:
    """Indices (i, i+1, …, i+width−1) for i = 0, stride, 2·stride, …, shape (K, width)."""
    return np.arange(n)[np.arange(0, n - width + 1, stride)[:, None] + np.arange(width)]


def _each(n: int) -> NDArray[np.intp]:
    return _windows(n, 1)


def styblinski_tang(n: int) -> GlobalProblem:
    """½ Σ (x_i⁴ − 16 x_i² + 5 x_i): 2ⁿ local minima."""
    minimizer = -2.9035340277711770951
    return GlobalProblem(
        f"Styblinski-Tang n={n}",
        (-5.0, 5.0),
        -39.166165703771418 * n,
        np.full(n, minimizer),
        (Part(lambda x: (x**4 - 16.0 * x**2 + 5.0 * x) / 2.0, _each(n)),),
        JAMIL,
    )


def dixon_price(n: int) -> GlobalProblem:
    """(x_1 − 1)² + Σ_{i≥2} i (2 x_i² − x_{i−1})²."""
    minimizer = 2.0 ** (2.0 ** -np.arange(n) - 1.0)
    other = np.where(np.arange(n) == n - 1, -minimizer, minimizer)  # x_n stands squared only
    return GlobalProblem(
        f"Dixon-Price n={n}",
        (-10.0, 10.0),
        0.0,
        [minimizer, other],
        (
            Part(lambda x: (x - 1.0) ** 2, [0]),
            Part(
                lambda before, x, i: i * (2.0 * x**2 - before) ** 2,
                _windows(n, 2),
                np.arange(2.0, n + 1),
            ),
        ),
        JAMIL,
    )


def qing(n: int) -> GlobalProblem:
    """Σ (x_i² − i)²: 2ⁿ global minima."""
    return GlobalProblem(
        f"Qing n={n}",
        (-500.0, 500.0),
        0.0,
        np.sqrt(np.arange(1.0, n + 1)),
        (Part(lambda x, i: (x**2 - i) ** 2, _each(n), np.arange(1.0, n + 1)),),
        JAMIL,
    )


def rosenbrock(n: int) -> GlobalProblem:
    """Σ 100 (x_{i+1} − x_i²)² + (x_i − 1)²; from n = 4 on with a second local minimum."""
    return GlobalProblem(
        f"Rosenbrock n={n}",
        (-30.0, 30.0),
        0.0,
        np.ones(n),
        (Part(lambda x, y: 100.0 * (y - x**2) ** 2 + (x - 1.0) ** 2, _windows(n, 2)),),
        JAMIL,
    )


def perm1(n: int) -> GlobalProblem:
    """Σ_k [Σ_j (j^k + ½) ((x_j/j)^k − 1)]²."""
    return GlobalProblem(
        f"Perm 1 n={n}",
        (-float(n), float(n)),
        0.0,
        np.arange(1.0, n + 1),
        tuple(Part(partial(_perm1, k), np.arange(n)) for k in range(1, n + 1)),
        JAMIL + ": Perm 1, β = 0.5",
    )


def _perm1(k: int, *x: Any) -> Any:
    return sum((j**k + 0.5) * (x_j**k / float(j**k) - 1.0) for j, x_j in enumerate(x, 1)) ** 2


def perm2(n: int) -> GlobalProblem:
    """Σ_k [Σ_j (j + 10) (x_j^k − 1/j^k)]²."""
    return GlobalProblem(
        f"Perm 2 n={n}",
        (-float(n), float(n)),
        0.0,
        1.0 / np.arange(1.0, n + 1),
        tuple(Part(partial(_perm2, k), np.arange(n)) for k in range(1, n + 1)),
        JAMIL + ": Perm 2, β = 10",
    )


def _perm2(k: int, *x: Any) -> Any:
    return sum((j + 10.0) * (x_j**k - 1.0 / float(j**k)) for j, x_j in enumerate(x, 1)) ** 2


def rastrigin(n: int) -> GlobalProblem:
    """Σ x_i² − 10 cos 2πx_i + 10: 11ⁿ local minima."""
    return GlobalProblem(
        f"Rastrigin n={n}",
        (-5.12, 5.12),
        0.0,
        np.zeros(n),
        (Part(lambda x: x**2 - 10.0 * cos(2.0 * math.pi * x) + 10.0, _each(n)),),
        JAMIL,
    )


def levy(n: int) -> GlobalProblem:
    """sin²πy_1 + Σ_{i<n} (y_i − 1)² (1 + 10 sin²(πy_i + 1)) + (y_n − 1)² (1 + sin²2πy_n).

    y = 1 + (x − 1)/4. Every sin²φ is written as (1 − cos 2φ)/2.
    """
    return GlobalProblem(
        f"Levy n={n}",
        (-10.0, 10.0),
        0.0,
        np.ones(n),
        (Part(_levy_first, [0]), Part(_levy_middle, _each(n - 1)), Part(_levy_last, [n - 1])),
        LAGUNA,
    )


def _levy_first(x: Any) -> Any:
    return 0.5 - 0.5 * cos(math.pi / 2.0 * (x + 3.0))


def _levy_middle(x: Any) -> Any:
    return ((x - 1.0) / 4.0) ** 2 * (6.0 - 5.0 * cos(math.pi / 2.0 * (x + 3.0) + 2.0))


def _levy_last(x: Any) -> Any:
    return ((x - 1.0) / 4.0) ** 2 * (1.5 - 0.5 * cos(math.pi * (x + 3.0)))


def _powell(x1: Any, x2: Any, x3: Any, x4: Any) -> Any:
    return (
        (x1 + 10.0 * x2) ** 2 + 5.0 * (x3 - x4) ** 2 + (x2 - 2.0 * x3) ** 4 + 10.0 * (x1 - x4) ** 4
    )


def powell(n: int) -> GlobalProblem:
    """Powell's singular function, summed over groups of four variables."""
    return GlobalProblem(
        f"Powell n={n}",
        (-4.0, 5.0),
        0.0,
        np.zeros(n),
        (Part(_powell, _windows(n, 4, 4)),),
        f"{MGH}, (13); box: {LAGUNA}",
    )


def watson(n: int) -> GlobalProblem:
    """Σ_t [Σ_j (j−1) x_j t^{j−2} − (Σ_j x_j t^{j−1})² − 1]² + x_1² + (x_2 − x_1² − 1)².

    t = 1/29, 2/29, …, 1.
    """
    minimum, minimizer = _WATSON[n]
    reach = 5.0 if n < 12 else 20.0  # the usual box leaves the minimizer of n = 12 out
    return GlobalProblem(
        f"Watson n={n}",
        (-reach, reach),
        minimum,
        minimizer,
        (
            Part(_watson, np.arange(n), np.arange(1, 30) / 29.0),
            Part(lambda x, y: x**2 + (y - x**2 - 1.0) ** 2, [0, 1]),
        ),
        f"{MGH}, (20); box: {JAMIL}",
    )


def _watson(*x_and_t: Any) -> Any:
    *x, t = x_and_t
    slope = sum(j * x_j * t ** (j - 1) for j, x_j in enumerate(x) if j)
    value = sum(x_j * t**j for j, x_j in enumerate(x))
    return (slope - value**2 - 1.0) ** 2


# n → f*, minimizer: by Gauss and Newton from zero; MGH print the same f*.
_WATSON: dict[int, tuple[float, tuple[float, ...]]] = {
    6: (
        2.2876700535524428e-3,
        (
            *(-0.015725086401458508, 1.0124348693691099, -0.23299162595673803),
            *(1.260430087799609, -1.5137289227222803, 0.9929964324311348),
        ),
    ),
    9: (
        1.3997601381029164e-6,
        (
            *(-1.5307036521414037e-05, 0.999789703931948, 0.014763963693578146),
            *(0.14634232829914845, 1.0008211030056675, -2.6177311405212573),
            *(4.104403164481702, -3.1436122785582965, 1.0526264080106529),
        ),
    ),
    12: (
        4.722381106603683e-10,
        (
            *(-6.6380604697767915e-09, 1.0000016441178623, -0.0005639322104327806),
            *(0.3478205405063616, -0.15673150412059714, 1.0528151773442516),
            *(-3.24727115391508, 7.288434898877666, -10.27184824253767),
            *(9.074113648035036, -4.541375467114619, 1.0120118886320801),
        ),
    ),
}


def broyden_tridiagonal(n: int) -> GlobalProblem:
    """Σ [(3 − 2x_i) x_i − x_{i−1} − 2x_{i+1} + 1]², x_0 = x_{n+1} = 0."""

    def residual(before: Any, x: Any, after: Any) -> Any:
        return (3.0 - 2.0 * x) * x - before - 2.0 * after + 1.0

    rows = (
        Part(lambda x, after: residual(0.0, x, after), [0, 1]),
        Part(residual, _windows(n, 3)),
        Part(lambda before, x: residual(before, x, 0.0), [n - 2, n - 1]),
    )
    return _squares(f"Broyden tridiagonal n={n}", n, rows, f"{MGH}, (30); the box is ours")


def broyden_banded(n: int) -> GlobalProblem:
    """Σ_i [x_i (2 + 5x_i²) + 1 − Σ_j x_j (1 + x_j)]², j ≠ i from i − 5 to i + 1."""
    bands: dict[tuple[int, int], list[NDArray[np.intp]]] = {}
    for i in range(n):
        band = np.arange(max(0, i - 5), min(n, i + 2))
        bands.setdefault((band.size, i - int(band[0])), []).append(band)
    rows = tuple(
        Part(partial(_broyden_banded, place), np.array(copies))
        for (_, place), copies in bands.items()
    )
    return _squares(f"Broyden banded n={n}", n, rows, f"{MGH}, (31); the box is ours")


def _broyden_banded(place: int, *x: Any) -> Any:
    neighbours = sum(x_j * (1.0 + x_j) for j, x_j in enumerate(x) if j != place)
    return x[place] * (2.0 + 5.0 * x[place] ** 2) + 1.0 - neighbours


def _squares(name: str, n: int, rows: tuple[Part, ...], source: str) -> GlobalProblem:
    """The sum of squares of n rows, zero where Newton's method from −1 ends."""
    squares = tuple(Part(partial(_square, row.function), row.variables) for row in rows)
    root = _solve_rows(rows, np.full(n, -1.0))
    return GlobalProblem(name, (-10.0, 10.0), 0.0, root, squares, source)


def _square(row: Callable[..., Any], *x: Any) -> Any:
    return row(*x) ** 2


def _solve_rows(rows: tuple[Part, ...], x: Floats) -> Floats:
    """Newton's method on as many rows as variables."""
    for _ in range(20):
        values, entries = [], []
        first = 0
        for part in rows:
            numbers = first + np.arange(len(part.variables))
            values.append(part.function(*x[part.variables].T))
            entries += [(slopes, numbers, variables) for variables, slopes in part.slopes(x)]
            first += len(part.variables)
        slopes, row_of, column_of = (np.concatenate(each) for each in zip(*entries, strict=True))
        jacobian = coo_array((slopes, (row_of, column_of)), shape=(x.size, x.size)).tocsr()
        x = x - spsolve(jacobian, np.concatenate(values))
    return x


def chained_singular(n: int) -> GlobalProblem:
    """Powell's singular function over every second window of four variables."""
    return GlobalProblem(
        f"chained singular n={n}",
        (-4.0, 5.0),
        0.0,
        np.zeros(n),
        (Part(_powell, _windows(n, 4, 2)),),
        f"{LUKSAN}, chained Powell singular; box: as Powell's",
    )


def chained_wood(n: int) -> GlobalProblem:
    """Wood's function over every second window of four variables."""
    return GlobalProblem(
        f"chained Wood n={n}",
        (-10.0, 10.0),
        0.0,
        np.ones(n),
        (Part(_wood, _windows(n, 4, 2)),),
        f"{LUKSAN}, chained Wood; box: as Colville's",
    )


def _wood(x1: Any, x2: Any, x3: Any, x4: Any) -> Any:
    return (
        100.0 * (x1**2 - x2) ** 2
        + (x1 - 1.0) ** 2
        + 90.0 * (x3**2 - x4) ** 2
        + (x3 - 1.0) ** 2
        + 10.0 * (x2 + x4 - 2.0) ** 2
        + 0.1 * (x2 - x4) ** 2
    )
