"""One Newton iteration of the annealing against its own banded Cholesky.

    python -m benchmarks.newton_speed [--steps 200] [--repeats 15]

On Table I's first problem at N = 200, in turns, seconds of one core:

- an iteration: an annealing from the ladder's first rung, divided by its Newton iterations, so
  that trials which failed, line searches and all else are counted;
- LAPACK's dpbtrf of a matrix of the same shape, and the copy of it that it works on;
- value, gradient and Hessian of the smoothed objective f̄(c, e^z) − μ Σ z alone.

Writes newton_speed.csv; exits with 1 if an iteration takes more than three factorizations.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import dataclasses
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg.lapack import dpbtrf

from benchmarks.script import Spread, clock, is_met, read_flags, take_turns, write_csv
from drake_aigto.planning import PlanOptions, ProgramTask, make_ball_task
from drake_aigto.world import Scenario, World

MOST_FACTORIZATIONS = 3.0
CALLS = 20  # of what takes less than a millisecond, in a turn
ITERATION, CHOLESKY, HESSIAN = "iteration", "dpbtrf", "Hessian"


@dataclass(frozen=True)
class Timing:
    """One turn: a line of the CSV file."""

    what: str
    turn: int
    seconds: float


def main() -> int:
    """Measures, prints, writes and judges."""
    arguments = read_flags(
        __doc__,
        workers=None,
        steps=(200, "N of the boxes"),
        repeats=(15, "turns"),
        out=(Path(), "folder of the CSV"),
    )
    problem = make_boxes(arguments.steps)
    seconds = take_turns(make_works(problem), arguments.repeats, CALLS)
    seconds[ITERATION] = time_iterations(problem, arguments.repeats)
    spreads = {what: Spread.of(each) for what, each in seconds.items()}
    for what, spread in spreads.items():
        ratio = spread.median / spreads[CHOLESKY].median
        print(f"{what:22}{spread.show(1e-6, 1):>24} µs   {ratio:6.2f} × dpbtrf")
    timings = [
        Timing(what, turn, each)
        for what, found in seconds.items()
        for turn, each in enumerate(found)
    ]
    write_csv(arguments.out / "newton_speed.csv", timings, f"one thread, N = {arguments.steps}")
    ratio = spreads[ITERATION].median / spreads[CHOLESKY].median
    return 0 if is_met("an iteration / its banded Cholesky", ratio, MOST_FACTORIZATIONS) else 1


def make_boxes(steps: int) -> ProgramTask:
    """Returns Table I's first problem, its boxes at so many time steps."""
    scenario = dataclasses.replace(Scenario.named("table1/1"), time_step=1.0 / steps)
    options = PlanOptions(aigo_steps=steps)
    return make_ball_task(World.from_scenario(scenario), scenario, options)


def time_iterations(problem: ProgramTask, repeats: int) -> list[float]:
    """Returns seconds a Newton iteration, of whole annealings."""
    rung = problem.ladder[0]
    problem.run_aigo(rung)  # Loads compiled code.
    found = []
    for _ in range(repeats):
        result, seconds = clock(lambda: problem.run_aigo(rung))
        found.append(seconds.cpu / result.num_inner_steps)
    return found


def make_works(problem: ProgramTask) -> dict[str, Callable[[], Any]]:
    """Returns what takes turns."""
    f, box = problem.polynomial, problem.box
    half_width = np.where(box.free, box.half_width, 0.1)
    band = f.newton_system(box.center, half_width).band
    # A matrix of that shape which is positive definite for sure.
    band = np.asfortranarray(np.vstack([np.full_like(band[0], 1e3), band[1:] / np.abs(band).max()]))
    return {
        CHOLESKY: lambda: dpbtrf(band, lower=1),
        HESSIAN: lambda: f.newton_system(box.center, half_width),
    }


if __name__ == "__main__":
    sys.exit(main())
