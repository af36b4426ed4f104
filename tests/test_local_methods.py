"""Plain Newton steps end in what the interior point finds, or in nothing."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from box_programs import dense
from hypothesis import given
from hypothesis import strategies as st
from local_problems import PROBLEMS, Problem, add_cost
from pydrake.solvers import MathematicalProgram
from pydrake.symbolic import cos, exp, log, sin, tan
from pydrake.symbolic import max as symbolic_max

from benchmarks.collections.global_functions import planar_problems
from benchmarks.collections.known_optimum import GlobalProblem
from drake_aigto import Scenario
from drake_aigto.box import System, add_means
from drake_aigto.errors import OptionsError, UnsupportedTermError
from drake_aigto.linear import factorize_band, solve_band
from drake_aigto.local import (
    InteriorPoint,
    LocalStatus,
    NewtonLagrange,
    NlpBuilder,
    PenaltyLadder,
    PolynomialNlp,
    compile_nlp,
    make_penalty_tables,
)
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
    found = [NewtonLagrange().solve(convex_problem(seed), np.ones(6)) for seed in range(8)]
    assert sum(result is not None for result in found) >= 7


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
    for name in ("positions", "velocities", "controls"):
        one, other = (getattr(each.trajectory, name) for each in (quick, slow))
        np.testing.assert_allclose(one, other, atol=1e-8)
    assert quick.cost == pytest.approx(slow.cost)


def chain(num_stages: int = 12) -> PolynomialNlp:
    """Returns a program with all kinds of factors, in stages; one variable is held."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2 * num_stages, "x").reshape(num_stages, 2)
    for i in range(num_stages):
        a, b = x[i]
        add_cost(prog, (a - 1.5) ** 4 + a * b**3 + b**2 * cos(2 * a + 0.3) + 0.1 * exp(b) * a)
        if i:
            before, _ = x[i - 1]
            prog.AddConstraint(a - before + 0.3 * sin(b - before) - 0.2 * b == 0)
    prog.AddBoundingBoxConstraint(-2.0, 2.0, x.ravel())
    prog.AddBoundingBoxConstraint(0.7, 0.7, x[0, :1])
    return compile_nlp(prog)


@pytest.mark.slow
def test_derivatives_of_penalties_are_those_of_finite_differences() -> None:
    nlp, step = chain(4), 1e-6
    tables, rng = make_penalty_tables(nlp), np.random.default_rng(1)
    x, weights = rng.uniform(-2, 2, nlp.num_variables), rng.uniform(1, 3, nlp.num_rows)
    multipliers = rng.normal(size=nlp.num_rows)
    free = np.flatnonzero(tables.places >= 0)

    def value(at: np.ndarray) -> float:
        f, rows = nlp.evaluate(at)
        return float(3.0 * f + multipliers @ rows + weights @ rows**2 / 2)

    def slopes(at: np.ndarray) -> System:
        costs, none = np.full(nlp.num_costs, 3.0), np.zeros(nlp.num_costs)
        first = np.append(costs, multipliers + weights * nlp.evaluate(at)[1])
        system = System(
            *(first, tables.places, np.full(first.size, -1), np.zeros(tables.size)),
            *(np.zeros((tables.size, tables.bandwidth + 1)), None),
            np.array([first, np.append(none, weights)]),
        )
        values = np.empty(first.size)
        add_means(tables.derivatives, tables.weights, at, np.zeros(at.size), values, system)
        return system

    system = slopes(x)
    hessian = dense(system.band.T)
    for i, place in zip(free, tables.places[free], strict=True):
        ends = [x + sign * step * (np.arange(x.size) == i) for sign in (1, -1)]
        above, below = map(value, ends)
        assert system.gradient[place] == pytest.approx((above - below) / (2 * step), abs=1e-5)
        upper, lower = (slopes(end).gradient for end in ends)
        np.testing.assert_allclose(hessian[:, place], (upper - lower) / (2 * step), atol=1e-5)


@pytest.mark.slow
def test_a_penalty_of_a_row_that_reads_a_variable_twice_is_squared_whole() -> None:
    builder = NlpBuilder()
    builder.new(1)
    builder.add_row("3 x", [(1.0, (0,)), (2.0, (1,))], [[0, 0]])
    tables = make_penalty_tables(builder.build())
    one, band = np.ones(1), np.zeros((1, 1))
    system = System(one, tables.places, np.full(1, -1), np.zeros(1), band, None, np.ones((2, 1)))
    add_means(tables.derivatives, tables.weights, one, np.zeros(1), np.empty(1), system)
    assert (system.gradient[0], band[0, 0]) == (3.0, 9.0)


@pytest.mark.parametrize("bandwidth", [0, 1, 4])
def test_bands_are_solved_unless_they_are_indefinite(bandwidth: int) -> None:
    rng = np.random.default_rng(bandwidth)
    band = rng.uniform(-1, 1, (9, bandwidth + 1))
    band[:, 0] = 2.5 * (bandwidth + 1)
    band[np.add.outer(np.arange(9), np.arange(bandwidth + 1)) >= 9] = 0.0
    matrix = dense(band.T)
    x = rng.uniform(-1, 1, 9)
    right = matrix @ x
    factors = band.copy()
    assert factorize_band(factors)
    solve_band(factors, right)
    np.testing.assert_allclose(right, x, atol=1e-12)
    band[5, 0] = -1.0
    assert not factorize_band(band)


