"""Means of one-variable functions over an interval, in closed form.

A box mean factorizes over the coordinates (AIGTO Sec. II-B), so all that the optimizer ever
integrates are functions of one variable. A function g takes part once it has a closed-form mean

    μ(g; c, w) = 1/(2w) ∫_{c−w}^{c+w} g(x) dx,        μ(g; c, 0) = g(c),

and the derivatives of μ in (c, z) with z = log w. `factor_mean` is the one place that knows them;
with y = scale·x + offset the kinds are:

    POWER           y^p           Σ_{j ≤ p/2} C(p, 2j) c^{p−2j} w^{2j} / (2j + 1): every summand has
                                  one sign, so nothing cancels, and w = 0 is exact
    SQUARED_HINGE   max(0, −y)²   the ReLU² penalty of y ≥ 0 (AIGTO Sec. III-A)
    NEG_LOG         −log y        the log barrier of y ≥ 0, +∞ once the interval leaves y ≥ 0
    COSINE          x^p cos y     a binomial sum of moments, see `_wave_mean`: w = 0 is exact, and
    SINE            x^p sin y     at any width and distance from the origin the error is some
    EXPONENTIAL     x^p exp y     roundings of (|c| + w)^p times the mean's envelope, ≤ max |g(y)|
"""

from __future__ import annotations

import math

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.kernels import inner, kernel
from drake_aigto.terms import WAVES, FunctionKind

# They take Numba longer to compile than all others.
TRANSCENDENTAL = (FunctionKind.NEG_LOG, *WAVES)

# Plain integers, as Numba turns module-level ones into constants.
_POWER = int(FunctionKind.POWER)
_SQUARED_HINGE = int(FunctionKind.SQUARED_HINGE)
_NEG_LOG = int(FunctionKind.NEG_LOG)
_EXPONENTIAL = int(FunctionKind.EXPONENTIAL)
_SINE = int(FunctionKind.SINE)
_HINGE = int(FunctionKind.HINGE)

# Columns of the row that `factor_mean` fills.
VALUE, D_C, D_Z, D_CC, D_CZ, D_ZZ = range(6)

# 2²⁷ + 1 splits a double into halves of 26 bits (Dekker, 1971).
_SPLITTER = 134217729.0

# Below this w/c the log mean takes its series, as the closed form's numbers are (c/w)² its size.
_LOG_SERIES_RATIO = 0.3


@inner
def _power_mean(exponent: int, c: float, w: float, row: Floats) -> None:
    """Fills a row with the mean of y^p by the recurrence of its even and odd part.

    (c + w)^k = e_k + w o_k with e_{k+1} = c e_k + w² o_k and o_{k+1} = c o_k + e_k, in which all
    summands have one sign, so that nothing cancels; μ_p = o_{p+1}/(p + 1), ∂μ_p/∂c = o_p. With
    their first and second derivative in z = log w.
    """
    square = w * w
    even, even_z, even_zz = 1.0, 0.0, 0.0
    odd, odd_z, odd_zz, before = 0.0, 0.0, 0.0, 0.0
    for _ in range(exponent):
        before = odd
        even, even_z, even_zz, odd, odd_z, odd_zz = (
            c * even + square * odd,
            c * even_z + square * (2.0 * odd + odd_z),
            c * even_zz + square * (4.0 * (odd + odd_z) + odd_zz),
            c * odd + even,
            c * odd_z + even_z,
            c * odd_zz + even_zz,
        )
    inverse = 1.0 / (exponent + 1)
    row[VALUE] = (c * odd + even) * inverse
    row[D_Z] = (c * odd_z + even_z) * inverse
    row[D_ZZ] = (c * odd_zz + even_zz) * inverse
    row[D_C], row[D_CZ], row[D_CC] = odd, odd_z, exponent * before


@inner
def _squared_hinge_mean(c: float, w: float, row: Floats) -> None:
    """Fills a row with the mean of max(0, −y)² for c > −w: 0 for c ≥ w, (w − c)³/(6w) below that.

    There, every derivative is a product of positive factors: nothing cancels near |c| = w.
    """
    if c >= w:
        row[:] = 0.0
    else:
        below = w - c  # length of the interval's part below zero
        above = w + c
        row[VALUE] = below * below * (below / (6.0 * w))
        row[D_C] = -below * (below / (2.0 * w))
        row[D_CC] = below / w
        row[D_Z] = below * below * ((w + above) / (6.0 * w))
        row[D_CZ] = -below * (above / (2.0 * w))
        row[D_ZZ] = below * ((4.0 * w * w + c * w + c * c) / (6.0 * w))


