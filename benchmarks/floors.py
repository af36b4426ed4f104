"""How often is the plan the best motion on a floor, where balls settle, rest and jump?

    python -m benchmarks.floors --count 200 --seed 0 --workers 2

Random starts, goals, durations, masses and gravities, e in turn from 1 to 0. A plan succeeds if its
event-driven replay costs no more than 1.01 J* + 1e-7, where J* is the best that a search knows
which is no part of the package (`floor_optimum`), and doing nothing. What costs less than J* is
reported: then J* is not what it is said to be.

Exits with 1 if fewer than 95 % succeed.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from benchmarks.floor_reference import FloorMotion, floor_optimum
from benchmarks.script import read_flags, run_all, run_as
from drake_aigto.errors import AigtoError
from drake_aigto.planning import Plan, Planner, PlanOptions
from drake_aigto.simulation import replay_event_driven
from drake_aigto.world import Scenario, World, models_directory

ASKED = 0.95
RELATIVE, ABSOLUTE = 0.01, 1e-7
RESTITUTIONS = (1.0, 0.8, 0.5, 0.3, 0.1, 0.0)
# What others are drawn from, evenly: [m], [m/s], [m], [s], [m/s²], [kg].
POSITIONS, VELOCITIES, GOALS = (0.1, 1.0), (-2.0, 2.0), (0.0, 1.0)
DURATIONS, GRAVITIES, MASSES = (0.5, 2.0), (1.6, 20.0), (0.3, 3.0)
OPTIONS = PlanOptions(confirm=False, threads=1)


@dataclass(frozen=True)
class Job:
    """One scenario, how strongly it is pulled down [m/s²], and the mass [kg]."""

    scenario: Scenario
    gravity: float
    mass: float


@dataclass(frozen=True)
class Outcome:
    """What became of it: the best that is known, and what the plan costs."""

    job: Job
    known: FloorMotion
    cost: float
    seconds: float
    told: str

    @property
    def succeeded(self) -> bool:
        """Whether the plan is the best that is known."""
        return self.cost <= (1 + RELATIVE) * self.known.cost + ABSOLUTE


def draw(count: int, seed: int) -> Iterator[tuple[Scenario, float, float]]:
    """Yields scenarios with their gravity and mass; the first ones do not depend on the count."""
    generator = np.random.default_rng(seed)
    for number in range(count):
        q, v, goal, T, gravity, mass = (
            generator.uniform(*interval)
            for interval in (POSITIONS, VELOCITIES, GOALS, DURATIONS, GRAVITIES, MASSES)
        )
        scenario = Scenario(
            model="package://drake_aigto_models/floor.sdf",
            initial_position=q,
            initial_velocity=v,
            goal_position=goal,
            duration=round(T, 1),
            restitution=RESTITUTIONS[number % len(RESTITUTIONS)],
        )
        yield scenario, gravity, mass


def make_world(gravity: float, mass: float) -> World:
    """Returns the shipped floor with another gravity [m/s²] and mass [kg]."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    Parser(plant).AddModels(str(models_directory() / "floor.sdf"))
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -gravity])
    plant.Finalize()
    return World.from_diagram(builder.Build(), mass)


def run(job: Job) -> Outcome:
    """Plans, and searches for what is better."""
    scenario, world = job.scenario, make_world(job.gravity, job.mass)
    known = floor_optimum(scenario, job.gravity, job.mass)
    times = np.linspace(0.0, scenario.duration, scenario.num_steps + 1)
    idle = replay_event_driven(world, scenario, times, np.zeros((scenario.num_steps, 1)))
    if idle.cost < known.cost:
        known = FloorMotion(idle.cost, len(idle.bounce_times))
    start = time.perf_counter()
    made = plan(world, scenario)
    seconds = time.perf_counter() - start
    cost = made.replay.event_driven.cost if made else np.inf
    told = f"{made.best.origin}: {made.best.describe_contacts()}" if made else "no plan"
    return Outcome(job, known, cost, seconds, told)


def plan(world: World, scenario: Scenario) -> Plan | None:
    """Returns the plan, None if there is none."""
    try:
        return Planner(scenario, OPTIONS, world).plan()
    except AigtoError:
        return None


def report(outcomes: list[Outcome]) -> bool:
    """Prints the figures; returns whether enough plans are the best."""
    for outcome in outcomes:
        job, known = outcome.job, outcome.known
        scenario = job.scenario
        about = (
            f"q {scenario.initial_position[0]:.6f}, v {scenario.initial_velocity[0]:.5f}, "
            f"goal {scenario.goal_position[0]:.6f}, T {scenario.duration:g}, "
            f"e {scenario.restitution:g}, mass {job.mass:.5f}, gravity {job.gravity:.5f}"
        )
        if not outcome.succeeded:
            print(f"MISSED  {outcome.cost:.4e} by {outcome.told}; known {known}: {about}")
        if outcome.cost < (1 - RELATIVE) * known.cost - ABSOLUTE:
            print(f"BELOW the known {known.cost:.4e}: plan {outcome.cost:.4e}, {about}")
    count, right = len(outcomes), sum(outcome.succeeded for outcome in outcomes)
    print(f"floors, the best known: {right} of {count}, asked: {ASKED:.0%}")
    for e in RESTITUTIONS:
        mine = [o.succeeded for o in outcomes if o.job.scenario.restitution == e]
        print(f"  e = {e:g}: {sum(mine)} of {len(mine)}")
    shapes = Counter((o.known.rests, o.known.leaves) for o in outcomes)
    print(
        f"the best motion rests and jumps: {shapes[True, True]}, "
        f"rests to the end: {shapes[True, False]}, never rests: {shapes[False, False]}"
    )
    seconds = [outcome.seconds for outcome in outcomes]
    print(f"seconds a plan: median {np.median(seconds):.2f}, at most {np.max(seconds):.2f}")
    return right >= ASKED * count


def main() -> int:
    """Runs all scenarios and returns the exit status."""
    options = read_flags(__doc__, count=(200, ""), seed=(0, ""))
    jobs = [Job(*each) for each in draw(options.count, options.seed)]
    outcomes = run_all(run, jobs, options)
    is_enough = report(outcomes)
    print(f"{len(outcomes)} of {len(jobs)} scenarios done")
    return 0 if is_enough and len(outcomes) == len(jobs) else 1


if __name__ == "__main__":
    run_as("benchmarks.floors")
