"""How often is the plan the global optimum? Random starts, goals and restitutions, one wall.

    python benchmarks/random_scenarios.py --count 200 --seed 0

p0, goal ∈ [0.2, 1.5] m, v0 ∈ [−3, 0.5] m/s, e ∈ {1, 0.8, 0.5}. A plan succeeds if its
event-driven replay costs no more than 1.01 J* + 1e-7, where J* is the exact optimum
(`study.rigid_optimum`, which the planner does not know). Shown apart: how often AIGO's boxes alone,
before any polish, have the optimum's number of contacts, reading every cluster of impulses in the
last box as one. Exits with 1 if less than 99 % succeed.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context

import numpy as np

from drake_aigto.planning import Planner, PlanningError, PlanOptions, RigidProblem, make_problem
from drake_aigto.study import rigid_optimum
from drake_aigto.world import Scenario, World

RESTITUTIONS = (1.0, 0.8, 0.5)
RELATIVE, ABSOLUTE = 0.01, 1e-7
ASKED = 0.99
OPTIONS = PlanOptions(confirm=False)


@dataclass(frozen=True)
class Outcome:
    """What became of one scenario.

    Attributes:
        scenario: the question.
        exact: J*.
        contacts: of the optimum.
        cost: of the plan's event-driven replay; infinity if nothing held.
        seconds: of the plan.
        read: contacts in the last box of every rung.
    """

    scenario: Scenario
    exact: float
    contacts: int
    cost: float
    seconds: float
    read: tuple[int, ...]

    @property
    def is_optimal(self) -> bool:
        """Whether the plan is the optimum."""
        return self.cost <= (1 + RELATIVE) * self.exact + ABSOLUTE


@cache
def shared_world() -> World:
    """Returns the shipped world, built once a process, with all kernels loaded."""
    scenario = Scenario.named("table1/1")
    world = World.from_scenario(scenario)
    Planner(scenario, OPTIONS, world).plan()
    return world


def draw(count: int, seed: int) -> list[Scenario]:
    """Returns random scenarios."""
    generator = np.random.default_rng(seed)
    return [
        Scenario(
            initial_position=generator.uniform(0.2, 1.5),
            goal_position=generator.uniform(0.2, 1.5),
            initial_velocity=generator.uniform(-3.0, 0.5),
            restitution=RESTITUTIONS[i % len(RESTITUTIONS)],
        )
        for i in range(count)
    ]


def run(scenario: Scenario) -> Outcome:
    """Plans, and reads the boxes."""
    world = shared_world()
    exact = rigid_optimum(world, scenario)
    start = time.perf_counter()
    try:
        cost = Planner(scenario, OPTIONS, world).plan().replay.event_driven.cost
    except PlanningError:
        cost = np.inf
    seconds = time.perf_counter() - start
    return Outcome(
        scenario, exact.cost, len(exact.bounce_times), cost, seconds, read_boxes(world, scenario)
    )


def read_boxes(world: World, scenario: Scenario) -> tuple[int, ...]:
    """Returns the number of contacts in the last box of every rung."""
    problem = make_problem(world, scenario, OPTIONS)
    assert isinstance(problem, RigidProblem)
    first = (problem.find_sequences(problem.run_aigo(rung), rung)[0] for rung in OPTIONS.rungs)
    return tuple(map(len, first))


def report(outcomes: list[Outcome]) -> bool:
    """Prints the figures; returns whether enough plans are optimal."""
    count = len(outcomes)
    for outcome in outcomes:
        if not outcome.is_optimal:
            print(f"MISSED  {outcome.cost:.4e}, exact {outcome.exact:.4e}: {outcome.scenario}")
    succeeded = sum(outcome.is_optimal for outcome in outcomes)
    excess = [o.cost / o.exact - 1 for o in outcomes if o.exact > ABSOLUTE and o.is_optimal]
    seconds = [outcome.seconds for outcome in outcomes]
    print(f"optimal: {succeeded} of {count}, asked {ASKED:.0%}")
    print(f"above the optimum: median {np.median(excess):.1e}, at most {np.max(excess):.1e}")
    print(
        f"seconds a plan, N = {outcomes[0].scenario.num_steps}, without confirmation in Drake: "
        f"median {np.median(seconds):.2f}, at most {np.max(seconds):.2f}"
    )
    for contacts, share in sorted(Counter(outcome.contacts for outcome in outcomes).items()):
        print(f"optimum with {contacts} contacts: {share}")
    print("boxes alone, before the polish, have as many contacts as the optimum:")
    for number, rung in enumerate(OPTIONS.rungs):
        right = sum(outcome.read[number] == outcome.contacts for outcome in outcomes)
        print(f"  rung {number + 1}, from temperature {rung.temperature:g}: {right} of {count}")
    right = sum(outcome.contacts in outcome.read for outcome in outcomes)
    print(f"  any rung: {right} of {count}")
    return succeeded >= ASKED * count


def main() -> int:
    """Runs all scenarios and returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    options = parser.parse_args()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # Workers would fight for cores.
    with ProcessPoolExecutor(options.workers, get_context("spawn")) as pool:
        outcomes = list(pool.map(run, draw(options.count, options.seed)))
    return 0 if report(outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
