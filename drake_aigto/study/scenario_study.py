"""How often, and how fast, methods find the global optimum of random scenarios."""

from __future__ import annotations

import dataclasses
import logging
import os
import time
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager
from functools import cache, lru_cache

from drake_aigto.baselines import run_baseline
from drake_aigto.count import Count
from drake_aigto.jobs import Jobs, ProcessDiedError, open_jobs
from drake_aigto.optima import RigidOptimum, rigid_optimum
from drake_aigto.plain import to_plain
from drake_aigto.planning import Plan, Planner, PlanOptions
from drake_aigto.study.method_run import COST_DIGITS, PLANNER, Job, MethodRun
from drake_aigto.study.results_file import check_results_file, check_same_question, round_to
from drake_aigto.study.scenario_question import ScenarioQuestion
from drake_aigto.study.scenario_results import DIED, ScenarioResult, ScenarioStudy
from drake_aigto.world import Scenario, World

_LOG = logging.getLogger(__name__)

_SECONDS_BETWEEN_SAVES = 5.0
OPTIONS = PlanOptions(confirm=False, threads=1)
# The same, with the boxes of every rung and every candidate, whether or not they can win.
EXHAUSTIVE = dataclasses.replace(OPTIONS, exhaustive=True)
# What a process does at first is not measured: it loads libraries and kernels. [s]
_WARM_UP = 0.2


def run_scenario_study(
    question: ScenarioQuestion,
    path: str | os.PathLike[str] | None = None,
    *,
    resume: bool = False,
    executor: AbstractContextManager[Executor] | None = None,
    progress: Callable[[str], None] | None = None,
) -> ScenarioStudy:
    """Runs all methods on all scenarios.

    The planner goes first on each scenario, as its time is the unit of the others' budgets. What is
    done is written every few seconds, and at the end, whatever that is: Ctrl-C, a crash, a pool
    that broke.

    Args:
        question: what to run.
        path: of the results; None keeps them in memory only.
        resume: go on from the results that are there. Theirs may be of fewer scenarios and methods;
            all else has to be the same. Jobs whose process died are tried again.
        executor: where jobs run, entered once all is checked; `open_workers`, with a process a
            core, if None. Any will do that pickles; its processes should have one thread each.
        progress: called with a line of text after each job.

    Raises:
        OptionsError, MissingExtraError, ScenarioError: from `ScenarioQuestion.check`.
        OutputFileError: the results can't be written.
        ResultsFileError: there are results and they are not to be gone on from; or they are damaged
            or another study's.
        StudyError: from `open_workers`; or the executor broke.
    """
    question.check()
    known = _load(question, path) if path and check_results_file(path, resume) else ()
    with open_jobs(executor) as jobs:
        return _Sweep(question, path, known, jobs, progress).run()


def _load(question: ScenarioQuestion, path: str | os.PathLike[str]) -> tuple[ScenarioResult, ...]:
    """Returns the results in a file, if they are of this question or of a part of it."""
    study = ScenarioStudy.load(path, type(question))
    here, there = to_plain(question), to_plain(study.question)
    if study.question.count <= question.count:
        there["count"] = here["count"]
    if set(study.question.methods) <= set(question.methods):
        there["methods"] = here["methods"]
    check_same_question(path, there, here)
    return study.results


