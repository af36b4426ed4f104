"""How long the first plan takes from an installed wheel that has machine code.

    python -m benchmarks.first_plans [--wheel dist/NAME.whl] [--scenarios NAME,NAME]

A wheel is built with machine code of all shipped scenarios, which takes some 48 CPU minutes, unless
one is given. It is installed into a folder of its own, without its dependencies. Each scenario is
planned for twice in a process of its own that finds an empty cache of Numba's: CPU seconds of the
first plan, with all imports, those of the second, and how many functions Numba compiled. Exits with
1 where one was compiled, or the first plan took more than 2 s above the second.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.script import is_met, read_flags
from drake_aigto import scenario_names

MOST_MORE = 2.0  # [s]
PROGRAM = """
import sys, time
sys.path.insert(0, sys.argv[1])
from numba.core import event
from drake_aigto import Planner, PlanOptions, Scenario
scenario = Scenario.named(sys.argv[2])
with event.install_recorder("numba:compile") as recorder:
    ends = [0.0]
    for _ in range(2):
        plan = Planner(scenario, PlanOptions(confirm=False)).plan()
        ends.append(time.process_time())
        print(ends[-1] - ends[-2])
print(len(recorder.buffer) // 2, plan.cost)
"""


def main() -> int:
    """Installs, measures and judges."""
    arguments = read_flags(
        __doc__,
        workers=None,
        wheel=(Path(), "that has machine code; built if none is given"),
        scenarios=("", "names, with commas between; all that are shipped"),
    )
    met = []
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as built:
        wheel = arguments.wheel if arguments.wheel != Path() else build_wheel(built)
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
        subprocess.run([*command, "--target", folder, str(wheel)], check=True)
        print(f"{'scenario':28}{'first':>8}{'second':>8}{'compiled':>10}  cost")
        for name in arguments.scenarios.split(",") if arguments.scenarios else scenario_names():
            first, second, compiled, cost = plan_twice(folder, name)
            print(f"{name:28}{first:8.2f}{second:8.2f}{compiled:10}  {cost:.6g}", flush=True)
            met.append(is_met(f"{name}: functions compiled", compiled, 0))
            met.append(is_met(f"{name}: first above second [CPU s]", first - second, MOST_MORE))
    return 0 if all(met) else 1


def build_wheel(folder: str) -> Path:
    """Returns a wheel with machine code of all scenarios, in a folder."""
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation"]
    environment = {**os.environ, "DRAKE_AIGTO_MACHINE_CODE": "all"}
    command += ["--quiet", "--wheel-dir", folder, "."]
    subprocess.run(command, check=True, env=environment)
    (wheel,) = Path(folder).glob("*.whl")
    return wheel


def plan_twice(folder: str, name: str) -> tuple[float, float, int, float]:
    """Returns CPU seconds of both plans, functions compiled, and the cost."""
    with tempfile.TemporaryDirectory() as cache:
        told = subprocess.run(
            [sys.executable, "-I", "-c", PROGRAM, folder, name],
            check=True,
            capture_output=True,
            text=True,
            env={**os.environ, "NUMBA_CACHE_DIR": cache, "OPENBLAS_NUM_THREADS": "1"},
        )
    first, second, compiled, cost = told.stdout.split()[-4:]
    return float(first), float(second), int(compiled), float(cost)


if __name__ == "__main__":
    sys.exit(main())
