"""One-variable means and their derivatives against exact arithmetic, wherever they are used."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import pytest
from box_programs import evaluate, evaluate_in_a_program
from hypothesis import given, settings
from hypothesis import strategies as st
from rational_means import exact_factor_mean, exact_row, relative_error

from drake_aigto.box import D_C, D_CC, D_CZ, D_Z, D_ZZ, VALUE
from drake_aigto.terms import Factor, FunctionKind

# The goal is 1e-13; a mean takes some ten roundings of 1.1e-16, in c^p most of all.
VALUE_TOLERANCE = 1e-14
# The log's closed form subtracts numbers that are up to 3/0.3² = 33 times their difference.
DERIVATIVE_TOLERANCE = 1e-13
SQUARED_HINGE = Factor(0, FunctionKind.SQUARED_HINGE)
HINGE = Factor(0, FunctionKind.HINGE)
NEG_LOG = Factor(0, FunctionKind.NEG_LOG)

# The ranges: |c| up to 1e3; w is 0, or 1e-12 to 1e3, in all sizes alike.
sizes = st.floats(-12.0, 3.0).map(lambda e: 10.0**e)
centers = st.one_of(
    st.just(0.0), st.floats(1e-12, 1e3), sizes, st.floats(-1e3, -1e-12), sizes.map(lambda c: -c)
)
half_widths = st.one_of(st.just(0.0), sizes)
powers = st.integers(0, 8).map(lambda p: Factor(0, FunctionKind.POWER, p))

# Kernels evaluate powers by themselves.
Way = Callable[[Factor, float, float], npt.NDArray[np.float64]]
WAYS = [evaluate, evaluate_in_a_program]


@st.composite
def hinge_boxes(draw: st.DrawFn) -> tuple[float, float]:
    """Boxes on both sides of the borders |c| = w, on them, and next to them."""
    w = draw(sizes)
    c = w * draw(st.one_of(st.just(1.0), st.floats(0.9, 1.1), st.floats(0.0, 2.0)))
    c = draw(st.sampled_from([c, math.nextafter(c, 0.0), math.nextafter(c, math.inf)]))
    return draw(st.sampled_from([c, -c])), w


@st.composite
def log_boxes(draw: st.DrawFn) -> tuple[float, float]:
    """Boxes in y > 0: on both sides of the series' border w/c = 0.3, and nearly touching 0."""
    c = draw(st.one_of(sizes, st.floats(0.5, 2.0)))
    ratios = st.one_of(
        st.just(0.0),
        sizes.filter(lambda r: r < 1.0),
        st.floats(1e-12, 0.99),
        st.sampled_from([0.3, math.nextafter(0.3, 0.0), math.nextafter(0.3, 1.0)]),
        sizes.filter(lambda r: r < 1.0).map(lambda gap: 1.0 - gap),
    )
    w = c * draw(ratios)
    return c, (w if w < c else math.nextafter(c, 0.0))


def assert_derivatives_exact(
    factor: Factor, center: float, half_width: float, way: Way = evaluate
) -> None:
    row, exact = way(factor, center, half_width), exact_row(factor, center, half_width)
    mean = exact.pop(VALUE)
    for column, derivative in exact.items():
        # What the differences' own error h² = 1e-40 can be mistaken for is not to be judged.
        size = abs(derivative) + Fraction(1, 10**35) * abs(mean)
        error = relative_error(row[column], derivative, size)
        assert error <= DERIVATIVE_TOLERANCE, (column, row[column], float(derivative))


@pytest.mark.parametrize("way", WAYS)
@given(powers, centers, half_widths)
def test_mean_of_a_power_is_that_of_exact_arithmetic(
    way: Way, factor: Factor, center: float, half_width: float
) -> None:
    mean = exact_factor_mean(factor, Fraction(center), Fraction(half_width))
    computed = way(factor, center, half_width)[VALUE]
    assert relative_error(computed, mean, abs(mean)) <= VALUE_TOLERANCE


@given(hinge_boxes())
def test_mean_of_the_squared_hinge_is_that_of_exact_arithmetic(box: tuple[float, float]) -> None:
    mean = exact_factor_mean(SQUARED_HINGE, *map(Fraction, box))
    computed = evaluate(SQUARED_HINGE, *box)[VALUE]
    assert relative_error(computed, mean, mean) <= VALUE_TOLERANCE


@given(log_boxes())
def test_mean_of_the_logarithm_is_that_of_exact_arithmetic(box: tuple[float, float]) -> None:
    mean = exact_factor_mean(NEG_LOG, *map(Fraction, box))
    at_center = exact_factor_mean(NEG_LOG, Fraction(box[0]), Fraction(0))
    size = abs(at_center) + abs(mean - at_center)  # the two may nearly cancel, as near c = 1
    assert relative_error(evaluate(NEG_LOG, *box)[VALUE], mean, size) <= 4 * VALUE_TOLERANCE


@pytest.mark.parametrize("way", WAYS)
@settings(max_examples=60)
@given(powers, centers, half_widths)
def test_derivatives_of_a_power_are_those_of_exact_arithmetic(
    way: Way, factor: Factor, center: float, half_width: float
) -> None:
    if center or half_width:  # else there is no length to take differences over
        assert_derivatives_exact(factor, center, half_width, way)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("exponent", [*range(6), 12, 13])
