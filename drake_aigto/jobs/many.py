"""Many questions in, plans out as they come: side by side, kept, and gone on from.

Answers are kept in a folder of plan files, with a line for each.
"""

from __future__ import annotations

import dataclasses
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drake_aigto import __version__
from drake_aigto.errors import AigtoError, OptionsError, ResultsFileError
from drake_aigto.jobs.jobs import ProcessDiedError, open_jobs, open_workers
from drake_aigto.plain import LEFT_OUT, check_writable, from_plain, to_plain, write_text
from drake_aigto.planning import Plan, Planner, PlanningError, PlanOptions
from drake_aigto.progress import Count
from drake_aigto.world import Scenario

_INDEX = "answers.jsonl"
_FORMAT = "drake_aigto answers"


@dataclass(frozen=True)
class Answer:
    """Plan of one of many questions, or why it has none.

    Attributes:
        name: of the question.
        scenario: the question.
        seconds: CPU time of the process that planned, its world included [s].
        error: why no plan holds; None if the plan does.
        died: whether two processes died of it, one after the other; `resume` tries it again.
        plan: the plan; with an error, the best that does not hold, if there is one.
    """

    name: str
    scenario: Scenario
    seconds: float
    error: str | None = None
    died: bool = False
    plan: Plan | None = field(default=None, metadata=LEFT_OUT)

    @property
    def holds(self) -> bool:
        """Whether there is a plan that holds in simulation."""
        return self.error is None


class AnswerFolder:
    """Folder of a plan file for each answer, ``NAME.json``, and ``answers.jsonl`` about all.

    The latter begins with a line about how plans are made, and grows by a line with each answer:
    whenever work ends, all finished answers are there.
    """

    def __init__(self, folder: str | os.PathLike[str], options: object, resume: bool) -> None:
        """Reads the answers that are there, or makes the folder.

        Args:
            folder: its path.
            options: what all plans are made with.
            resume: whether to go on from answers that are there.

        Raises:
            OutputFileError: the folder can't be written.
            ResultsFileError: it has answers, and they are not to be gone on from; or they are
                damaged, or were made with other options.
        """
        self._folder = Path(folder)
        self._index = self._folder / _INDEX
        head = {"format": _FORMAT, "drake_aigto": __version__, "options": to_plain(options)}
        if not self._folder.exists():
            check_writable(self._folder)
            self._folder.mkdir()
        check_writable(self._index)
        there, self.answers = _read(self._index) if self._index.exists() else (head, {})
        if self.answers and not resume:
            raise ResultsFileError(
                f"folder {folder}",
                got="one that has answers",
                remedy="Go on from them (--resume), name another, or delete it first.",
            )
        if self.answers and there != head:
            names = [name for name in head if there.get(name) != head[name]]
            raise ResultsFileError(
                f"folder {folder} has other answers",
                got=", ".join(f"{name} {there.get(name)}" for name in names),
                expected=", ".join(f"{name} {head[name]}" for name in names),
                remedy="Name another folder.",
            )
        # A line that was cut short by the end of a process is not gone on from.
        lines = [head, *map(to_plain, self.answers.values())]
        write_text(self._index, "".join(f"{json.dumps(line)}\n" for line in lines))

    def done(self, questions: Mapping[str, Scenario]) -> dict[str, Answer]:
        """Returns the answers to these questions, with their plans.

        Those that processes died of are not done.

        Raises:
            ResultsFileError: the folder has another question of one of these names.
            PlanFileError: a plan file is gone, or damaged.
        """
        found = {}
        for name, scenario in questions.items():
            answer = self.answers.get(name)
            if answer is None or answer.died:
                continue
            if answer.scenario != scenario:
                raise ResultsFileError(
                    f"folder {self._folder}",
                    got=f"the answer to another question of the name {name!r}",
                    expected="the same questions",
                    remedy="Name another folder, or give questions other names.",
                )
            found[name] = _with_plan(answer, self._folder)
        return found

    def keep(self, answer: Answer) -> None:
        """Writes an answer.

        Raises:
            OutputFileError: it can't be written.
        """
        if answer.plan is not None:
            path = _path(self._folder, answer.name)
            path.parent.mkdir(parents=True, exist_ok=True)
            answer.plan.save(path)
        self.answers[answer.name] = answer
        with self._index.open("a", encoding="utf-8") as file:
            file.write(f"{json.dumps(to_plain(answer))}\n")


def load_answers(folder: str | os.PathLike[str]) -> list[Answer]:
    """Returns the answers that `plan_many` kept in a folder, with their plans.

    Raises:
        ResultsFileError: there are none, or they are damaged.
        PlanFileError: a plan file is damaged.
    """
    _, answers = _read(Path(folder) / _INDEX)
    return [_with_plan(answer, Path(folder)) for answer in answers.values()]


def _path(folder: Path, name: str) -> Path:
    return folder / f"{name}.json"


def _with_plan(answer: Answer, folder: Path) -> Answer:
    """Returns an answer with the plan of its file, which not every answer has."""
    path = _path(folder, answer.name)
    if not answer.holds and not path.exists():
        return answer
    plan = Plan.load(path)
    return Answer(answer.name, answer.scenario, answer.seconds, answer.error, answer.died, plan)


def _read(index: Path) -> tuple[dict[str, Any], dict[str, Answer]]:
    """Returns the first line of an index, and the last answer of each name."""
    try:
        text = index.read_text(encoding="utf-8")
        head, *lines = map(json.loads, text[: text.rfind("\n") + 1].splitlines())
        answers = [from_plain(Answer, line) for line in lines]
        if head["format"] != _FORMAT:
            raise KeyError("format")
    except (OSError, ValueError, KeyError, TypeError, AigtoError) as error:
        raise ResultsFileError(
            f"{index} can't be read, or is damaged", got=error, remedy="Plan again."
        ) from error
    return head, {answer.name: answer for answer in answers}


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
    named = (
        scenarios
        if isinstance(scenarios, Mapping)
        else {str(number): scenario for number, scenario in enumerate(scenarios)}
    )
    _check(named, options)
    kept = None if folder is None else AnswerFolder(folder, options, resume)
    done = kept.done(named) if kept else {}
    executor = open_workers(workers, scheduler)
    return _answer(named, options, executor, kept, done, progress)


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
            raise type(error)(what, *error.args[1:]) from error


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
