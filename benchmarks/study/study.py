"""One way to measure: questions × methods, run as jobs, judged, kept in a file, gone on from."""

from __future__ import annotations

import json
import logging
import math
import os
import shlex
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, replace
from decimal import ROUND_DOWN, ROUND_HALF_EVEN, Context
from pathlib import Path
from types import GenericAlias
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

from drake_aigto.errors import AigtoError, ResultsFileError
from drake_aigto.jobs import open_jobs
from drake_aigto.output import check_writable, write_text
from drake_aigto.plain import from_plain, read_json, to_plain
from drake_aigto.progress import Count

_LOG = logging.getLogger(__name__)
_SECONDS_BETWEEN_SAVES = 5.0

_Question = TypeVar("_Question", bound="StudyQuestion")
_Result = TypeVar("_Result")
_Self = TypeVar("_Self", bound="Study[Any, Any]")


class StudyQuestion:
    """Dataclass of what a study asks: which questions, which methods.

    Attributes:
        kind: of the files that answer it.
        command: that asks it.
        flags: field → flag, where they differ.
        told: fields that `command_of` tells even where they are as usual.
    """

    kind: ClassVar[str]
    command: ClassVar[str]
    flags: ClassVar[Mapping[str, str]] = {}
    told: ClassVar[Sequence[str]] = ()

    def check(self) -> None:
        """Checks what would else fail in the middle of long work."""


class Call(NamedTuple):
    """One job of a study: its name among those of one question, and what is called."""

    name: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...]


