"""Collections of problems in the benchmarks: minima are minima, and rows and slopes agree."""

from __future__ import annotations

import numpy as np
import pytest
from marks import slow
from numpy.typing import NDArray
from pydrake.solvers import SnoptSolver, SolverOptions
from scipy.optimize import minimize

from benchmarks.collections.chain import REACH, ChainProblem, chain_problem, exact_chain_minimum
from benchmarks.collections.constrained_programs import constrained_problems, planted_program
from benchmarks.collections.global_functions import global_problems, random_univariate
from benchmarks.collections.known_optimum import ConstrainedProblem, GlobalProblem
from drake_aigto.errors import OptionsError
from drake_aigto.solver import AigoOptions, AigoSolver

FUNCTIONS = {problem.name: problem for problem in global_problems()}
SMALL = [problem for problem in FUNCTIONS.values() if problem.num_variables <= 12]

every_function = pytest.mark.parametrize("problem", FUNCTIONS.values(), ids=lambda p: p.name)
small_function = pytest.mark.parametrize("problem", SMALL, ids=lambda p: p.name)


def random_points(problem: GlobalProblem, count: int) -> NDArray[np.float64]:
    shape = (count, problem.num_variables)
    return np.random.default_rng(0).uniform(problem.lower, problem.upper, shape)


@every_function
def test_minimizers_lie_in_the_box_have_the_minimum_and_no_slope(problem: GlobalProblem) -> None:
    # Rounding in f and ∇f grows with the numbers that they sum up.
    size = np.ptp(problem.evaluate(random_points(problem, 100)))
    for x in problem.minimizers:
        assert np.all((problem.lower <= x) & (x <= problem.upper))
        assert problem.evaluate(x) == pytest.approx(problem.minimum, rel=1e-13, abs=1e-15)
        assert np.max(np.abs(problem.gradient(x))) <= 1e-11 + 1e-16 * size


@pytest.mark.slow
@small_function
def test_local_searches_find_nothing_below_the_minimum(problem: GlobalProblem) -> None:
    points = random_points(problem, 2000)
    starts = points[np.argsort(problem.evaluate(points))[:3]]
    found = [
        minimize(
            problem.evaluate,
            start,
            jac=problem.gradient,
            bounds=list(zip(problem.lower, problem.upper, strict=True)),
            method="L-BFGS-B",
            options={"maxfun": 60},
        ).fun
        for start in starts
    ]
    assert min(found) >= problem.minimum - 1e-9 * max(1.0, abs(problem.minimum))


@every_function
def test_numbers_batches_and_programs_agree(problem: GlobalProblem) -> None:
    points = random_points(problem, 2)
    values = problem.evaluate(points)
    assert values.shape == (2,)
    prog = problem.prog()
    for x, value in zip(points, values, strict=True):
        assert problem.evaluate(x) == pytest.approx(value, rel=1e-12)
        costs = [prog.EvalBinding(binding, x).item() for binding in prog.GetAllCosts()]
        assert sum(costs) == pytest.approx(value, rel=1e-12)
    (bounds,) = prog.bounding_box_constraints()
    np.testing.assert_array_equal(bounds.evaluator().lower_bound(), problem.lower)
    np.testing.assert_array_equal(bounds.evaluator().upper_bound(), problem.upper)


@small_function
def test_the_gradient_is_the_slope(problem: GlobalProblem) -> None:
    (x,) = random_points(problem, 1)
    step = 1e-5 * (problem.upper - problem.lower) * np.eye(problem.num_variables)
    slope = (problem.evaluate(x + step) - problem.evaluate(x - step)) / (2.0 * np.diag(step))
    gradient = problem.gradient(x)
    # Central differences: off by step² f‴/6, of which the degree, up to 24, makes 1e-6 of ∇f.
    np.testing.assert_allclose(slope, gradient, rtol=1e-4, atol=1e-5 * np.max(np.abs(gradient)))


@pytest.mark.parametrize("degree", [4, 8, 12])
def test_a_random_polynomial_is_nowhere_below_its_minimum(degree: int) -> None:
    grid = np.linspace(-2.5, 2.5, 10_001)[:, None]
    for seed in range(15):
        problem = random_univariate(degree, seed)
        (minimizer,) = problem.minimizers
        assert problem.evaluate(minimizer) == problem.minimum
        assert abs(problem.gradient(minimizer).item()) <= 1e-9
        assert np.min(problem.evaluate(grid)) >= problem.minimum - 1e-12


