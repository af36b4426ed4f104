"""Does `AigoSolver` ever crash or lie? Random small programs of every kind that it takes.

    python -m benchmarks.random_programs [--count 10000] [--seed 0] [--again 10] [--workers 16]
        [--minutes 9]

A success has to be finite and to meet its constraints to 1e-6, but for what rounding of the answer
changes them by: at 4e4, no number meets 1e-3 x⁴ = y to 1e-6. Of every so many programs one is
solved again, which has to give the same bits. Exits with 1 otherwise, or if not all were tried.
"""

from __future__ import annotations

import os
import time
import traceback
from collections import Counter
from functools import partial
from typing import Any

import numpy as np
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.solvers import Binding, ExpressionCost, MathematicalProgram
from pydrake.symbolic import Expression, abs, cos, exp, log, max, min, sqrt, tan

from benchmarks.script import read_flags, run_as, run_jobs
from drake_aigto.arrays import Floats
from drake_aigto.solver import AigoOptions, AigoSolver


def random_program(generator: np.random.Generator) -> MathematicalProgram:
    """Returns a program of 1 to 3 variables: a polynomial, and in three of ten a function more.

    Coefficients span four decades. Some programs have a cost that grows in all directions, some may
    fall without end; bounds may be on one side, on both or none, and contradict the rows.
    """
    prog = MathematicalProgram()
    n = int(generator.integers(1, 4))
    x = prog.NewContinuousVariables(n, "x")
    growth = sum((x_i**8 for x_i in x), Expression(0.0)) if generator.random() < 0.7 else 0.0
    cost = ExpressionCost(_random_polynomial(generator, x, 4) + growth + x[0])
    prog.AddCost(cost, vars=cost.vars())
    for x_i in x:
        if generator.random() < 0.6:
            ends = np.sort(generator.normal(size=2) * 3)
            low, high = np.where(generator.random(2) < 0.3, [-np.inf, np.inf], ends)
            prog.AddBoundingBoxConstraint(low, high, x_i)
    for _ in range(int(generator.integers(0, 3))):
        row, level = _random_polynomial(generator, x, 2) + x[0], generator.normal()
        prog.AddConstraint(row == level if generator.random() < 0.4 else row <= level)
    if generator.random() < 0.3:
        extra = ExpressionCost(_random_function(generator, x))
        prog.AddCost(extra, vars=extra.vars())
    return prog


def _random_function(generator: np.random.Generator, x: Any) -> Expression:
    """Returns a function that has a value everywhere, or the tangent within its branch."""
    u, v = x[0], x[-1]
    functions = (
        lambda: u / (1.0 + v**2),
        lambda: sqrt(1.0 + u**2),
        lambda: (2.0 + u**2) ** 1.5,
        lambda: log(1.0 + u**2 + v**2),
        lambda: (1.0 + u**2) * log(1.0 + u**2),
        lambda: abs(u - v**2),
        lambda: max(u, 1.0 - v),
        lambda: min(u**2, 3.0 + v),
        lambda: tan(0.5 * cos(u)),
        lambda: exp(-(u**2) / (1.0 + v**2)),
    )
    return generator.normal() * functions[int(generator.integers(len(functions)))]()


def _random_polynomial(generator: np.random.Generator, x: Any, num_terms: int) -> Expression:
    """Returns a sum of terms of degree 0 to 6."""
    total = Expression(generator.normal())
    for _ in range(num_terms):
        term = Expression(generator.normal() * 10 ** generator.uniform(-2, 2))
        for i in generator.integers(0, x.size, 3):
            term *= x[i] ** int(generator.integers(0, 3))
        total += term
    return total


# Of constraint violations.
TOLERANCE = 1e-6
REPORTED = 1000  # programs between lines of progress


def run(number: int, seed: int, rounds: int, again: int) -> str:
    """Solves the program of a number and seed; returns its status, or what went wrong."""
    prog = random_program(np.random.default_rng([seed, number]))
    solver = AigoSolver(AigoOptions(rounds=rounds))
    try:
        first, *repeated = (solver.Solve(prog) for _ in range(1 + (number % again == 0)))
    except Exception:
        return f"CRASH of {number}: {traceback.format_exc(limit=-2)}"
    x = first.get_x_val()
    if any(x.tobytes() != each.get_x_val().tobytes() for each in repeated):
        return f"OTHER BITS in {number}"
    if first.is_success():
        if not (np.all(np.isfinite(x)) and np.isfinite(first.get_optimal_cost())):
            return f"NOT FINITE in {number}"
        if not all(_is_met(prog, binding, x) for binding in prog.GetAllConstraints()):
            return f"INFEASIBLE success of {number}"
    return first.get_solver_details().status.name


def _is_met(prog: MathematicalProgram, binding: Binding, x: Floats) -> bool:
    """Returns whether a constraint g holds at x to 1e-6, and to ε Σ_j |x_j ∂g/∂x_j| all in all."""
    evaluator, found = binding.evaluator(), prog.EvalBinding(binding, x)
    excess = np.maximum(evaluator.lower_bound() - found, found - evaluator.upper_bound())
    if np.all(excess <= TOLERANCE * (1 + 1e-9)):
        return True
    read = x[prog.FindDecisionVariableIndices(binding.variables())]
    slopes = ExtractGradient(evaluator.Eval(InitializeAutoDiff(read)))
    rounding = np.finfo(float).eps * np.abs(slopes * read).sum(axis=1)
    return bool(np.all(excess <= TOLERANCE + rounding))


def main() -> int:
    """Solves all programs and returns the exit status."""
    options = read_flags(
        __doc__,
        workers=os.cpu_count() or 1,
        count=(10000, ""),
        seed=(0, ""),
        rounds=(4, "of each solve"),
        again=(10, "one of so many is solved twice"),
    )
    work = partial(run, seed=options.seed, rounds=options.rounds, again=options.again)
    start = time.perf_counter()
    outcomes: Counter[str] = Counter()
    wrong = twice = 0
    for number, future in run_jobs(work, range(options.count), options):
        died = future.exception()
        outcome = f"WORKER DIED on {number}: {died!r}" if died else future.result()
        if " " in outcome:
            print(outcome, flush=True)
            wrong += 1
        else:
            outcomes[outcome] += 1
        twice += number % options.again == 0
        tried = outcomes.total() + wrong
        if tried % REPORTED == 0:
            print(f"{tried} tried, {wrong} crashed or lied", flush=True)
    tried = outcomes.total() + wrong
    seconds = time.perf_counter() - start
    print(f"{tried} of {options.count} programs, {twice} of them twice, in {seconds:.0f} s")
    print(dict(outcomes))
    print(f"crashed or lied: {wrong}")
    return 1 if wrong or tried < options.count else 0


if __name__ == "__main__":
    run_as("benchmarks.random_programs")
