"""Answers to many questions, and the folder that keeps them: plan files, and a line for each."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drake_aigto import __version__
from drake_aigto.errors import AigtoError, ResultsFileError
from drake_aigto.output import check_writable, write_text
from drake_aigto.plain import LEFT_OUT, from_plain, to_plain
from drake_aigto.planning import Plan
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
