"""One method on one scenario: what it is asked, and what it did."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeAlias

from drake_aigto.study.results_file import round_to
from drake_aigto.world import Scenario, World

PLANNER = "aigto"
# Significant digits in files: of costs so that ratios near 1 are still told apart.
COST_DIGITS, _SECONDS_DIGITS = 7, 4


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
        """Returns the best after so many seconds, infinity if there was none."""
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
        runner: what runs it, if not the planner or a baseline; a function of a module, so that it
            can be sent to another process.
        reads_boxes: whether it is kept what the planner's boxes say without any polish.
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
