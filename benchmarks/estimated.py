"""Models that are 20 % off: where planning again ends that estimates them, and that does not.

    python -m benchmarks.estimated [--only soft,spinner] [--keep FILE] [--minutes 60]

Masses are off by a fifth, and so is friction where there is any, in all ways. Beside that stands
how near models end that are off by a fiftieth in the same ways, and those that are right: a goal is
weighed against effort, so the best motion of another mass ends elsewhere.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import itertools
from collections.abc import Sequence

import numpy as np

from benchmarks.loop_record import make_controller, pick, prepare
from benchmarks.script import machine, read_flags, run_all, run_as
from drake_aigto import Planner, Scenario, World
from drake_aigto.control import Disturbance, run_in_loop
from drake_aigto.world import TaskCost

WORLDS = (
    *("table1/1", "cart_pole/soft_06", "pushed_block/slide", "spinner/two_radians"),
    "hopper/hop",
)
FAR, NEAR = 0.2, 0.02
# By how much the plant is off the model that was made for it, how much of that is known, and
# whether the rest is estimated.
RUNS = {
    "2 % off": (NEAR, False, False),
    "20 % off": (FAR, False, False),
    "estimated": (FAR, False, True),
    "known": (FAR, True, False),
}

Job = tuple[str, int, int]  # a world, and the signs of what is off of its masses and friction


def list_jobs(names: Sequence[str]) -> list[Job]:
    """Returns all worlds, and all ways in which they are off."""
    found = list[Job]()
    for name in names:
        has_friction = bool(World.from_scenario(Scenario.named(name)).frictions)
        signs = itertools.product((1, -1), (1, -1) if has_friction else (0,))
        found += [(name, mass, friction) for mass, friction in signs]
    return found


def run(job: Job) -> tuple[Job, dict[str, float]]:
    """Returns how far from the goal each run ends, in the norm of what is asked for [m, rad]."""
    name, mass, friction = job
    prepared, found = prepare(name), dict[str, float]()
    world, scenario = prepared.world, prepared.plan.scenario
    cost, unknown = TaskCost.of(world, scenario), ["mass", "friction"][: 1 + abs(friction)]
    for label, (off, is_known, estimates) in RUNS.items():
        true = Disturbance(mass_factor=1 + off * mass, friction_factor=1 + off * friction)
        known = prepared._replace(options={**prepared.options, "estimate": unknown * estimates})
        if is_known:
            right, posed = true.apply(world, scenario)
            planner = Planner(posed, prepared.planner.options, right)
            known = known._replace(world=right, planner=planner, plan=planner.plan())
        controller = make_controller("planning again", known, true)
        loop = run_in_loop(controller, scenario, world, true)
        errors = cost.goal_errors(loop.replay.positions[-1])
        found[label] = float(np.linalg.norm(errors[cost.is_asked]))
    print(f"{job}: " + ", ".join(f"{label} {off:.3g}" for label, off in found.items()), flush=True)
    return job, found


def report(name: str, runs: Sequence[tuple[Job, dict[str, float]]]) -> str:
    """Returns a table of a world: how far from the goal each run ends."""
    lines = [f"{name:<30}" + "".join(f"{label:>11}" for label in RUNS)]
    for (_, mass, friction), found in runs:
        what = f"mass {FAR * mass:+g}" + (f", friction {FAR * friction:+g}" if friction else "")
        lines.append(f"{what:<30}" + "".join(f"{found[label]:11.4f}" for label in RUNS))
    return "\n".join(lines)


def main() -> int:
    """Runs all worlds, and prints a table of each."""
    options = read_flags(__doc__, only=("", "worlds with one of these in their names"))
    print(machine(), flush=True)
    names = pick(WORLDS, options.only)
    done = run_all(run, list_jobs(names), options)
    for name in names:
        if runs := [each for each in done if each[0][0] == name]:
            print(report(name, runs), flush=True)
    return 0


if __name__ == "__main__":
    run_as("benchmarks.estimated")
