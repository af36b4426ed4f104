"""Mixes of points: the best of all combinations, also where loops have to be cut."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from box_programs import power

from drake_aigto.aigo import Box, BoxSearch, Fusion
from drake_aigto.box import BoxPolynomial
from drake_aigto.terms import Term, TermBlock


def random_grid(rows: int, columns: int, seed: int) -> BoxPolynomial:
    """x⁴ − 2 x² + a x at each node, b x y along each edge."""
    rng = np.random.default_rng(seed)
    place = np.arange(rows * columns).reshape(rows, columns)
    across = np.column_stack([place[:, :-1].ravel(), place[:, 1:].ravel()])
    down = np.column_stack([place[:-1].ravel(), place[1:].ravel()])
    wells = Term(1.0, (power(0, 4),)), Term(-2.0, (power(0, 2),))
    blocks = [
        TermBlock(f"node {i}", (*wells, Term(rng.normal(), (power(0),))), [[i]])
        for i in range(place.size)
    ]
    blocks += [
        TermBlock(f"edge {i} {j}", (Term(rng.normal(), (power(0), power(1))),), [[i, j]])
        for i, j in np.vstack([across, down]).tolist()
    ]
    return BoxPolynomial(place.size, tuple(blocks))


def test_the_best_of_all_combinations_is_found() -> None:
    f, rng = random_grid(2, 4, 0), np.random.default_rng(1)
    points = list(rng.uniform(-2, 2, (3, 8)))
    fusion = Fusion.of(f, 3)
    assert fusion is not None
    free = np.ones(8, dtype=bool)
    mixed = fusion.mix(points, free, rng)
    choices = itertools.product(range(3), repeat=8)
    least = min(f(np.array(points)[list(choice), np.arange(8)]) for choice in choices)
    assert f(mixed) == pytest.approx(least, rel=1e-12)

    free[[1, 6]] = False
    mixed = fusion.mix(points, free, rng)
    np.testing.assert_array_equal(mixed[~free], points[0][~free])
    choices = itertools.product(*(range(3) if each else (0,) for each in free))
    least = min(f(np.array(points)[list(choice), np.arange(8)]) for choice in choices)
    assert f(mixed) == pytest.approx(least, rel=1e-12)


def test_where_loops_are_cut_the_mix_is_no_worse_than_the_first_point() -> None:
    f, rng = random_grid(12, 12, 0), np.random.default_rng(0)
    fusion = Fusion.of(f, 4)
    assert fusion is not None
    free = np.ones(144, dtype=bool)
    best = rng.uniform(-2, 2, 144)
    for _ in range(5):
        points = [best, *rng.uniform(-2, 2, (3, 144))]
        mixed = fusion.mix(points, free, rng)
        assert np.all((mixed == points).any(axis=0))
        assert f(mixed) < f(best) - 1.0
        best = mixed


def test_terms_of_many_variables_are_not_mixed() -> None:
    product = Term(1.0, tuple(power(i) for i in range(5)))
    assert Fusion.of(BoxPolynomial(5, (TermBlock("", (product,), [range(5)]),)), 4) is None


def test_a_frustrated_grid_is_searched_to_its_minimum() -> None:
    """Each node's value is near ±1, so that the minimum is found from all signs."""
    f = random_grid(3, 4, 2)
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=12)))
    values = [f(x) for x in signs]
    box = Box(np.zeros(12), np.full(12, 2.5))
    starts = signs[np.argsort(values)[:64]]
    least = min(BoxSearch(rounds=0).run(f, Box(x, np.full(12, 0.3))).best.cost for x in starts)
    found = BoxSearch().run(f, box).best
    assert found.cost <= least + 1e-9 * abs(least)
