"""Plain Newton steps end in what the interior point finds, or in nothing."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_aigto import Scenario
from drake_aigto.local import InteriorPoint, NewtonLagrange, NlpBuilder, PolynomialNlp
from drake_aigto.planning import PlanOptions, make_ball_task
from drake_aigto.transcription import Touch
from drake_aigto.world import World


def convex_problem(seed: int, bound: float = np.inf) -> PolynomialNlp:
    """Returns Σ (x_i − a_i)² + b_i x_i⁴ / 10 over a chain of rows x_i x_{i+1} + x_i = d_i."""
    rng = np.random.default_rng(seed)
    builder = NlpBuilder()
    x = builder.new(6)
    targets, weights = rng.uniform(1.0, 2.0, 6), rng.uniform(0.0, 1.0, 6)
    for place, target, weight in zip(x, targets, weights, strict=True):
        terms = [(1.0, (0, 0)), (-2 * target, (0,)), (weight / 10, (0, 0, 0, 0))]
        builder.add_cost("near", terms, np.array([place]))
    for i in range(0, 4, 2):
        row = [(1.0, (0, 1)), (1.0, (0,)), (-rng.uniform(2.0, 4.0), ())]
        builder.add_row("chain", row, x[i : i + 2])
    builder.bound(x, -bound, bound)
    return builder.build()


@given(seed=st.integers(0, 10**6))
@settings(deadline=None, max_examples=25)
def test_it_ends_in_the_optimum_of_the_interior_point(seed: int) -> None:
    nlp, start = convex_problem(seed), np.ones(6)
    found = NewtonLagrange().solve(nlp, start)
    if found is None:
        return  # No bound is active, but it never promised to get there.
    known = InteriorPoint().solve(nlp, found.x)
    assert known.is_success and known.iterations <= 3  # It is one.
    np.testing.assert_allclose(found.x, known.x, atol=1e-8)
    np.testing.assert_allclose(found.multipliers, known.multipliers, atol=1e-6)
    assert found.cost == pytest.approx(known.cost)
    assert found.residual <= 1e-12


def test_it_mostly_gets_there() -> None:
    found = [NewtonLagrange().solve(convex_problem(seed), np.ones(6)) for seed in range(20)]
    assert sum(result is not None for result in found) >= 18


def test_a_point_outside_of_bounds_is_none() -> None:
    free = NewtonLagrange().solve(convex_problem(3), np.ones(6))
    assert free is not None
    largest = float(np.max(np.abs(free.x)))
    wide, narrow = (convex_problem(3, share * largest) for share in (1.01, 0.99))
    assert NewtonLagrange().solve(wide, np.ones(6)) is not None
    assert NewtonLagrange().solve(narrow, np.ones(6)) is None


def test_a_bound_that_rounding_crosses_is_kept() -> None:
    builder = NlpBuilder()
    x = builder.new(2)
    builder.add_cost("cost", [(1.0, (0, 0))], x[1:])
    builder.add_row("row", [(3.0, (0,)), (-0.3, ()), (1e-3, (1,))], x)
    builder.bound(x[0], 0.0, 0.1)  # The row holds it there, but for rounding of 0.3 / 3.
    found = NewtonLagrange().solve(builder.build(), [0.05, 0.5])
    assert found is not None
    assert found.x[0] <= 0.1
    np.testing.assert_allclose(found.x, [0.1, 0.0], atol=1e-12)


@pytest.mark.parametrize(("sign", "exists"), [(1.0, True), (-1.0, False)])
def test_a_maximum_or_saddle_is_none(sign: float, exists: bool) -> None:
    builder = NlpBuilder()
    x = builder.new(3)
    builder.add_cost("cost", [(1.0, (0, 0)), (sign, (1, 1)), (1.0, (2, 2))], x)
    builder.add_row("row", [(1.0, (0,)), (-1.0, (2,))], x)
    assert (NewtonLagrange().solve(builder.build(), [0.3, 0.2, 0.1]) is not None) == exists


def test_what_runs_away_is_none_without_a_warning() -> None:
    builder = NlpBuilder()
    x = builder.new(1)
    builder.add_cost("cost", [(1.0, (0,))], x)
    builder.add_row("never", [(1.0, (0, 0)), (1.0, ())], x)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert NewtonLagrange(max_iterations=200).solve(builder.build(), [0.3]) is None


@pytest.mark.parametrize("sequence", [(), (Touch.bounce(0.4),)])
def test_a_polish_is_the_interior_points(
    sequence: tuple[Touch, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = dataclasses.replace(Scenario.named("table1/1"), time_step=0.02)
    problem = make_ball_task(World.from_scenario(scenario), scenario, PlanOptions(confirm=False))
    quick = problem.polish(problem.box.center, sequence)
    with monkeypatch.context() as patch:
        patch.setattr(NewtonLagrange, "solve", lambda *arguments: None)
        slow = problem.polish(problem.box.center, sequence)
    np.testing.assert_allclose(quick[1], slow[1], atol=1e-8)
    assert quick[0].scenario_cost(quick[1]) == pytest.approx(slow[0].scenario_cost(slow[1]))
