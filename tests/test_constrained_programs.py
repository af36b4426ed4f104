"""Constrained programs with known optima: these are feasible, and nothing beats them."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.solvers import SnoptSolver, SolverOptions

from benchmarks.collections.constrained_programs import constrained_problems, planted_program
from benchmarks.collections.known_optimum import ConstrainedProblem
from drake_aigto.solver import AigoSolver

PROBLEMS = {problem.name: problem for problem in constrained_problems()}
# 1e-8 is the most that a minimizer's residuals, and what they buy in cost, may be.
FEASIBLE = 1e-8
NUM_STARTS = 8

every_problem = pytest.mark.parametrize("problem", PROBLEMS.values(), ids=lambda p: p.name)


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
    problem = PROBLEMS[name]
    result = AigoSolver().Solve(problem.prog())
    assert result.is_success() and problem.violation(result.get_x_val()) <= 1e-6
    assert result.get_optimal_cost() <= problem.minimum + 1e-5 * scale(problem)


def test_there_are_enough_of_them() -> None:
    assert len(PROBLEMS) == len(constrained_problems()) >= 70
    rows = [
        (len(p.equalities(*p.minimizers[0])), len(p.inequalities(*p.minimizers[0])))
        for p in PROBLEMS.values()
    ]
    assert sum(equalities > 0 for equalities, _ in rows) >= 25
    assert sum(inequalities > 0 for _, inequalities in rows) >= 40


@every_problem
def test_minimizers_are_feasible_and_have_the_minimum(problem: ConstrainedProblem) -> None:
    for x in problem.minimizers:
        assert problem.violation(x) <= FEASIBLE
        assert problem.evaluate(x) == pytest.approx(problem.minimum, rel=1e-9, abs=1e-9)


@every_problem
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


@every_problem
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


@pytest.mark.parametrize("seed", range(5))
def test_a_planted_minimum_holds_wherever_the_rows_do(seed: int) -> None:
    problem = planted_program(2 + 3, seed)
    for x in np.random.default_rng(seed).uniform(-2.0, 2.0, (300, problem.num_variables)):
        equalities = np.asarray(problem.equalities(*x))
        if min(problem.inequalities(*x)) < 0.0:
            continue
        # Multipliers of equalities are at most 1 in size.
        assert problem.evaluate(x) >= -np.sum(np.abs(equalities))


def test_a_planted_program_comes_from_its_seed() -> None:
    first, again, other = (planted_program(5, seed).minimizers for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