def test_random_functions_come_from_their_seeds() -> None:
    np.testing.assert_array_equal(chain_problem(5, 1).roots, chain_problem(5, 1).roots)
    assert not np.array_equal(chain_problem(5, 1).roots, chain_problem(5, 2).roots)
    assert random_univariate(6, 1).minimum == random_univariate(6, 1).minimum
    assert random_univariate(6, 1).minimum != random_univariate(6, 2).minimum
    first, again, other = (planted_program(5, seed).minimizers for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize(("n", "grid_points"), [(2, 801), *slow((3, 89))])
@pytest.mark.parametrize("seed", range(2))
def test_a_chains_minimum_is_that_of_brute_force(n: int, grid_points: int, seed: int) -> None:
    problem = chain_problem(n, seed)
    axis = np.linspace(-REACH, REACH, grid_points)
    grid = np.stack(np.meshgrid(*[axis] * n, indexing="ij"), axis=-1).reshape(-1, n)
    values = problem.evaluate(grid)
    best = grid[np.argmin(values)]
    x = exact_chain_minimum(problem)
    assert problem.evaluate(x) <= np.min(values)
    np.testing.assert_allclose(x, best, atol=2.0 * (axis[1] - axis[0]))


@pytest.mark.parametrize("n", [10, *slow(170)])
def test_no_local_search_gets_below_a_chains_minimum(n: int) -> None:
    problem = chain_problem(n, 0)
    x = exact_chain_minimum(problem)
    minimum = problem.evaluate(x)
    assert np.max(np.abs(problem.gradient(x))) <= 1e-11
    rng = np.random.default_rng(0)
    starts = [*rng.uniform(-REACH, REACH, (30, n)), *(x + rng.normal(0.0, 0.5, (30, n)))]
    for start in starts:
        found = minimize(
            problem.evaluate,
            np.clip(start, -REACH, REACH),
            jac=problem.gradient,
            method="L-BFGS-B",
            bounds=[(-REACH, REACH)] * n,
        )
        assert found.fun >= minimum - 1e-9 * abs(minimum)


def test_a_chain_has_two_variables_or_more_and_its_minimum_may_lie_on_the_box() -> None:
    with pytest.raises(OptionsError, match="2 variables or more"):
        chain_problem(1, 0)
    # Both wells fall towards the box's ends, where coupling pulls x_1 and x_2 apart.
    problem = ChainProblem(np.full((2, 6), 9.0), np.array([1e9]))
    np.testing.assert_array_equal(np.abs(exact_chain_minimum(problem)), [REACH, REACH])


def test_a_chain_as_a_test_function_is_the_same_function() -> None:
    chain = chain_problem(10, 3)
    problem = chain.problem()
    assert problem.minimum == chain.evaluate(problem.minimizers[0])
    for x in random_points(problem, 5):
        assert problem.evaluate(x) == pytest.approx(chain.evaluate(x), rel=1e-12)
        np.testing.assert_allclose(problem.gradient(x), chain.gradient(x), rtol=1e-10, atol=1e-10)
    assert len(chain.prog().GetAllCosts()) == 10


PROGRAMS = {problem.name: problem for problem in constrained_problems()}
# 1e-8 is the most that a minimizer's residuals, and what they buy in cost, may be.
FEASIBLE = 1e-8
NUM_STARTS = 5

every_program = pytest.mark.parametrize("problem", PROGRAMS.values(), ids=lambda p: p.name)


def tight_options() -> SolverOptions:
    options = SolverOptions()
    options.SetOption(SnoptSolver.id(), "Major feasibility tolerance", 1e-11)
    options.SetOption(SnoptSolver.id(), "Major optimality tolerance", 1e-9)
    options.SetOption(SnoptSolver.id(), "Major iterations limit", 200)
    return options


def scale(problem: ConstrainedProblem) -> float:
    return max(1.0, abs(problem.minimum))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["HS 18", "HS 40", "HS 106", "HS 108", "Floudas-Pardalos 2.1"])
def test_ours_solves_those_that_once_were_missed_or_slow(name: str) -> None:
    problem = PROGRAMS[name]
    result = AigoSolver(AigoOptions(cells=0)).Solve(problem.prog())
    assert result.is_success() and problem.violation(result.get_x_val()) <= 1e-6
    assert result.get_optimal_cost() <= problem.minimum + 1e-5 * scale(problem)


@every_program
def test_minimizers_are_feasible_and_have_the_minimum(problem: ConstrainedProblem) -> None:
    for x in problem.minimizers:
        assert problem.violation(x) <= FEASIBLE
        assert problem.evaluate(x) == pytest.approx(problem.minimum, rel=1e-9, abs=1e-9)


@pytest.mark.slow
@every_program
def test_snopt_ends_at_the_minimum_from_there_and_never_below_it(
    problem: ConstrainedProblem,
) -> None:
    prog, options = problem.prog(), tight_options()
    rng = np.random.default_rng(0)
    starts = rng.uniform(problem.lower, problem.upper, (NUM_STARTS, problem.num_variables))
    near = np.clip(problem.minimizers[0] + 1e-4, problem.lower, problem.upper)
    costs = []
    for start in (near, *starts):
        x = SnoptSolver().Solve(prog, start, options).get_x_val()
        if problem.violation(x) <= FEASIBLE:
            costs.append(problem.evaluate(x))
    assert costs[0] <= problem.minimum + 1e-6 * scale(problem)
    assert min(costs) >= problem.minimum - 1e-6 * scale(problem)


@every_program
def test_the_program_has_the_same_costs_and_rows(problem: ConstrainedProblem) -> None:
    prog = problem.prog()
    x = np.random.default_rng(1).uniform(problem.lower, problem.upper)
    costs = sum(prog.EvalBinding(binding, x).item() for binding in prog.GetAllCosts())
    assert costs == pytest.approx(problem.evaluate(x), rel=1e-10, abs=1e-10)
    violations = [0.0]
    for binding in prog.GetAllConstraints():
        value, row = prog.EvalBinding(binding, x), binding.evaluator()
        violations += [*(row.lower_bound() - value), *(value - row.upper_bound())]
    # Drake may divide a row by its greatest coefficient: only whether it holds is the same.
    assert (max(violations) <= 0.0) == (problem.violation(x) == 0.0)
    holds = prog.CheckSatisfied(prog.GetAllConstraints(), problem.minimizers[0], 1e-7)
    assert holds


@pytest.mark.parametrize("seed", range(2))
def test_a_planted_minimum_holds_wherever_the_rows_do(seed: int) -> None:
    problem = planted_program(2 + 3, seed)
    for x in np.random.default_rng(seed).uniform(-2.0, 2.0, (300, problem.num_variables)):
        equalities = np.asarray(problem.equalities(*x))
        if min(problem.inequalities(*x)) < 0.0:
            continue
        # Multipliers of equalities are at most 1 in size.
        assert problem.evaluate(x) >= -np.sum(np.abs(equalities))
