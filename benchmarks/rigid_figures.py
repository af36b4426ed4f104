"""Rigid plans of Table I's problems against exact optima, and how long a plan takes.

    python -m benchmarks.rigid_figures

For e = 1, 0.8 and 0.5: the plan's control, replayed event-driven and in Drake, against the exact
optimum in continuous time (`optima.rigid_optimum`, which the planner does not know). Then seconds:
of a plan in a running process, and of ``drake-aigto plan table1/1`` with cached kernels and
without. Exits with 1 if a figure is missed.
"""

from __future__ import annotations

import dataclasses
import os
import statistics
import subprocess
import sys
import tempfile
import time

from benchmarks.script import COMMAND
from drake_aigto.contact import contact_delay
from drake_aigto.paper import ROWS, rigid_optimum
from drake_aigto.planning import Planner
from drake_aigto.world import Scenario

RESTITUTIONS = (1.0, 0.8, 0.5)
RELATIVE = 0.01  # event-driven
NEARLY_NOTHING = 1e-6  # where the optimum is 0
DRAKE_RELATIVE, DRAKE_ABSOLUTE = 0.02, 1e-5
SECONDS_A_PLAN, SECONDS_A_COMMAND = 1.0, 3.0
REPEATS = 5


def check(row: int, restitution: float) -> bool:
    """Plans, prints a line, and returns whether its figures are met."""
    scenario = dataclasses.replace(Scenario.named(f"table1/{row}"), restitution=restitution)
    planner = Planner(scenario)
    exact = rigid_optimum(planner.world, scenario)
    plan = planner.plan()
    rigid, drake = plan.replay.event_driven, plan.replay.drake
    assert drake is not None
    met = rigid.cost <= max((1 + RELATIVE) * exact.cost, NEARLY_NOTHING)
    drake_error = abs(drake.cost - exact.cost)
    met = met and drake_error <= max(DRAKE_RELATIVE * exact.cost, DRAKE_ABSOLUTE)
    times = ", ".join(f"{contact.time:.4f}" for contact in plan.best.contacts)
    print(
        f"row {row}  e = {restitution:g}  exact {exact.cost:.6e}  event-driven {rigid.cost:.6e} "
        f"({_excess(rigid.cost, exact.cost)})  Drake {drake.cost:.6e} "
        f"({_excess(drake.cost, exact.cost)})  contact at {times} s, exact "
        f"{', '.join(f'{t:.4f}' for t in exact.bounce_times)} s; in Drake "
        f"{1e3 * contact_delay(planner.world):.3f} ms late  "
        f"defect {plan.best.max_defect:.0e}  energy ratio {rigid.energy_ratio:.3f}  "
        f"{'met' if met and plan.holds else 'MISSED'}"
    )
    return met and plan.holds


def _excess(cost: float, exact: float) -> str:
    return f"{cost / exact - 1:+.1e}" if exact > NEARLY_NOTHING else f"{cost - exact:+.1e} absolute"


def seconds_a_plan() -> float:
    """Returns the median of repeated plans for the four rows, N = 200, confirmed in Drake [s]."""
    seconds = []
    for row in ROWS:
        planner = Planner(Scenario.named(f"table1/{row}"))
        for _ in range(REPEATS):
            start = time.perf_counter()
            planner.plan()
            seconds.append(time.perf_counter() - start)
    print(
        f"a plan at N = 200, confirmed in Drake: median {statistics.median(seconds):.2f} s, "
        f"{min(seconds):.2f} … {max(seconds):.2f} s"
    )
    return statistics.median(seconds)


def seconds_a_command() -> float:
    """Returns the median of `drake-aigto plan table1/1` with cached kernels [s]; prints it cold."""
    arguments = [sys.executable, "-c", COMMAND, "plan", "table1/1", "--quiet"]
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        seconds = []
        for _ in range(1 + REPEATS):
            start = time.perf_counter()
            subprocess.run(arguments, env=environment, check=True, stdout=subprocess.DEVNULL)
            seconds.append(time.perf_counter() - start)
    cold, *warm = seconds
    print(
        f"drake-aigto plan table1/1: median {statistics.median(warm):.2f} s "
        f"({min(warm):.2f} … {max(warm):.2f} s), without cached kernels {cold:.1f} s"
    )
    return statistics.median(warm)


def main() -> int:
    """Prints all figures and returns the exit status."""
    met = [check(row, e) for row in ROWS for e in RESTITUTIONS]
    met.append(seconds_a_plan() <= SECONDS_A_PLAN)
    met.append(seconds_a_command() <= SECONDS_A_COMMAND)
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
