"""One search for every world: propose, close, vary, judge."""

from __future__ import annotations

import copy
import dataclasses
import logging
import math
import time
from abc import ABC, abstractmethod
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeVar

from drake_aigto.kernels import tell_compilation
from drake_aigto.planning.candidate import LARGEST_DEFECT, Candidate, Origin, Replays
from drake_aigto.planning.options import SearchOptions
from drake_aigto.planning.plans import Plan, PlanningError, PlanStats
from drake_aigto.planning.threads import start_threads, wait_for
from drake_aigto.simulation import HARD_GOAL
from drake_aigto.transcription import scaled_defects

if TYPE_CHECKING:
    from drake_aigto.trajectory import Trajectory
    from drake_aigto.world import Scenario, World

_LOG = logging.getLogger(__name__)

Progress = Callable[[str], None]
_MOST_NAMED = 8  # of active bounds, in an error

_Self = TypeVar("_Self", bound="Search")


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


class Task(Protocol):
    """A scenario in a world, to be searched for plans."""

    @property
    def transcription_name(self) -> str:
        """Its name in plan files."""

    @property
    def world(self) -> World:
        """The world of the task."""

    @property
    def scenario(self) -> Scenario:
        """The task's question."""

    @property
    def options(self) -> SearchOptions:
        """Numerics."""

    @property
    def sources(self) -> str:
        """The sources of candidates, in words."""

    @property
    def remedy(self) -> str:
        """Advice to the user if no candidate meets the rows."""

    def idle_candidate(self) -> Candidate:
        """Returns the uncontrolled motion."""

    def confirm(self, candidate: Candidate) -> Replays:
        """Returns the candidate's replays: its own, and Drake's if the options confirm."""


def name_active(world: World, scenario: Scenario, candidates: Iterable[Candidate]) -> str:
    """Returns a sentence of the bounds that most candidates touch, empty where there are none."""
    if not world.bounds(scenario).are_any:
        return ""
    motions = (candidate.trajectory for candidate in candidates)
    active = Counter(
        item
        for motion in motions
        for item in world.limits.active_items(
            world.plant, scenario, motion.positions, motion.velocities, motion.controls
        )
    )
    named = [item for item, _ in active.most_common(_MOST_NAMED)]
    named += [f"and {len(active) - _MOST_NAMED} others"] * (len(active) > _MOST_NAMED)
    return f"These bounds are active: {'; '.join(named)}. " if named else ""


def name_obstacles(world: World, scenario: Scenario, candidates: Sequence[Candidate]) -> str:
    """Returns the same, after sentences of what all of them miss in simulation, and by how much."""
    told = ""
    for name in candidates[0].replay.broken:
        if all(name in candidate.replay.broken for candidate in candidates):
            least = min(candidate.replay.violations[name] for candidate in candidates)
            told += (
                f"In simulation all miss {name!r}, by {least:.2g} of the task's scales or more. "
            )
            if name == HARD_GOAL:
                told += "Weigh the goal (hard_goal: false) to come as near as it can. "
    return told + name_active(world, scenario, candidates)


class Proposal(NamedTuple):
    """A possible origin of a candidate.

    Attributes:
        origin: of the candidate.
        close: takes it towards a local optimum; several may run at once, in threads.
        text: a line that is shown at its start, if any.
    """

    origin: Origin
    close: Callable[[], Any]
    text: str = ""


