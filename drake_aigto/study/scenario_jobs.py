"""What a worker does in a study of random scenarios: one method on one scenario."""

from __future__ import annotations

import dataclasses
import time
from functools import cache, lru_cache

from drake_aigto.baselines import run_baseline
from drake_aigto.optima import RigidOptimum, rigid_optimum
from drake_aigto.planning import Plan, Planner, PlanOptions
from drake_aigto.study.method_run import PLANNER, Job, MethodRun
from drake_aigto.world import Scenario, World

OPTIONS = PlanOptions(confirm=False, threads=1)
# The same, with the boxes of every rung and every candidate, whether or not they can win.
EXHAUSTIVE = dataclasses.replace(OPTIONS, exhaustive=True)
# What a process does at first is not measured: it loads libraries and kernels. [s]
_WARM_UP = 0.2


def run_job(job: Job) -> MethodRun:
    """Returns what a method made of a scenario, and be it an error.

    Time is the CPU time of this process, after the method has run here once.
    """
    start = time.process_time()
    try:
        _warm_up(job.method if job.runner is None else PLANNER)
        world = _make_world(job.scenario.mass)
        run = (job.runner or _run_method)(world, job)
    except Exception as error:  # Whatever it is, this is how the method did.
        text = f"{type(error).__name__}: {error}"
        run = MethodRun((), time.process_time() - start, error=text)
    return run


def find_optimum(scenario: Scenario) -> RigidOptimum:
    """Returns the exact optimum, which no job knows."""
    return rigid_optimum(_make_world(scenario.mass), scenario)


def _run_method(world: World, job: Job) -> MethodRun:
    return _run_planner(world, job) if job.method == PLANNER else _run_baseline(world, job)


def _run_planner(world: World, job: Job) -> MethodRun:
    start = time.process_time()
    plan = Planner(job.scenario, OPTIONS, world).plan()
    seconds = time.process_time() - start
    cost = plan.replay.event_driven.cost
    boxes: tuple[int, ...] = ()
    if job.reads_boxes:
        boxes = read_boxes(Planner(job.scenario, EXHAUSTIVE, world).plan())
    return MethodRun(((seconds, cost),), seconds, len(plan.candidates), boxes=boxes)


def read_boxes(plan: Plan) -> tuple[int, ...]:
    """Returns how many contacts the last box of each rung shows, for a plan with all rungs."""
    return tuple(count for count in plan.stats.box_contacts if count is not None)


def _run_baseline(world: World, job: Job) -> MethodRun:
    run = run_baseline(job.method, world, job.scenario, job.seconds, job.seed, job.good_enough)
    improvements = tuple((each.seconds, each.cost) for each in run.improvements)
    return MethodRun(improvements, run.seconds, run.evaluations)


@lru_cache(maxsize=4)
def _make_world(mass: float | None) -> World:
    """Returns the world of all scenarios with this mass, made once a process."""
    return World.from_scenario(dataclasses.replace(_any_scenario(), mass=mass))


@cache
def _warm_up(method: str) -> None:
    """Has a method run once in this process."""
    scenario = _any_scenario()
    world = _make_world(scenario.mass)
    if method == PLANNER:
        Planner(scenario, OPTIONS, world).plan()
    else:
        run_baseline(method, world, scenario, _WARM_UP)


def _any_scenario() -> Scenario:
    return Scenario.named("table1/1")
