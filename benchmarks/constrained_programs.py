"""AIGO on constrained programs whose global optimum is known, and multistart SNOPT beside it.

    python benchmarks/constrained_programs.py [--only HS] [--factor 1] [--out DIR]

Global: constraints and bounds hold to 1e-6, and f − f* ≤ 1e-5 max(1, |f*|). A success that is not
feasible to 1e-6 is counted apart: there must be none. SNOPT starts from random points of the box
for as many seconds as ours took, times `--factor`. Writes constrained_programs.csv.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded: one core for all

import argparse
import time
from pathlib import Path

import numpy as np
from peers import OURS, Record, machine, write_csv
from pydrake.solvers import SnoptSolver

from drake_aigto.solver import AigoSolver
from drake_aigto.study.constrained_problem import ConstrainedProblem
from drake_aigto.study.constrained_programs import constrained_problems

FEASIBLE = 1e-6
GLOBAL = 1e-5
PEER = "SNOPT, multistart"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", default="", help="programs whose name has this in it")
    parser.add_argument("--factor", type=float, default=1.0, help="seconds of SNOPT over ours")
    parser.add_argument("--out", type=Path, default=Path())
    arguments = parser.parse_args()
    problems = [p for p in constrained_problems() if arguments.only in p.name]
    AigoSolver().Solve(problems[0].prog())  # Numba compiles
    records, broken = [], 0
    for problem in problems:
        ours, is_broken = run_ours(problem)
        peer = run_snopt(problem, arguments.factor * ours.seconds)
        records += [ours, peer]
        broken += is_broken
        words = ["global" if is_global(record) else f"{record.cost:.6g}" for record in (ours, peer)]
        print(
            f"{problem.name:24} f* = {problem.minimum:12.6g}  ours {words[0]:12} "
            f"{ours.seconds:6.2f} s{' INFEASIBLE SUCCESS' if is_broken else ''}  SNOPT {words[1]}",
            flush=True,
        )
    print(machine())
    for name in (OURS, PEER):
        runs = [record for record in records if record.solver == name]
        count = sum(is_global(record) for record in runs)
        print(f"{name:20} global {count} of {len(runs)}, {count / len(runs):.1%}")
    print(f"successes of ours that are infeasible: {broken}")
    write_csv(arguments.out / "constrained_programs.csv", records)


def is_global(record: Record) -> bool:
    return record.cost - record.minimum <= GLOBAL * max(1.0, abs(record.minimum))


def make_record(problem: ConstrainedProblem, name: str, seconds: float, cost: float) -> Record:
    n, minimum = problem.num_variables, problem.minimum
    return Record(problem.name, n, name, 0, seconds, cost, minimum, 1.0)


def cost_if_feasible(problem: ConstrainedProblem, x: np.ndarray) -> float:
    return float(problem.evaluate(x)) if problem.violation(x) <= FEASIBLE else np.inf


def run_ours(problem: ConstrainedProblem) -> tuple[Record, bool]:
    """Returns the run, and whether it calls a success what is not feasible."""
    prog = problem.prog()
    begin = time.process_time()
    result = AigoSolver().Solve(prog)
    seconds = time.process_time() - begin
    cost = cost_if_feasible(problem, result.get_x_val()) if result.is_success() else np.inf
    is_broken = result.is_success() and not np.isfinite(cost)
    return make_record(problem, OURS, seconds, cost), is_broken


def run_snopt(problem: ConstrainedProblem, seconds: float) -> Record:
    """Returns the best feasible answer of the starts that end in time, of one at least."""
    prog, rng = problem.prog(), np.random.default_rng(0)
    deadline, best = time.process_time() + seconds, np.inf
    while True:
        start = rng.uniform(problem.lower, problem.upper)
        x = SnoptSolver().Solve(prog, start, None).get_x_val()
        best = min(best, cost_if_feasible(problem, x))
        if time.process_time() > deadline:
            return make_record(problem, PEER, seconds, best)


if __name__ == "__main__":
    main()