class Search(ABC):
    """One search for every world: propose → close → vary → judge.

    Boxes of AIGO and motions without control *propose*; a closer takes each proposal to a local
    optimum of its contact sequence; the best of these are *varied* (neighboring sequences, or
    stretches opened to boxes again) and closed as well; and simulations *judge* the best of all.
    Proposers and closers depend on the world. Work is cut off by counts, never by clocks, and
    random draws depend on the seed alone, not on threads.

    Attributes:
        task: that is searched.
        clock: times of the parts of the search.
        guess: a motion that a user proposes, beside what the search does; None: there is none.
        others: candidates that do not come from the search, such as the uncontrolled motion.
        aigo_steps: inner iterations of AIGO so far.
        searches: see `PlanStats`, as for `found`.
        is_interrupted: whether Ctrl-C ended it.
    """

    def __init__(self, task: Task, clock: Stopwatch | None = None) -> None:
        """Starts with no candidate."""
        self.task, self.clock = task, clock or Stopwatch()
        self.guess: Trajectory | None = None
        self.others: list[Candidate] = []
        self.aigo_steps = self.searches = 0
        self.is_interrupted = False
        self._progress: Progress | None = None
        self._replays: dict[int, Replays] = {}  # Of candidates for the plan, by id.

    @property
    def found(self) -> int:
        """In how many searches that did not begin with it the best motion was found, if known."""
        return 0

    def run(self, progress: Progress | None = None) -> None:
        """Searches, and judges the motions found.

        Args:
            progress: called with a line of text before each part, and once, with a `Notice`, if
                machine code has to be compiled.

        Raises:
            KeyboardInterrupt: before anything was found; later, it only ends the current part.
        """
        self.explore(progress)
        self.finish()

    def finish(self) -> None:
        """Judges the motions found; Ctrl-C ends it once there is a candidate."""
        with self.ended_by_ctrl_c(lambda: list(self.candidates)):
            self.judge()

    def explore(self, progress: Progress | None = None) -> None:
        """Proposes, closes and varies."""
        for _ in self.explore_in_waves(progress):
            pass

    def explore_in_waves(self, progress: Progress | None = None) -> Iterator[None]:
        """Does what `explore` does, and yields after each wave."""
        self._progress = progress
        with self.ended_by_ctrl_c(self.list_found), tell_compilation(self.tell):
            for wave in chain(self.propose(), self.vary()):
                self.close(wave)
                yield

    def so_far(self: _Self) -> _Self:
        """Returns the search as it stands, to be judged while this one goes on."""
        other = copy.copy(self)
        for name, value in vars(self).items():
            if isinstance(value, list | dict | set):  # A search changes it in place.
                setattr(other, name, copy.copy(value))
        other.clock = Stopwatch()
        other.clock.seconds.update(self.clock.seconds)
        return other

    @property
    @abstractmethod
    def promise(self) -> float:
        """Cost of the best motion so far, before it is judged; infinite if there is none."""

    @abstractmethod
    def propose(self) -> Iterator[Sequence[Proposal]]:
        """Yields proposals in waves; each may depend on results of those before it."""

    @abstractmethod
    def vary(self) -> Iterator[Sequence[Proposal]]:
        """Yields variations of the best motions in waves, after all proposals."""

    def close(self, wave: Sequence[Proposal]) -> None:
        """Closes proposals, as many at once as the options allow, and keeps good results."""
        for found, proposal in zip(self._close_at_once(wave), wave, strict=False):
            self.keep(proposal.origin, found)

    def _close_at_once(self, wave: Sequence[Proposal]) -> Iterable[Any]:
        """Yields the result of each proposal, in their order."""
        with self.clock("search"), start_threads(self.task.options.num_threads) as pool:
            # The first one of all compiles; where Ctrl-C is raised, that ends it.
            first = [] if self.list_found() else [each.close() for each in wave[:1]]
            yield from first
            runs = [pool.submit(proposal.close) for proposal in wave[len(first) :]]
            try:
                for run in runs:
                    wait_for([run])
                    yield run.result()
            finally:
                for run in runs:
                    run.cancel()

    @abstractmethod
    def keep(self, origin: Origin, found: Any) -> None:
        """Keeps the result of a proposal, if it is good enough."""

    @abstractmethod
    def judge(self) -> None:
        """Improves the best motions, and simulates their controls."""

    @abstractmethod
    def list_found(self) -> Collection[object]:
        """Returns results so far: if there are any, Ctrl-C only ends the search."""

    def find_best(self) -> Candidate:
        """Returns the best candidate that meets the rows."""
        return self.find_feasible()[0]

    @abstractmethod
    def add_left_out(self) -> None:
        """Judges candidates left out because of one that a simulation has contradicted since."""

    def add_idle(self) -> None:
        """Adds the uncontrolled motion, which a plan has to beat."""
        with self.clock("replay"):
            self.others.append(self.task.idle_candidate())

    @property
    @abstractmethod
    def candidates(self) -> Iterable[Candidate]:
        """Candidates of the search, in the order that they were found."""

    @property
    def box_contacts(self) -> tuple[int | None, ...]:
        """Numbers of contacts of the last box of each start, None if it was left out."""
        return ()

    def tell(self, line: str) -> None:
        """Logs and shows the start of a part."""
        _LOG.info("%s", line)
        if self._progress:
            self._progress(line)

    @contextmanager
    def ended_by_ctrl_c(self, find: Callable[[], Collection[object]]) -> Iterator[None]:
        """Makes Ctrl-C end only a `with` block if something was found by then."""
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
            best = self.ranked()[polished.index(nearest) :][:1] if polished else []
            missed = [name for name, by in nearest.items() if by > LARGEST_DEFECT]
            raise PlanningError(
                "no candidate meets the transcription's rows",
                got=f"{len(polished)} candidates from {self.task.sources}, "
                f"the smallest defect {max(nearest.values()):.1e}, in {', '.join(missed)}",
                expected=f"at most {LARGEST_DEFECT:g} of the task's scales",
                remedy=name_active(self.task.world, self.task.scenario, best) + self.task.remedy,
            )
        return feasible

    def confirm(self, candidate: Candidate) -> bool:
        """Replays a candidate's control, and returns whether the replays confirm it.

        Ctrl-C skips simulations that have not ended.
        """
        steps = len(candidate.trajectory.controls)
        self.tell(f"replaying the best of {len(self.ranked())} candidates, {steps} time steps")
        self._replays[id(candidate)] = candidate.own_replays
        try:
            with self.clock("replay"):
                self._replays[id(candidate)] = self.task.confirm(candidate)
        except KeyboardInterrupt:
            self.is_interrupted = True
        replays, unit = self._replays[id(candidate)], self.task.world.position_unit
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
            self.searches,
            self.found,
        )
        took = ", ".join(f"{part} {seconds:.2f}" for part, seconds in stats.seconds.items())
        _LOG.info("%s; seconds: %s", stats, took)
        options, world = self.task.options, self.task.world
        return Plan(
            scenario=scenario.starting_at(best.trajectory.states[0]),
            transcription=self.task.transcription_name,
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
        """Lower bound of the cost of a free flight, if it was left out because of that."""
        return None

    @abstractmethod
    def rank(self, candidate: Candidate) -> tuple[float, ...]:
        """Returns the sorting key of candidates, the best first."""


def scaled(factor: float, cost: float) -> float:
    """Returns a multiple of a cost; for negative ones (of users), the same relative increase."""
    return cost + (factor - 1) * abs(cost) if cost < math.inf else cost
