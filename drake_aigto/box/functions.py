"""Means of one-variable functions over an interval, in closed form.

A box mean factorises over the coordinates (AIGTO Sec. II-B), so all that the optimizer ever integrates are functions of
one variable. A function g takes part once it has a closed-form mean

    μ(g; c, w) = 1/(2w) ∫_{c−w}^{c+w} g(x) dx,        μ(g; c, 0) = g(c),

and the derivatives of μ in (c, z) with z = log w. `factor_mean` is the one place that knows them; every kind here is a
function of y = scale·x + offset:

    POWER           y^p           Σ_{j ≤ p/2} C(p, 2j) c^{p−2j} w^{2j} / (2j + 1): no cancellation, exact at w = 0
    SQUARED_HINGE   max(0, −y)²   the ReLU² penalty of y ≥ 0 (AIGTO Sec. III-A)
    NEG_LOG         −log y        the log barrier of y ≥ 0, +∞ once the interval leaves y ≥ 0
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
from numba import njit
from numpy.typing import NDArray


class FunctionKind(IntEnum):
    """The one-variable functions whose mean over an interval is known in closed form."""

    POWER = 0
    SQUARED_HINGE = 1
    NEG_LOG = 2


# Plain integers, as Numba turns module-level ones into constants.
_POWER = int(FunctionKind.POWER)
_SQUARED_HINGE = int(FunctionKind.SQUARED_HINGE)

# Columns of the row that `factor_mean` fills.
VALUE, D_C, D_Z, D_CC, D_CZ, D_ZZ = range(6)

# Below this w/c the log mean's series is used: the closed form's difference of x log x loses (c/w)² digits.
_LOG_SERIES_RATIO = 0.1


@njit(cache=True, error_model="numpy")
def _power_sums(exponent: int, c: float, w: float) -> tuple[float, float, float]:
    """μ_p and its first and second derivative in log w: Σ_j (2j)^d C(p, 2j) c^{p−2j} w^{2j} / (2j+1), d = 0, 1, 2."""
    value, first, second = 0.0, 0.0, 0.0
    binomial, w_power = 1.0, 1.0
    for j in range(exponent // 2 + 1):
        term = binomial * c ** (exponent - 2 * j) * w_power / (2 * j + 1)
        value += term
        first += 2 * j * term
        second += 4.0 * j * j * term
        binomial *= (exponent - 2 * j) * (exponent - 2 * j - 1) / ((2.0 * j + 1) * (2.0 * j + 2))
        w_power *= w * w
    return value, first, second


@njit(cache=True, error_model="numpy")
def _power_mean(exponent: int, c: float, w: float, row: NDArray[np.float64]) -> None:
    """Mean of y^p, by ∂μ_p/∂c = p μ_{p−1}."""
    row[VALUE], row[D_Z], row[D_ZZ] = _power_sums(exponent, c, w)
    row[D_C] = row[D_CZ] = row[D_CC] = 0.0
    if exponent >= 1:
        mean, d_z, _ = _power_sums(exponent - 1, c, w)
        row[D_C] = exponent * mean
        row[D_CZ] = exponent * d_z
    if exponent >= 2:
        row[D_CC] = exponent * (exponent - 1) * _power_sums(exponent - 2, c, w)[0]


@njit(cache=True, error_model="numpy")
def _squared_hinge_mean(c: float, w: float, row: NDArray[np.float64]) -> None:
    """Mean of max(0, −y)²: 0 for c ≥ w, c² + w²/3 for c ≤ −w, (w − c)³/(6w) between."""
    if c >= w:
        row[:] = 0.0
    elif c <= -w:
        _power_mean(2, c, w, row)
    else:
        inside = w - c  # length of the interval's part below zero
        row[VALUE] = inside**3 / (6.0 * w)
        row[D_C] = -(inside**2) / (2.0 * w)
        row[D_CC] = inside / w
        row[D_Z] = inside**2 / 2.0 - row[VALUE]
        row[D_CZ] = -inside - row[D_C]
        row[D_ZZ] = inside * w - row[D_Z]


@njit(cache=True, error_model="numpy")
def _neg_log_mean(c: float, w: float, row: NDArray[np.float64]) -> None:
    """Mean of −log y: −[(c+w) log(c+w) − (c−w) log(c−w)]/(2w) + 1, or −log c + Σ_{j≥1} r^{2j}/(2j(2j+1)), r = w/c.

    Derivatives in z follow from a(r) = artanh(r)/r: ∂μ/∂c = −a(r)/c and ∂μ/∂z = −μ − ½ log(c² − w²).
    """
    if c <= 0.0 or c < w:
        row[:] = 0.0
        row[VALUE] = math.inf
        return
    r = w / c
    square = r * r
    if r < _LOG_SERIES_RATIO:
        d_log, d_z, d_zz, d_cz, power = 0.0, 0.0, 0.0, 0.0, 1.0
        for j in range(1, 9):  # the next term is r¹⁸/342 < 1e-20
            power *= square
            d_log += power / (2.0 * j * (2.0 * j + 1))
            d_z += power / (2.0 * j + 1)
            d_zz += 2.0 * j * power / (2.0 * j + 1)
            d_cz -= 2.0 * j * power / (2.0 * j + 1)
        row[VALUE] = -math.log(c) + d_log
        row[D_C] = -(1.0 + d_z) / c
    else:
        low = c - w
        row[VALUE] = 1.0 - (
            (c + w) * math.log(c + w) - (low * math.log(low) if low > 0 else 0.0)
        ) / (2 * w)
        artanh_ratio = math.atanh(r) / r
        row[D_C] = -artanh_ratio / c
        d_z = artanh_ratio - 1.0
        d_zz = 1.0 / (1.0 - square) - artanh_ratio
        d_cz = -d_zz
    row[D_Z] = d_z
    row[D_ZZ] = d_zz
    row[D_CZ] = d_cz / c
    row[D_CC] = 1.0 / (c * c * (1.0 - square))


@njit(cache=True, error_model="numpy")
def factor_mean(
    kind: int,
    exponent: int,
    scale: float,
    offset: float,
    center: float,
    half_width: float,
    row: NDArray[np.float64],
) -> None:
    """Mean over |x − center| ≤ half_width of g(scale·x + offset), and its derivatives in (c, z = log w).

    Args:
        kind: A `FunctionKind`.
        exponent: The power p (POWER only).
        scale: Factor inside the function.
        offset: Term inside the function.
        center: Box center c.
        half_width: Box half width w ≥ 0; at w = 0 the mean is the value and every z-derivative is 0.
        row: Filled with (μ, ∂c, ∂z, ∂cc, ∂cz, ∂zz), shape (6,).
    """
    c, w = scale * center + offset, abs(scale) * half_width
    if kind == _POWER:
        _power_mean(exponent, c, w, row)
    elif kind == _SQUARED_HINGE:
        _squared_hinge_mean(c, w, row)
    else:
        _neg_log_mean(c, w, row)
    row[D_C] *= scale
    row[D_CZ] *= scale
    row[D_CC] *= scale * scale
