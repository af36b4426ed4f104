"""Which methods are compared on which questions, and what came of it, as numbers.

Methods on the same questions with the same seconds, all judged by the same judge.
"""

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
from benchmarks.robots.methods import METHODS, PLANS, Attempt, is_installed
from benchmarks.robots.shooting import replay_in_drake
from benchmarks.robots.worlds import WORLDS, Question, make_questions
from benchmarks.study import StudyQuestion
from benchmarks.study.study import Call, WorldStudy, round_to
from drake_aigto.errors import OptionsError
from drake_aigto.plain import from_plain


@dataclass(frozen=True)
class Comparison(StudyQuestion):
    """What is compared.

    Attributes:
        worlds: of `WORLDS`.
        count: how many questions of each at most; None: all of them.
        methods: of `METHODS`; each runs where it applies.
        seconds: of CPU time that a method has for a start, but for plans, which end by themselves;
            None: as long as the first plan took, and 1 s at least.
        is_tuning: questions to tune on, and not those that are reported.

    Raises:
        OptionsError: an unknown world or method, one that is not installed, or no seconds.
    """

    worlds: tuple[str, ...] = tuple(WORLDS)
    count: int | None = None
    methods: tuple[str, ...] = tuple(METHODS)
    seconds: float | None = None
    is_tuning: bool = False

    kind: ClassVar[str] = "robots"
    command: ClassVar[str] = "python -m benchmarks.robots compare"

    def __post_init__(self) -> None:
        """Checks names and numbers."""
        for name, got, known in (
            ("worlds", self.worlds, WORLDS),
            ("methods", self.methods, METHODS),
        ):
            for each in got:
                if each not in known:
                    raise OptionsError(name, got=each, expected=f"some of {', '.join(known)}")
        missing = [each for each in self.methods if not is_installed(each)]
        if missing:
            remedy = "Install the extra `bench`, or leave them out."
            raise OptionsError("methods", ", ".join(missing), "installed ones", remedy)
        if self.count is not None and self.count < 1:
            raise OptionsError("count", got=self.count, expected="at least 1")
        if self.seconds is None and self.methods[:1] and self.methods[0] not in PLANS:
            expected = f"a number, or one of {', '.join(PLANS)} as the first method"
            raise OptionsError("seconds", got="none", expected=expected)

    def questions(self) -> list[Question]:
        """Returns all questions, world by world."""
        counts = {name: WORLDS[name].count for name in self.worlds}
        if self.count is not None:
            counts = {name: min(self.count, most) for name, most in counts.items()}
        return [
            each
            for name, count in counts.items()
            for each in make_questions(name, count, self.is_tuning)
        ]

    def methods_for(self, world: str) -> tuple[str, ...]:
        """Returns the methods that can answer questions of a world."""
        return tuple(name for name in self.methods if METHODS[name].applies(world))


class Step(NamedTuple):
    """A control that a method had found by then."""

    seconds: float  # CPU
    cost: float  # J by the judge; infinite if it leaves its range

    @classmethod
    def from_plain(cls, data: object) -> Step:
        """Returns the step that files have as a list."""
        return cls(*from_plain(tuple[float, float], data))


@dataclass(frozen=True)
class Outcome:
    """What a method made of a question.

    Attributes:
        method: its name.
        steps: each control that it took for better than those before.
        cpu: seconds of all its attempts.
        wall: the same by the clock.
        attempts: how many.
        promised: J of the last step, as the method has it.
        drake: J of a plan in Drake; None: not replayed there.
    """

    method: str
    steps: tuple[Step, ...]
    cpu: float
    wall: float
    attempts: int
    promised: float
    drake: float | None = None

    @property
    def cost(self) -> float:
        """The least cost of its steps; infinite if it found none."""
        return min((step.cost for step in self.steps), default=math.inf)


@dataclass(frozen=True)
class Row:
    """All methods on one question.

    Attributes:
        world: whose question it is.
        number: of the question.
        is_deep: whether it starts deep in a soft wall.
        known: the best cost that was known before.
        outcomes: of each method.
    """

    world: str
    number: int
    is_deep: bool
    known: float
    outcomes: tuple[Outcome, ...]

    @property
    def best(self) -> float:
        """The best cost that is known now."""
        return min([self.known, *(outcome.cost for outcome in self.outcomes)])


_DIGITS = 6
_LEAST = 1.0  # CPU seconds of a peer where plans take less
_WARM_UP = 0.5  # seconds of a method that count for nothing: libraries load, kernels compile

_Key = tuple[str, int]  # world, number of the question


class Found(NamedTuple):
    """What a method found, and its best control."""

    outcome: Outcome
    control: Control | None


@dataclass(frozen=True)
class RobotStudy(WorldStudy[Comparison, Row]):
    """All methods on all questions."""

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