@inner
def _hinge_mean(c: float, w: float, row: Floats) -> None:
    """Fills a row with the mean of max(0, −y): 0 for c ≥ w, −c for c ≤ −w, else (w − c)²/(4w)."""
    row[:] = 0.0
    if c >= w:
        return
    if c <= -w:
        row[VALUE], row[D_C] = -c, -1.0
        return
    below, above = w - c, w + c
    row[VALUE] = below * (below / (4.0 * w))
    row[D_C] = -below / (2.0 * w)
    row[D_CC] = 1.0 / (2.0 * w)
    row[D_Z] = below * (above / (4.0 * w))
    row[D_CZ] = -c / (2.0 * w)
    row[D_ZZ] = (w * w + c * c) / (4.0 * w)


@inner
def _log_deviation(r: float, gap: float) -> tuple[float, float, float]:
    """Returns how far the mean of −log y lies above −log c: h(r), ∂h/∂z and ∂²h/∂z².

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


@inner
def _neg_log_mean(c: float, w: float, row: Floats) -> None:
    """Fills a row with the mean of −log y; +∞ once the interval leaves y ≥ 0.

    It is h(w/c) − log c, see `_log_deviation`.

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


@inner
def _exact_product(a: float, b: float) -> tuple[float, float]:
    """Returns the product a·b as rounded, and what its rounding left out (Dekker, 1971)."""
    product = a * b
    a_high = _SPLITTER * a - (_SPLITTER * a - a)
    b_high = _SPLITTER * b - (_SPLITTER * b - b)
    a_low, b_low = a - a_high, b - b_high
    rest = ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low
    return product, (rest if math.isfinite(rest) else 0.0)


@inner
def _exact_sum(a: float, b: float) -> tuple[float, float]:
    """Returns the sum a + b as rounded, and what its rounding left out (Knuth)."""
    total = a + b
    shift = total - a
    rest = (a - (total - shift)) + (b - shift)
    return total, (rest if math.isfinite(rest) else 0.0)


@inner
def _fill_moments(s: float, sine: float, cosine: float, sign: float, moments: Floats) -> None:
    """Fills in the moments m_j = ½ ∫ t^j g_j(st) dt over [−1, 1].

    Here g_j(st) = cosh st for even j, else sinh st.

    By parts, j m_{j−1} = sinh s − s m_j for even j, and cosh s − s m_j for odd j. Upwards this is
    stable up to j ≤ s; beyond, downwards, from any start that is far enough above.

    Sine and cosine are sinh s and cosh s, or sin s and cos s for the sign −1: s is imaginary then.
    They may have a common factor, as the moments then have.
    """
    last = moments.size - 1
    filled = 0
    if s >= 1.0:
        moments[0] = sine / s
        filled = 1
        while filled <= last and filled <= s:
            below = filled * moments[filled - 1]
            moments[filled] = sign * (cosine - below) / s if filled % 2 else (sine - below) / s
            filled += 1
    if filled > last:
        return
    top, forgotten = last + 1, 1.0
    while forgotten > 1e-17:  # the share of the start that is left in the last moment
        top += 1
        forgotten *= s / top
    moment = 0.0
    for j in range(top, filled, -1):
        inverse = 1.0 / j  # off the chain of dependent operations
        if j % 2:
            moment = cosine * inverse - sign * s * inverse * moment
        else:
            moment = sine * inverse - s * inverse * moment
        if j <= last + 1:
            moments[j - 1] = moment


@inner
def _wave_mean(
    exponent: int,
    rate: float,
    moments: Floats,
    sign: float,
    even: float,
    odd: float,
    c: float,
    w: float,
    row: Floats,
    first: int,
) -> None:
    """Fills six entries, from one on, with the mean of x^p G(x), G″ = sign·rate² G.

    Moments are for s = rate·w.

    With x = c + wt, and G(c + wt) = even·cosh st + odd·sinh st (cos and sin for sign −1),

        μ = Σ_j a_j T_j m_j,    a_j = C(p, j) c^{p−j} w^j,    T_j = even, odd, even, odd, …

    where s ∂/∂s m_j is s m_{j+1}, times the sign for even j: nothing cancels at small s.

    Here even is G(c), odd G′(c)/rate, the sign 1 for exp, −1 for cos and sin.
    """
    row[first : first + 6] = 0.0
    s, weight = rate * w, 1.0
    for j in range(exponent + 1):
        m = exponent - j
        a = weight * c**m
        a_c = weight * m * c ** (m - 1) if m >= 1 else 0.0
        a_cc = weight * m * (m - 1) * c ** (m - 2) if m >= 2 else 0.0
        if j % 2:
            t, t_c, step = odd, sign * rate * even, s * moments[j + 1]
        else:
            t, t_c, step = even, rate * odd, sign * s * moments[j + 1]
        mean_z = j * moments[j] + step
        slope = a_c * t + a * t_c
        row[first + VALUE] += a * t * moments[j]
        row[first + D_C] += slope * moments[j]
        row[first + D_Z] += a * t * mean_z
        row[first + D_CC] += (a_cc * t + 2.0 * a_c * t_c + sign * rate * rate * a * t) * moments[j]
        row[first + D_CZ] += slope * mean_z
        row[first + D_ZZ] += a * t * (j * mean_z + (j + 1) * step + sign * s * s * moments[j + 2])
        weight *= w * m / (j + 1)


