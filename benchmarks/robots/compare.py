"""Methods on the same questions with the same seconds, all judged by the same judge."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from benchmarks.robots.judge import Control, judge
from benchmarks.robots.known import find_known, keep, load_known
from benchmarks.robots.methods import METHODS, PLANS, Attempt
from benchmarks.robots.plans import replay_in_drake
from benchmarks.robots.results import Comparison, Outcome, Row, Step
from benchmarks.robots.worlds import WORLDS, Question
from benchmarks.study.study import Call, Study, round_to
from drake_aigto.progress import Count

_DIGITS = 6
_LEAST = 1.0  # CPU seconds of a peer where plans take less
_WARM_UP = 0.5  # seconds of a method that count for nothing: libraries load, kernels compile

_Key = tuple[str, int]  # world, number of the question


class Found(NamedTuple):
    """What a method found, and its best control."""

    outcome: Outcome
    control: Control | None


@dataclass(frozen=True)
class RobotStudy(Study[Comparison, Row]):
    """All methods on all questions.

    Attributes:
        refresh: whether what is better than the best known takes its place.
    """

    refresh: bool = False

    question_type: ClassVar[Any] = Comparison
    result_type: ClassVar[Any] = Row

    @cached_property
    def _questions(self) -> dict[_Key, Question]:
        return {(each.world, each.number): each for each in self.question.questions()}

    @cached_property
    def _known(self) -> dict[_Key, float]:
        table = load_known()
        return {key: find_known(table, each).cost for key, each in self._questions.items()}

    def order(self) -> list[_Key]:
        """Returns the questions, world by world."""
        return list(self._questions)

    def first_keys(self) -> list[_Key]:
        """Returns one question of each world at first: time may be up."""
        return sorted(self.order(), key=lambda key: key[1])

    def key_of(self, result: Row) -> _Key:
        """Returns whose question a row is about, and which."""
        return result.world, result.number

    def calls(self, key: _Key, result: Row | None) -> Iterator[Call]:
        """Yields the job of a question that is not answered."""
        if result is None:
            yield Call("", answer, (self._questions[key], self.question, self._known[key]))

    def taken(
        self, key: _Key, result: Row | None, name: str, future: Future[tuple[Row, Any]]
    ) -> Row:
        """Returns what all methods found; what is better than the best known is kept if asked."""
        row, controls = future.result()
        if self.refresh:
            question = self._questions[key]
            before = known = find_known(load_known(), question)
            for method, control in controls.items():
                known = known.offered(question, method, control)
            if known is not before:
                keep(question, known)
        return row

    def progress(self) -> Count:
        """Returns how many questions are answered."""
        return Count(len(self.results), len(self._questions), "questions answered")


def answer(
    question: Question, comparison: Comparison, known: float
) -> tuple[Row, dict[str, Control]]:
    """Returns what all methods make of a question, and the best control of each."""
    outcomes: list[Outcome] = []
    controls: dict[str, Control] = {}
    for name in comparison.methods_for(question.world):
        warm = _first_alike(question.world) if name in PLANS else question.world
        _warm_up(name, warm, question.is_tuning)
        seconds = math.inf
        if name not in PLANS:
            seconds = comparison.seconds or max(_LEAST, outcomes[0].cpu)
        found = run_method(name, question, seconds)
        outcomes.append(found.outcome)
        if found.control is not None:
            controls[name] = found.control
    return Row(question.world, question.number, question.is_deep, known, tuple(outcomes)), controls


def _first_alike(world: str) -> str:
    """Returns the first world between walls of the same kind: plans there run the same code."""
    kind = WORLDS[world].is_soft, WORLDS[world].is_rigid
    return next(name for name, each in WORLDS.items() if (each.is_soft, each.is_rigid) == kind)


@cache
def _warm_up(name: str, world: str, is_tuning: bool) -> None:
    """Has a method load and compile what it needs, once in a process."""
    _run(name, Question(world, 0, is_tuning), _WARM_UP)


class _Timed(NamedTuple):
    """Attempts that are each better than those before, with the CPU seconds until then."""

    better: list[tuple[float, Attempt]]
    cpu: float
    wall: float
    attempts: int


def _run(name: str, question: Question, seconds: float) -> _Timed:
    """Runs a method until no attempt may start any more; the last one may end later."""
    better: list[tuple[float, Attempt]] = []
    best, count = math.inf, 0
    cpu, wall = time.process_time(), time.perf_counter()
    for attempt in METHODS[name].run(question, 0):
        spent = time.process_time() - cpu
        count += 1
        if attempt.promised < best:
            best = attempt.promised
            better.append((spent, attempt))
        if spent > seconds:
            break
    return _Timed(better, time.process_time() - cpu, time.perf_counter() - wall, count)


def run_method(name: str, question: Question, seconds: float) -> Found:
    """Returns what a method finds in these CPU seconds, judged."""
    timed = _run(name, question, seconds)
    scores = [judge(question, attempt.control).score for _, attempt in timed.better]
    best = int(np.argmin(scores)) if scores else None
    control = None if best is None or math.isinf(scores[best]) else timed.better[best][1].control
    outcome = Outcome(
        method=name,
        steps=tuple(
            Step(round(spent, 4), round_to(score, _DIGITS))
            for (spent, _), score in zip(timed.better, scores, strict=True)
        ),
        cpu=round(timed.cpu, 4),
        wall=round(timed.wall, 4),
        attempts=timed.attempts,
        promised=round_to(timed.better[-1][1].promised, _DIGITS) if timed.better else math.inf,
        drake=None
        if name not in PLANS or control is None
        else round_to(replay_in_drake(question, control), _DIGITS),
    )
    return Found(outcome, control)
