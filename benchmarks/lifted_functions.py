"""AIGO on test functions as they are, and with auxiliary variables, with presolve and without.

    python -m benchmarks.lifted_functions [--only Levy] [--lift-seeds 11 12] [--workers 1]

A part of every formula has, with probability 0.6, a variable of its own and an equality that
defines it; none has where it is solved directly. Bounds are cut, the same ones for all three ways,
so that no minimizer is in the middle of the box. Solved: the answer is
feasible to 1e-6, and f − f* ≤ 1e-6 max(1, |f*|).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from pydrake.solvers import ExpressionCost, MathematicalProgram
from pydrake.symbolic import Expression, ExpressionKind

from benchmarks.collections.global_functions import global_problems
from benchmarks.collections.known_optimum import GlobalProblem
from benchmarks.peers import Record, make_record, time_solve
from benchmarks.script import machine, read_flags, run_all, run_as
from drake_aigto.solver import AigoOptions

MOST_VARIABLES = 10
_SHARE = 0.6  # of a formula's parts, that have a variable
_CUT = 0.8  # of the way to a minimizer, that a bound is moved by at most
_LEAVES = (ExpressionKind.Constant, ExpressionKind.Var)


def lifted_problems() -> Iterator[GlobalProblem]:
    """Yields the functions of few variables."""
    for problem in global_problems():
        if problem.num_variables <= MOST_VARIABLES:
            yield problem


def lift(problem: GlobalProblem, seed: int, share: float = _SHARE) -> MathematicalProgram:
    """Returns a program of a function, lifted and cut as the seed has it."""
    rng = np.random.default_rng([seed, *problem.name.encode()])
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(problem.num_variables, "x")
    minimizer = rng.choice(problem.minimizers)
    part = _CUT * rng.random((2, x.size))
    lower = problem.lower + part[0] * (minimizer - problem.lower)
    upper = problem.upper + part[1] * (minimizer - problem.upper)
    prog.AddBoundingBoxConstraint(lower, upper, x)
    cost = ExpressionCost(_Lift(prog, rng, share).replace(problem.evaluate(x)))
    prog.AddCost(cost, vars=cost.vars())
    return prog


class _Lift:
    """Replaces parts of formulas from the leaves up; equal ones by the same variable."""

    def __init__(self, prog: MathematicalProgram, rng: np.random.Generator, share: float) -> None:
        self._prog, self._rng, self._share = prog, rng, share
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
            if self._rng.random() < self._share:
                (own,) = self._prog.NewContinuousVariables(1, f"y{len(self._known)}")
                self._prog.AddConstraint(own - inner == 0)
                inner = Expression(own)
            self._known[text] = inner
        return self._known[text]


def _expression(operand: Any) -> Expression:
    return operand if isinstance(operand, Expression) else Expression(operand)


TOLERANCE = 1e-6
METHODS = ("presolve", "without", "direct")


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
    found = run_all(solve_all, jobs, arguments)
    for runs in found:
        if not all(map(is_solved, runs)):
            told = "   ".join(f"{run.cost:12.6g}{run.seconds:8.2f} s" for run in runs)
            print(f"{f'{runs[0].problem} seed={runs[0].seed}':32}{told}")
    for which, runs in zip(METHODS, zip(*found, strict=True), strict=True):
        solved, broken = sum(map(is_solved, runs)), sum(map(is_broken, runs))
        median = np.median([run.seconds for run in runs])
        print(f"{which:9} solved {solved} of {len(runs)}, broken {broken}, median {median:.2f} s")


def is_solved(run: Record) -> bool:
    """Returns whether an answer is feasible and has the minimum."""
    return run.cost - run.minimum <= TOLERANCE * max(1.0, abs(run.minimum))


def is_broken(run: Record) -> bool:
    """Returns whether a success is infeasible, or lower than the minimum."""
    below = (run.minimum - run.cost) / max(1.0, abs(run.minimum))
    return bool(np.isnan(run.cost) or below > 10 * TOLERANCE)


def solve_all(job: tuple[str, int]) -> tuple[Record, ...]:
    """Returns runs with presolve and without, and of the function itself."""
    return tuple(solve(*job, method) for method in METHODS)


def solve(name: str, seed: int, method: str) -> Record:
    """Returns one run; its cost is inf if it is not feasible, nan if that is called a success."""
    (problem,) = (each for each in lifted_problems() if each.name == name)
    options = AigoOptions(presolve=method != "without")
    share = 0.0 if method == "direct" else _SHARE
    result, seconds = time_solve(lift(problem, seed, share), options)
    cost = result.get_optimal_cost()
    if result.get_solver_details().violation > TOLERANCE:
        cost = np.nan if result.is_success() else np.inf
    return make_record(problem, 1.0, method, seed, seconds, cost)


if __name__ == "__main__":
    run_as("benchmarks.lifted_functions")