class _Sweep:
    """One run of a study: which jobs are done, which are under way, which come next."""

    def __init__(
        self,
        question: ScenarioQuestion,
        path: str | os.PathLike[str] | None,
        known: Iterable[ScenarioResult],
        jobs: Jobs,
        progress: Callable[[str], None] | None,
    ) -> None:
        self._question, self._path, self._jobs, self._progress = question, path, jobs, progress
        self._results = {result.number: result for result in known}
        self._saved = time.monotonic()

    def run(self) -> ScenarioStudy:
        """Runs what is not done, and returns all."""
        try:
            for number in range(self._question.count):
                self._start(number, self._ready_methods(number))
            for job, future in self._jobs.ended():
                self._take(job, future)
        finally:
            self._save()
        return self._study()

    def _ready_methods(self, number: int) -> tuple[str, ...]:
        """Returns the methods whose time on a scenario is known."""
        if self._question.runner is not None:
            return self._question.methods
        others = tuple(name for name in self._question.methods if name != PLANNER)
        asks_planner = PLANNER in self._question.methods
        return (PLANNER,) * asks_planner + others * (self._unit(number) is not None)

    def _unit(self, number: int) -> float | None:
        result = self._results.get(number)
        return self._question.seconds_per_unit or (result.planner_seconds if result else None)

    def _start(self, number: int, methods: Iterable[str]) -> None:
        """Has those of the methods run that are not done."""
        result = self._results.get(number)
        for method in methods:
            run = result.runs.get(method) if result else None
            if run is None or run.error == DIED:
                job = self._make_job(number, method)
                self._jobs.start(job, run_job, job)

    def _make_job(self, number: int, method: str) -> Job:
        question, scenario = self._question, self._question.scenario(number)
        if method == PLANNER or question.runner is not None:
            reads_boxes, runner = question.reads_boxes, question.runner
            return Job(number, scenario, method, reads_boxes=reads_boxes, runner=runner)
        return Job(
            number,
            scenario,
            method,
            seconds=question.budgets[-1] * (self._unit(number) or 0.0),
            good_enough=self._result(number).good_enough,
            seed=question.method_seed(number),
        )

    def _take(self, job: Job, future: Future[MethodRun]) -> None:
        """Keeps what came of a job, and starts what waited for it."""
        try:
            run = future.result()
        except ProcessDiedError:
            run = MethodRun((), 0.0, error=DIED)
        self._keep(job, run)
        if job.method == PLANNER and self._question.seconds_per_unit is None:
            waiting = [name for name in self._ready_methods(job.number) if name != PLANNER]
            self._start(job.number, waiting)

    def _keep(self, job: Job, run: MethodRun) -> None:
        result = self._result(job.number)
        unit = self._unit(job.number) or 0.0
        thinned = run.thinned(budget * unit for budget in self._question.budgets)
        runs = {**result.runs, job.method: thinned}
        in_order = {name: runs[name] for name in self._question.methods if name in runs}
        self._results[job.number] = dataclasses.replace(result, runs=in_order)
        if time.monotonic() - self._saved > _SECONDS_BETWEEN_SAVES:
            self._save()
        outcome = run.error or f"{run.seconds:.2f} s"
        _LOG.info("scenario %d, %s: %s", job.number, job.method, outcome)
        if self._progress:
            self._progress(describe_progress(self._study()))

    def _result(self, number: int) -> ScenarioResult:
        """Returns what there is of a scenario; at first, its exact optimum."""
        if number not in self._results:
            scenario = self._question.scenario(number)
            exact = find_optimum(scenario)
            self._results[number] = ScenarioResult(
                number, scenario, round_to(exact.cost, COST_DIGITS), len(exact.bounce_times)
            )
        return self._results[number]

    def _study(self) -> ScenarioStudy:
        return ScenarioStudy(
            self._question, tuple(self._results[number] for number in sorted(self._results))
        )

    def _save(self) -> None:
        if self._path is not None and self._results:
            self._study().save(self._path)
            self._saved = time.monotonic()


def describe_progress(study: ScenarioStudy) -> Count:
    """Returns in a line how much is done, and how often each method has found the optimum."""
    question = study.question
    counts = []
    for method in question.methods:
        done = list(study.of_method(method))
        solved = sum(study.succeeds(result, method, question.budgets[-1]) for result in done)
        counts.append(f"{method} {solved}/{len(done)}")
    runs = sum(len(result.runs) for result in study.results)
    total = question.count * len(question.methods)
    return Count(runs, total, f"runs; optimal: {', '.join(counts)}")


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


def _run_method(world: World, job: Job) -> MethodRun:
    if job.method == PLANNER:
        return _run_planner(world, job)
    run = run_baseline(job.method, world, job.scenario, job.seconds, job.seed, job.good_enough)
    return MethodRun(run.improvements, run.seconds, run.evaluations)


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
