"""Compiles every kernel that shipped scenarios and the solver use into a folder, for all levels.

python .ci/compile_kernels.py FOLDER [SCENARIO ...]

What is compiled is what runs: each scenario is planned for once, with little search, in a process
for each level of processors. That takes minutes.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

# Little of all that a plan is made of: starts, renewals, neighbors, polish, replay.
PROGRAM = """
import sys
from pydrake.solvers import MathematicalProgram
from pydrake.symbolic import sin
from drake_aigto import AigoOptions, AigoSolver, Planner, PlanOptions, Scenario, scenario_names
from drake_aigto.planning import PlanningError
for name in sys.argv[1:] or scenario_names():
    scenario = Scenario.named(name)
    planner = Planner(scenario)
    if not planner.is_of_balls:
        planner = Planner(scenario, PlanOptions(renewals=8, finalists=1))
    try:
        planner.plan()
    except PlanningError:  # So little search may find nothing; its code is compiled.
        pass
    print(name, flush=True)
prog = MathematicalProgram()
x = prog.NewContinuousVariables(3)
prog.AddBoundingBoxConstraint(-2, 2, x)
prog.AddCost(x[0] ** 4 - x[0] ** 2 * x[1] + sin(x[1]) + x[2] ** 2 + x[0])
prog.AddConstraint(x[0] * x[1] + x[2] ** 2 <= 1)
AigoSolver(AigoOptions(certify=True)).Solve(prog)
"""


def main() -> None:
    """Compiles for each level, and writes what the code is for."""
    from drake_aigto.code_cache import BUILT_INTO, LEVELS, MANIFEST, list_versions

    folder = Path(sys.argv[1]).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    for level in LEVELS:
        told = {"NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": "", BUILT_INTO: str(folder)}
        print(f"machine code for {level}", flush=True)
        subprocess.run(
            [sys.executable, "-c", PROGRAM, *sys.argv[2:]],
            check=True,
            cwd=ROOT,
            env={**os.environ, **told},
        )
    (folder / MANIFEST).write_text(json.dumps(list_versions()), encoding="utf-8")
    print(f"{sum(each.stat().st_size for each in folder.iterdir()) / 1e6:.1f} MB in {folder}")


if __name__ == "__main__":
    main()