@dataclass(frozen=True)
class Study(ABC, Generic[_Question, _Result]):
    """A question, and the results so far; a kind of study says which jobs there are.

    Attributes:
        question: what is asked.
        results: those that there are, in that of `order`.
    """

    question: _Question
    results: tuple[_Result, ...] = ()

    question_type: ClassVar[Any]
    result_type: ClassVar[Any]

    @abstractmethod
    def order(self) -> Iterable[Hashable]:
        """Returns what results are told apart by, in their order."""

    @abstractmethod
    def key_of(self, result: _Result) -> Hashable:
        """Returns the key of a result."""

    @abstractmethod
    def calls(self, key: Any, result: _Result | None) -> Iterable[Call]:
        """Yields the jobs of a key that can start now and are not done; the result is so far."""

    @abstractmethod
    def taken(self, key: Any, result: _Result | None, name: str, future: Future[Any]) -> _Result:
        """Returns the result with what came of one more job."""

    @abstractmethod
    def progress(self) -> Count:
        """Returns in a line how much is done."""

    def first_keys(self) -> Iterable[Hashable]:
        """Returns the keys in the order in which their jobs start."""
        return self.order()

    def resumed(self: _Self, path: str | os.PathLike[str]) -> _Self:
        """Returns this study with the results of a file of the same question.

        Raises:
            ResultsFileError: the file is damaged, or another study's.
        """
        known = self.load(path)
        check_same_question(path, to_plain(known.question), to_plain(self.question))
        return replace(self, results=known.results)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a file that `load` reads, whole or not at all, a line for each result.

        Raises:
            OutputFileError: it can't be written.
        """
        head = {"kind": self.question.kind, "question": to_plain(self.question)}
        lines = ",\n".join(json.dumps(to_plain(each)) for each in self.results)
        text = json.dumps(head, indent=1).removesuffix("\n}")
        write_text(path, f'{text},\n "results": [\n{lines}\n]}}\n')

    @classmethod
    def load(cls: type[_Self], path: str | os.PathLike[str]) -> _Self:
        """Reads the file that `save` wrote.

        Raises:
            ResultsFileError: no such file, damaged, or of another kind.
        """
        data = read_results(path, cls.question_type.kind)
        with refuse_damaged(path):
            question = from_plain(cls.question_type, data["question"])
            kind: Any = GenericAlias(tuple, (cls.result_type, ...))
            results: Any = from_plain(kind, data["results"], "results")
        return cls(question, results)

    def run(
        self: _Self,
        path: str | os.PathLike[str] | None = None,
        *,
        resume: bool = False,
        executor: AbstractContextManager[Executor] | None = None,
        progress: Callable[[str], None] | None = None,
        minutes: float = math.inf,
    ) -> _Self:
        """Runs all jobs that are not done, and returns the study with what came of them.

        What is done is written every few seconds, and at the end, whatever that is: Ctrl-C, a
        crash, a pool that broke.

        Args:
            path: of the results; None keeps them in memory only.
            resume: go on from the results that are there.
            executor: where jobs run, entered once all is checked; `open_workers`, with a process a
                core, if None. Its processes should have one thread each.
            progress: called with a line of text after each job.
            minutes: after which what is not done is left out.

        Raises:
            OptionsError, MissingExtraError, ScenarioError: from `check` of the question.
            OutputFileError: the results can't be written.
            ResultsFileError: there are results and they are not to be gone on from; or they are
                damaged or another study's.
            StudyError: from `open_workers`; or the executor broke.
        """
        self.question.check()
        study = self.resumed(path) if path and check_results_file(path, resume) else self
        done = {study.key_of(result): result for result in study.results}
        begun: set[tuple[Hashable, str]] = set()

        def so_far() -> _Self:
            return replace(study, results=tuple(done[key] for key in study.order() if key in done))

        with open_jobs(executor) as jobs:

            def start(key: Hashable) -> None:
                for name, function, arguments in study.calls(key, done.get(key)):
                    if (key, name) not in begun:
                        begun.add((key, name))
                        jobs.start((key, name), function, *arguments)

            saved = time.monotonic()
            try:
                for key in study.first_keys():
                    start(key)
                with suppress(TimeoutError):
                    for (key, name), future in jobs.ended(60.0 * minutes):
                        done[key] = study.taken(key, done.get(key), name, future)
                        _LOG.info("%s, %s: done", key, name)
                        start(key)
                        if path and time.monotonic() - saved > _SECONDS_BETWEEN_SAVES:
                            so_far().save(path)
                            saved = time.monotonic()
                        if progress:
                            progress(so_far().progress())
            finally:
                if path and done:
                    so_far().save(path)
        return so_far()


@dataclass(frozen=True)
class WorldStudy(Study[_Question, _Result]):
    """Study of numbered questions about worlds, with a best known cost of each.

    Results have the world and the number of their question.

    Attributes:
        refresh: whether what is better than the best known takes its place.
    """

    refresh: bool = False

    @abstractmethod
    def order(self) -> list[tuple[str, int]]:
        """Returns the questions, world by world."""

    def first_keys(self) -> list[tuple[str, int]]:
        """Returns one question of each world at first: time may be up."""
        return sorted(self.order(), key=lambda key: key[1])

    def key_of(self, result: Any) -> tuple[str, int]:
        """Returns whose question a result is about, and which."""
        return result.world, result.number

    def progress(self) -> Count:
        """Returns how many questions are answered."""
        return Count(len(self.results), len(self.order()), "questions answered")


def command_of(question: StudyQuestion) -> str:
    """Returns the command line that asks a question."""
    words = [question.command]
    asked, usual = to_plain(question), to_plain(type(question)())
    for name, value in asked.items():
        if value == usual[name] and name not in question.told:
            continue
        words.append(f"--{question.flags.get(name, name).replace('_', '-')}")
        if isinstance(value, list):
            words.extend(shlex.quote(_as_word(each)) for each in value)
        elif not isinstance(value, bool):
            words.append(_as_word(value))
    return " ".join(words)


def _as_word(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def check_results_file(path: str | os.PathLike[str] | None, resume: bool = False) -> bool:
    """Returns whether there is a file to go on from; None, for no file, passes.

    Raises:
        OutputFileError: the file can't be written.
        ResultsFileError: there is one, and nobody asked to go on from it.
    """
    check_writable(path)
    if path is None or not Path(path).exists():
        return False
    if not resume:
        raise ResultsFileError(
            f"results file {path}",
            got="one that exists",
            remedy="Go on from it (--resume), name another, or delete it first.",
        )
    return True


def read_results(path: str | os.PathLike[str], kind: str | None = None) -> dict[str, Any]:
    """Returns what is in a results file: a JSON object with a field "kind", of any kind if None.

    Raises:
        ResultsFileError: no such file, damaged, or of another kind.
    """
    data = read_json(path, "results file", ResultsFileError)
    found = data.get("kind") if isinstance(data, dict) else None
    if not isinstance(found, str) or kind not in (None, found):
        raise ResultsFileError(
            f"results file {path}",
            got=f"kind {found!r}",
            expected=f"kind {kind!r}" if kind else 'an object with a field "kind"',
        )
    return data


@contextmanager
def refuse_damaged(path: str | os.PathLike[str]) -> Iterator[None]:
    """Reports what is wrong with the values of a results file as its damage.

    Raises:
        ResultsFileError: something was missing, of the wrong type, or out of range.
    """
    try:
        yield
    except (AigtoError, KeyError, TypeError) as error:
        raise ResultsFileError(
            f"results file {path} is damaged",
            got=f"no {error}" if isinstance(error, KeyError) else error,
            remedy="Delete it, and measure again.",
        ) from error


def check_same_question(
    path: str | os.PathLike[str], there: Mapping[str, Any], here: Mapping[str, Any]
) -> None:
    """Refuses to go on from results whose question's fields are others than those asked for here.

    Raises:
        ResultsFileError: says which fields differ.
    """
    names = [name for name in {**here, **there} if there.get(name) != here.get(name)]
    if names:
        raise ResultsFileError(
            f"results file {path} is of another study",
            got=", ".join(f"{name} {there.get(name)}" for name in names),
            expected=", ".join(f"{name} {here.get(name)}" for name in names),
            remedy="Name another file, or ask the same question.",
        )


def round_to(value: float, digits: int, down: bool = False) -> float:
    """Returns a number with that many significant digits, as files of results have them.

    It is the nearest one, or the next towards 0; what is not finite stays as it is.
    """
    if not math.isfinite(value):
        return value
    rounding = ROUND_DOWN if down else ROUND_HALF_EVEN
    return float(Context(prec=digits, rounding=rounding).create_decimal(repr(float(value))))