def test_derivatives_of_a_power_at_the_origin_are_those_of_its_value(
    way: Way, exponent: int
) -> None:
    row = way(Factor(0, FunctionKind.POWER, exponent), 0.0, 0.0)
    expected = np.zeros(6)
    if exponent <= 2:
        expected[{0: VALUE, 1: D_C, 2: D_CC}[exponent]] = math.factorial(exponent)
    np.testing.assert_array_equal(row, expected)


@settings(max_examples=60)
@given(hinge_boxes().filter(lambda box: abs(abs(box[0]) - box[1]) > 1e-9 * box[1]))
def test_derivatives_of_the_squared_hinge_are_those_of_exact_arithmetic(
    box: tuple[float, float],
) -> None:
    assert_derivatives_exact(SQUARED_HINGE, *box)


@given(hinge_boxes())
def test_the_hinge_is_minus_half_the_slope_of_its_square(box: tuple[float, float]) -> None:
    square, hinge = evaluate(SQUARED_HINGE, *box), evaluate(HINGE, *box)
    for of_square, of_hinge in ((D_C, VALUE), (D_CC, D_C), (D_CZ, D_Z)):
        size = max(abs(square[of_square]), 1e-300)
        assert abs(-2.0 * hinge[of_hinge] - square[of_square]) <= DERIVATIVE_TOLERANCE * size


@pytest.mark.parametrize("center", [-0.3, 0.0, 0.2, 0.49, -0.8, 0.8])
def test_second_derivatives_of_the_hinge_are_the_slopes_of_the_first(center: float) -> None:
    w, h = 0.5, 1e-6
    here = evaluate(HINGE, center, w)
    right, left = evaluate(HINGE, center + h, w), evaluate(HINGE, center - h, w)
    wide, narrow = (evaluate(HINGE, center, w * math.exp(sign * h)) for sign in (1.0, -1.0))
    assert here[D_CC] == pytest.approx((right[D_C] - left[D_C]) / (2 * h), abs=1e-8)
    assert here[D_CZ] == pytest.approx((wide[D_C] - narrow[D_C]) / (2 * h), abs=1e-8)
    assert here[D_ZZ] == pytest.approx((wide[D_Z] - narrow[D_Z]) / (2 * h), abs=1e-8)


@settings(max_examples=60)
@given(log_boxes().filter(lambda box: box[0] - box[1] > 1e-9 * box[0]))
def test_derivatives_of_the_logarithm_are_those_of_exact_arithmetic(
    box: tuple[float, float],
) -> None:
    assert_derivatives_exact(NEG_LOG, *box)


@given(st.sampled_from([1e-12, 1e-3, 1.0, 1e3]), st.sampled_from([-1.0, 1.0]))
def test_the_squared_hinge_is_twice_differentiable_across_its_borders(
    w: float, side: float
) -> None:
    border = evaluate(SQUARED_HINGE, side * w, w)
    inside = evaluate(SQUARED_HINGE, side * math.nextafter(w, 0.0), w)
    scale = np.array([w * w, w, w * w, 1.0, w, w * w])  # units of the six columns
    np.testing.assert_allclose(inside / scale, border / scale, atol=1e-14)


@given(
    st.sampled_from([Factor(0, FunctionKind.POWER, 3), SQUARED_HINGE, NEG_LOG]),
    st.floats(2.0, 10.0),
    st.floats(0.0, 1.0),
    st.sampled_from([-2.0, -0.5, 0.25, 4.0]),
    st.sampled_from([-3.0, 0.0, 0.5, 8.0]),
)
def test_scale_and_offset_act_as_a_change_of_variable(
    factor: Factor, y: float, reach: float, scale: float, offset: float
) -> None:
    y, reach = round(y * 64) / 64, round(reach * 64) / 64  # so that x is a float too
    y = -y if factor is SQUARED_HINGE else y
    inner = evaluate(factor, y, reach)
    moved = Factor(0, factor.kind, factor.exponent, scale, offset)
    outer = evaluate(moved, (y - offset) / scale, reach / abs(scale))
    chain = np.ones(6)
    chain[[D_C, D_CZ]], chain[D_CC] = scale, scale * scale
    np.testing.assert_array_equal(outer, inner * chain)


@given(
    st.sampled_from([Factor(0, FunctionKind.POWER, 6), SQUARED_HINGE, NEG_LOG]),
    st.floats(1e-3, 1e3),
)
def test_a_box_of_no_width_has_the_value_and_no_slope_in_z(factor: Factor, size: float) -> None:
    y = -size if factor is SQUARED_HINGE else size
    row = evaluate(factor, y, 0.0)
    value = -math.log(y) if factor is NEG_LOG else y**6 if factor.exponent == 6 else y * y
    assert row[VALUE] == pytest.approx(value, rel=VALUE_TOLERANCE)
    np.testing.assert_array_equal(row[[D_Z, D_CZ, D_ZZ]], 0.0)


def test_the_logarithm_has_a_finite_mean_up_to_the_border_of_its_domain_and_none_beyond() -> None:
    touching = evaluate(NEG_LOG, 0.25, 0.25)
    assert touching[VALUE] == pytest.approx(1.0 - math.log(0.5), rel=1e-15)
    np.testing.assert_array_equal(touching[[D_C, D_CZ]], -np.inf)
    np.testing.assert_array_equal(touching[[D_Z, D_CC, D_ZZ]], np.inf)
    for center, half_width in [(0.25, math.nextafter(0.25, 1.0)), (0.0, 0.0), (-1.0, 0.5)]:
        assert evaluate(NEG_LOG, center, half_width)[VALUE] == math.inf
