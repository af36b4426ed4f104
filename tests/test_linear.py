"""Sparse symmetric matrices, their orders, and the choice between them and bands."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from box_programs import arrow, dense, grid, whole
from hypothesis import given
from hypothesis import strategies as st
from marks import slow
from pydrake.solvers import ExpressionConstraint, ExpressionCost, MathematicalProgram
from pydrake.symbolic import Variable

from drake_aigto import AigoOptions, AigoSolver
from drake_aigto.aigo import Annealing, BoundedAnnealing, Box, CenterObjective, Status, minimize
from drake_aigto.box import BoxPolynomial
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
from drake_aigto.local import (
    BandFactors,
    DenseFactors,
    InteriorPoint,
    LocalStatus,
    SparseKktFactors,
    compile_nlp,
    multiply_symmetric,
)
from drake_aigto.terms import Factor, FunctionKind, Term, TermBlock


@st.composite
def patterns(draw: st.DrawFn, least: int = 1) -> tuple[Pattern, np.random.Generator]:
    size = draw(st.integers(least, 25))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    edges = rng.integers(0, size, (2, draw(st.integers(0, 3 * size))))
    return make_pattern(size, edges), rng


@given(patterns())
def test_a_pattern_tells_every_entry_apart_and_what_its_orders_fill_in(
    case: tuple[Pattern, np.random.Generator],
) -> None:
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
    assert sorted(minimum_degree(pattern)) == list(range(pattern.size))
    has_entry = whole(pattern, np.ones(pattern.rows.size)) > 0
    for k in range(pattern.size):
        below = np.flatnonzero(has_entry[:, k])
        below = below[below > k]
        has_entry[np.ix_(below, below)] = True
    least = np.count_nonzero(np.tril(has_entry, -1))
    # SuperLU stores zeros where that merges columns into blocks.
    assert least <= count_fill(pattern) <= least + 10 * pattern.size


@given(patterns(), st.integers(1, 3))
def test_spread_patterns_have_blocks_for_entries(
    case: tuple[Pattern, np.random.Generator], group_size: int
) -> None:
    pattern, _ = case
    blocks = np.kron(whole(pattern, np.ones(pattern.rows.size)), np.ones((group_size, group_size)))
    wide = spread(pattern, group_size)
    np.testing.assert_array_equal(whole(wide, np.ones(wide.rows.size)), blocks)


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
    product = multiply(pattern, values, right)
    np.testing.assert_allclose(product, matrix @ right, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("junk", [0.0, np.nan, np.inf])
def test_matrices_without_pivots_have_no_factors(junk: float) -> None:
    pattern = make_pattern(3, np.array([[0, 1], [1, 2]]))
    values = np.array([2.0, 2.0, junk, 1.0, 0.0])
    assert factorize(pattern, values) is None


def fill(size: int, edges: np.ndarray) -> int:
    return count_fill(make_pattern(size, minimum_degree(make_pattern(size, edges))[edges]))


def test_minimum_degree_keeps_arrows_and_grids_sparse() -> None:
    for size in (100, 1000, 4000):
        assert fill(size, arrow(size)) <= 6 * size
    # Nested dissection, which is optimal, fills 31/4 n log₂ n (George 1973).
    for side in (20, 60):
        assert fill(side**2, grid(side)) <= 31 / 4 * side**2 * np.log2(side**2)


def choose(size: int, edges: np.ndarray, may_be_dense: bool = False) -> Storage:
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
        *slow((62500, grid(250), False, Factorization.SPARSE)),
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


@contextmanager
def only_bands() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("drake_aigto.linear.storage._SPARSE_CALL", np.inf)
        yield


def product(coefficient: float, *powers: tuple[int, int]) -> Term:
    return Term(coefficient, tuple(Factor(i, FunctionKind.POWER, p) for i, p in powers))


def wells(num_variables: int, seed: int = 0) -> list[TermBlock]:
    well = (product(1.0, (0, 4)), product(-2.0, (0, 2)))
    tilts = 0.3 * np.random.default_rng(seed).normal(size=num_variables)
    blocks = [TermBlock("wells", well, np.arange(num_variables)[:, np.newaxis])]
    return blocks + [
        TermBlock(f"tilt {i}", (product(float(tilt), (0, 1)),), [[i]])
        for i, tilt in enumerate(tilts)
    ]


def shared_variable(num_variables: int) -> BoxPolynomial:
    """Returns a chain of wells, all of which one variable stretches."""
    i = np.arange(1, num_variables - 1)
    link = (product(0.3, (0, 1), (1, 1)), product(0.1, (0, 1), (1, 1), (2, 1)))
    links = TermBlock("links", link, np.column_stack([i, i + 1, np.zeros_like(i)]))
    return BoxPolynomial(num_variables, (links, *wells(num_variables)))


def on_grid(side: int) -> BoxPolynomial:
    link = TermBlock("links", (product(0.4, (0, 1), (1, 1)),), grid(side).T)
    return BoxPolynomial(side * side, (link, *wells(side * side)))


def in_variable_order(f: BoxPolynomial, matrix: np.ndarray, stride: int) -> np.ndarray:
    """Returns a Hessian whose unknowns are those of variable 0, of variable 1, …"""
    places = (stride * f.position[:, np.newaxis] + np.arange(stride)).ravel()
    return matrix[np.ix_(places, places)]


@pytest.mark.slow
@pytest.mark.parametrize("centers_only", [True, False])
def test_sparse_hessians_are_the_banded_ones(centers_only: bool) -> None:
    f = shared_variable(250)
    with only_bands():
        g = shared_variable(250)
    assert f.storage.factorization is Factorization.SPARSE
    assert g.storage.factorization is Factorization.BAND
    rng = np.random.default_rng(0)
    box = rng.normal(size=250), rng.uniform(0.1, 1.0, 250)
    sparse, band = (h.newton_system(*box, centers_only) for h in (f, g))
    assert sparse.pattern is not None
    assert band.pattern is None
    assert sparse.value == pytest.approx(band.value, rel=1e-12)
    stride = 1 if centers_only else 2
    np.testing.assert_allclose(
        in_variable_order(f, whole(sparse.pattern, sparse.band[0]), stride),
        in_variable_order(g, dense(band.band), stride),
        atol=1e-12,
    )
    for ours, theirs in zip(
        f.to_variables(sparse.gradient), g.to_variables(band.gradient), strict=True
    ):
        np.testing.assert_allclose(ours, theirs, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("make", [lambda: shared_variable(250), lambda: on_grid(30)])
@pytest.mark.parametrize("algorithm", [Annealing(), BoundedAnnealing()])
def test_boxes_end_where_banded_systems_lead(make, algorithm) -> None:  # type: ignore[no-untyped-def]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "drake_aigto.linear.storage._SPARSE_UNIT", 0.0
        )  # A small grid would stay a band.
        f = make()
    with only_bands():
        g = make()
    half_width = np.full(f.num_variables, 2.0)
    half_width[7] = 0.0  # held
    results = [
        minimize(h, Box(np.full(h.num_variables, 0.1), half_width), algorithm) for h in (f, g)
    ]
    sparse, band = results
    assert (sparse.status, band.status) == (Status.CONVERGED, Status.CONVERGED)
    assert sparse.storage.factorization is Factorization.SPARSE
    assert band.storage.factorization is Factorization.BAND
    assert sparse.box.center[7] == 0.1
    np.testing.assert_allclose(sparse.box.center, band.box.center, atol=1e-6)
    assert sparse.cost == pytest.approx(band.cost, rel=1e-9)


@pytest.mark.slow
def test_newtons_method_keeps_within_bounds_and_to_its_free_variables() -> None:
    f = shared_variable(250)
    free = np.random.default_rng(1).random(250) < 0.5
    bounds = np.full(250, -0.9), np.full(250, 0.9)
    ends: list[list[np.ndarray]] = []
    with only_bands():
        g = shared_variable(250)
    for h in (f, g):
        start = np.full(250, 0.5)
        objective = CenterObjective(h, free, 1e-8, bounds)
        damped = objective.descend(start, 60).x
        bold, steps = objective.descend_boldly(start, 12)
        assert steps > 2
        for end in (damped, bold):
            assert np.all(np.abs(end) <= 0.9)
            assert np.all(end[~free] == 0.5)
        ends.append([damped, bold])
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-6)


def shortest_time(steps: int) -> MathematicalProgram:
    """Returns the least time from rest at 0 to rest at 1, |u| ≤ 1, by trapezoids of free width h.

    Bang-bang control takes 2 s, in any even number of steps. All rows share h.
    """
    prog = MathematicalProgram()
    q, v = prog.NewContinuousVariables(steps + 1, "q"), prog.NewContinuousVariables(steps + 1, "v")
    u, h = prog.NewContinuousVariables(steps, "u"), prog.NewContinuousVariables(1, "h")
    for point, position in ((0, 0.0), (steps, 1.0)):
        prog.AddBoundingBoxConstraint(position, position, q[point])
        prog.AddBoundingBoxConstraint(0.0, 0.0, v[point])
    prog.AddBoundingBoxConstraint(-1.0, 1.0, u)
    prog.AddBoundingBoxConstraint(1e-4, 10.0, h)
    prog.AddLinearCost([float(steps)], 0.0, h)
    a = [Variable(name) for name in ("q0", "q1", "v0", "v1", "u", "h")]
    rows = [a[1] - a[0] - a[5] * (a[2] + a[3]) * 0.5, a[3] - a[2] - a[5] * a[4]]
    row = ExpressionConstraint(rows, np.zeros(2), np.zeros(2))
    for k in range(steps):
        here = [*q[k : k + 2], *v[k : k + 2], u[k], h[0]]
        of_id = {local.get_id(): x for local, x in zip(a, here, strict=True)}
        prog.AddConstraint(row, vars=[of_id[local.get_id()] for local in row.vars()])
    return prog


@pytest.mark.slow
def test_a_shared_time_step_is_found_by_sparse_kkt_systems(
    caplog: pytest.LogCaptureFixture,
) -> None:
    steps = 300
    nlp = compile_nlp(shortest_time(steps))
    start = np.clip(np.full(nlp.num_variables, 0.02), nlp.lower, nlp.upper)
    with caplog.at_level(logging.INFO, logger="drake_aigto"):
        sparse = InteriorPoint().solve(nlp, start)
    assert "sparse LDLᵀ" in caplog.text
    with only_bands():
        other = InteriorPoint().solve(compile_nlp(shortest_time(steps)), start)
    assert sparse.storage.factorization is Factorization.SPARSE
    assert other.storage.factorization is not Factorization.SPARSE
    for result in (sparse, other):
        assert result.status is LocalStatus.CONVERGED
        assert result.residual <= 1e-10
        assert result.cost == pytest.approx(2.0, rel=1e-5)
    np.testing.assert_allclose(sparse.x, other.x, atol=1e-6)
    np.testing.assert_allclose(sparse.multipliers, other.multipliers, atol=1e-5)


@pytest.mark.slow
def test_a_program_with_a_shared_variable_is_solved_and_the_choice_reported() -> None:
    n = 400
    prog = MathematicalProgram()
    x, scale = prog.NewContinuousVariables(n, "x"), prog.NewContinuousVariables(1, "scale")
    prog.AddBoundingBoxConstraint(-2.0, 2.0, x)
    prog.AddBoundingBoxConstraint(0.5, 2.0, scale)
    a, b = Variable("a"), Variable("b")
    stage = ExpressionCost((a**2 - b) ** 2 + 0.2 * a * b)
    for x_k in x:
        values = {a.get_id(): x_k, b.get_id(): scale[0]}
        prog.AddCost(stage, vars=[values[v.get_id()] for v in stage.vars()])
    result = AigoSolver(AigoOptions(cells=0, rounds=2)).Solve(prog)
    details = result.get_solver_details()
    assert result.is_success()
    assert details.box_storage.factorization is Factorization.SPARSE
    assert details.kkt_storage.size == n + 1
    # All x alike: least (a² − b)² + 0.2 a b on a fine grid.
    grid_a, grid_b = np.meshgrid(np.linspace(-2, 2, 2001), np.linspace(0.5, 2, 1501))
    least = n * np.min((grid_a**2 - grid_b) ** 2 + 0.2 * grid_a * grid_b)
    assert result.get_optimal_cost() <= least + 1e-9 * abs(least)


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
    nothing = kind(0, 0)
    assert nothing.factorize(np.empty((1, 0), order="F")) == 0 == nothing.solve(np.empty(0)).size


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
