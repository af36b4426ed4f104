"""Programs that are proven in a few seconds of one thread: ours, SCIP's and Gurobi's.

    python -m benchmarks.provers [--without-rows] [--seconds 4] [--most 24] [--only HS]
        [--workers 1] [--minutes 9] [--keep FILE]

All of `constrained_problems()` with up to 24 variables, a rule that was fixed before the first run;
without rows all such of `global_problems()`. Proven is a gap of 1e-6, relative to max(1, |cost|),
within the seconds of the processor, search for the answer included; wall time counts for nothing. A
claim is wrong if a bound is above the known optimum by more than 1e-6. Gurobi runs where it is
installed, with the free licence that comes along; what is too large for that is not proven.
"""

from __future__ import annotations

import importlib
import importlib.util
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from pydrake.solvers import MathematicalProgram

from benchmarks.collections.constrained_programs import constrained_problems
from benchmarks.collections.global_functions import global_problems
from benchmarks.collections.known_optimum import ConstrainedProblem, GlobalProblem
from benchmarks.script import machine, read_flags, run_as, run_jobs
from drake_aigto.certify import Operation, certify, read_formulas, write_sum
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.solver import AigoOptions, AigoSolver

PROVEN = 1e-6
_LATE = 1.1  # of the seconds: what ends by then counts
QUICK, SLOW = 0.1, 1.0  # [s]: what all peers prove in the first should take us no more
_LARGEST = 20  # variables of the programs that warm up
_WARM_UP = AigoOptions(certify=True, cells=1000, rounds=1, starts=1)

Problem = ConstrainedProblem | GlobalProblem
Prover = Callable[[MathematicalProgram, float], tuple[float, float]]


@dataclass(frozen=True)
class Outcome:
    """What came of one program with one prover.

    Attributes:
        gap: (cost − bound) / max(1, |cost|); inf where one is missing.
        seconds: of the processor.
        is_proven: in time.
        is_wrong: whether the bound is above the known optimum.
    """

    gap: float
    seconds: float
    is_proven: bool
    is_wrong: bool


def main() -> None:
    arguments = read_flags(
        __doc__,
        without_rows=(False, "functions over boxes, in place of programs with rows"),
        only=("", "programs whose name has this in it"),
        seconds=(4.0, "of the processor, for each program"),
        most=(24, "variables"),
    )
    print(machine(), flush=True)
    collection = problems(arguments.without_rows)
    chosen = [each for each in collection.values() if each.num_variables <= arguments.most]
    names = [each.name for each in chosen if arguments.only in each.name]
    work = partial(run, is_free=arguments.without_rows, seconds=arguments.seconds)
    found: dict[str, dict[str, Outcome]] = {}
    for number, future in run_jobs(work, names, arguments):
        found[names[number]] = future.result()
        tell(collection[names[number]], future.result())
    for prover in next(iter(found.values()), {}):
        own = [outcomes[prover] for outcomes in found.values()]
        print(
            f"{prover}: {sum(each.is_proven for each in own)} of {len(own)} proven, "
            f"{sum(each.seconds for each in own):.0f} CPU s in all, "
            f"bounds above the optimum {sum(each.is_wrong for each in own)}"
        )
    late = ", ".join(name for name, outcomes in found.items() if is_late(outcomes))
    print(f"proven by all peers in {QUICK:g} s, by us in more than {SLOW:g}: {late or 'none'}")


def tell(problem: Problem, outcomes: dict[str, Outcome]) -> None:
    """Prints a line for a program."""
    line = f"{problem.name:24} n = {problem.num_variables:2}"
    for prover, own in outcomes.items():
        told = "proven" if own.is_proven else f"{own.gap:6.0e}"
        line += f"  {prover} {told}{'!' * own.is_wrong} {own.seconds:5.2f} s"
    print(line, flush=True)


def is_late(outcomes: dict[str, Outcome]) -> bool:
    """Whether all peers are quick where we are slow."""
    ours, *peers = outcomes.values()
    is_easy = all(each.is_proven and each.seconds <= QUICK for each in peers)
    return is_easy and not (ours.is_proven and ours.seconds <= SLOW)


