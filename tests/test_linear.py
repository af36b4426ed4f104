"""Sparse symmetric matrices, their orders, and the choice between them and bands."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sparse_matrices import arrow, grid, whole

from drake_aigto.linear import (
    Factorization,
    Pattern,
    Storage,
    choose_storage,
    count_fill,
    factorize,
    find_entry,
    make_pattern,
    minimum_degree,
    multiply,
    spread,
)


@st.composite
def patterns(draw: st.DrawFn, least: int = 1) -> tuple[Pattern, np.random.Generator]:
    """Random patterns of some unknowns, pairs twice and with themselves among the edges."""
    size = draw(st.integers(least, 25))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    edges = rng.integers(0, size, (2, draw(st.integers(0, 3 * size))))
    return make_pattern(size, edges), rng


@given(patterns())
def test_a_pattern_tells_every_entry_apart(case: tuple[Pattern, np.random.Generator]) -> None:
    pattern, _ = case
    size, count = pattern.size, pattern.rows.size
    numbers = whole(pattern, np.arange(1.0, count + 1))
    assert np.array_equal(np.diag(numbers), np.arange(1.0, size + 1))
    for i, j in zip(*np.nonzero(numbers), strict=True):
        assert find_entry(pattern, i, j) == numbers[i, j] - 1
    for k in range(size):
        beside = pattern.beside[pattern.beside_starts[k] : pattern.beside_starts[k + 1]]
        row = np.delete(numbers[k], k)
        assert sorted(beside + 1) == sorted(row[row > 0])
    for j in range(size):
        column = slice(pattern.whole_starts[j], pattern.whole_starts[j + 1])
        rows = pattern.whole_rows[column]
        assert np.array_equal(rows, np.flatnonzero(numbers[:, j]))
        assert np.array_equal(pattern.whole[column] + 1, numbers[rows, j])


@given(patterns(), st.integers(1, 3))
def test_spread_patterns_have_blocks_for_entries(
    case: tuple[Pattern, np.random.Generator], group_size: int
) -> None:
    pattern, _ = case
    blocks = np.kron(whole(pattern, np.ones(pattern.rows.size)), np.ones((group_size, group_size)))
    wide = spread(pattern, group_size)
    np.testing.assert_array_equal(whole(wide, np.ones(wide.rows.size)), blocks)


@given(patterns())
def test_products_are_those_of_the_dense_matrix(case: tuple[Pattern, np.random.Generator]) -> None:
    pattern, rng = case
    values, x = rng.normal(size=pattern.rows.size), rng.normal(size=pattern.size)
    product = whole(pattern, values) @ x
    np.testing.assert_allclose(multiply(pattern, values, x), product, atol=1e-12)


@given(patterns(), st.floats(0.0, 1.0))
def test_sparse_factors_solve_and_count_negative_eigenvalues(
    case: tuple[Pattern, np.random.Generator], share: float
) -> None:
    # Quasidefinite: diagonally dominant within two sets, of either sign, and coupled at will.
    pattern, rng = case
    size = pattern.size
    values = rng.normal(size=pattern.rows.size)
    signs = np.where(rng.random(size) < share, -1.0, 1.0)
    values[:size] = signs * (1.0 + np.abs(whole(pattern, values)).sum(axis=0))
    matrix = whole(pattern, values)
    factors = factorize(pattern, values)
    assert factors is not None
    assert factors.num_negative == np.count_nonzero(np.linalg.eigvalsh(matrix) < 0.0)
    right = rng.normal(size=size)
    np.testing.assert_allclose(factors.solve(right), np.linalg.solve(matrix, right), atol=1e-10)


@pytest.mark.parametrize("junk", [0.0, np.nan, np.inf])
def test_matrices_without_pivots_have_no_factors(junk: float) -> None:
    pattern = make_pattern(3, np.array([[0, 1], [1, 2]]))
    values = np.array([2.0, 2.0, junk, 1.0, 0.0])
    assert factorize(pattern, values) is None


@given(patterns())
def test_the_fill_is_that_of_a_dense_elimination_and_of_small_supernodes(
    case: tuple[Pattern, np.random.Generator],
) -> None:
    pattern, _ = case
    has_entry = whole(pattern, np.ones(pattern.rows.size)) > 0
    for k in range(pattern.size):
        below = np.flatnonzero(has_entry[:, k])
        below = below[below > k]
        has_entry[np.ix_(below, below)] = True
    least = np.count_nonzero(np.tril(has_entry, -1))
    # SuperLU stores zeros where that merges columns into blocks.
    assert least <= count_fill(pattern) <= least + 10 * pattern.size


@given(patterns())
def test_orders_of_minimum_degree_are_permutations(
    case: tuple[Pattern, np.random.Generator],
) -> None:
    pattern, _ = case
    assert sorted(minimum_degree(pattern)) == list(range(pattern.size))


def fill(size: int, edges: np.ndarray) -> int:
    """Returns the entries of L in an order of minimum degree."""
    return count_fill(make_pattern(size, minimum_degree(make_pattern(size, edges))[edges]))


def test_minimum_degree_keeps_arrows_and_grids_sparse() -> None:
    for size in (100, 1000, 4000):
        assert fill(size, arrow(size)) <= 6 * size
    # Nested dissection, which is optimal, fills 31/4 n log₂ n (George 1973).
    for side in (20, 60):
        assert fill(side**2, grid(side)) <= 31 / 4 * side**2 * np.log2(side**2)


def choose(size: int, edges: np.ndarray, may_be_dense: bool = False) -> Storage:
    """Returns the choice where the order given is the only one for a band."""
    return choose_storage(size, edges, [np.arange(size)], may_be_dense=may_be_dense)


@pytest.mark.parametrize(
    ("size", "edges", "may_be_dense", "choice"),
    [
        (28, arrow(28), True, Factorization.DENSE),
        (28, arrow(28), False, Factorization.BAND),
        (150, arrow(150), True, Factorization.DENSE),
        (5000, arrow(5000)[:, : 2 * 4996], True, Factorization.BAND),
        (900, grid(30), True, Factorization.BAND),
        (10000, grid(100), False, Factorization.BAND),
        (62500, grid(250), False, Factorization.SPARSE),
        (1000, arrow(1000), True, Factorization.SPARSE),
        (400, np.indices((400, 400)).reshape(2, -1), True, Factorization.DENSE),
        (400, np.indices((400, 400)).reshape(2, -1), False, Factorization.BAND),
    ],
)
def test_the_cheapest_storage_is_chosen(
    size: int, edges: np.ndarray, may_be_dense: bool, choice: Factorization
) -> None:
    storage = choose(size, edges, may_be_dense)
    assert storage.factorization is choice
    assert (storage.pattern is not None) == (choice is Factorization.SPARSE)
    assert choice.value in str(storage)
    assert f"{size:,} unknowns" in str(storage)
    assert sorted(storage.places) == list(range(size))
    if storage.pattern is not None:
        assert storage.fill == count_fill(storage.pattern)
        assert storage.fill < size * storage.bandwidth / 5


def test_the_narrowest_of_several_bands_is_taken() -> None:
    size = 50
    chain = np.vstack([np.arange(size - 1), np.arange(1, size)])
    shuffled = np.random.default_rng(0).permutation(size)
    orders = [shuffled, np.arange(size)]
    storage = choose_storage(size, chain, orders)
    assert storage.bandwidth == 1
    np.testing.assert_array_equal(storage.places, np.arange(size))
    assert choose_storage(size, chain, orders, group_size=2).bandwidth == 3
