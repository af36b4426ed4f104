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

from benchmarks.loop_record import Job, prepare, run_worlds, simulate
from benchmarks.script import run_as

WORLDS = ("acrobot/swing_up", "cart_pole/soft_06", "cart_pole/rigid_06")
METHODS = ("tracking", "planning again")
AFTER, LAST, NEAR = 10.0, 1.0, 0.1  # [s], [s], [m, rad]


def run(job: Job) -> tuple[Job, dict[str, float]]:
    """Returns how far from the goal each method is at the end, the largest of all coordinates."""
    name, seed, what = job
    world, goal = prepare(name).world, prepare(name).plan.scenario.goal_position
    found = dict[str, float]()
    for method, _, loop in simulate(job, METHODS, AFTER):
        found[method] = np.inf
        if loop is not None:
            times, q = loop.replay.times, world.take_nearest(loop.replay.positions, goal)
            late = times >= prepare(name).plan.scenario.duration + AFTER - LAST
            found[method] = float(np.mean(np.abs(q[late] - goal), axis=0).max())
    off = ", ".join(f"{method} {each:.3g}" for method, each in found.items())
    print(f"{name}, {what}, seed {seed}, off by: {off}", flush=True)
    return job, found


def report(name: str, runs: Sequence[tuple[str, dict[str, float]]]) -> str:
    """Returns of a world how many runs are held, and which are not."""
    lines = [name]
    for method in METHODS:
        lost = [what for what, found in runs if not found[method] <= NEAR]
        held = len(runs) - len(lost)
        names = "" if not lost else ": not " + ", ".join(lost)
        lines.append(f"{method:<16}{held:>4} of {len(runs)}, {held / len(runs):4.0%}{names}")
    return "\n".join(lines)


def main() -> int:
    """Runs both controllers on all disturbances, and prints how many runs are held."""
    return run_worlds(__doc__, WORLDS, run, report)


if __name__ == "__main__":
    run_as("benchmarks.held")
