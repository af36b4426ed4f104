"""How the boxes' work grows with the number of knots: time per knot and iteration, and memory.

    python -m benchmarks.growth [--repeats 3] [--most 20000]

Table I's first problem at N = 50 … 20,000 time steps of the boxes, each in a process of its own,
one thread: seconds to build the problem, and CPU seconds of an annealing over a few temperatures
for each of its Newton iterations and each knot; the largest memory that the process had, less what
it had before the problem was built. Writes growth.csv; exits with 1 if time per knot and iteration
grows by more than a factor 1.3 from 200 to the most steps, or memory faster than they do.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import dataclasses
import json
import resource
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.script import clock, is_met, read_flags, write_csv
from drake_aigto.aigo import Annealing
from drake_aigto.planning import PlanOptions, make_ball_task
from drake_aigto.world import Scenario, World

STEPS = (50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000)
FIRST = 200  # of the figures
LARGEST_GROWTH = 1.3
TEMPERATURES = 4
# `ru_maxrss` counts in these [bytes].
RESIDENT_UNIT = 1 if sys.platform == "darwin" else 1024


@dataclass(frozen=True)
class Growth:
    """One process: a line of the CSV file."""

    steps: int
    turn: int
    build_seconds: float
    iterations: int
    seconds: float
    memory: float  # [bytes]

    @property
    def seconds_per_knot(self) -> float:
        """Of one iteration."""
        return self.seconds / self.iterations / self.steps

    @property
    def memory_per_knot(self) -> float:
        """[bytes]."""
        return self.memory / self.steps


def main() -> int:
    """Starts a process for each line, prints, writes and judges."""
    arguments = read_flags(
        __doc__,
        workers=None,
        repeats=(3, "turns"),
        most=(STEPS[-1], "time steps"),
        out=(Path(), "folder of the CSV"),
        steps=(None, argparse.SUPPRESS, {"type": int}),
    )
    if arguments.steps:
        print(json.dumps(dataclasses.asdict(measure(arguments.steps))))
        return 0
    steps = [each for each in STEPS if each <= arguments.most]
    found = [start(each, turn) for turn in range(arguments.repeats) for each in steps]
    write_csv(arguments.out / "growth.csv", found, "one thread")
    for each in steps:
        tell([growth for growth in found if growth.steps == each])
    return 0 if judge(found, steps[-1]) else 1


def start(steps: int, turn: int) -> Growth:
    """Returns what a process of its own measures."""
    command = [sys.executable, "-m", "benchmarks.growth", "--steps", str(steps)]
    answer = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return Growth(**{**json.loads(answer), "turn": turn})


def measure(steps: int) -> Growth:
    """Builds and anneals, in this process."""
    world = World.from_scenario(Scenario.named("table1/1"))
    anneal(world, 50)  # Loads compiled code.
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    build_seconds, iterations, seconds = anneal(world, steps)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    return Growth(steps, 0, build_seconds, iterations, seconds, float(memory * RESIDENT_UNIT))


def anneal(world: World, steps: int) -> tuple[float, int, float]:
    """Returns seconds to build, the number of Newton iterations, and their seconds."""
    scenario = dataclasses.replace(Scenario.named("table1/1"), time_step=1.0 / steps)
    options = PlanOptions(aigo_steps=steps)
    problem, building = clock(lambda: make_ball_task(world, scenario, options))
    rung = problem.ladder[0]
    algorithm = problem.make_algorithm(rung)
    assert isinstance(algorithm, Annealing)
    last = algorithm.initial_temperature * algorithm.cooling ** (TEMPERATURES - 1)
    short = dataclasses.replace(algorithm, final_temperature=last)
    result, seconds = clock(lambda: problem.run_aigo(rung, short))
    return building.cpu, result.num_inner_steps, seconds.cpu


def tell(found: list[Growth]) -> None:
    """Prints the medians of one number of steps."""
    build, knot, memory, iterations = (
        float(np.median([getattr(each, name) for each in found]))
        for name in ("build_seconds", "seconds_per_knot", "memory", "iterations")
    )
    print(
        f"N = {found[0].steps:6}  built in {1e3 * build:8.1f} ms  {1e6 * knot:6.3f} µs a knot and "
        f"iteration, {iterations:4.0f} iterations  {memory / 2**20:7.1f} MiB",
        flush=True,
    )


def judge(found: list[Growth], most: int) -> bool:
    """Returns whether the figures are reached."""

    def median(name: str, steps: int) -> float:
        return float(np.median([getattr(each, name) for each in found if each.steps == steps]))

    time = median("seconds_per_knot", most) / median("seconds_per_knot", FIRST)
    # At few knots it is what a process has anyway that counts.
    some = max(steps for steps in STEPS if steps <= most / 4)
    memory = median("memory_per_knot", most) / median("memory_per_knot", some)
    name = f"time per knot and iteration, N = {most} / {FIRST}"
    met = is_met(name, time, LARGEST_GROWTH)
    return is_met(f"memory per knot, N = {most} / {some}", memory, LARGEST_GROWTH) and met


if __name__ == "__main__":
    sys.exit(main())
