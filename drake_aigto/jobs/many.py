"""Many questions in, plans out as they come: side by side, kept, and gone on from."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import AbstractContextManager

from drake_aigto.errors import AigtoError, OptionsError
from drake_aigto.jobs.answers import Answer, AnswerFolder
from drake_aigto.jobs.jobs import ProcessDiedError, open_jobs
from drake_aigto.jobs.workers import open_workers
from drake_aigto.planning import Planner, PlanningError, PlanOptions
from drake_aigto.progress import Count
from drake_aigto.world import Scenario


def plan_many(
    scenarios: Mapping[str, Scenario] | Iterable[Scenario],
    options: PlanOptions | None = None,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    folder: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Iterator[Answer]:
    """Plans for many scenarios in parallel, and yields each answer as it is ready.

    All is checked before this returns; work begins with the first answer that is requested. If a
    question has no plan or its process dies, its answer is the error, and the others continue.
    Plans are those of `plan`, to the last bit. Ctrl-C, or leaving the loop, ends the workers:
    all yielded answers are in the folder.

    Args:
        scenarios: the questions, by name; without names, they have their numbers.
        options: of every plan; the defaults, on one thread each, if None.
        workers: number of processes of this machine, started below a script's
            ``if __name__ == "__main__":``; None: one per core.
        scheduler: address of a Dask scheduler whose workers plan instead (extra ``cluster``).
        folder: keeps each plan as ``NAME.json`` and all answers in ``answers.jsonl``
            (`load_answers`); None keeps nothing.
        resume: continue from the answers in the folder: they are yielded first, and not planned
            again, except those whose processes died.
        progress: called with a line of text (`Count`) after each answer.

    Raises:
        OptionsError: no questions, no name, fewer than one worker, or options that do not fit.
        ScenarioError, ModelError: a question that can't be asked; names it.
        OutputFileError, ResultsFileError, PlanFileError: from `AnswerFolder`.
        StudyError, MissingExtraError: workers that are not fit, from `open_workers`.
    """
    named = scenarios if isinstance(scenarios, Mapping) else dict(_numbered(scenarios))
    _check(named, options)
    kept = None if folder is None else AnswerFolder(folder, options, resume)
    done = kept.done(named) if kept else {}
    executor = open_workers(workers, scheduler)
    return _answer(named, options, executor, kept, done, progress)


def _numbered(scenarios: Iterable[Scenario]) -> Iterator[tuple[str, Scenario]]:
    return ((str(number), scenario) for number, scenario in enumerate(scenarios))


def _check(scenarios: Mapping[str, Scenario], options: PlanOptions | None) -> None:
    """Refuses what would fail in the middle of long work."""
    if not scenarios:
        raise OptionsError("scenarios", got="none", expected="one or more")
    for name, scenario in scenarios.items():
        if not name or name.startswith(("/", ".")) or ".." in name.split("/"):
            raise OptionsError("the name of a question", got=repr(name), expected="a file's name")
        try:
            Planner(scenario, options)
        except AigtoError as error:
            what = f"{name}: {error.what}"
            raise type(error)(what, error.got, error.expected, error.remedy) from error


def _answer(
    scenarios: Mapping[str, Scenario],
    options: PlanOptions | None,
    executor: AbstractContextManager[Executor],
    kept: AnswerFolder | None,
    done: Mapping[str, Answer],
    progress: Callable[[str], None] | None,
) -> Iterator[Answer]:
    """Yields finished answers, then the others as they are ready."""
    yield from done.values()
    if len(done) == len(scenarios):
        return
    num_done, num_holding = len(done), sum(answer.holds for answer in done.values())
    with open_jobs(executor) as jobs:
        for name, scenario in scenarios.items():
            if name not in done:
                jobs.start(name, answer_question, name, scenario, options)
        for name, future in jobs.ended():
            try:
                answer = future.result()
            except ProcessDiedError as error:
                answer = Answer(name, scenarios[name], 0.0, str(error), died=True)
            if kept:
                kept.keep(answer)
            num_done, num_holding = num_done + 1, num_holding + answer.holds
            if progress:
                progress(Count(num_done, len(scenarios), f"questions; {num_holding} plans hold"))
            yield answer


def answer_question(name: str, scenario: Scenario, options: PlanOptions | None = None) -> Answer:
    """Plans in this process, and returns the plan, or its error."""
    start, plan, error = time.process_time(), None, None
    try:
        planner = Planner(scenario, options)
        if options is None:  # Other cores are for other questions.
            alone = dataclasses.replace(planner.options, threads=1)
            planner = Planner(scenario, alone, planner.world)
        plan = planner.plan()
    except PlanningError as failure:
        plan, error = failure.plan, str(failure)
    except Exception as failure:  # Whatever it is, the other questions are not to be lost for it.
        error = f"{type(failure).__name__}: {failure}"
    return Answer(name, scenario, time.process_time() - start, error, plan=plan)
