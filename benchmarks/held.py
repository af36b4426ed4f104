"""Goals that only feedback holds: which runs are still there ten seconds after the plan's end.

    python -m benchmarks.held [--only acrobot] [--seeds 1] [--keep FILE] [--minutes 60]

Worlds whose goal is upright, and all that disturbs them in `benchmarks.loop_record`; noise, delay
and what is wrong with the plant go on after the plan's end. A run is held if, over its last second,
no coordinate is farther from the goal than 0.1 m or rad on average.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Sequence

import numpy as np

from benchmarks.loop_record import Job, list_disturbances, list_jobs, make_controller, prepare
from benchmarks.script import machine, read_flags, run_all, run_as
from drake_aigto import AigtoError
from drake_aigto.control import run_in_loop

WORLDS = ("acrobot/swing_up", "cart_pole/soft_06", "cart_pole/rigid_06")
METHODS = ("tracking", "planning again")
AFTER, LAST, NEAR = 10.0, 1.0, 0.1  # [s], [s], [m, rad]


def run(job: Job) -> tuple[Job, dict[str, float]]:
    """Returns how far from the goal each method is at the end, the largest of all coordinates."""
    name, seed, what = job
    prepared, found = prepare(name), dict[str, float]()
    scenario, world = prepared.plan.scenario, prepared.world
    largest = np.max(np.abs(prepared.plan.trajectory.controls), axis=0)
    disturbance = dict(list_disturbances(world, scenario, seed, largest))[what]
    end = scenario.duration + AFTER
    for method in METHODS:
        controller = make_controller(method, prepared, disturbance.delay)
        try:
            loop = run_in_loop(controller, scenario, world, disturbance, end)
        except AigtoError as error:
            print(f"{name}, {what}, seed {seed}: {method}: {error}", flush=True)
            found[method] = np.inf
            continue
        late = loop.replay.times >= end - LAST
        q = world.take_nearest(loop.replay.positions[late], scenario.goal_position)
        found[method] = float(np.mean(np.abs(q - scenario.goal_position), axis=0).max())
    off = ", ".join(f"{method} {each:.3g}" for method, each in found.items())
    print(f"{name}, {what}, seed {seed}, off by: {off}", flush=True)
    return job, found


def report(name: str, runs: Sequence[tuple[Job, dict[str, float]]]) -> str:
    """Returns of a world how many runs are held, and which are not."""
    lines = [name]
    for method in METHODS:
        lost = [what for (_, _, what), found in runs if not found[method] <= NEAR]
        held = len(runs) - len(lost)
        names = "" if not lost else ": not " + ", ".join(lost)
        lines.append(f"{method:<16}{held:>4} of {len(runs)}, {held / len(runs):4.0%}{names}")
    return "\n".join(lines)


def main() -> int:
    """Runs both controllers on all disturbances, and prints how many runs are held."""
    options = read_flags(
        __doc__, only=("", "worlds whose name has this in it"), seeds=(1, "of noise and kicks")
    )
    print(machine(), flush=True)
    names = [each for each in WORLDS if options.only in each]
    done = run_all(run, list_jobs(names, options.seeds), options)
    for name in names:
        if runs := [each for each in done if each[0][0] == name]:
            print(report(name, runs), flush=True)
    return 0


if __name__ == "__main__":
    run_as("benchmarks.held")
