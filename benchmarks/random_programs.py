"""Does `AigoSolver` ever crash or lie? Random small programs, solved twice.

    python benchmarks/random_programs.py --count 10000 --seed 0

Every program is solved twice, which has to give the same bits. A success has to be finite and to
meet its constraints to 1e-6. Exits with 1 otherwise.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
import traceback
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np

from drake_aigto.solver import AigoOptions, AigoSolver
from drake_aigto.study.random_programs import random_program

# Of constraint violations; Drake compares with this itself.
TOLERANCE = 1e-6


def run(job: tuple[int, int, int]) -> str:
    """Solves the program of a seed and number; returns its status, or what went wrong."""
    seed, number, rounds = job
    prog = random_program(np.random.default_rng([seed, number]))
    try:
        first, again = (AigoSolver(AigoOptions(rounds=rounds)).Solve(prog) for _ in range(2))
    except Exception:
        return f"CRASH of {number}: {traceback.format_exc(limit=-2)}"
    x = first.get_x_val()
    if x.tobytes() != again.get_x_val().tobytes():
        return f"OTHER BITS in {number}"
    if first.is_success():
        if not (np.all(np.isfinite(x)) and np.isfinite(first.get_optimal_cost())):
            return f"NOT FINITE in {number}"
        if first.GetInfeasibleConstraints(prog, TOLERANCE * (1 + 1e-9)):
            return f"INFEASIBLE success of {number}"
    return first.get_solver_details().status.name


def main() -> int:
    """Solves all programs and returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rounds", type=int, default=4, help="of each solve")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    options = parser.parse_args()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # Workers would fight for cores.
    jobs = [(options.seed, number, options.rounds) for number in range(options.count)]
    start = time.perf_counter()
    with ProcessPoolExecutor(options.workers, get_context("spawn")) as pool:
        outcomes = list(pool.map(run, jobs, chunksize=16))
    wrong = [outcome for outcome in outcomes if " " in outcome]
    for outcome in wrong:
        print(outcome)
    print(f"{options.count} programs, each twice, in {time.perf_counter() - start:.0f} s")
    print(dict(Counter(outcome for outcome in outcomes if " " not in outcome)))
    print(f"crashed or lied: {len(wrong)}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
