"""Copies that are evaluated side by side: each as it would be alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_boxes import NUM_VARIABLES, Boxes, blocks, boxes, eighths

from drake_aigto.box import BoxPolynomial, NewtonSystem, Order, make_lanes
from drake_aigto.terms import TermBlock, stack_terms

ORDER = range(NUM_VARIABLES)


def rescaled(block: TermBlock, factor: float) -> TermBlock:
    """Returns a block whose coefficients are those of another, times a factor."""
    terms = [
        dataclasses.replace(term, coefficient=factor * term.coefficient) for term in block.terms
    ]
    return TermBlock(block.name, tuple(terms), block.variables, block.weight)


def sum_of(systems: list[NewtonSystem]) -> NewtonSystem:
    value, gradient, band = zip(*((s.value, s.gradient, s.band) for s in systems), strict=True)
    return NewtonSystem(sum(value), np.sum(gradient, axis=0), np.sum(band, axis=0))


@settings(max_examples=30)
@given(blocks(copies=3), boxes(), st.lists(eighths(-2, 2), min_size=2, max_size=4), st.booleans())
def test_copies_add_up(
    block: TermBlock, box: Boxes, factors: list[float], centers_only: bool
) -> None:
    # More copies than there are lanes, of sums that differ in their coefficients.
    many = [rescaled(block, factor) for factor in factors * 15]
    together = BoxPolynomial(NUM_VARIABLES, tuple(many), ORDER)
    alone = [
        TermBlock("alone", one.terms, [copy], one.weight) for one in many for copy in one.variables
    ]
    pieces = [BoxPolynomial(NUM_VARIABLES, (one,), ORDER) for one in alone]
    size = 1.0 + sum(abs(f.mean(*box)) for f in pieces)
    assert together.mean(*box) == pytest.approx(sum(f.mean(*box) for f in pieces), abs=1e-12 * size)
    width = max((f.bandwidth for f in pieces), default=0)
    for f in (together, *pieces):
        f.bandwidth = width
    ours = together.newton_system(*box, centers_only)
    theirs = sum_of([f.newton_system(*box, centers_only) for f in pieces])
    for name in ("value", "gradient", "band"):
        expected = getattr(theirs, name)
        largest = 1.0 + size + np.max(np.abs(expected))
        np.testing.assert_allclose(getattr(ours, name), expected, rtol=0, atol=1e-12 * largest)
    gradients = [np.array(f.gradient(*box)[1:]) for f in pieces]
    largest = 1.0 + size + max(np.max(np.abs(gradient)) for gradient in gradients)
    np.testing.assert_allclose(
        together.gradient(*box)[1:], np.sum(gradients, axis=0), rtol=0, atol=1e-11 * largest
    )


@given(blocks(copies=2), st.integers(1, 100))
def test_sums_that_differ_in_numbers_share_a_tape(block: TermBlock, copies: int) -> None:
    many = TermBlock("many", block.terms, np.tile(block.variables, (copies, 1)))
    stacked = stack_terms([many, rescaled(block, 2.0)])
    for order in Order:
        lanes = make_lanes(stacked, order)
        assert lanes.tapes.size == 2, "the tape, and the entry that ends it"
        assert lanes.most_lanes == min(64, 2 * copies + 2)