def test_a_ladder_leads_from_anywhere_to_a_feasible_point_unless_that_is_too_dear() -> None:
    nlp = chain()
    center, half_width = np.zeros(nlp.num_variables), np.full(nlp.num_variables, 2.0)
    tables, none = make_penalty_tables(nlp), np.empty(0, dtype=np.int64)
    ladder = PenaltyLadder(nlp, tables, center, half_width, none, np.zeros(nlp.num_rows, bool))
    rng = np.random.default_rng(2)
    for _ in range(5):
        end = ladder.climb(rng.uniform(-2, 2, center.size), 0.01, 1e3)
        assert end.is_nearly_feasible
        assert np.max(np.abs(nlp.evaluate(end.x)[1])) <= 1e-3
        assert end.cost == pytest.approx(nlp.evaluate(end.x)[0])
        # No feasible direction leads down by more than the last barrier is worth.
        polished = InteriorPoint.warm().solve(nlp, end.x)
        assert polished.is_success
        assert polished.cost == pytest.approx(end.cost, rel=0.05)
    whole = ladder.climb(center, 0.01, 1e3)
    near, far = (ladder.climb(center, 0.01, 1e3, most=whole.cost - d) for d in (0.1, 10.0))
    assert far.steps < near.steps < whole.steps
    assert not near.is_nearly_feasible and not far.is_nearly_feasible


PLANAR = planar_problems()
NAMES = [problem.name for problem in PLANAR]


@pytest.mark.parametrize("problem", PLANAR, ids=NAMES)
def test_rounding_wastes_no_steps_at_a_minimum_nor_where_tolerances_are_below_it(
    problem: GlobalProblem,
) -> None:
    nlp = compile_nlp(problem.prog())
    for seed in range(5):
        start = np.random.default_rng(seed).uniform(problem.lower, problem.upper)
        result = InteriorPoint().solve(nlp, start)
        assert result.status is LocalStatus.CONVERGED, seed
        assert result.iterations <= 60, seed
    for seed in range(2):
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


def constrained(add: Callable[[MathematicalProgram, Any], object]) -> MathematicalProgram:
    prog = MathematicalProgram()
    add(prog, prog.NewContinuousVariables(2, "x"))
    return prog


@pytest.mark.parametrize(
    ("add", "message"),
    [
        (
            lambda p, x: p.AddConstraint(sin(x[0] * x[1]) == 0),
            r"constraint 'ExpressionConstraint' of x\(0\), x\(1\) .* the term sin\(.*not affine",
        ),
        (
            lambda p, x: p.AddConstraint(exp(x[0]) * sin(x[0]) == x[1]),
            r"the term \(exp\(x\(0\)\) \* sin\(x\(0\)\)\), where an exponential and a sine",
        ),
        (
            lambda p, x: p.AddConstraint(log(x[0]) == x[1]),
            r"the term log\(x\(0\)\), where .* stands in a constraint, .* take exp of both sides",
        ),
        (
            lambda p, x: p.AddConstraint(symbolic_max(0.0, x[0]) ** 2 == x[1]),
            r"stands in a constraint",
        ),
        (lambda p, x: p.AddConstraint(cos(x[0]) >= 0.5), r"-inf ≤ \(-1 \* cos\(x\(0\)\)\) ≤ -0\.5"),
        (lambda p, x: p.AddConstraint(1 / x[0] == x[1]), "Multiply denominators out"),
        (lambda p, x: p.AddConstraint(x[0] * x[1] >= 1), r"inequality.*variable s of its own"),
        (lambda p, x: p.AddConstraint(x[0] + x[1] <= 1), "an inequality of several variables"),
        (lambda p, x: p.AddConstraint(lambda z: z, [0.0], [0.0], x[:1]), "PyFunctionConstraint"),
        (lambda p, x: p.AddLorentzConeConstraint(x), "LorentzConeConstraint"),
        (
            lambda p, x: p.AddQuadraticConstraint(np.full((2, 2), np.nan), np.zeros(2), 0, 0, x),
            "got a number that is NaN or infinite in 0 ≤ nan",
        ),
        (
            lambda p, x: (p.AddConstraint(x[0] >= 3), p.AddConstraint(x[0] <= 2)),
            r"bounds of x\(0\) leave it no value: got \[3, 2\]",
        ),
        (lambda p, x: p.AddCost(tan(x[0])), "the cost"),
    ],
)
def test_unsupported_programs_are_refused_by_name(
    add: Callable[[MathematicalProgram, Any], object], message: str
) -> None:
    with pytest.raises(UnsupportedTermError, match=message):
        compile_nlp(constrained(add))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda nlp: InteriorPoint().solve(nlp, [1.0]), r"x0: got shape \(1,\), expected \(2,\)"),
        (
            lambda nlp: InteriorPoint().solve(nlp, [1.0, np.nan]),
            r"x0: got 1 entries that are NaN or infinite.*initial guess is NaN",
        ),
        (lambda nlp: InteriorPoint(tolerance=0.0), "tolerance: got 0, expected a number above 0"),
        (lambda nlp: InteriorPoint(bound_push=0.5), "bound_push: got 0.5, expected .* below 0.5"),
        (lambda nlp: InteriorPoint(max_iterations=-1), "max_iterations: got -1"),
        (lambda nlp: nlp.evaluate([1.0]), "the point: got shape"),
        (
            lambda nlp: compile_nlp(PROBLEMS["HS 6"].program(), [0, 0]),
            "the elimination order: got 2 entries",
        ),
    ],
)
def test_bad_numbers_are_refused(call: Callable[[PolynomialNlp], object], message: str) -> None:
    nlp = compile_nlp(PROBLEMS["HS 6"].program())
    with pytest.raises(OptionsError, match=message):
        call(nlp)
