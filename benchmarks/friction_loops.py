"""Plans with friction in the loop, on plants whose masses and friction are up to 10 % off.

    python -m benchmarks.friction_loops [--only spinner] [--count 10] [--seed 0]
        [--renewals 24] [--workers 1] [--minutes 30]

Each world runs once as it was planned for, and in so many disturbances: masses and μ times factors
from 0.9 to 1.1 that no controller knows, and nothing learns. Methods: the plan's control alone;
`TrackingController`; and `ModelPredictiveController`, warm, once every time step, whose first plan
is its own search's. What is measured is how far from the goal a run ends, by the coordinates that
the task weighs there, and what it costs.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Iterator, Mapping, Sequence
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from benchmarks.in_the_loop import OFF, make_open_loop
from benchmarks.script import machine, read_flags, run_all, run_as
from drake_aigto import (
    ModelPredictiveController,
    Plan,
    Planner,
    PlanOptions,
    Scenario,
    TrackingController,
)
from drake_aigto.control import ClosedLoopRun, Disturbance, run_in_loop

WORLDS = ("spinner/two_radians", "hopper/hop", "pushed_block/slide")
RENEWALS, ITERATIONS = 24, 15


class Outcome(NamedTuple):
    """A run of a method."""

    off: float  # from the goal at the end [m, rad]
    cost: float


class Run(NamedTuple):
    """What all methods make of one plant."""

    number: int  # of the plant; 0 is the model
    outcomes: Mapping[str, Outcome]


def draw(seed: int, number: int) -> Disturbance:
    """Returns a plant; number 0 is the model."""
    if number == 0:
        return Disturbance()
    mass, friction = np.random.default_rng((seed, number)).uniform(1 - OFF, 1 + OFF, 2)
    return Disturbance(mass_factor=float(mass), friction_factor=float(friction))


@cache
def prepare(name: str, renewals: int) -> tuple[Planner, Plan]:
    """Returns a world's planner and plan."""
    planner = Planner(Scenario.named(name), PlanOptions(renewals=renewals, threads=1))
    return planner, planner.plan()


def make_controllers(
    planner: Planner, plan: Plan
) -> Iterator[tuple[str, TrackingController | ModelPredictiveController]]:
    """Yields the methods' controllers."""
    period = plan.scenario.time_step
    yield "open loop", make_open_loop(plan, period)
    yield "tracking", TrackingController(plan, period=period)
    again = ModelPredictiveController(
        planner, period, "shrinking", iterations=ITERATIONS, surprise=np.inf
    )
    yield "replanning", again


def run(job: tuple[str, int], *, seed: int, renewals: int) -> Run:
    """Returns what all methods make of a world's plant."""
    name, number = job
    planner, plan = prepare(name, renewals)
    disturbance, outcomes = draw(seed, number), dict[str, Outcome]()
    for method, controller in make_controllers(planner, plan):
        loop = run_in_loop(controller, plan.scenario, planner.world, disturbance)
        outcomes[method] = Outcome(measure(loop), loop.cost)
    factors = f"mass {disturbance.mass_factor:.3f}, mu {disturbance.friction_factor:.3f}"
    ends = ", ".join(f"{method} {each.off:.4f}" for method, each in outcomes.items())
    print(f"{name} {number}: {factors}: {ends} off", flush=True)
    return Run(number, outcomes)


def measure(loop: ClosedLoopRun) -> float:
    """Returns how far from its goal a run ends, by the coordinates that are weighed there."""
    scenario, end = loop.scenario, loop.replay.positions[-1]
    counts = np.broadcast_to(np.asarray(scenario.goal_weight), end.shape) > 0
    return float(np.linalg.norm((end - scenario.goal_position)[counts]))


def report(name: str, runs: Sequence[Run]) -> str:
    """Returns a table of a world, of runs of which the first is the model's."""
    model, others = runs[0].outcomes, [each.outcomes for each in runs[1:]]
    lines = [
        f"{name}: off the goal at the end, and cost, on the model and on {len(others)} others",
        f"{'':<12} {'off':>8} {'median':>8} {'worst':>8}   {'cost':>8} {'median':>8} {'worst':>8}",
    ]
    for method, own in model.items():
        off, cost = np.array([each[method] for each in others]).T
        lines.append(
            f"{method:<12} {own.off:8.4f} {np.median(off):8.4f} {off.max():8.4f}  "
            f" {own.cost:8.3g} {np.median(cost):8.3g} {cost.max():8.3g}"
        )
    return "\n".join(lines)


def main() -> int:
    """Runs all methods on the same plants, and prints a table of each world."""
    options = read_flags(
        __doc__,
        only=("", "worlds whose name has this in it"),
        count=(10, "of plants that are off"),
        seed=(0, "of these"),
        renewals=(RENEWALS, "of each search"),
    )
    print(machine(), flush=True)
    work = partial(run, seed=options.seed, renewals=options.renewals)
    for name in [each for each in WORLDS if options.only in each]:
        runs = run_all(work, [(name, number) for number in range(options.count + 1)], options)
        if len(runs) > 1 and runs[0].number == 0:
            print(report(name, runs), flush=True)
    return 0


if __name__ == "__main__":
    run_as("benchmarks.friction_loops")