@cache
def problems(is_free: bool) -> dict[str, Problem]:
    every = global_problems() if is_free else constrained_problems()
    return {each.name: each for each in every}


@cache
def warm_up(is_free: bool) -> None:
    """Has all machine code compiled or loaded in this process, before anything is timed."""
    for problem in {each.num_variables: each for each in problems(is_free).values()}.values():
        if problem.num_variables <= _LARGEST:
            AigoSolver(_WARM_UP).Solve(problem.prog())


def run(name: str, *, is_free: bool, seconds: float) -> dict[str, Outcome]:
    """Runs all provers on a program."""
    problem = problems(is_free)[name]
    warm_up(is_free)
    provers: dict[str, Prover] = {"ours": ours, "SCIP": scip}
    if importlib.util.find_spec("gurobipy"):
        provers["Gurobi"] = gurobi
    return {each: judge(problem, provers[each], seconds) for each in provers}


def judge(problem: Problem, prover: Prover, most: float) -> Outcome:
    """Runs a prover for as many seconds of the processor."""
    prog, start = problem.prog(), time.process_time()
    try:
        cost, bound = prover(prog, _LATE * most)
    except (UnsupportedTermError, KeyboardInterrupt):  # A function that it lacks; between steps.
        cost, bound = np.inf, -np.inf
    seconds = time.process_time() - start
    gap = (cost - bound) / max(1.0, abs(cost)) if np.isfinite(cost + bound) else np.inf
    return Outcome(
        gap=gap,
        seconds=seconds,
        is_proven=gap <= 1.01 * PROVEN and seconds <= _LATE * most,
        is_wrong=bound > problem.minimum + PROVEN * max(1.0, abs(problem.minimum)),
    )


def ours(prog: MathematicalProgram, seconds: float) -> tuple[float, float]:
    """Ends as by Ctrl-C once the processor's time is up, which keeps the bound so far."""

    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        result = AigoSolver(AigoOptions(certify=True)).Solve(prog)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    details = result.get_solver_details()
    is_feasible = details.violation <= 1e-6
    return (result.get_optimal_cost() if is_feasible else np.inf), details.lower_bound


def scip(prog: MathematicalProgram, seconds: float) -> tuple[float, float]:
    found = certify(prog, prover="scip", seconds=seconds / _LATE, gap=PROVEN)
    return found.best_cost, found.lower_bound


def gurobi(prog: MathematicalProgram, seconds: float) -> tuple[float, float]:
    """Writes functions as Gurobi's nonlinear constraints, and asks the clock of the processor."""
    gurobipy: Any = importlib.import_module("gurobipy")
    formulas, nl, end = read_formulas(prog), gurobipy.nlfunc, time.process_time() + seconds
    functions = {
        Operation.EXP: nl.exp,
        Operation.LOG: nl.log,
        Operation.SIN: nl.sin,
        Operation.COS: nl.cos,
        Operation.TANH: nl.tanh,
    }
    with gurobipy.Env(params={"OutputFlag": 0}) as env, gurobipy.Model(env=env) as model:
        sides = zip(formulas.lower, formulas.upper, strict=True)
        x = [model.addVar(lb=low, ub=high) for low, high in sides]
        cost = model.addVar(lb=-np.inf)
        model.addConstr(cost == write_sum(formulas.summands, x, functions))
        for row in formulas.rows:
            own = model.addVar(lb=row.lower, ub=row.upper)
            model.addConstr(own == write_sum((row,), x, functions))
        model.setObjective(cost)
        model.setParam("Threads", 1)
        model.setParam("MIPGap", 0.5 * PROVEN)
        try:
            model.optimize(lambda own, _: own.terminate() if time.process_time() > end else None)
        except gurobipy.GurobiError:  # The free licence is limited in size.
            return np.inf, -np.inf
        cost, bound = (model.ObjVal if model.SolCount else np.inf), model.ObjBound
    return cost, bound


if __name__ == "__main__":
    run_as("benchmarks.provers")