@inner
def trigonometric_means(
    exponent: int, scale: float, offset: float, c: float, w: float, rows: Floats
) -> None:
    """Fills the means of x^p cos(scale·x + offset), and behind them those of x^p sin(…), (12,).

    The angles at c and over w are taken with what their rounding leaves out, so that thousands of
    periods cost no digits.
    """
    angle, rest = _exact_product(scale, c)
    angle, rest_of_sum = _exact_sum(angle, offset)
    rest += rest_of_sum
    cosine, sine = math.cos(angle), math.sin(angle)
    cosine, sine = cosine - rest * sine, sine + rest * cosine
    if w == 0.0 and exponent == 0:  # Moments would give the same bits, in three times the time.
        rows[:] = 0.0
        rows[VALUE], rows[D_C], rows[D_CC] = cosine, scale * -sine, -scale * scale * cosine
        rows[6 + VALUE], rows[6 + D_C], rows[6 + D_CC] = sine, scale * cosine, -scale * scale * sine
        return
    s, rest = _exact_product(abs(scale), w)
    cosine_s, sine_s = math.cos(s), math.sin(s)
    moments = np.empty(exponent + 3)
    _fill_moments(s, sine_s + rest * cosine_s, cosine_s - rest * sine_s, -1.0, moments)
    odd, even = math.copysign(1.0, scale) * -sine, math.copysign(1.0, scale) * cosine
    _wave_mean(exponent, abs(scale), moments, -1.0, cosine, odd, c, w, rows, 0)
    _wave_mean(exponent, abs(scale), moments, -1.0, sine, even, c, w, rows, 6)


@inner
def _exponential_mean(
    exponent: int, scale: float, offset: float, c: float, w: float, row: Floats
) -> None:
    """Fills a row with the mean of x^p exp(scale·x + offset).

    Where it or a derivative overflows, it is ±∞ without derivatives.

    The greatest value of the exponential is taken out of the moments: only the result overflows.
    """
    at_center, rest = _exact_product(scale, c)
    at_center, rest_of_sum = _exact_sum(at_center, offset)
    s, rest_of_s = _exact_product(abs(scale), w)
    greatest, rest_of_greatest = _exact_sum(at_center, s)
    rest += rest_of_sum + rest_of_s + rest_of_greatest
    even = math.exp(greatest) * (1.0 + rest)
    odd = math.copysign(even, scale)
    moments = np.empty(exponent + 3)
    loss = -0.5 * math.expm1(-2.0 * s)
    _fill_moments(s, loss, 1.0 - loss, 1.0, moments)
    _wave_mean(exponent, abs(scale), moments, 1.0, even, odd, c, w, row, 0)
    for part in range(6):
        if not math.isfinite(row[part]):
            row[:6] = 0.0
            falls = exponent % 2 == 1 and c + math.copysign(w, scale) < 0.0
            row[VALUE] = -math.inf if falls else math.inf
            return


@kernel
def factor_mean(
    kind: int,
    exponent: int,
    scale: float,
    offset: float,
    center: float,
    half_width: float,
    row: Floats,
    transcendental: bool | None = True,
) -> None:
    """Fills a row with a function's mean over |x − c| ≤ w, and its derivatives in (c, log w).

    Args:
        kind: A `FunctionKind`.
        exponent: The power p (POWER, COSINE, SINE, EXPONENTIAL).
        scale: Factor inside the function.
        offset: Term inside the function.
        center: Box center c.
        half_width: Box half width w ≥ 0; at w = 0 the mean is the value, every z-derivative 0.
        row: Filled with (μ, ∂c, ∂z, ∂cc, ∂cz, ∂zz), shape (6,).
        transcendental: None promises that the kind is not among `TRANSCENDENTAL`, by its type:
            then Numba compiles without them.
    """
    c, w = scale * center + offset, abs(scale) * half_width
    is_hinge = kind == _SQUARED_HINGE
    if kind == _POWER or (is_hinge and c <= -w):  # There the hinge is y².
        _power_mean(2 if is_hinge else exponent, c, w, row)
    elif is_hinge:
        _squared_hinge_mean(c, w, row)
    elif kind == _HINGE:
        _hinge_mean(c, w, row)
    elif transcendental is not None:
        if kind == _NEG_LOG:
            _neg_log_mean(c, w, row)
        elif kind == _EXPONENTIAL:
            _exponential_mean(exponent, scale, offset, center, half_width, row)
            return
        else:
            both = np.empty(12)
            trigonometric_means(exponent, scale, offset, center, half_width, both)
            for part in range(6):
                row[part] = both[part + 6 if kind == _SINE else part]
            return
    row[D_C] *= scale
    row[D_CZ] *= scale
    row[D_CC] *= scale * scale
