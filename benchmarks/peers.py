"""Other people's global optimizers, each given the same seconds and the same compiled function.

A peer that ends early starts again with the next seed, until its time is over; what counts is the
least value that it saw. None is told where the optimum is.
"""

from __future__ import annotations

import argparse
import itertools
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.solvers import IpoptSolver, MathematicalProgram, SnoptSolver, SolverOptions
from scipy.optimize import differential_evolution, direct, dual_annealing, minimize, shgo

from benchmarks.collections.chain import chain_problem
from benchmarks.collections.global_functions import planar_problems
from benchmarks.collections.known_optimum import GlobalProblem, KnownOptimum
from benchmarks.collections.scalable_functions import rastrigin
from benchmarks.compiled import compile_function
from benchmarks.script import run_jobs, write_csv
from drake_aigto.local import InteriorPoint, compile_nlp
from drake_aigto.solver import AigoOptions, AigoSolver

try:
    import cma
except ModuleNotFoundError:
    cma = None

LARGEST_SHGO = 10  # its first simplices have 2ⁿ corners
LARGEST_DIRECT = 50  # from here on it spends its time before the first report
LARGEST_FULL_CMA = 200  # above, only the diagonal of the covariance
POLISH_STEPS = 100  # of a start of our polish: it converges in 20, or not at all
OURS = "AIGO"
ALONE = "AIGO, boxes alone"
OUR_NAMES = (OURS, ALONE)


@dataclass(frozen=True)
class Record:
    """One run: a line of the CSV file."""

    problem: str
    variables: int
    solver: str
    seed: int
    seconds: float
    cost: float
    minimum: float
    range: float


class TimeIsUpError(Exception):
    """Ends a peer from within the function that it minimises."""


