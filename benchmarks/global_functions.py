"""AIGO and its peers on the test functions of the literature, at equal time on one core.

    python benchmarks/global_functions.py [--seeds 3] [--factor 1] [--only Rastrigin] [--out DIR]

Ours is timed first, from the program to the answer; each peer then gets as many seconds, times
`--factor`. Two measures of "solved":

    by range     f − f* ≤ 1e-6 (max f over the box − f*)
    by value     f − f* ≤ 1e-6 max(1, |f*|)

The range over the box is the largest of 10,000 seeded samples and (random) corners. It is up to
1e28: then the first measure says next to nothing, and only the second one tells solvers apart.

Also 1,000 random polynomials of one variable, `--univariate` of each degree 4 to 12, ours alone.
Writes global_functions.csv and global_functions.png.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded: one core for all

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from peers import OPTIONS, PEERS, Record, machine, run_all, warm_up, write_csv

from drake_aigto.solver import AigoSolver
from drake_aigto.study.global_functions import global_problems, random_univariate
from drake_aigto.study.global_problem import GlobalProblem

TOLERANCE = 1e-6
SAMPLES = 10_000
DEGREES = (4, 6, 8, 10, 12)
MEASURES = ("by range", "by value")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=3, help="runs of each peer")
    parser.add_argument("--factor", type=float, default=1.0, help="seconds of peers over ours")
    parser.add_argument("--only", default="", help="functions whose name has this in it")
    parser.add_argument("--univariate", type=int, default=200, help="polynomials a degree")
    parser.add_argument("--out", type=Path, default=Path())
    arguments = parser.parse_args()
    warm_up()
    records: list[Record] = []
    for problem in global_problems():
        if arguments.only in problem.name:
            records += run_all(
                problem, value_range(problem), range(arguments.seeds), arguments.factor, PEERS
            )
            tell(problem, records)
            write_csv(arguments.out / "global_functions.csv", records)  # what is done is kept
    summarise(records)
    draw(records, arguments.out / "global_functions.png")
    if not arguments.only:
        univariate(arguments.univariate)


def value_range(problem: GlobalProblem) -> float:
    """Returns max f − f* over samples and corners."""
    rng = np.random.default_rng(0)
    n = problem.num_variables
    points = rng.uniform(problem.lower, problem.upper, (SAMPLES if n <= 100 else SAMPLES // 10, n))
    corners = np.where(rng.random((2 ** min(n, 10), n)) < 0.5, problem.lower, problem.upper)
    return float(max(np.max(problem.evaluate(x)) for x in (points, corners)) - problem.minimum)


def is_solved(record: Record, measure: str) -> bool:
    size = record.range if measure == "by range" else max(1.0, abs(record.minimum))
    return record.cost - record.minimum <= TOLERANCE * size


def tell(problem: GlobalProblem, records: Sequence[Record]) -> None:
    """Prints a line for a function: ours, and which peers solve it in every run."""
    mine = [record for record in records if record.problem == problem.name]
    for name in OPTIONS:
        (run,) = [record for record in mine if record.solver == name]
        marks = "".join("+" if is_solved(run, measure) else "-" for measure in MEASURES)
        gap = run.cost - run.minimum
        print(f"{problem.name:28}{name:20}{marks}  {run.seconds:7.3f} s  f − f* = {gap:.1e}")
    solved = [
        f"{name} {np.mean([is_solved(r, 'by value') for r in mine if r.solver == name]):.0%}"
        for name in PEERS
        if any(r.solver == name for r in mine)
    ]
    print(f"{'':28}{', '.join(solved)}", flush=True)


def summarise(records: Sequence[Record]) -> None:
    """Prints how many functions each solver solves, over its runs."""
    print(f"\n{machine()}\n{'':26}functions  {'  '.join(MEASURES)}  slowest")
    for name in (*OPTIONS, *PEERS):
        runs = [record for record in records if record.solver == name]
        if runs:
            shares = [np.mean([is_solved(r, measure) for r in runs]) for measure in MEASURES]
            count = len({record.problem for record in runs})
            slowest = max(record.seconds for record in runs)
            print(f"{name:26}{count:9}  {shares[0]:8.1%}  {shares[1]:8.1%}  {slowest:5.2f} s")


def draw(records: Sequence[Record], path: Path) -> None:
    """Draws both shares of solved runs for each solver."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names = [n for n in (*OPTIONS, *PEERS) if any(r.solver == n for r in records)]
    figure, axes = plt.subplots(figsize=(8.0, 0.4 * len(names) + 1.2), layout="constrained")
    for offset, measure in enumerate(MEASURES):
        # Of all functions: a peer that is left out of one has not solved it.
        total = len({r.problem for r in records})
        shares = []
        for name in names:
            runs = [r for r in records if r.solver == name]
            seeds = len({r.seed for r in runs})
            shares.append(100.0 * sum(is_solved(r, measure) for r in runs) / (total * seeds))
        places = np.arange(len(names)) + 0.4 * offset
        axes.barh(places, shares, height=0.38, label=f"solved {measure}")
    axes.set_yticks(np.arange(len(names)) + 0.2, names)
    axes.invert_yaxis()
    axes.set_xlabel("solved runs [%]")
    axes.set_xlim(0.0, 100.0)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 1.12), ncols=2, frameon=False)
    figure.savefig(path, dpi=150)


def univariate(count: int) -> None:
    """Prints how many random polynomials of each degree ours solves."""
    print()
    for degree in DEGREES:
        problems = [random_univariate(degree, seed) for seed in range(count)]
        for name, options in OPTIONS.items():
            begin = time.process_time()
            answers = [AigoSolver(options).Solve(p.prog()).get_x_val() for p in problems]
            seconds = (time.process_time() - begin) / count
            solved = sum(
                problem.evaluate(x) - problem.minimum <= TOLERANCE
                for problem, x in zip(problems, answers, strict=True)
            )
            print(f"degree {degree:2}  {name:20}{solved:5} of {count}  {1e3 * seconds:.1f} ms each")


if __name__ == "__main__":
    main()
