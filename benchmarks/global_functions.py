"""AIGO and its peers on the test functions of the literature, at equal time on one core.

    python -m benchmarks.global_functions [--seeds 3] [--factor 1] [--only Rastrigin]
        [--univariate 200] [--aigo-seed 0] [--workers 1] [--minutes 9] [--out DIR]

Ours is timed first, from the program to the answer; each peer then gets as many seconds, times
`--factor`. Two measures of "solved":

    by range     f − f* ≤ 1e-6 (max f over the box − f*)
    by value     f − f* ≤ 1e-6 max(1, |f*|)

The range over the box is the largest of 10,000 seeded samples and (random) corners. It is up to
1e28: then the first measure says next to nothing, and only the second one tells solvers apart.

Also 1,000 random polynomials of one variable, `--univariate` of each degree 4 to 12, ours alone.
Writes global_functions.csv, global_functions.png and univariate.csv.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from functools import cache, partial

import numpy as np

from benchmarks.collections.global_functions import global_problems, random_univariate
from benchmarks.collections.known_optimum import GlobalProblem
from benchmarks.figures import draw_shares
from benchmarks.peers import (
    OUR_NAMES,
    OURS,
    PEER_FLAGS,
    PEERS,
    Record,
    Target,
    collect,
    run_all,
    run_ours_only,
    warm_up,
)
from benchmarks.script import machine, read_flags, run_as

TOLERANCE = 1e-6
SAMPLES = 10_000
DEGREES = (4, 6, 8, 10, 12)
BATCH = 25  # polynomials of a job
BY_RANGE = "solved by range: f − f* ≤ 1e-6 (max f − f*)"
BY_VALUE = "solved by value: f − f* ≤ 1e-6 max(1, |f*|)"
MEASURES = (BY_RANGE, BY_VALUE)


def main() -> None:
    arguments = read_flags(
        __doc__,
        seeds=(3, "runs of each peer"),
        only=("", "functions whose name has this in it"),
        univariate=(200, "polynomials a degree"),
        **PEER_FLAGS,
    )
    print(machine())
    if arguments.univariate and not arguments.only:
        summarise_univariate(univariate(arguments.univariate, arguments))
    if records := functions(arguments):
        summarise(records)
        shares = {measure: all_shares(records, measure) for measure in MEASURES}
        draw_shares(shares, arguments.out / "global_functions.png")


def functions(arguments: argparse.Namespace) -> list[Record]:
    """Runs all test functions."""
    names = [name for name in problems_by_name() if arguments.only in name]
    work = partial(
        run, seeds=arguments.seeds, factor=arguments.factor, aigo_seed=arguments.aigo_seed
    )
    return collect(work, names, effort, tell, "global_functions.csv", arguments)


@cache
def problems_by_name() -> dict[str, GlobalProblem]:
    return {problem.name: problem for problem in global_problems()}


def effort(name: str) -> float:
    """What a function takes, roughly: its summands' variables."""
    return sum(part.variables.size for part in problems_by_name()[name].parts)


def run(name: str, *, seeds: int, factor: float, aigo_seed: int) -> list[Record]:
    """Runs ours and its peers on one function."""
    warm_up()
    problem = problems_by_name()[name]
    return run_all(Target(problem), value_range(problem), range(seeds), factor, aigo_seed)


