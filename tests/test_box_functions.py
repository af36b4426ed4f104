"""One-variable means and their derivatives against exact arithmetic, wherever they are used."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import pytest
from box_programs import (
    NUM_VARIABLES,
    TOLERANCE,
    Boxes,
    Floats,
    boxes,
    dense,
    eighths,
    evaluate,
    evaluate_in_a_program,
    exact_factor_mean,
    exact_mean,
    exact_row,
    mean_by_block,
    polynomials,
    relative_error,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from marks import slow

from drake_aigto.box import D_C, D_CC, D_CZ, D_Z, D_ZZ, VALUE, BoxPolynomial, factor_mean
from drake_aigto.terms import WAVES, Factor, FunctionKind, Term, TermBlock

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
Case = tuple[Factor, float, float]
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


KINDS = (
    st.tuples(powers, centers, half_widths)
    | hinge_boxes().map(lambda box: (SQUARED_HINGE, *box))
    | hinge_boxes().map(lambda box: (SQUARED_HINGE, box[0], 0.0))
    | log_boxes().map(lambda box: (NEG_LOG, *box))
)


def is_smooth(case: Case) -> bool:
    factor, center, half_width = case
    if factor is SQUARED_HINGE:
        return abs(abs(center) - half_width) > 1e-9 * half_width
    if factor is NEG_LOG:
        return center - half_width > 1e-9 * center
    return bool(center or half_width)


@pytest.mark.parametrize("way", WAYS)
@settings(max_examples=40)
@given(KINDS)
def test_the_mean_is_that_of_exact_arithmetic(way: Way, case: Case) -> None:
    factor, *box = case
    mean = exact_factor_mean(factor, *map(Fraction, box))
    size, tolerance = abs(mean), VALUE_TOLERANCE
    if factor is NEG_LOG:  # Value and gain over it may nearly cancel, as near c = 1.
        at_center = exact_factor_mean(factor, Fraction(box[0]), Fraction(0))
        size, tolerance = abs(at_center) + abs(mean - at_center), 4 * VALUE_TOLERANCE
    assert relative_error(way(factor, *box)[VALUE], mean, size) <= tolerance


@pytest.mark.parametrize("way", WAYS)
@settings(max_examples=40)
@given(KINDS.filter(is_smooth))
def test_derivatives_are_those_of_exact_arithmetic(way: Way, case: Case) -> None:
    factor, *box = case
    row, exact = way(factor, *box), exact_row(factor, *box)
    mean = exact.pop(VALUE)
    for column, derivative in exact.items():
        # What the differences' own error h² = 1e-40 can be mistaken for is not to be judged.
        size = abs(derivative) + Fraction(1, 10**35) * abs(mean)
        error = relative_error(row[column], derivative, size)
        assert error <= DERIVATIVE_TOLERANCE, (column, row[column], float(derivative))


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


@given(st.sampled_from([1e-12, 1e-3, 1.0, 1e3]), st.sampled_from([-1.0, 1.0]))
def test_the_squared_hinge_is_twice_differentiable_across_its_borders(
    w: float, side: float
) -> None:
    border = evaluate(SQUARED_HINGE, side * w, w)
    inside = evaluate(SQUARED_HINGE, side * math.nextafter(w, 0.0), w)
    scale = np.array([w * w, w, w * w, 1.0, w, w * w])  # units of the six columns
    np.testing.assert_allclose(inside / scale, border / scale, atol=1e-14)


def test_the_logarithm_has_a_finite_mean_up_to_the_border_of_its_domain_and_none_beyond() -> None:
    touching = evaluate(NEG_LOG, 0.25, 0.25)
    assert touching[VALUE] == pytest.approx(1.0 - math.log(0.5), rel=1e-15)
    np.testing.assert_array_equal(touching[[D_C, D_CZ]], -np.inf)
    np.testing.assert_array_equal(touching[[D_Z, D_CC, D_ZZ]], np.inf)
    for center, half_width in [(0.25, math.nextafter(0.25, 1.0)), (0.0, 0.0), (-1.0, 0.5)]:
        assert evaluate(NEG_LOG, center, half_width)[VALUE] == math.inf


def size_of(f: BoxPolynomial, box: Boxes) -> float:
    """Returns Σ |a_m| ∏ |μ|, the size that rounding errors are measured by."""
    return float(exact_mean(f, *box)[1])


def in_variable_order(f: BoxPolynomial, matrix: Floats) -> Floats:
    """Returns a Hessian in elimination order as one over all c, then all z."""
    places = f.to_variables(np.arange(float(matrix.shape[0])))
    index = np.concatenate(list(places)).astype(int)
    return np.asarray(matrix[np.ix_(index, index)])


@given(polynomials(), boxes())
def test_mean_is_that_of_exact_arithmetic(f: BoxPolynomial, box: Boxes) -> None:
    mean, size = exact_mean(f, *box)
    assert relative_error(f.mean(*box), mean, size) <= TOLERANCE


@given(polynomials(), boxes(), st.permutations(range(NUM_VARIABLES)))
def test_results_do_not_depend_on_the_elimination_order(
    f: BoxPolynomial, box: Boxes, order: list[int]
) -> None:
    g = BoxPolynomial(NUM_VARIABLES, f.blocks, order)
    np.testing.assert_array_equal(g.order, order)
    assert g.mean(*box) == f.mean(*box)
    for centers_only in (False, True):
        ours, theirs = f.newton_system(*box, centers_only), g.newton_system(*box, centers_only)
        assert ours.value == theirs.value == pytest.approx(f.mean(*box))
        for mine, other in zip(
            f.to_variables(ours.gradient), g.to_variables(theirs.gradient), strict=True
        ):
            np.testing.assert_array_equal(mine, other)
        np.testing.assert_array_equal(
            in_variable_order(f, dense(ours.band)), in_variable_order(g, dense(theirs.band))
        )


def largest_size(f: BoxPolynomial, box: Boxes) -> float:
    """Returns a bound on what the terms come to near the box, on either side of a hinge."""
    center, half_width = box
    return sum(size_of(f, (c, half_width + 1)) for c in (center, np.abs(center), -np.abs(center)))


@given(polynomials(), boxes(least_width=0.5))
def test_gradient_is_the_slope_of_the_mean(f: BoxPolynomial, box: Boxes) -> None:
    center, half_width = box
    value, gradient_c, gradient_z = f.gradient(center, half_width)
    h = 2.0**-17  # so that c ± h is a float; error h²/6 of the third derivative, and 1e-16/h
    scale = 1e-8 * (1 + largest_size(f, box))
    assert value == f.mean(center, half_width)
    for i, unit in enumerate(np.eye(NUM_VARIABLES)):
        slope_c = f.mean(center + h * unit, half_width) - f.mean(center - h * unit, half_width)
        wide, narrow = half_width * np.exp(h * unit), half_width * np.exp(-h * unit)
        slope_z = f.mean(center, wide) - f.mean(center, narrow)
        assert gradient_c[i] == pytest.approx(slope_c / (2 * h), abs=scale)
        assert gradient_z[i] == pytest.approx(slope_z / (2 * h), abs=scale)


@given(polynomials(), boxes(least_width=0.5), st.booleans())
def test_banded_hessian_is_the_slope_of_the_gradient(
    f: BoxPolynomial, box: Boxes, centers_only: bool
) -> None:
    center, half_width = box
    system = f.newton_system(center, half_width, centers_only)
    value, *gradient = f.gradient(center, half_width)
    size = largest_size(f, box)
    parts = gradient[:1] if centers_only else gradient
    assert system.value == pytest.approx(value, abs=1e-13 * size)
    for ours, theirs in zip(f.to_variables(system.gradient), parts, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-12 * (1 + size))
    h = 2.0**-17
    columns = []
    for direction in np.eye(len(parts) * NUM_VARIABLES):
        step_c, step_z = direction[:NUM_VARIABLES], direction[NUM_VARIABLES:]
        moved = [
            f.gradient(center + s * step_c, half_width * np.exp(s * step_z if step_z.size else 0.0))
            for s in (h, -h)
        ]
        forward, backward = (np.concatenate(m[1 : 1 + len(parts)]) for m in moved)
        columns.append((forward - backward) / (2 * h))
    hessian = in_variable_order(f, dense(system.band))
    # The hinge's third derivative jumps by 1/w ≤ 2 at its borders: an error of h there, not h².
    np.testing.assert_allclose(hessian, np.array(columns).T, atol=2 * h * (1 + size))


def test_bandwidth_is_that_of_a_chain_in_its_own_order() -> None:
    product = Term(1.0, (Factor(0, FunctionKind.POWER), Factor(1, FunctionKind.POWER)))
    links = [[i, i + 1] for i in range(9)]
    chain = BoxPolynomial(10, (TermBlock("chain", (product,), links),), range(10))
    assert chain.bandwidth == 1
    assert chain.newton_system(np.ones(10), 0.1).band.shape == (4, 20)
    assert chain.newton_system(np.ones(10), 0.1, centers_only=True).band.shape == (2, 10)
    shuffled = np.random.default_rng(0).permutation(10)
    renamed = BoxPolynomial(10, (TermBlock("chain", (product,), shuffled[links]),))
    assert renamed.bandwidth == 1, "reverse Cuthill-McKee finds the chain"


@given(polynomials(), boxes(), eighths(-4, 4))
def test_mean_is_linear_in_the_weights(f: BoxPolynomial, box: Boxes, factor: float) -> None:
    before, weights = f.mean(*box), f.weights
    scaled = f.with_weights({name: factor * weight for name, weight in weights.items()})
    assert (f.mean(*box), f.weights) == (before, weights), "the old one stays as it was"
    shares = mean_by_block(f, *box)
    size = 1e-13 * (1 + abs(factor)) * size_of(f, box)
    assert scaled.mean(*box) == pytest.approx(factor * f.mean(*box), abs=size)
    assert set(shares) == set(f.weights)
    total = sum(weight * shares[name] for name, weight in f.weights.items())
    assert total == pytest.approx(f.mean(*box), abs=size)
    assert f.with_weights({"first": 0.0}).mean(*box) == pytest.approx(
        f.mean(*box) - f.weights["first"] * shares["first"], abs=size
    )


# The goal is 1e-13 of the natural size; 5e-16 is the worst that 1,800 random boxes gave.
WAVE_TOLERANCE = 4e-15

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
def wave_boxes(draw: st.DrawFn, least: float = -12.0) -> Box:
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
        error, largest = (
            abs(Fraction(row[column]) - exact),
            Fraction(WAVE_TOLERANCE) * sizes[column],
        )
        assert error <= largest + slack, (column, row[column], float(exact))


@given(wave_boxes())
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
    assert abs(Fraction(row[VALUE]) - exact) <= Fraction(WAVE_TOLERANCE) * sizes[VALUE]
    # To first order in w², ∂/∂z is twice the gain of the mean over the value; w² may underflow.
    at_point = evaluate(factor, center, 0.0)
    curvature = half_width**2 * at_point[D_CC] / 3
    slack = WAVE_TOLERANCE * float(sizes[D_Z]) + 1e-319
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


@given(wave_boxes())
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
