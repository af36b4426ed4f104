"""Face flow: boxes nest, one variable is solved globally, decoupled parts do not see each other."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from box_programs import power, univariate
from hypothesis import given
from hypothesis import strategies as st
from marks import slow

from drake_aigto.aigo import Alternating, Box, CouplingGraph, FaceFlow, minimize
from drake_aigto.box import BoxPolynomial
from drake_aigto.terms import Term, TermBlock


def random_chain(n: int, seed: int) -> BoxPolynomial:
    """Returns Σ of random quartics of x_i, and of b_i x_i x_{i+1}."""
    rng = np.random.default_rng(seed)
    blocks = []
    for i in range(n):
        quartic = np.polynomial.polynomial.polyfromroots(rng.uniform(-2, 2, 4))
        terms = tuple(Term(float(a), (power(0, p),) if p else ()) for p, a in enumerate(quartic))
        blocks.append(TermBlock(f"well {i}", terms, [[i]]))
    for i in range(n - 1):
        link = Term(rng.uniform(-1, 1), (power(0, 1), power(1, 1)))
        blocks.append(TermBlock(f"link {i}", (link,), [[i, i + 1]]))
    return BoxPolynomial(n, tuple(blocks))


@pytest.mark.parametrize("degree", [4, 12])
def test_random_polynomials_of_one_variable_are_solved_globally(degree: int) -> None:
    rng = np.random.default_rng(degree)
    for _ in range(10):
        roots = rng.uniform(-2, 2, degree - 1)
        f = np.polynomial.Polynomial.fromroots(roots).integ()
        result = minimize(univariate(f.coef), Box(np.zeros(1), np.array([2.5])), FaceFlow())
        assert result.is_converged
        # A last half width of 2.5e-3 around the minimizer leaves this much.
        low = float(np.min(f(roots)))
        nearby = f(roots[np.argmin(f(roots))] + np.array([-3e-3, 3e-3]))
        assert result.cost <= max(low + 1e-9, float(np.max(nearby)))


@given(st.booleans(), st.integers(0, 10**6), st.floats(0.01, 0.9), st.floats(-3, 3))
def test_every_box_from_the_first_on_holds_the_next(
    is_coupled: bool, seed: int, share: float, shift: float
) -> None:
    first = Box(np.full(5, shift), np.array([1.0, 2.0, 0.3, 5.0, 1.0]))
    algorithm = FaceFlow(is_coupled=is_coupled, share=share, least_shrink=0.05)
    result = minimize(random_chain(5, seed), first, algorithm)
    assert result.is_converged
    for before, after in pairwise(i.box for i in result.history):
        slack = before.half_width - np.abs(after.center - before.center) - after.half_width
        assert np.all(slack >= -1e-12)


def test_what_is_cut_off_was_worse() -> None:
    # x² + 3x on [−2, 2]: the face at 2 is the worse one, and all that moves.
    f = univariate(np.array([0.0, 3.0, 1.0]))
    box = Box(np.zeros(1), np.array([2.0]))
    after = FaceFlow().step(f, FaceFlow().init(f, box)).box
    assert after.center[0] - after.half_width[0] == pytest.approx(-2.0)
    assert after.center[0] + after.half_width[0] < 0.01


@pytest.mark.parametrize("is_coupled", [True, False])
def test_parts_that_are_not_coupled_do_not_see_each_other(is_coupled: bool) -> None:
    alone = random_chain(3, 1)
    moved = [TermBlock(b.name + "'", b.terms, b.variables + 3, 50.0) for b in alone.blocks]
    both = BoxPolynomial(6, (*alone.blocks, *moved))
    algorithm = FaceFlow(is_coupled=is_coupled)
    one = minimize(alone, Box(np.zeros(3), np.full(3, 2.2)), algorithm).box.center
    two = minimize(both, Box(np.zeros(6), np.full(6, 2.2)), algorithm).box.center
    # The boxes of the part that is done first go on to shrink: 1e-3 of 2.2 is their last width.
    np.testing.assert_allclose(two[:3], one, atol=2e-3)
    np.testing.assert_allclose(two[3:], one, atol=2e-3)


def test_a_flat_cost_leaves_the_center_where_it_is() -> None:
    f = univariate(np.array([3.0]))
    result = minimize(f, Box(np.array([1.5]), np.array([2.0])), FaceFlow(least_shrink=0.1))
    assert result.is_converged
    assert result.box.center[0] == 1.5


@pytest.mark.parametrize("units", [5.0, *slow(1.0)])
def test_a_box_of_a_few_units_in_the_last_place_ends(units: float) -> None:
    first = Box(np.array([0.0, 4.0]), np.array([1.0, 0.5 * units * np.spacing(4.0)]))
    result = minimize(random_chain(2, 0), first, FaceFlow())
    assert result.is_converged
    assert abs(result.box.center[1] - 4.0) <= units * np.spacing(4.0)


def test_alternating_stays_inside_the_first_box() -> None:
    first = Box(np.full(3, 0.5), np.full(3, 1.5))
    for iterate in minimize(random_chain(3, 3), first, Alternating()).history:
        reach = np.abs(iterate.box.center - first.center) + iterate.box.half_width
        assert np.all(reach <= first.half_width * (1 + 1e-9))


@given(st.integers(1, 30), st.integers(1, 8), st.integers(0, 10**6), st.sets(st.integers(0, 29)))
def test_clusters_are_small_connected_and_apart(
    n: int, size: int, seed: int, held: set[int]
) -> None:
    free = np.array([i not in held for i in range(n)])
    graph = CouplingGraph.of(random_chain(n, 0))
    labels = graph.clusters(size, free, np.random.default_rng(seed))
    assert np.all(labels[~free] == -1)
    for cluster in range(labels.max(initial=-1) + 1):
        members = np.flatnonzero(labels == cluster)
        assert 1 <= members.size <= size
        assert np.all(np.diff(members) == 1)  # connected, in a chain
    left, right = labels[:-1], labels[1:]
    assert np.all((left == right) | (left < 0) | (right < 0))
    # Nothing could be added: who is left out stands beside a cluster.
    for i in np.flatnonzero(free & (labels < 0)):
        assert max(labels[max(i - 1, 0) : i + 2]) >= 0


def test_components_are_split_by_what_is_held() -> None:
    free = np.array([True, True, False, True, False, True])
    labels = CouplingGraph.of(random_chain(6, 0)).components(free)
    np.testing.assert_array_equal(labels, [0, 0, -1, 1, -1, 2])
