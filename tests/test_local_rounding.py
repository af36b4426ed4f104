"""The local solver where f or its rows are small sums of large terms, so that rounding shows."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from local_problems import Problem

from benchmarks.collections.global_functions import planar_problems
from benchmarks.collections.known_optimum import GlobalProblem
from drake_aigto.local import InteriorPoint, LocalStatus, Progress, compile_nlp

PLANAR = planar_problems()
NAMES = [problem.name for problem in PLANAR]


@pytest.mark.parametrize("problem", PLANAR, ids=NAMES)
def test_no_start_wastes_steps_at_a_minimum_that_rounding_blurs(problem: GlobalProblem) -> None:
    nlp = compile_nlp(problem.prog())
    for seed in range(20):
        start = np.random.default_rng(seed).uniform(problem.lower, problem.upper)
        result = InteriorPoint().solve(nlp, start)
        assert result.status is LocalStatus.CONVERGED, seed
        assert result.iterations <= 60, seed


@pytest.mark.parametrize("problem", PLANAR, ids=NAMES)
def test_tolerances_below_rounding_end_the_run_where_it_gets_no_further(
    problem: GlobalProblem,
) -> None:
    nlp = compile_nlp(problem.prog())
    for seed in range(5):
        start = np.random.default_rng(seed).uniform(problem.lower, problem.upper)
        result = InteriorPoint(tolerance=1e-15).solve(nlp, start)
        assert result.status in (LocalStatus.CONVERGED, LocalStatus.STALLED), seed
        assert result.iterations <= 120, seed
        usual = InteriorPoint().solve(nlp, start)
        rounding = 1e-14 * nlp.cost_magnitude(result.x)
        assert result.cost <= usual.cost + rounding, seed


def test_magnitudes_are_the_sums_of_absolute_terms() -> None:
    problem = Problem(
        lambda x: 3 * (x[0] - x[1]) ** 2 - x[0],
        lambda x: [(x[0] - 10) ** 3 + x[1], x[0] * x[1] - 4],
        [2.0, -3.0],
    )
    nlp = compile_nlp(problem.program())
    assert nlp.cost_magnitude([2.0, -3.0]) == pytest.approx(3 * (2 + 3) ** 2 + 2)
    np.testing.assert_allclose(np.sort(nlp.row_magnitudes([2.0, -3.0])), [6 + 4, 12**3 + 3])


def test_a_row_that_rounding_keeps_from_its_tolerance_counts_as_held() -> None:
    # (x − 300)³ multiplied out: terms of 3e7, so the row is known to 1e-8 or so.
    result = Problem(
        lambda x: x[1] ** 2 + x[0], lambda x: [(x[0] - 300) ** 3 - x[1]], [1.0, 2.0]
    ).solve(tolerance=1e-11)
    assert result.is_success
    # y = t³ with t = x − 300: t⁶ + t is least at t = −6^(−1/5).
    np.testing.assert_allclose(result.x[0] - 300, -(6**-0.2), atol=1e-7)


def count_idle(steps: list[tuple[float, float, float]]) -> list[bool]:
    """Returns whether progress has ended after each (θ, φ, error); φ is known to 0.1."""
    progress, ended = Progress(), []
    for (theta, phi, error), (new_theta, new_phi, _) in itertools.pairwise(steps):
        progress.add((theta, new_theta), (phi, new_phi), 0.1, error)
        ended.append(progress.has_ended)
    return ended


def test_steps_that_only_round_are_the_end() -> None:
    noise = [(0.0, 0.01 * (i % 2), 1.0) for i in range(9)]
    assert count_idle(noise)[-1]
    assert not any(count_idle(noise)[:4])


@pytest.mark.parametrize(
    "steps",
    [
        [(0.0, -0.01 * i, 1.0) for i in range(30)],  # φ falls, slowly
        [(0.0, 0.01 * (i % 2), 0.8**i) for i in range(30)],  # the gradient tells the way
        [(0.8**i, 0.0, 1.0) for i in range(30)],  # rows close
        [(0.0, float(i % 2), 1.0) for i in range(30)],  # a filter lets φ rise
    ],
)
def test_steps_that_lead_somewhere_are_not(steps: list[tuple[float, float, float]]) -> None:
    assert not any(count_idle(steps))
