"""Programs with rows that are proven in a few seconds of one thread: ours, and SCIP's.

    python -m benchmarks.provers [--seconds 4] [--most 24]

All of `constrained_problems()` with up to 24 variables, a rule that was fixed before the first run.
Proven is a gap of 1e-6, relative to max(1, |cost|), within the seconds of the processor, search for
the answer included. A claim is wrong if a bound is above the known optimum by more than 1e-6.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from pydrake.solvers import MathematicalProgram

from benchmarks.collections.constrained_programs import constrained_problems
from benchmarks.script import machine, read_flags
from drake_aigto.certify import certify
from drake_aigto.solver import AigoOptions, AigoSolver

PROVEN = 1e-6


def main() -> None:
    arguments = read_flags(
        __doc__,
        workers=None,
        seconds=(4.0, "of the processor, for each program"),
        most=(24, "variables"),
    )
    print(machine(), flush=True)
    problems = [each for each in constrained_problems() if each.num_variables <= arguments.most]
    warm_up = next(each for each in problems if each.num_variables == 2)
    ours(warm_up.prog(), 10.0)
    provers = {"ours": ours, "SCIP": scip}
    proven, spent, wrong = dict.fromkeys(provers, 0), dict.fromkeys(provers, 0.0), 0
    for problem in problems:
        line = f"{problem.name:24} n = {problem.num_variables:2}"
        for name, prover in provers.items():
            start = time.process_time()
            cost, bound = within(arguments.seconds, partial(prover, problem.prog()))
            seconds = time.process_time() - start
            gap = (cost - bound) / max(1.0, abs(cost)) if np.isfinite(cost + bound) else np.inf
            is_proven = gap <= 1.01 * PROVEN and seconds <= 1.1 * arguments.seconds
            is_wrong = bound > problem.minimum + PROVEN * max(1.0, abs(problem.minimum))
            proven[name] += is_proven
            wrong += is_wrong and name == "ours"
            spent[name] += seconds
            outcome = "proven" if is_proven else f"{gap:6.0e}"
            line += f"  {name} {outcome}{'!' * is_wrong} {seconds:5.2f} s"
        print(line, flush=True)
    for name in provers:
        print(f"{name}: {proven[name]} of {len(problems)} proven, {spent[name]:.0f} CPU s in all")
    print(f"bounds of ours that were wrong: {wrong}")


def within(seconds: float, run: Callable[[float], tuple[float, float]]) -> tuple[float, float]:
    """Returns a prover's cost and bound; nothing if it takes longer."""

    def stop(*_: Any) -> None:
        raise TimeoutError

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, 1.1 * seconds)
    try:
        return run(seconds)
    except TimeoutError:
        return np.inf, -np.inf
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def ours(prog: MathematicalProgram, seconds: float) -> tuple[float, float]:
    result = AigoSolver(AigoOptions(certify=True)).Solve(prog)
    return result.get_optimal_cost(), result.get_solver_details().lower_bound


def scip(prog: MathematicalProgram, seconds: float) -> tuple[float, float]:
    found = certify(prog, prover="scip", seconds=seconds, gap=PROVEN)
    return found.best_cost, found.lower_bound


if __name__ == "__main__":
    main()
