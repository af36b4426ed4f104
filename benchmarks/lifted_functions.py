"""AIGO on test functions that are written with auxiliary variables, with presolve and without.

    python -m benchmarks.lifted_functions [--only Levy] [--lift-seeds 11 12] [--workers 1]

A part of every formula has, with probability 0.6, a variable of its own and an equality that
defines it; bounds are cut, so that no minimizer is in the middle of the box. Solved: the answer is
feasible to 1e-6, and f − f* ≤ 1e-6 max(1, |f*|).

Test functions as modeling tools write them: parts have variables of their own, by equalities.

Their minimum stays what it was. Bounds are cut at random, so that no minimizer is in the middle.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.solvers import ExpressionCost, MathematicalProgram
from pydrake.symbolic import Expression, ExpressionKind

from benchmarks.collections.global_functions import global_problems
from benchmarks.collections.known_optimum import GlobalProblem
from benchmarks.script import machine, read_flags, run_all, run_as
from drake_aigto.solver import AigoOptions, AigoSolver

MOST_VARIABLES = 10
_SHARE = 0.6  # of a formula's parts, that have a variable
_CUT = 0.8  # of the way to a minimizer, that a bound is moved by at most
_LEAVES = (ExpressionKind.Constant, ExpressionKind.Var)


def lifted_problems() -> Iterator[GlobalProblem]:
    """Yields the functions of few variables."""
    for problem in global_problems():
        if problem.num_variables <= MOST_VARIABLES:
            yield problem


def lift(problem: GlobalProblem, seed: int) -> MathematicalProgram:
    """Returns a program of a function, lifted and cut as the seed has it."""
    rng = np.random.default_rng([seed, *problem.name.encode()])
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(problem.num_variables, "x")
    minimizer = rng.choice(problem.minimizers)
    part = _CUT * rng.random((2, x.size))
    lower = problem.lower + part[0] * (minimizer - problem.lower)
    upper = problem.upper + part[1] * (minimizer - problem.upper)
    prog.AddBoundingBoxConstraint(lower, upper, x)
    cost = ExpressionCost(_Lift(prog, rng).replace(problem.evaluate(x)))
    prog.AddCost(cost, vars=cost.vars())
    return prog


class _Lift:
    """Replaces parts of formulas from the leaves up; equal ones by the same variable."""

    def __init__(self, prog: MathematicalProgram, rng: np.random.Generator) -> None:
        self._prog, self._rng = prog, rng
        self._known: dict[str, Any] = {}

    def replace(self, formula: Any) -> Any:
        """Returns a formula with variables in place of its parts, never of all of it."""
        return self._rebuild(_expression(formula))

    def _rebuild(self, formula: Expression) -> Any:
        if formula.get_kind() in _LEAVES:
            return formula
        make, operands = formula.Unapply()
        return make(*(self._replace_part(_expression(operand)) for operand in operands))

    def _replace_part(self, part: Expression) -> Any:
        if part.get_kind() in _LEAVES:
            return part
        if (text := str(part)) not in self._known:
            inner = self._rebuild(part)
            if self._rng.random() < _SHARE:
                (own,) = self._prog.NewContinuousVariables(1, f"y{len(self._known)}")
                self._prog.AddConstraint(own - inner == 0)
                inner = Expression(own)
            self._known[text] = inner
        return self._known[text]


def _expression(operand: Any) -> Expression:
    return operand if isinstance(operand, Expression) else Expression(operand)


TOLERANCE = 1e-6


@dataclass(frozen=True)
class Run:
    """One solve.

    Attributes:
        problem: the function.
        cost: of the answer; inf where it is not feasible.
        is_solved: by value.
        is_broken: a success that is infeasible, or lower than the minimum.
        seconds: of the process.
    """

    problem: str
    cost: float
    is_solved: bool
    is_broken: bool
    seconds: float


def main() -> None:
    """Runs all functions and prints those that are missed, and counts."""
    arguments = read_flags(
        __doc__,
        only=("", "functions whose name has this in it"),
        lift_seeds=((11, 12), "of the parts and the cuts"),
    )
    print(machine())
    names = [each.name for each in lifted_problems() if arguments.only in each.name]
    jobs = [(name, seed) for seed in arguments.lift_seeds for name in names]
    pairs = run_all(solve_both, jobs, arguments)
    for runs in pairs:
        if not all(run.is_solved for run in runs):
            told = "   ".join(f"{run.cost:12.6g}{run.seconds:8.2f} s" for run in runs)
            print(f"{runs[0].problem:32}{told}")
    for which, runs in zip(("presolve", "without"), zip(*pairs, strict=True), strict=True):
        solved, broken = sum(run.is_solved for run in runs), sum(run.is_broken for run in runs)
        median = np.median([run.seconds for run in runs])
        print(f"{which:9} solved {solved} of {len(runs)}, broken {broken}, median {median:.2f} s")


def solve_both(job: tuple[str, int]) -> tuple[Run, Run]:
    """Returns runs with presolve and without."""
    name, seed = job
    return solve(name, seed, presolve=True), solve(name, seed, presolve=False)


def solve(name: str, seed: int, presolve: bool) -> Run:
    """Returns one run."""
    (problem,) = (each for each in lifted_problems() if each.name == name)
    prog = lift(problem, seed)
    start = time.process_time()
    result = AigoSolver(AigoOptions(presolve=presolve)).Solve(prog)
    seconds = time.process_time() - start
    details, unit = result.get_solver_details(), max(1.0, abs(problem.minimum))
    above = (result.get_optimal_cost() - problem.minimum) / unit
    is_feasible = details.violation <= TOLERANCE
    return Run(
        problem=f"{name} seed={seed}",
        cost=result.get_optimal_cost() if is_feasible else np.inf,
        is_solved=is_feasible and above <= TOLERANCE,
        is_broken=result.is_success() and (not is_feasible or above < -10 * TOLERANCE),
        seconds=seconds,
    )


if __name__ == "__main__":
    run_as("benchmarks.lifted_functions")
