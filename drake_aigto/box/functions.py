"""Means of one-variable functions over an interval, in closed form.

A box mean factorises over the coordinates (AIGTO Sec. II-B), so all that the optimizer ever
integrates are functions of one variable. A function g takes part once it has a closed-form mean

    μ(g; c, w) = 1/(2w) ∫_{c−w}^{c+w} g(x) dx,        μ(g; c, 0) = g(c),

and the derivatives of μ in (c, z) with z = log w. `factor_mean` is the one place that knows them;
every kind here is a function of y = scale·x + offset:

    POWER           y^p           Σ_{j ≤ p/2} C(p, 2j) c^{p−2j} w^{2j} / (2j + 1): every summand has
                                  one sign, so nothing cancels, and w = 0 is exact
    SQUARED_HINGE   max(0, −y)²   the ReLU² penalty of y ≥ 0 (AIGTO Sec. III-A)
    NEG_LOG         −log y        the log barrier of y ≥ 0, +∞ once the interval leaves y ≥ 0
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from drake_aigto.jit import njit


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

# Below this w/c the log mean takes its series, as the closed form's numbers are (c/w)² its size.
_LOG_SERIES_RATIO = 0.3


@njit(cache=True, error_model="numpy")
def _power_sums(exponent: int, c: float, w: float) -> tuple[float, float, float]:
    """μ_p with its first and second derivative in z = log w, d = 0, 1, 2.

    Σ_j (2j)^d C(p, 2j) c^{p−2j} w^{2j} / (2j+1).
    """
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
    """Mean of max(0, −y)²: 0 for c ≥ w, c² + w²/3 for c ≤ −w, (w − c)³/(6w) between.

    Between, every derivative is a product of positive factors: nothing cancels near |c| = w.
    """
    if c >= w:
        row[:] = 0.0
    elif c <= -w:
        _power_mean(2, c, w, row)
    else:
        below = w - c  # length of the interval's part below zero
        above = w + c
        row[VALUE] = below * below * (below / (6.0 * w))
        row[D_C] = -below * (below / (2.0 * w))
        row[D_CC] = below / w
        row[D_Z] = below * below * ((w + above) / (6.0 * w))
        row[D_CZ] = -below * (above / (2.0 * w))
        row[D_ZZ] = below * ((4.0 * w * w + c * w + c * c) / (6.0 * w))


@njit(cache=True, error_model="numpy")
def _log_deviation(r: float, gap: float) -> tuple[float, float, float]:
    """How far the mean of −log y lies above −log c: h(r), ∂h/∂z and ∂²h/∂z².

    h = Σ_{j≥1} r^{2j}/(2j (2j+1)) = 1 − [(1+r) log(1+r) − (1−r) log(1−r)]/(2r) at r = w/c, with
    gap = 1 − r given apart, as it is small where the interval nearly touches y = 0.
    ∂h/∂z = artanh(r)/r − 1.
    """
    if r < _LOG_SERIES_RATIO:
        h, d_z, d_zz = 0.0, 0.0, 0.0
        square, power, even = r * r, 1.0, 0.0
        while power > 1e-18 * square:
            power *= square
            even += 2.0
            h += power / (even * (even + 1.0))
            d_z += power / (even + 1.0)
            d_zz += even * power / (even + 1.0)
        return h, d_z, d_zz
    upper = (1.0 + r) * math.log1p(r)
    if gap == 0.0:  # the interval touches y = 0: the mean is finite, its slope is not
        return 1.0 - upper / (2.0 * r), math.inf, math.inf
    log_gap = math.log(gap)
    artanh_ratio = (math.log1p(r) - log_gap) / (2.0 * r)
    h = 1.0 - (upper - gap * log_gap) / (2.0 * r)
    return h, artanh_ratio - 1.0, 1.0 / (gap * (1.0 + r)) - artanh_ratio


@njit(cache=True, error_model="numpy")
def _neg_log_mean(c: float, w: float, row: NDArray[np.float64]) -> None:
    """Mean of −log y: h(w/c) − log c, see `_log_deviation`; +∞ once the interval leaves y ≥ 0.

    Derivatives in c follow from h being a function of w/c alone: ∂h/∂c = −(1/c) ∂h/∂z.
    """
    if c <= 0.0 or c < w:
        row[:] = 0.0
        row[VALUE] = math.inf
        return
    r, gap = w / c, (c - w) / c
    deviation, row[D_Z], row[D_ZZ] = _log_deviation(r, gap)
    row[VALUE] = deviation - math.log(c)
    row[D_C] = -(1.0 + row[D_Z]) / c
    row[D_CZ] = -row[D_ZZ] / c
    row[D_CC] = 1.0 / (c * c * gap * (1.0 + r))


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
    """Mean over |x − center| ≤ half_width of g(scale·x + offset), with derivatives in (c, log w).

    Args:
        kind: A `FunctionKind`.
        exponent: The power p (POWER only).
        scale: Factor inside the function.
        offset: Term inside the function.
        center: Box center c.
        half_width: Box half width w ≥ 0; at w = 0 the mean is the value, every z-derivative 0.
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
