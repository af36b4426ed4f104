"""Means of whole polynomials over boxes: their laws, their derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from box_programs import mean_by_block
from hypothesis import given
from hypothesis import strategies as st
from random_boxes import (
    NUM_VARIABLES,
    TOLERANCE,
    Boxes,
    Floats,
    boxes,
    dense,
    eighths,
    polynomials,
)
from rational_means import exact_mean, relative_error

from drake_aigto.box import BoxPolynomial
from drake_aigto.terms import Factor, FunctionKind, Term, TermBlock


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


@given(polynomials(), boxes())
def test_copies_of_a_block_are_the_sum_of_separate_blocks(f: BoxPolynomial, box: Boxes) -> None:
    separate = tuple(
        TermBlock(block.name, block.terms, variables, block.weight)
        for block in f.blocks
        for variables in block.variables
    )
    g = BoxPolynomial(NUM_VARIABLES, separate, f.order)
    assert (g.num_terms, g.bandwidth) == (f.num_terms, f.bandwidth)
    size = size_of(f, box)
    assert g.mean(*box) == pytest.approx(f.mean(*box), abs=1e-13 * size)
    np.testing.assert_allclose(
        g.newton_system(*box).band, f.newton_system(*box).band, atol=1e-11 * (1 + size)
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
