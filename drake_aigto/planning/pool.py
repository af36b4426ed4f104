"""The candidates of a search: their order, their replays, and the plan that comes out."""

from __future__ import annotations

import dataclasses
import logging
import math
import time
from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

from drake_aigto.planning.candidate import LARGEST_DEFECT, Candidate, Replays
from drake_aigto.planning.options import SearchOptions
from drake_aigto.planning.plan import Plan, PlanningError, PlanStats
from drake_aigto.transcription.rows import scaled_defects

if TYPE_CHECKING:
    from drake_aigto.world import Scenario, World

_LOG = logging.getLogger(__name__)

Progress = Callable[[str], None]


class Stopwatch:
    """Wall time by part of the road.

    Attributes:
        seconds: part → its time so far [s].
    """

    def __init__(self) -> None:
        """Starts at nothing."""
        self.seconds: defaultdict[str, float] = defaultdict(float)

    @contextmanager
    def __call__(self, part: str) -> Iterator[None]:
        """Adds the time of a `with` block to a part's."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[part] += time.perf_counter() - start


class Problem(Protocol):
    """What is searched: a task in a world."""

    @property
    def world(self) -> World:
        """Where the task is."""

    @property
    def options(self) -> SearchOptions:
        """Numerics."""

    @property
    def sources(self) -> str:
        """What candidates come from, in words."""

    @property
    def remedy(self) -> str:
        """What a user may try where no candidate meets the rows."""

    def confirm(self, candidate: Candidate) -> Replays:
        """Returns the candidate's replays: its own, and Drake's if the options confirm."""


class CandidatePool(ABC):
    """Candidates, and what simulations say of them.

    Attributes:
        problem: that is searched.
        clock: what the parts of the search took.
        others: candidates that were not searched for, such as doing nothing.
        aigo_steps: inner iterations of AIGO so far.
        is_interrupted: whether Ctrl-C ended it.
    """

    def __init__(self, problem: Problem, clock: Stopwatch | None = None) -> None:
        """Starts with no candidate."""
        self.problem, self.clock = problem, clock or Stopwatch()
        self.others: list[Candidate] = []
        self.aigo_steps = 0
        self.is_interrupted = False
        self._progress: Progress | None = None
        self._replays: dict[int, Replays] = {}  # Of those that were to be the plan, by id.

    @property
    @abstractmethod
    def candidates(self) -> Iterable[Candidate]:
        """Those that were searched for, in the order that they were found."""

    @property
    def box_contacts(self) -> tuple[int | None, ...]:
        """How many contacts the last box of each start shows; None: left out."""
        return ()

    def tell(self, line: str) -> None:
        """Logs and shows what begins."""
        _LOG.info("%s", line)
        if self._progress:
            self._progress(line)

    @contextmanager
    def ended_by_ctrl_c(self, find: Callable[[], Collection[object]]) -> Iterator[None]:
        """Has Ctrl-C end no more than a `with` block if something was found by then."""
        try:
            yield
        except KeyboardInterrupt:
            if not find():
                raise
            self.is_interrupted = True
            _LOG.info("interrupted: going on with what was found")

    def ranked(self) -> list[Candidate]:
        """Returns all candidates, the best first."""
        return sorted([*self.candidates, *self.others], key=self.rank)

    def find_feasible(self) -> list[Candidate]:
        """Returns the candidates that meet the rows, the best first.

        Raises:
            PlanningError: there is none.
        """
        feasible = [candidate for candidate in self.ranked() if candidate.is_feasible]
        if not feasible:
            polished = [scaled_defects(each.defects, each.scales) for each in self.ranked()]
            nearest = min(polished, key=lambda by: max(by.values()), default={"rows": math.inf})
            missed = [name for name, by in nearest.items() if by > LARGEST_DEFECT]
            raise PlanningError(
                "no candidate meets the transcription's rows",
                got=f"{len(polished)} candidates from {self.problem.sources}, "
                f"the smallest defect {max(nearest.values()):.1e}, in {', '.join(missed)}",
                expected=f"at most {LARGEST_DEFECT:g} of the task's scales",
                remedy=self.problem.remedy,
            )
        return feasible

    def confirm(self, candidate: Candidate) -> bool:
        """Replays a candidate's control, and returns whether the replays confirm it.

        Ctrl-C leaves out what has not been simulated by then.
        """
        steps = len(candidate.trajectory.controls)
        self.tell(f"replaying the best of {len(self.ranked())} candidates, {steps} time steps")
        self._replays[id(candidate)] = Replays(candidate.replay, None)
        try:
            with self.clock("replay"):
                self._replays[id(candidate)] = self.problem.confirm(candidate)
        except KeyboardInterrupt:
            self.is_interrupted = True
        replays, unit = self._replays[id(candidate)], self.problem.world.position_unit
        for replay in replays:
            if not candidate.is_confirmed_by(replay):
                _LOG.info(
                    "  vetoed by the %s replay: %s promises cost %.3e and %.1e %s off the goal; "
                    "simulated %.3e and %.1e %s",
                    replay.simulator,
                    candidate.describe_contacts(),
                    candidate.cost,
                    candidate.goal_error,
                    unit,
                    replay.cost,
                    replay.goal_error,
                    unit,
                )
        return candidate.holds(replays)

    def _is_vetoed(self, candidate: Candidate) -> bool:
        """Returns whether a replay that `confirm` ran contradicts a candidate."""
        replays = self._replays.get(id(candidate))
        return replays is not None and not candidate.holds(replays)

    def make_plan(self, scenario: Scenario, best: Candidate) -> Plan:
        """Returns the plan with this candidate, which was replayed, and the others by rank."""
        rest = [
            dataclasses.replace(other, drake=self._replays[id(other)].drake)
            if id(other) in self._replays
            else other
            for other in self.ranked()
            if other is not best
        ]
        stats = PlanStats(
            self.aigo_steps,
            sum(candidate.is_feasible for candidate in self.candidates),
            dict(self.clock.seconds),
            self.box_contacts,
            self.flight_left_out,
        )
        took = ", ".join(f"{part} {seconds:.2f}" for part, seconds in stats.seconds.items())
        _LOG.info("%d inner steps of AIGO; seconds: %s", stats.aigo_steps, took)
        options, world = self.problem.options, self.problem.world
        return Plan(
            scenario=scenario,
            transcription=options.transcription,
            candidates=(best, *rest),
            replay=self._replays[id(best)],
            stats=stats,
            made_in=world.fingerprint,
            is_interrupted=self.is_interrupted,
            options=options,
            world=world,
        )

    @property
    def flight_left_out(self) -> float | None:
        """What a free flight costs at least, if it was left out for that."""
        return None

    @abstractmethod
    def rank(self, candidate: Candidate) -> tuple[float, ...]:
        """Returns what candidates are ordered by, the best least."""
