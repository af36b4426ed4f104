"""Which methods are compared on which questions, and what came of it, as numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from benchmarks.robots.methods import METHODS, PLANS, is_installed
from benchmarks.robots.worlds import WORLDS, Question, make_questions
from benchmarks.study import StudyQuestion
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
