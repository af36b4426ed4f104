"""Means of powers times cosines, sines and exponentials against arithmetic in many digits."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from box_programs import evaluate, exact_factor_mean, exact_row
from hypothesis import given
from hypothesis import strategies as st
from marks import slow

from drake_aigto.box import D_C, D_CC, D_CZ, D_Z, D_ZZ, VALUE, factor_mean
from drake_aigto.terms import WAVES, Factor, FunctionKind

# The goal is 1e-13 of the natural size; 5e-16 is the worst that 1,800 random boxes gave.
TOLERANCE = 4e-15

COSINE, SINE, EXPONENTIAL = FunctionKind.COSINE, FunctionKind.SINE, FunctionKind.EXPONENTIAL
PLAIN: dict[FunctionKind, Callable[[float], float]] = {
    COSINE: math.cos,
    SINE: math.sin,
    EXPONENTIAL: math.exp,
}
Box = tuple[Factor, float, float]

signs = st.sampled_from([-1.0, 1.0])
scales = st.one_of(
    st.sampled_from([1.0, -1.0, 2 * math.pi]), st.floats(-2.0, 2.0).map(lambda e: 10.0**e)
)


@st.composite
def boxes(draw: st.DrawFn, least: float = -12.0) -> Box:
    """Factors, centers up to 1e6 on both sides, scale·half_width 0, or 10^least to 1e6."""
    kind = draw(st.sampled_from(WAVES))
    scale = draw(signs) * draw(scales)
    decades = st.one_of(st.floats(least, 6.0), st.floats(-2.0, 1.5))
    reach = draw(st.one_of(st.just(0.0), decades.map(lambda e: 10.0**e)))
    half_width = reach / abs(scale)
    center = draw(
        st.one_of(
            st.just(0.0),
            st.floats(-2.0, 2.0).map(lambda ratio: ratio * half_width),
            st.tuples(signs, st.floats(-6.0, 6.0)).map(lambda t: t[0] * 10.0 ** t[1]),
        )
    )
    offset = draw(st.one_of(st.just(0.0), st.floats(-4.0, 4.0)))
    if kind is EXPONENTIAL:  # at most e⁵ in the box
        offset += 1.0 - scale * center - reach
    return Factor(0, kind, draw(st.integers(0, 8)), scale, offset), center, half_width


def bound(factor: Factor, order: int, reach: Fraction) -> Fraction:
    """Returns an upper bound of |d^order/dx^order (x^p g)| over |x| ≤ reach, |g| ≤ 1."""
    p, k = factor.exponent, abs(Fraction(factor.scale))
    return sum(
        (
            math.comb(order, i) * math.perm(p, order - i) * reach ** (p - order + i) * k**i
            for i in range(order + 1)
            if order - i <= p
        ),
        start=Fraction(0),
    )


def natural_sizes(factor: Factor, center: float, half_width: float) -> dict[int, Fraction]:
    """Returns what errors are measured by: bounds of μ and its derivatives.

    The mean of a wave falls as 1/s, s = scale·w; ∂/∂z is w²/3 times a second derivative for small
    s, and for large s a difference of the wave's mean and its values at the box's ends.
    """
    reach, w = abs(Fraction(center)) + Fraction(half_width), Fraction(half_width)
    s = abs(Fraction(factor.scale)) * w
    once, twice = 1 / max(s, Fraction(1)), 1 / max(s, Fraction(1)) ** 2
    greatest = Fraction(1)
    if factor.kind is EXPONENTIAL:
        at_center = Fraction(factor.scale) * Fraction(center) + Fraction(factor.offset)
        greatest = Fraction(math.exp(at_center + s))
    sizes = {
        VALUE: bound(factor, 0, reach) * once,
        D_C: bound(factor, 1, reach) * once,
        D_CC: bound(factor, 2, reach) * once,
        D_Z: w * w * bound(factor, 2, reach) * twice,
        D_CZ: w * w * bound(factor, 3, reach) * twice,
        D_ZZ: w * w * bound(factor, 2, reach) * once,
    }
    return {column: size * greatest for column, size in sizes.items()}


def assert_exact(factor: Factor, center: float, half_width: float) -> None:
    row = evaluate(factor, center, half_width)
    sizes = natural_sizes(factor, center, half_width)
    slack = Fraction(0 if half_width else 1e-35)  # Differences at a point miss by h² = 1e-40.
    for column, exact in exact_row(factor, center, half_width).items():
        error, largest = abs(Fraction(row[column]) - exact), Fraction(TOLERANCE) * sizes[column]
        assert error <= largest + slack, (column, row[column], float(exact))


@given(boxes())
def test_mean_and_derivatives_are_those_of_exact_arithmetic(box: Box) -> None:
    assert_exact(*box)


@pytest.mark.parametrize("kind", WAVES)
@pytest.mark.parametrize(
    ("exponent", "center", "half_width"),
    [(0, 0.0, 1e-30), (0, -3.5, 1e-300), *slow((1, 0.0, 1e-300)), (3, -3.5, 1e-30)],
)
def test_tiny_widths_lose_no_digit(
    kind: FunctionKind, exponent: int, center: float, half_width: float
) -> None:
    factor = Factor(0, kind, exponent, -1.5, 0.25)
    row = evaluate(factor, center, half_width)
    exact = exact_factor_mean(factor, Fraction(center), Fraction(half_width))
    sizes = natural_sizes(factor, center, half_width)
    assert abs(Fraction(row[VALUE]) - exact) <= Fraction(TOLERANCE) * sizes[VALUE]
    # To first order in w², ∂/∂z is twice the gain of the mean over the value; w² may underflow.
    at_point = evaluate(factor, center, 0.0)
    curvature = half_width**2 * at_point[D_CC] / 3
    slack = TOLERANCE * float(sizes[D_Z]) + 1e-319
    assert row[D_Z] == pytest.approx(curvature, rel=0.0, abs=slack)
    assert row[D_ZZ] == pytest.approx(2 * curvature, rel=0.0, abs=2 * slack)
    np.testing.assert_allclose(row[[D_C, D_CC]], at_point[[D_C, D_CC]], rtol=1e-14)


@given(
    st.sampled_from(WAVES),
    st.integers(0, 8),
    signs,
    st.sampled_from([1.0, math.nextafter(2.0, 0.0), 2.0, 5.0, 10.0, 11.0]),
    st.floats(-1.5, 1.5),
)
def test_the_recursions_meet_where_their_direction_changes(
    kind: FunctionKind, exponent: int, side: float, reach: float, ratio: float
) -> None:
    offset = 0.0 if kind is not EXPONENTIAL else -reach
    assert_exact(Factor(0, kind, exponent, side, offset), ratio * reach, reach)


@given(st.sampled_from(WAVES), st.integers(0, 8), st.floats(-9.0, 9.0), st.floats(0.0, 9.0))
def test_without_a_scale_the_wave_is_a_constant(
    kind: FunctionKind, exponent: int, center: float, half_width: float
) -> None:
    wave = evaluate(Factor(0, kind, exponent, 0.0, 0.5), center, half_width)
    power = evaluate(Factor(0, FunctionKind.POWER, exponent), center, half_width)
    size = (abs(center) + half_width) ** exponent * exponent**2
    np.testing.assert_allclose(
        wave, power * PLAIN[kind](0.5), rtol=1e-13, atol=1e-14 * size + 1e-300
    )


@given(boxes())
def test_a_sine_is_a_cosine_a_quarter_later_and_both_know_their_symmetry(box: Box) -> None:
    factor, center, half_width = box
    p, k, b = factor.exponent, factor.scale, factor.offset
    sizes = natural_sizes(Factor(0, SINE, p, k, b), center, half_width)
    sine = evaluate(Factor(0, SINE, p, k, b), center, half_width)
    cosine = evaluate(Factor(0, COSINE, p, k, b - math.pi / 2), center, half_width)
    mirrored = evaluate(Factor(0, SINE, p, -k, -b), center, half_width)
    np.testing.assert_array_equal(mirrored, -sine)
    # b − π/2 is rounded, to half an ulp of b or π/2.
    slack = 1e-14 + math.ulp(max(abs(b), math.pi))
    for column, size in sizes.items():
        assert abs(sine[column] - cosine[column]) <= slack * float(size)


def test_an_exponential_overflows_to_infinity_and_underflows_to_zero_without_nan() -> None:
    for exponent in range(4):
        for center, half_width in [(1e4, 1.0), (1e4, 0.0), (0.0, 1e300), (-1.0, 1e6), (709.0, 2.0)]:
            row = evaluate(Factor(0, EXPONENTIAL, exponent), center, half_width)
            np.testing.assert_array_equal(row, [math.inf, 0.0, 0.0, 0.0, 0.0, 0.0])
        row = evaluate(Factor(0, EXPONENTIAL, exponent), -1e4, 1.0)
        np.testing.assert_array_equal(row, 0.0)
    falls = evaluate(Factor(0, EXPONENTIAL, 1, -1.0), -1e4, 1.0)
    assert falls[VALUE] == -math.inf
    # e^{x − 1e6} over |x| ≤ 1e6: the closed form's own numbers would overflow, the mean does not.
    mean = evaluate(Factor(0, EXPONENTIAL, 0, 1.0, -1e6), 0.0, 1e6)[VALUE]
    assert mean == pytest.approx(0.5e-6, rel=1e-15)


@pytest.mark.parametrize("leftover", [math.nan, math.inf, 1.0])
@pytest.mark.parametrize("kind", [kind for kind in FunctionKind if kind is not COSINE])
def test_a_mean_does_not_depend_on_what_was_behind_its_row(
    kind: FunctionKind, leftover: float
) -> None:
    """A program's rows have room for a sine behind each cosine; other functions leave it alone."""
    row = np.full(12, leftover)
    factor_mean(int(kind), 1, 0.5, 2.0, 0.7, 0.3, row)
    np.testing.assert_array_equal(row[:6], evaluate(Factor(0, kind, 1, 0.5, 2.0), 0.7, 0.3))


@given(st.floats(-300.0, 300.0), st.sampled_from([COSINE, SINE]), st.integers(0, 2))
def test_waves_stay_finite_at_any_width(decade: float, kind: FunctionKind, exponent: int) -> None:
    row = evaluate(Factor(0, kind, exponent, 3.0, 1.0), 0.5, 10.0 ** (decade / (1 + exponent)))
    assert np.all(np.isfinite(row[[VALUE, D_C, D_Z, D_CC, D_CZ]]))
