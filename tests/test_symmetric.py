"""Factors of symmetric indefinite matrices, against NumPy's eigenvalues and solutions."""

from __future__ import annotations

import numpy as np
import pytest
from box_programs import dense
from hypothesis import given
from hypothesis import strategies as st
from sparse_matrices import whole

from drake_aigto.linear import make_pattern
from drake_aigto.local import BandFactors, DenseFactors, SparseKktFactors, multiply_symmetric

KINDS = [BandFactors, DenseFactors]


def random_kkt(
    rng: np.random.Generator, size: int, bandwidth: int, share_of_rows: float, scale: float
) -> np.ndarray:
    """Returns a band like those of an interior point method.

    Where rows meet themselves entries are tiny, on the rest of the diagonal of another scale.
    """
    band = rng.normal(size=(bandwidth + 1, size))
    band[beyond(band)] = 0.0
    is_row = rng.random(size) < share_of_rows
    for d in range(bandwidth + 1):
        band[d, : size - d][is_row[: size - d] & is_row[d:]] = 0.0
    band[0] *= scale
    band[0, is_row] = -1e-10
    return np.asfortranarray(band)


def beyond(band: np.ndarray) -> np.ndarray:
    """Returns which entries of the storage are past the matrix's end."""
    return np.add.outer(np.arange(len(band)), np.arange(band.shape[1])) >= band.shape[1]


@pytest.mark.parametrize("kind", KINDS)
@given(
    *(st.integers(1, 40), st.integers(0, 39), st.floats(0.0, 0.6)),
    *(st.integers(-6, 6), st.integers(0, 2**32 - 1)),
)
def test_factors_solve_and_count_negative_eigenvalues(
    kind: type, size: int, bandwidth: int, share_of_rows: float, decade: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    bandwidth = min(bandwidth, size - 1)
    band = random_kkt(rng, size, bandwidth, share_of_rows, 10.0**decade)
    matrix = dense(band)
    eigenvalues = np.linalg.eigvalsh(matrix)
    largest, least = np.max(np.abs(eigenvalues)), np.min(np.abs(eigenvalues))
    if least < 1e-12 * largest:
        return  # too near singular for either to count
    band[beyond(band)] = 1e9  # nobody may read it
    factors = kind(size, bandwidth)
    count = factors.factorize(band)
    # In a band pivots may be as small as 1e-8: then signs are known of eigenvalues above 1e8 times
    # rounding alone.
    if kind is DenseFactors or least >= 1e8 * np.finfo(float).eps * largest:
        assert count == np.count_nonzero(eigenvalues < 0.0)
    x = rng.normal(size=size)
    right = matrix @ x
    found = factors.solve(right)
    # Pivots of 1e-8 let rounding grow by 1e8; each refinement takes as much off again.
    norm = max(largest * np.max(np.abs(found)), np.max(np.abs(right)))
    assert np.max(np.abs(matrix @ found - right)) <= 1e-10 * norm
    if least >= 1e-4 * largest:
        np.testing.assert_allclose(found, np.linalg.solve(matrix, right), rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@given(st.integers(2, 20), st.data())
def test_a_matrix_with_an_empty_row_is_singular(kind: type, size: int, data: st.DataObject) -> None:
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    bandwidth = data.draw(st.integers(0, size - 1))
    empty = data.draw(st.integers(0, size - 1))
    band = random_kkt(rng, size, bandwidth, 0.3, 1.0)
    for d in range(bandwidth + 1):
        band[d, empty] = 0.0
        if d <= empty:
            band[d, empty - d] = 0.0
    factors = kind(size, bandwidth)
    assert factors.factorize(band) == -1
    assert np.all(np.isnan(factors.solve(np.ones(size))))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("junk", [np.nan, np.inf])
def test_a_matrix_that_is_not_finite_has_no_inertia(kind: type, junk: float) -> None:
    on_diagonal = np.array([[1.0, junk]], order="F")
    assert kind(2, 0).factorize(on_diagonal) == -1
    beside_it = np.array([[1.0, 1.0], [junk, 0.0]], order="F")
    assert kind(2, 1).factorize(beside_it) == -1


@pytest.mark.parametrize("kind", KINDS)
def test_factors_serve_one_matrix_after_another(kind: type) -> None:
    rng = np.random.default_rng(0)
    factors = kind(12, 5)
    for _ in range(3):
        for band in (random_kkt(rng, 12, 5, 0.4, 1.0), np.zeros((6, 12), order="F")):
            negative = factors.factorize(band)
            assert negative == (np.count_nonzero(np.linalg.eigvalsh(dense(band)) < 0) or -1)
            if negative >= 0:
                right = rng.normal(size=12)
                np.testing.assert_allclose(
                    factors.solve(right), np.linalg.solve(dense(band), right), rtol=1e-7
                )


@pytest.mark.parametrize("kind", KINDS)
def test_a_system_without_unknowns_is_solved(kind: type) -> None:
    factors = kind(0, 0)
    assert factors.factorize(np.empty((1, 0), order="F")) == 0
    assert factors.solve(np.empty(0)).size == 0


def test_products_are_those_of_the_dense_matrix() -> None:
    rng = np.random.default_rng(1)
    band = random_kkt(rng, 9, 4, 0.3, 1.0)
    x = rng.normal(size=9)
    np.testing.assert_allclose(multiply_symmetric(band, x), dense(band) @ x, rtol=1e-13)


@given(st.integers(2, 40), st.floats(0.0, 0.5), st.integers(-3, 3), st.integers(0, 2**32 - 1))
def test_sparse_kkt_factors_solve_and_count_negative_eigenvalues(
    size: int, share_of_rows: float, decade: int, seed: int
) -> None:
    # W positive definite, as a Hessian that Newton's method accepts, or indefinite; A as it comes.
    rng = np.random.default_rng(seed)
    is_row = rng.random(size) < share_of_rows
    pattern = make_pattern(size, rng.integers(0, size, (2, 2 * size)))
    values = rng.normal(size=pattern.rows.size)
    values[is_row[pattern.rows] & is_row[pattern.columns]] = 0.0
    values[:size][~is_row] = rng.choice([0.0, 1.0, 10.0**decade], np.count_nonzero(~is_row))
    values[:size][is_row] = -1e-10
    matrix = whole(pattern, values)
    eigenvalues = np.linalg.eigvalsh(matrix)
    if np.min(np.abs(eigenvalues)) < 1e-5 * max(1.0, np.max(np.abs(eigenvalues))):
        return  # The shift that keeps pivots off zero could count.
    factors = SparseKktFactors(pattern, is_row)
    found = factors.factorize(values[np.newaxis])
    assert found == np.count_nonzero(eigenvalues < 0.0)
    right = rng.normal(size=size)
    np.testing.assert_allclose(
        matrix @ factors.solve(right), right, atol=1e-9 * np.max(np.abs(factors.solve(right)))
    )


def test_sparse_factors_without_accuracy_count_as_singular() -> None:
    # Two unknowns that are coupled by 1 alone; shifts of 1e-9 make factors of A + 1e-9 I, whose
    # solution for one of the almost parallel rows is off.
    pattern = make_pattern(2, np.array([[0], [1]]))
    factors = SparseKktFactors(pattern, np.zeros(2, dtype=bool))
    assert factors.factorize(np.array([[1.0, 1.0, 1.0]])) == -1
    assert np.isnan(factors.solve(np.ones(2))).all()
