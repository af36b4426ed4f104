"""How much plans suffer where the truth is a little other than they were made for."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import AbstractContextManager

from benchmarks.robustness.question import RobustnessQuestion, Task
from benchmarks.robustness.results import (
    DRAKE,
    FEEDBACK,
    GRADIENT,
    OPEN_LOOP,
    OURS,
    Outcome,
    PlanResult,
    RobustnessStudy,
    TaskResult,
    round_as_filed,
)
from drake_aigto.control import FlightFeedback, track_drake, track_event_driven
from drake_aigto.count import Count
from drake_aigto.errors import AigtoError
from drake_aigto.jobs import Jobs, open_jobs
from drake_aigto.local import solve_with_drake
from drake_aigto.optima import rigid_optimum
from drake_aigto.plain import to_plain
from drake_aigto.planning import Planner, PlanOptions
from drake_aigto.simulation import Replay, replay_event_driven
from drake_aigto.simulation.contacts import find_contacts
from drake_aigto.study.results_file import check_results_file, check_same_question
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import PhaseTranscription
from drake_aigto.world import Scenario, World

_LOG = logging.getLogger(__name__)

_OPTIONS = PlanOptions(confirm=False, threads=1)


def run_robustness(
    question: RobustnessQuestion,
    path: str | os.PathLike[str] | None = None,
    *,
    resume: bool = False,
    executor: AbstractContextManager[Executor] | None = None,
    progress: Callable[[str], None] | None = None,
) -> RobustnessStudy:
    """Plans for all tasks, and replays every plan under all perturbations.

    What is done is written after each task, so that Ctrl-C loses little.

    Args:
        question: what to run.
        path: of the results; None keeps them in memory only.
        resume: go on from the results that are there.
        executor: where tasks run, entered once all is checked; `open_workers`, with a process a
            core, if None.
        progress: called with a line of text after each task.

    Raises:
        OptionsError, ScenarioError: from `RobustnessQuestion.check`.
        OutputFileError: the results can't be written.
        ResultsFileError: there are results and they are not to be gone on from; or they are damaged
            or another study's.
        StudyError: from `open_workers`; or the processes that ran a task died: the others are done.
    """
    question.check()
    known = RobustnessStudy(question)
    if path and check_results_file(path, resume):
        known = RobustnessStudy.load(path)
        check_same_question(path, to_plain(known.question), to_plain(question))
    with open_jobs(executor) as jobs:
        return _run(known, path, jobs, progress)


def _run(
    known: RobustnessStudy,
    path: str | os.PathLike[str] | None,
    jobs: Jobs,
    progress: Callable[[str], None] | None,
) -> RobustnessStudy:
    """Returns a study with those tasks run that were not."""
    study = known
    done = {result.name for result in known.results}
    tasks = known.question.tasks()
    for task in tasks:
        if task.name not in done:
            jobs.start(task.name, run_task, task, known.question)
    for name, future in jobs.ended():
        study = study.with_result(future.result())
        _LOG.info("%s: done", name)
        if path:
            study.save(path)
        if progress:
            progress(Count(len(study.results), len(tasks), "tasks done"))
    return study


def run_task(task: Task, question: RobustnessQuestion) -> TaskResult:
    """Plans for one task, both ways, and replays the plans under its perturbations."""
    scenario, perturbations = task.scenario, question.perturbations(task.scenario)
    world = World.from_scenario(scenario)
    truths = [perturbation.apply(world, scenario) for perturbation in perturbations]
    planners = {OURS: _plan, GRADIENT: plan_without_contact}
    return TaskResult(
        name=task.name,
        scenario=scenario,
        optimum=round_as_filed(rigid_optimum(world, scenario).cost),
        kinds=tuple(perturbation.kind for perturbation in perturbations),
        optima=tuple(round_as_filed(rigid_optimum(*truth).cost) for truth in truths),
        plans=tuple(
            _judge(method, make_plan, world, scenario, truths, question)
            for method, make_plan in planners.items()
        ),
    )


def _plan(world: World, scenario: Scenario) -> Trajectory:
    return Planner(scenario, _OPTIONS, world).plan().trajectory


def plan_without_contact(world: World, scenario: Scenario) -> Trajectory:
    """Returns what IPOPT makes of exact flight with φ ≥ 0, from the straight line: no contact.

    It is what gradient solvers find for AIGTO's Table I: brake, turn, accelerate.
    """
    phases = PhaseTranscription(world, scenario)
    guess = phases.vector(phases.guess())
    return phases.trajectory(solve_with_drake(phases.prog(), guess, "ipopt").x)


def _judge(
    method: str,
    make_plan: Callable[[World, Scenario], Trajectory],
    world: World,
    scenario: Scenario,
    truths: list[tuple[World, Scenario]],
    question: RobustnessQuestion,
) -> PlanResult:
    """Returns what becomes of a plan, or why there is none that can be tracked."""
    try:
        plan = make_plan(world, scenario)
        controller = FlightFeedback(world, scenario, plan)
    except AigtoError as error:
        return PlanResult(method, error=str(error))
    control = plan.times, plan.controls
    contacts = tuple(contact.index for contact in find_contacts(world, plan))
    nominal = replay_event_driven(world, scenario, *control)
    runs: dict[str, Callable[[World, Scenario], Replay]] = {
        OPEN_LOOP: lambda world, scenario: replay_event_driven(world, scenario, *control),
        FEEDBACK: lambda world, scenario: track_event_driven(world, scenario, controller).replay,
    }
    if question.confirm:
        runs[DRAKE] = lambda world, scenario: track_drake(world, scenario, controller).replay
    return PlanResult(
        method,
        round_as_filed(nominal.cost),
        round_as_filed(nominal.goal_error),
        tuple(map(round_as_filed, nominal.bounce_times)),
        {
            name: tuple(_summarize(run(*truth), contacts) for truth in truths)
            for name, run in runs.items()
        },
    )


def _summarize(replay: Replay, contacts: tuple[int, ...]) -> Outcome:
    return Outcome(
        round_as_filed(replay.cost),
        round_as_filed(replay.goal_error),
        replay.bounce_contacts == contacts,
    )
