"""How long it takes to start: to import, to plan on the command line, and to compile at first.

    python -m benchmarks.start_time [--repeats 7] [--clock cpu]

Each in a process of its own, in turns, with bytecode and compiled code cached, as where the package
is installed; the command replays its plan in Drake, too. Beside them what no use of Drake and Numba
can go below: an interpreter that imports the libraries that the command needs and does nothing.
Then the first plan with an empty cache of Numba's, twice, of which the second finds all that the
first compiled. Writes start_time.csv; exits with 1 if ``import drake_aigto`` takes more than 0.5 s,
``drake-aigto plan table1/1`` more than 1.5 s, or the first compilation more than 5 s, or if the
second process compiles anything.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks.script import COMMAND, Spread, is_met, read_flags, write_csv

LIBRARIES = (
    "import numba, scipy.sparse.csgraph, scipy.linalg, yaml, pydrake.multibody.plant, "
    "pydrake.solvers, pydrake.systems.analysis, pydrake.geometry, pydrake.multibody.parsing"
)
IMPORT, PLAN, ALONE = "import drake_aigto", "drake-aigto plan table1/1", "libraries alone"
PROGRAMS = {
    IMPORT: ["import drake_aigto"],
    PLAN: [COMMAND, "plan", "table1/1", "--quiet"],
    ALONE: [LIBRARIES],
}
FIRST, SECOND = "first plan, compiling", "first plan, cached"
MOST = {IMPORT: 0.5, PLAN: 1.5, FIRST: 5.0}  # [s]

# Plans for the first time in a process; prints wall and CPU seconds, and how much Numba compiled.
FIRST_PLAN = """
import time
from numba.core import event
from benchmarks.script import read_flags
from drake_aigto import Planner, PlanOptions, Scenario
planner = Planner(Scenario.named("table1/1"), PlanOptions(confirm=False))
with event.install_recorder("numba:compile") as recorder:
    begin, cpu = time.perf_counter(), time.process_time()
    planner.plan()
    print(time.perf_counter() - begin, time.process_time() - cpu, len(recorder.buffer) // 2)
"""


@dataclass(frozen=True)
class Start:
    """One process, or what is timed in it: a line of the CSV file."""

    what: str
    turn: int
    wall_seconds: float
    cpu_seconds: float
    compiled: int = 0  # functions that Numba compiled


def main() -> int:
    """Measures, prints, writes and judges."""
    arguments = read_flags(
        __doc__,
        workers=None,
        repeats=(7, "turns"),
        clock=("wall", "of the figures", {"choices": ("wall", "cpu")}),
        out=(Path(), "folder of the CSV"),
    )
    with tempfile.TemporaryDirectory() as bytecode:
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPYCACHEPREFIX": bytecode}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        for program in PROGRAMS.values():
            run(program, environment)  # Fills caches.
        starts = [
            Start(what, turn, *run(program, environment))
            for turn in range(arguments.repeats)
            for what, program in PROGRAMS.items()
        ]
        starts += [
            start for turn in range(arguments.repeats) for start in plan_twice(turn, environment)
        ]
        write_csv(arguments.out / "start_time.csv", starts, "a process each, in turns")
    met = []
    for what in (*PROGRAMS, FIRST, SECOND):
        spreads = {
            clock: Spread.of(
                getattr(each, f"{clock}_seconds") for each in starts if each.what == what
            )
            for clock in ("wall", "cpu")
        }
        print(f"{what:28}{spreads['wall'].show()} s, of one core {spreads['cpu'].show()} s")
        if what in MOST:
            met.append(is_met(what, spreads[arguments.clock].median, MOST[what]))
    compiled = max(start.compiled for start in starts if start.what == SECOND)
    met.append(is_met("functions that a second process compiles", compiled, 0))
    return 0 if all(met) else 1


def plan_twice(turn: int, environment: dict[str, str]) -> Iterator[Start]:
    """Plans in two processes that share a cache of Numba's, empty at first."""
    with tempfile.TemporaryDirectory() as cache:
        for what in (FIRST, SECOND):
            told = subprocess.run(
                [sys.executable, "-c", FIRST_PLAN],
                check=True,
                capture_output=True,
                text=True,
                env={**environment, "NUMBA_CACHE_DIR": cache},
            )
            wall, cpu, compiled = told.stdout.split()
            yield Start(what, turn, float(wall), float(cpu), int(compiled))


def run(program: list[str], environment: dict[str, str]) -> tuple[float, float]:
    """Returns wall and CPU seconds of a process."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    begin = time.perf_counter()
    subprocess.run(
        [sys.executable, "-c", *program], check=True, stdout=subprocess.DEVNULL, env=environment
    )
    seconds = time.perf_counter() - begin
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - children.ru_utime - children.ru_stime
    return seconds, cpu


if __name__ == "__main__":
    sys.exit(main())
