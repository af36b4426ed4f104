"""AIGO and its peers on AIGO's own benchmark, against the exact optimum.

    python benchmarks/chain.py [--sizes 2 10 26 50 82 122 170] [--functions 10] [--large 1000 10000]

Ours is timed first, from the program to the answer; each peer then gets as many seconds on the same
core, times `--factor`. gap = (f − f*) / |f*|, f* by dynamic programming; the paper's score is
(f − mean) / (mean − min) of f at 1,000 random points, so lower is better, and depends on them.

Beside it: the seconds that dual_annealing with gradients needs to ours' value, tried for up to
`--patience` times ours' seconds. `--large` sizes are for ours alone. Writes chain.csv, chain.png.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded: one core for all

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from peers import (
    OPTIONS,
    OURS,
    PEERS,
    Record,
    Target,
    machine,
    run_all,
    run_ours,
    seconds_to_reach,
    warm_up,
    write_csv,
)

from drake_aigto.study.chain import chain_problem
from drake_aigto.study.global_problem import GlobalProblem

SIZES = (2, 10, 26, 50, 82, 122, 170)
SAMPLES = 1000
CHASER = "dual_annealing"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sizes", type=int, nargs="*", default=SIZES)
    parser.add_argument("--large", type=int, nargs="*", default=(1000, 10000))
    parser.add_argument("--functions", type=int, default=10, help="of each size")
    parser.add_argument("--factor", type=float, default=1.0, help="seconds of peers over ours")
    parser.add_argument("--patience", type=float, default=0.0, help="as said above; 0: don't")
    parser.add_argument("--out", type=Path, default=Path())
    arguments = parser.parse_args()
    warm_up()
    records: list[Record] = []
    for n in arguments.sizes:
        samples: dict[str, tuple[float, float]] = {}
        for seed in range(arguments.functions):
            problem = chain_problem(n, seed).problem(f"chain n={n} function={seed}")
            samples[problem.name] = sample(problem)
            records += run_all(problem, 1.0, [seed], arguments.factor, PEERS)
            if arguments.patience > 0:
                chase(problem, records, arguments.patience)
        tell(n, records, samples)
        write_csv(arguments.out / "chain.csv", records)  # what is done is kept
    for n in arguments.large:
        for seed in range(min(3, arguments.functions)):
            problem = chain_problem(n, seed).problem(f"chain n={n} function={seed}")
            target = Target(problem, is_compiled=False)
            for name, options in OPTIONS.items():
                seconds, cost = run_ours(target, options)
                records.append(
                    Record(problem.name, n, name, seed, seconds, cost, problem.minimum, 1.0)
                )
        tell(n, records, {})
    print(machine())
    write_csv(arguments.out / "chain.csv", records)
    draw(records, arguments.out / "chain.png")


def sample(problem: GlobalProblem) -> tuple[float, float]:
    """Returns mean and least value at random points."""
    shape = (SAMPLES, problem.num_variables)
    points = np.random.default_rng(0).uniform(problem.lower, problem.upper, shape)
    values = problem.evaluate(points)
    return float(np.mean(values)), float(np.min(values))


def gap(record: Record) -> float:
    return (record.cost - record.minimum) / abs(record.minimum)


def chase(problem: GlobalProblem, records: Sequence[Record], patience: float) -> None:
    """Prints how long the chaser takes to ours' value."""
    (ours,) = [r for r in records if r.problem == problem.name and r.solver == OURS]
    limit = patience * ours.seconds
    seconds, cost = seconds_to_reach(CHASER, Target(problem), ours.cost, limit, ours.seed)
    share = (cost - problem.minimum) / abs(problem.minimum)
    word = "reaches it after" if cost <= ours.cost else "has not reached it after"
    print(
        f"{problem.name}: ours {gap(ours):.2%} in {ours.seconds:.2f} s; {CHASER} {word} "
        f"{seconds:.2f} s, {share:.2%}",
        flush=True,
    )


def tell(n: int, records: Sequence[Record], samples: dict[str, tuple[float, float]]) -> None:
    """Prints mean gap and score of each solver at a size."""
    for name in (*OPTIONS, *PEERS):
        runs = [r for r in records if r.solver == name and r.variables == n]
        if not runs:
            continue
        scores = [
            (r.cost - mean) / (mean - least)
            for r in runs
            for mean, least in [samples.get(r.problem, (np.nan, np.nan))]
        ]
        seconds = np.mean([r.seconds for r in runs])
        gaps = [gap(r) for r in runs]
        print(
            f"n = {n:5}  {name:24} gap {np.mean(gaps):8.3%} (worst {max(gaps):8.3%})  "
            f"score {np.mean(scores):7.3f}  {seconds:8.3f} s",
            flush=True,
        )


def draw(records: Sequence[Record], path: Path) -> None:
    """Draws the mean gap over the size for each solver."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.0, 4.5), layout="constrained")
    for name in (*OPTIONS, *PEERS):
        sizes = sorted({r.variables for r in records if r.solver == name})
        gaps = [
            np.mean([gap(r) for r in records if r.solver == name and r.variables == n])
            for n in sizes
        ]
        if sizes:
            style = {"linewidth": 2.5} if name in OPTIONS else {"linewidth": 1.0}
            axes.plot(sizes, 100.0 * np.maximum(gaps, 1e-6), "o-", label=name, **style)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("variables n")
    axes.set_ylabel("mean gap to the exact optimum [%]")
    axes.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