class Target:
    """A function that keeps the best value seen, and ends its minimizer when time is up."""

    def __init__(self, problem: GlobalProblem, is_compiled: bool = True) -> None:
        """Compiles the function, unless it is for a solver that doesn't call it."""
        self.problem = problem
        self.lower, self.upper = problem.lower, problem.upper
        self.bounds = list(zip(problem.lower.tolist(), problem.upper.tolist(), strict=True))
        self.prog = problem.prog()
        if is_compiled:
            self.nlp = compile_nlp(self.prog)
            self._values, self._gradients = compile_function(problem)
        else:
            self._values = problem.evaluate
        self.start(0.0)

    def start(self, seconds: float, enough: float = -np.inf) -> None:
        """Forgets what was seen; time runs from now, and ends at a value that is enough too."""
        self.best = np.inf
        self.enough = enough
        self.deadline = time.process_time() + seconds

    def value(self, x: np.ndarray) -> float:
        """f(x)."""
        return self._seen(self._values(x))

    def value_and_gradient(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """f(x), ∇f(x)."""
        value, slope = self._gradients(x)
        return self._seen(value), slope

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """∇f(x)."""
        return self.value_and_gradient(x)[1]

    def found(self, x: np.ndarray) -> None:
        """Takes the answer of a solver that doesn't call this function."""
        if np.all(np.isfinite(x)):
            self.value(np.clip(x, self.lower, self.upper))

    def _seen(self, value: float) -> float:
        if time.process_time() > self.deadline:
            raise TimeIsUpError
        self.best = min(self.best, value)
        if value <= self.enough:
            raise TimeIsUpError
        return value


def dual_annealing_with_gradients(target: Target, seed: int) -> None:
    local = {"method": "L-BFGS-B", "jac": target.gradient, "bounds": target.bounds}
    dual_annealing(target.value, target.bounds, maxiter=10**7, minimizer_kwargs=local, seed=seed)


def evolution(target: Target, seed: int) -> None:
    differential_evolution(target.value, target.bounds, maxiter=10**6, seed=seed)


def dividing_rectangles(target: Target, seed: int) -> None:
    del seed  # the first run goes on until time is up: direct draws nothing
    direct(target.value, target.bounds, maxfun=10**6, maxiter=10**6, vol_tol=0.0, len_tol=0.0)
    raise TimeIsUpError


def simplicial_homology(target: Target, seed: int) -> None:
    local = {"method": "L-BFGS-B", "jac": target.gradient, "bounds": target.bounds}
    # Simplicial: Sobol's points go through Qhull, which takes minutes in ten dimensions.
    shgo(target.value, target.bounds, iters=1 + seed % 1000, minimizer_kwargs=local)


def covariance_adaptation(target: Target, seed: int) -> None:
    center, width = (target.lower + target.upper) / 2.0, target.upper - target.lower
    start = np.random.default_rng(seed).uniform(-0.5, 0.5, center.size)
    options = {
        "bounds": [-0.5, 0.5],
        "seed": seed + 1,
        "verbose": -9,
        "CMA_diagonal": center.size > LARGEST_FULL_CMA,
    }
    cma.fmin2(
        lambda y: target.value(center + width * y), start, 0.25, options, restarts=9, bipop=True
    )


def multistart_lbfgs(target: Target, seed: int) -> None:
    start = np.random.default_rng(seed).uniform(target.lower, target.upper)
    minimize(target.value_and_gradient, start, jac=True, method="L-BFGS-B", bounds=target.bounds)


def multistart_drake(solver: Any, target: Target, seed: int) -> None:
    start = np.random.default_rng(seed).uniform(target.lower, target.upper)
    options = SolverOptions()  # SNOPT has no such limit, but ends soon by itself
    left = max(1e-3, target.deadline - time.process_time())
    options.SetOption(IpoptSolver.id(), "max_cpu_time", left)
    target.found(solver.Solve(target.prog, start, options).get_x_val())


def multistart_polish(target: Target, seed: int) -> None:
    start = np.random.default_rng(seed).uniform(target.lower, target.upper)
    target.found(InteriorPoint(max_iterations=POLISH_STEPS).solve(target.nlp, start).x)


PEERS: dict[str, Callable[[Target, int], None]] = {
    "dual_annealing": dual_annealing_with_gradients,
    "differential_evolution": evolution,
    "direct": dividing_rectangles,
    "shgo": simplicial_homology,
    "CMA-ES": covariance_adaptation,
    "L-BFGS-B, multistart": multistart_lbfgs,
    "SNOPT, multistart": lambda target, seed: multistart_drake(SnoptSolver(), target, seed),
    "IPOPT, multistart": lambda target, seed: multistart_drake(IpoptSolver(), target, seed),
    "our polish, multistart": multistart_polish,
}


def is_left_out(name: str, num_variables: int) -> bool:
    """Whether a peer is not installed, or does not come to its first report in that many."""
    return (
        (name == "CMA-ES" and cma is None)
        or (name == "shgo" and num_variables > LARGEST_SHGO)
        or (name == "direct" and num_variables > LARGEST_DIRECT)
    )


def time_solve(prog: MathematicalProgram, options: AigoOptions) -> tuple[Any, float]:
    """Returns AIGO's result, and seconds of the processor from the program to the answer."""
    begin = time.process_time()
    result = AigoSolver(options).Solve(prog)
    return result, time.process_time() - begin


def run_ours(target: Target, options: AigoOptions) -> tuple[float, float]:
    """Returns what AIGO costs and finds: seconds from the program to the answer, and f there."""
    result, seconds = time_solve(target.prog, options)
    target.start(np.inf)
    target.found(result.get_x_val())
    return seconds, target.best


def run_peer(
    name: str, target: Target, seconds: float, seed: int, enough: float = -np.inf
) -> float:
    """Returns the least value that a peer sees in these seconds; infinite if it sees none."""
    target.start(seconds, enough)
    try:
        for restart in itertools.count():
            if time.process_time() > target.deadline:
                break
            PEERS[name](target, 1000 * seed + restart)
    except TimeIsUpError:
        pass
    return target.best


def seconds_to_reach(
    name: str, target: Target, cost: float, limit: float, seed: int
) -> tuple[float, float]:
    """Returns a peer's seconds to this cost, or the limit, and the least value that it saw."""
    begin = time.process_time()
    best = run_peer(name, target, limit, seed, enough=cost)
    return time.process_time() - begin, best


def our_options(seed: int) -> dict[str, AigoOptions]:
    """The default, and what boxes do without polish and restarts."""
    return {OURS: AigoOptions(seed=seed), ALONE: AigoOptions(polish="none", rounds=0, seed=seed)}


def run_all(
    target: Target, size: float, seeds: Iterable[int], factor: float, aigo_seed: int
) -> list[Record]:
    """Runs ours, and then each peer for `factor` times the seconds that ours took."""
    records = run_ours_only(target, size, aigo_seed)
    seconds = factor * records[0].seconds
    for name in PEERS:
        if not is_left_out(name, target.problem.num_variables):
            records += [
                make_record(
                    target.problem, size, name, seed, seconds, run_peer(name, target, seconds, seed)
                )
                for seed in seeds
            ]
    return records


def run_ours_only(target: Target, size: float, aigo_seed: int) -> list[Record]:
    """Runs ours: the default comes first."""
    return [
        make_record(target.problem, size, name, aigo_seed, *run_ours(target, options))
        for name, options in our_options(aigo_seed).items()
    ]


def make_record(
    problem: KnownOptimum, size: float, solver: str, seed: int, seconds: float, cost: float
) -> Record:
    n = problem.num_variables
    return Record(problem.name, n, solver, seed, seconds, cost, problem.minimum, size)


@cache
def warm_up() -> None:
    """Has Numba compile, and libraries load, before anything is timed in this process."""
    for problem in (chain_problem(26, 0).problem(), rastrigin(2), planar_problems()[0]):
        target = Target(problem)
        for options in our_options(0).values():
            run_ours(target, options)
    for name in PEERS:
        if not is_left_out(name, target.problem.num_variables):
            run_peer(name, target, 0.2, 0)


# Flags of all scripts that write records (`read_flags`).
PEER_FLAGS: dict[str, Any] = {
    "factor": (1.0, "seconds of peers over ours"),
    "aigo_seed": (0, "of AIGO's own random choices"),
    "out": (Path(), "folder of CSV file and figure"),
}


def collect(
    work: Callable[[Any], list[Record]],
    jobs: Sequence[Any],
    effort: Callable[[Any], float],
    tell: Callable[[list[Record]], None],
    name: str,
    arguments: argparse.Namespace,
) -> list[Record]:
    """Runs jobs, those of most effort first, and returns all records, in the order of the jobs.

    Tells what a job records as it ends, and keeps all that is done in a CSV file.
    """
    path = arguments.out / name
    scheduler, workers = arguments.scheduler, arguments.workers
    where = f"on workers of {scheduler}" if scheduler else f"{workers} runs at once"
    records: list[Record] = []
    order = sorted(range(len(jobs)), key=lambda number: -effort(jobs[number]))
    done: dict[int, list[Record]] = {}
    in_order = [jobs[number] for number in order]
    for number, future in run_jobs(work, in_order, arguments):
        if error := future.exception():
            print(f"FAILED {in_order[number]}: {''.join(traceback.format_exception(error))}")
            continue
        done[order[number]] = future.result()
        records = [record for place in sorted(done) for record in done[place]]
        write_csv(path, records, f"{where}, a core each")
        tell(future.result())
    print(f"{name}: {len(done)} of {len(jobs)} jobs done\n", flush=True)
    return records
