"""AIGO and its peers on AIGO's own benchmark, against the exact optimum.

    python -m benchmarks.chain [--sizes 2 10 26 50 82 122 170] [--functions 10] [--large 1000 10000]
        [--first-seed 0] [--patience 0] [--factor 1] [--aigo-seed 0] [--workers 1] [--minutes 9]
        [--out DIR]

Ours is timed first, from the program to the answer; each peer then gets as many seconds on the same
core, times `--factor`. gap = (f − f*) / |f*|, f* by dynamic programming; the paper's score is
(f − mean) / (mean − min) of f at 1,000 random points, so lower is better, and depends on them.

With `--patience`: the seconds that dual_annealing with gradients needs to ours' value, tried for up
to that many times ours' seconds. `--large` sizes are for ours alone, three functions at most.
Writes chain.csv and chain.png.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path

import numpy as np

from benchmarks.collections.chain import REACH, chain_problem
from benchmarks.figures import draw_gaps
from benchmarks.peers import (
    OUR_NAMES,
    OURS,
    PEER_FLAGS,
    PEERS,
    Record,
    Target,
    collect,
    make_record,
    run_all,
    run_ours_only,
    seconds_to_reach,
    warm_up,
)
from benchmarks.script import machine, read_flags, run_as

SIZES = (2, 10, 26, 50, 82, 122, 170)
LARGE = (1000, 10000)
LARGE_FUNCTIONS = 3
SAMPLES = 1000
CHASER = "dual_annealing"
CHASE = f"{CHASER}, to ours' value"
SAME = 1e-6  # gaps that differ by less are the same

Job = tuple[int, int]  # n, seed of the function


def main() -> None:
    arguments = read_flags(
        __doc__,
        sizes=(SIZES, ""),
        large=(LARGE, ""),
        functions=(10, "of each size"),
        first_seed=(0, "of the functions"),
        patience=(0.0, "as said above; 0: don't"),
        **PEER_FLAGS,
    )
    seeds = [arguments.first_seed + i for i in range(arguments.functions)]
    jobs = [(n, seed) for n in arguments.sizes for seed in seeds]
    jobs += [(n, seed) for n in arguments.large for seed in seeds[:LARGE_FUNCTIONS]]
    work = partial(
        run,
        large=frozenset(arguments.large),
        factor=arguments.factor,
        patience=arguments.patience,
        aigo_seed=arguments.aigo_seed,
    )
    records = collect(work, jobs, lambda job: job[0], tell, "chain.csv", arguments)
    print(machine())
    for n in sorted({record.variables for record in records}):
        summarise(n, [record for record in records if record.variables == n])
    draw(records, arguments.out / "chain.png")


def run(
    job: Job, *, large: frozenset[int], factor: float, patience: float, aigo_seed: int
) -> list[Record]:
    """Runs ours, its peers, and the chase on one function."""
    warm_up()
    n, seed = job
    problem = chain_problem(n, seed).problem(f"chain n={n} function={seed}")
    if n in large:
        return run_ours_only(Target(problem, is_compiled=False), 1.0, aigo_seed)
    target = Target(problem)
    records = run_all(target, 1.0, [seed], factor, aigo_seed)
    if patience > 0:
        limit = patience * records[0].seconds
        seconds, cost = seconds_to_reach(CHASER, target, records[0].cost, limit, seed)
        records.append(make_record(problem, 1.0, CHASE, seed, seconds, cost))
    return records


def gap(record: Record) -> float:
    return (record.cost - record.minimum) / abs(record.minimum)


def tell(runs: Sequence[Record]) -> None:
    """Prints a line for a function: ours, and the best of its peers."""
    ours = runs[0]
    peers = [record for record in runs if record.solver in PEERS]
    beside = ""
    if peers:
        best = min(peers, key=gap)
        beside = f"  best peer {gap(best):8.3%} {best.solver}"
    print(
        f"[{time.strftime('%H:%M:%S')}] {ours.problem:26} ours {gap(ours):8.3%} in "
        f"{ours.seconds:7.3f} s{beside}",
        flush=True,
    )


@cache
def sample(n: int, seed: int) -> tuple[float, float]:
    """Returns mean and least value at random points."""
    points = np.random.default_rng(0).uniform(-REACH, REACH, (SAMPLES, n))
    values = chain_problem(n, seed).evaluate(points)
    return float(np.mean(values)), float(np.min(values))


def score(record: Record) -> float:
    if record.variables > max(SIZES):
        return np.nan
    mean, least = sample(record.variables, int(record.problem.rpartition("=")[2]))
    return (record.cost - mean) / (mean - least)


def summarise(n: int, records: Sequence[Record]) -> None:
    """Prints mean gap and score of each solver at a size, and verdicts."""
    gaps = {}
    for name in (*OUR_NAMES, *PEERS):
        runs = [record for record in records if record.solver == name]
        if runs:
            gaps[name] = float(np.mean([gap(run) for run in runs]))
            print(
                f"n = {n:5}  {name:24} gap {gaps[name]:8.3%} (worst {max(map(gap, runs)):8.3%})  "
                f"score {np.mean([score(run) for run in runs]):7.3f}  "
                f"{np.mean([run.seconds for run in runs]):8.3f} s"
            )
    better = [
        f"{name} {gaps[name]:.4%}" for name in PEERS if gaps.get(name, np.inf) < gaps[OURS] - SAME
    ]
    if len(gaps) > len(OUR_NAMES):
        verdict = f"NO: ours {gaps[OURS]:.4%}, {', '.join(better)}" if better else "yes"
        print(f"n = {n:5}  no worse than every peer at equal time: {verdict}")
    judge_chase(n, records)


def judge_chase(n: int, records: Sequence[Record]) -> None:
    """Prints by how much the chaser is slower; where it gives up, that is a lower bound."""
    ours = {record.problem: record for record in records if record.solver == OURS}
    chases = [record for record in records if record.solver == CHASE]
    if chases:
        ratios = [record.seconds / ours[record.problem].seconds for record in chases]
        reached = sum(record.cost <= ours[record.problem].cost for record in chases)
        print(
            f"n = {n:5}  {CHASER} reaches ours' value in {reached} of {len(chases)}; its seconds, "
            f"then or when ended, over ours: least {min(ratios):.1f}, median "
            f"{np.median(ratios):.1f}; gap then {np.mean([gap(run) for run in chases]):.3%}"
        )


def draw(records: Sequence[Record], path: Path) -> None:
    """Draws the mean gap over the size for each solver."""
    lines = {}
    for name in (*OUR_NAMES, *PEERS):
        sizes = sorted({record.variables for record in records if record.solver == name})
        gaps = [
            np.mean([gap(r) for r in records if r.solver == name and r.variables == n])
            for n in sizes
        ]
        lines[name] = (sizes, 100.0 * np.array(gaps))
    draw_gaps({name: line for name, line in lines.items() if line[0]}, path)


if __name__ == "__main__":
    run_as("benchmarks.chain")
