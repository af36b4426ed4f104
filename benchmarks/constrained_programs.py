"""AIGO on constrained programs whose global optimum is known, and multistart SNOPT beside it.

    python -m benchmarks.constrained_programs [--only HS] [--moves 201 202] [--factor 1]
        [--aigo-seed 0] [--workers 1] [--minutes 9] [--out DIR]

With `--moves`, programs are rewritten by seeds: in another order of variables, some of them
mirrored, all shifted, with bounds cut, so that none is the program that anything was tuned on.
Global: constraints and bounds hold to 1e-6, and f − f* ≤ 1e-5 max(1, |f*|); what is refused is not.
A success that is not feasible to 1e-6 is counted apart: there must be none. SNOPT starts from
random points of the box for as many seconds as ours took, times `--factor`. Writes
constrained_programs.csv, in which inf is no feasible answer, and nan an infeasible one that was
called a success.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import cache, partial
from typing import Any

import numpy as np
from pydrake.solvers import SnoptSolver

from benchmarks.collections.constrained_programs import constrained_problems
from benchmarks.collections.known_optimum import ConstrainedProblem
from benchmarks.peers import OURS, PEER_FLAGS, Record, collect, make_record, time_solve
from benchmarks.script import machine, read_flags, run_as, within
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.solver import AigoOptions

FEASIBLE = 1e-6
GLOBAL = 1e-5
PEER = "SNOPT, multistart"
MOVED = " moved by "
CUT = 0.8  # of the way to a minimizer, that a bound is moved by at most
FARTHEST = 10.0  # from a minimizer, of a variable without bounds
WARM_UPS = ("HS 43", "planted n=5 seed=0")


def main() -> None:
    arguments = read_flags(
        __doc__,
        only=("", "programs whose name has this in it"),
        moves=((0,), "seeds by which programs are rewritten; 0: as they are"),
        **PEER_FLAGS,
    )
    names = [name for name in problems_by_name() if arguments.only in name]
    names = [f"{name}{MOVED}{seed}" if seed else name for seed in arguments.moves for name in names]
    work = partial(run, factor=arguments.factor, aigo_seed=arguments.aigo_seed)
    summarise(collect(work, names, effort, tell, "constrained_programs.csv", arguments))


@cache
def problems_by_name() -> dict[str, ConstrainedProblem]:
    return {problem.name: problem for problem in constrained_problems()}


def find_problem(name: str) -> ConstrainedProblem:
    own, _, seed = name.partition(MOVED)
    return move(problems_by_name()[own], int(seed)) if seed else problems_by_name()[own]


def move(problem: ConstrainedProblem, seed: int) -> ConstrainedProblem:
    """Returns a program in z, x_i = s_i (z_p(i) − t_i), with bounds cut towards a minimizer."""
    rng = np.random.default_rng([seed, *problem.name.encode()])
    n = problem.num_variables
    order, signs, cut = rng.permutation(n), rng.choice([-1.0, 1.0], n), CUT * rng.random((2, n))
    shifts = rng.uniform(-1.0, 1.0, n)
    best = rng.choice(problem.minimizers)
    lower = np.where(np.isfinite(problem.lower), problem.lower, best - FARTHEST)
    upper = np.where(np.isfinite(problem.upper), problem.upper, best + FARTHEST)
    lower, upper = lower + cut[0] * (best - lower), upper + cut[1] * (best - upper)

    def back(z: Any) -> list[Any]:
        return [s * (z[p] - t) for s, p, t in zip(signs, order, shifts, strict=True)]

    def ahead(x: Any) -> Any:
        z = np.empty(n)
        z[order] = signs * x + shifts
        return z

    ends = ahead(lower), ahead(upper)
    return ConstrainedProblem(
        f"{problem.name}{MOVED}{seed}",
        (np.minimum(*ends), np.maximum(*ends)),
        problem.minimum,
        ahead(best),
        lambda *z: problem.summands(back(z)),
        equalities=lambda *z: problem.equalities(*back(z)),
        inequalities=lambda *z: problem.inequalities(*back(z)),
        source=problem.source,
    )


def effort(name: str) -> int:
    return find_problem(name).num_variables


@cache
def warm_up() -> None:
    """Has Numba compile, and SNOPT load, before anything is timed in this process."""
    for name in WARM_UPS:
        problem = problems_by_name()[name]
        run_ours(problem, 0)
        run_snopt(problem, 0.0)


def run(name: str, *, factor: float, aigo_seed: int) -> list[Record]:
    """Runs ours, and then SNOPT."""
    warm_up()
    problem = find_problem(name)
    ours = run_ours(problem, aigo_seed)
    return [ours, run_snopt(problem, factor * ours.seconds)]


def tell(runs: Sequence[Record]) -> None:
    """Prints a line for a program."""
    ours, peer = runs
    words = ["global" if is_global(run) else f"{run.cost:.6g}" for run in runs]
    print(
        f"[{time.strftime('%H:%M:%S')}] {ours.problem:24} f* = {ours.minimum:12.6g}  "
        f"ours {words[0]:12}{ours.seconds:7.2f} s{' INFEASIBLE SUCCESS' * is_broken(ours)}  "
        f"{peer.solver} {words[1]}",
        flush=True,
    )


def summarise(records: Sequence[Record]) -> None:
    """Prints how many programs each solver solves, and which ours does not."""
    print(machine())
    for name in (OURS, PEER):
        runs = [record for record in records if record.solver == name]
        if runs:
            count = sum(map(is_global, runs))
            slowest = max(run.seconds for run in runs)
            print(
                f"{name:20} global {count} of {len(runs)}, {count / len(runs):.1%}, "
                f"slowest {slowest:.2f} s"
            )
    ours = [record for record in records if record.solver == OURS]
    print(f"not global: {', '.join(r.problem for r in ours if not is_global(r)) or 'none'}")
    print(f"successes of ours that are infeasible: {sum(map(is_broken, ours))}")


def is_global(record: Record) -> bool:
    return record.cost - record.minimum <= GLOBAL * max(1.0, abs(record.minimum))


def is_broken(record: Record) -> bool:
    """Whether what was called a success is not feasible."""
    return bool(np.isnan(record.cost))


def run_ours(problem: ConstrainedProblem, aigo_seed: int) -> Record:
    try:
        result, seconds = time_solve(problem.prog(), AigoOptions(seed=aigo_seed))
    except UnsupportedTermError:  # Refused: multiplied out, it has too many terms.
        return make_record(problem, 1.0, OURS, aigo_seed, 0.0, np.inf)
    cost = cost_or(problem, result.get_x_val(), np.nan) if result.is_success() else np.inf
    return make_record(problem, 1.0, OURS, aigo_seed, seconds, cost)


def cost_or(problem: ConstrainedProblem, x: np.ndarray, infeasible: float) -> float:
    """The cost, if x is feasible and finite."""
    if not np.all(np.isfinite(x)) or problem.violation(x) > FEASIBLE:
        return infeasible
    return float(problem.evaluate(x))


def run_snopt(problem: ConstrainedProblem, seconds: float) -> Record:
    """Returns the best feasible answer of the starts that end in time, of one at least."""
    prog, rng, best = problem.prog(), np.random.default_rng(0), np.inf
    for _ in within(seconds):
        start = rng.uniform(problem.lower, problem.upper)
        found = SnoptSolver().Solve(prog, start, None)
        best = min(best, cost_or(problem, found.get_x_val(), np.inf))
    return make_record(problem, 1.0, PEER, 0, seconds, best)


if __name__ == "__main__":
    run_as("benchmarks.constrained_programs")
