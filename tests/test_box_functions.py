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

from drake_aigto.box import D_C, D_CC, D_CZ, D_Z, D_ZZ, VALUE, BoxPolynomial
from drake_aigto.terms import Factor, FunctionKind, Term, TermBlock

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