def value_range(problem: GlobalProblem) -> float:
    """Returns max f − f* over samples and corners."""
    rng = np.random.default_rng(0)
    n = problem.num_variables
    points = rng.uniform(problem.lower, problem.upper, (SAMPLES if n <= 100 else SAMPLES // 10, n))
    corners = np.where(rng.random((2 ** min(n, 10), n)) < 0.5, problem.lower, problem.upper)
    return float(max(np.max(problem.evaluate(x)) for x in (points, corners)) - problem.minimum)


def is_solved(record: Record, measure: str) -> bool:
    size = record.range if measure == BY_RANGE else max(1.0, abs(record.minimum))
    return record.cost - record.minimum <= TOLERANCE * size


def share(records: Sequence[Record], name: str, measure: str) -> float:
    """The part of a solver's runs in which it solves its function."""
    return float(np.mean([is_solved(r, measure) for r in records if r.solver == name]))


def tell(runs: Sequence[Record]) -> None:
    """Prints a line for a function: ours, and in how many of its runs each peer solves it."""
    name = runs[0].problem
    for ours in (run for run in runs if run.solver in OUR_NAMES):
        marks = "".join("+" if is_solved(ours, measure) else "-" for measure in MEASURES)
        gap = ours.cost - ours.minimum
        print(f"{name:28}{ours.solver:20}{marks}  {ours.seconds:7.3f} s  f − f* = {gap:.1e}")
    took_part = {run.solver for run in runs}
    solved = [f"{peer} {share(runs, peer, BY_VALUE):.0%}" for peer in PEERS if peer in took_part]
    print(f"[{time.strftime('%H:%M:%S')}]{'':18}{', '.join(solved)}", flush=True)


def all_shares(records: Sequence[Record], measure: str) -> dict[str, float]:
    """The part of all functions that a solver solves: those that it is left out of, it doesn't."""
    total = len({record.problem for record in records})
    shares = {}
    for name in (*OUR_NAMES, *PEERS):
        if runs := [record for record in records if record.solver == name]:
            seeds = len({record.seed for record in runs})
            shares[name] = sum(is_solved(run, measure) for run in runs) / (total * seeds)
    return shares


def summarise(records: Sequence[Record]) -> None:
    """Prints how many functions each solver solves, verdicts, and what ours does not solve."""
    print(f"{'':26}functions  by range  by value  slowest")
    for name in (*OUR_NAMES, *PEERS):
        if runs := [record for record in records if record.solver == name]:
            shares = "".join(f"{share(runs, name, measure):10.1%}" for measure in MEASURES)
            slowest = max(record.seconds for record in runs)
            print(f"{name:26}{len({r.problem for r in runs}):9}{shares}{slowest:7.2f} s")
    for measure in MEASURES:
        better = more_solved(records, measure)
        print(f"{measure}: no peer solves more: {'NO: ' + ', '.join(better) if better else 'yes'}")
        left = [r.problem for r in records if r.solver == OURS and not is_solved(r, measure)]
        print(f"  unsolved by ours: {', '.join(left) or 'none'}")


def more_solved(records: Sequence[Record], measure: str) -> list[str]:
    """Peers that solve more than ours does, of the functions that they take part in."""
    better = []
    for name in PEERS:
        if runs := [record for record in records if record.solver == name]:
            taken = {run.problem for run in runs}
            ours = share([r for r in records if r.problem in taken], OURS, measure)
            theirs = share(runs, name, measure)
            if theirs > ours:
                better.append(f"{name} {theirs:.1%}, ours {ours:.1%} of the same {len(taken)}")
    return better


def univariate(count: int, arguments: argparse.Namespace) -> list[Record]:
    """Runs this many random polynomials of each degree, ours alone."""
    jobs = [
        (degree, range(first, min(first + BATCH, count)))
        for degree in DEGREES
        for first in range(0, count, BATCH)
    ]
    work = partial(run_univariate, aigo_seed=arguments.aigo_seed)
    return collect(work, jobs, lambda job: job[0], tell_batch, "univariate.csv", arguments)


def run_univariate(job: tuple[int, range], *, aigo_seed: int) -> list[Record]:
    """Runs ours on the polynomials of a degree and some seeds."""
    warm_up()
    degree, seeds = job
    return [
        record
        for seed in seeds
        for record in run_ours_only(
            Target(random_univariate(degree, seed), is_compiled=False), 1.0, aigo_seed
        )
    ]


def tell_batch(runs: Sequence[Record]) -> None:
    """Prints a line for a batch."""
    print(
        f"[{time.strftime('%H:%M:%S')}] from {runs[0].problem:32} ours "
        f"{share(runs, OURS, BY_RANGE):7.1%}",
        flush=True,
    )


def summarise_univariate(records: Sequence[Record]) -> None:
    """Prints how many polynomials of each degree, and of all, are solved."""
    degrees = [f"degree={degree} " for degree in DEGREES]
    for name in OUR_NAMES:
        for degree in (*degrees, "univariate"):
            runs = [r for r in records if r.solver == name and degree in r.problem]
            solved = sum(is_solved(run, BY_RANGE) for run in runs)
            seconds = [1e3 * run.seconds for run in runs]
            print(
                f"{name:20} {degree:11}{solved:5} of {len(runs)}  {np.mean(seconds):6.1f} ms each, "
                f"at most {max(seconds):.1f}"
            )
    print()


if __name__ == "__main__":
    run_as("benchmarks.global_functions")
