"""One method on one scenario: what it is asked, and what it did."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import TypeAlias

from benchmarks.baselines import run_baseline
from benchmarks.study.study import round_to
from drake_aigto.paper import RigidOptimum, rigid_optimum
from drake_aigto.planning import Plan, Planner, PlanOptions
from drake_aigto.world import Scenario, World

PLANNER = "aigto"
OPTIONS = PlanOptions(confirm=False, threads=1)
# The same, with the boxes of every rung and every candidate, whether or not they can win.
EXHAUSTIVE = dataclasses.replace(OPTIONS, exhaustive=True)
# Significant digits in files: of costs so that ratios near 1 are still told apart.
COST_DIGITS, _SECONDS_DIGITS = 7, 4
# What a process does at first is not measured: it loads libraries and kernels. [s]
_WARM_UP = 0.2


@dataclass(frozen=True)
class MethodRun:
    """What one method did on one scenario.

    Attributes:
        improvements: seconds of one core since it began, and the cost then, by event-driven replay
            on the rigid wall; each cheaper than the one before. Only those that were the best when
            a budget ended, and the last.
        seconds: of one core, that it took.
        evaluations: how many controls were replayed; of the planner, how many candidates it had.
        error: what it failed with, if it did.
        boxes: of the planner, if the question asks: the number of contacts in the last box of each
            rung, before any polish.
    """

    improvements: tuple[tuple[float, float], ...]
    seconds: float
    evaluations: int = 0
    error: str | None = None
    boxes: tuple[int, ...] = ()

    @property
    def cost(self) -> float:
        """The best; infinity if nothing was found."""
        return self.cost_within(math.inf)

    def cost_within(self, seconds: float) -> float:
        """Returns the best after these seconds, infinity if there was none."""
        return min((cost for at, cost in self.improvements if at <= seconds), default=math.inf)

    def thinned(self, ends: Iterable[float]) -> MethodRun:
        """Returns this run as files have it: what was best at these times, and in the end.

        Times are rounded down, so that what was in time still is.
        """
        kept = {}
        for end in (*ends, math.inf):
            for at, cost in [each for each in self.improvements if each[0] <= end][-1:]:
                kept[round_to(at, _SECONDS_DIGITS, down=True)] = round_to(cost, COST_DIGITS)
        seconds = round_to(self.seconds, _SECONDS_DIGITS)
        return MethodRun(
            tuple(sorted(kept.items())), seconds, self.evaluations, self.error, self.boxes
        )


@dataclass(frozen=True)
class Job:
    """One method on one scenario.

    Attributes:
        number: of the scenario in its study.
        scenario: the task.
        method: "aigto", or a baseline's name.
        seconds: of one core that a baseline has.
        good_enough: the cost at which a baseline may stop.
        seed: of a baseline.
        reads_boxes: whether it is kept what the planner's boxes say without any polish.
        runner: what runs it, if not the planner or a baseline; a function of a module, so that it
            can be sent to another process.
    """

    number: int
    scenario: Scenario
    method: str
    seconds: float = 0.0
    good_enough: float = -math.inf
    seed: int = 0
    reads_boxes: bool = False
    runner: Runner | None = None


Runner: TypeAlias = Callable[[World, Job], MethodRun]


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
    if job.method != PLANNER:
        run = run_baseline(job.method, world, job.scenario, job.seconds, job.seed, job.good_enough)
        return MethodRun(run.improvements, run.seconds, run.evaluations)
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


@lru_cache(maxsize=4)
def _make_world(mass: float | None) -> World:
    """Returns the world of all scenarios with this mass, made once a process."""
    return World.from_scenario(dataclasses.replace(Scenario.named("table1/1"), mass=mass))


@cache
def _warm_up(method: str) -> None:
    """Runs a method once in this process."""
    scenario = Scenario.named("table1/1")
    world = _make_world(scenario.mass)
    if method == PLANNER:
        Planner(scenario, OPTIONS, world).plan()
    else:
        run_baseline(method, world, scenario, _WARM_UP)
