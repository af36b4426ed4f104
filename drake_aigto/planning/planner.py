"""The whole road: scenario → world → transcription → AIGO → polish → replay → plan."""

from __future__ import annotations

import dataclasses
import logging
import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from drake_aigto.errors import AigtoError
from drake_aigto.planning.literal import LiteralProblem, LiteralSearch
from drake_aigto.planning.options import PlanOptions, Rung
from drake_aigto.planning.plan import LARGEST_DEFECT, Candidate, Plan, PlanStats, Replays
from drake_aigto.planning.rigid import RigidProblem
from drake_aigto.planning.rigid_search import RigidSearch
from drake_aigto.planning.search import Search
from drake_aigto.simulation.material import contact_delay
from drake_aigto.simulation.replay import Replay, replay_drake, replay_event_driven
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import (
    LiteralTranscription,
    LiteralWithForces,
    RigidTranscription,
    RigidWithForces,
)
from drake_aigto.world import Scenario, World

if TYPE_CHECKING:
    import numpy.typing as npt

_LOG = logging.getLogger(__name__)

# AIGO's boxes tell a bounce from the start's own push if so many steps lead to the wall.
_STEPS_TO_WALL = 3


class PlanningError(AigtoError, RuntimeError):
    """Nothing was found; the message says what was tried.

    Attributes:
        plan: the best that does not hold, if there is one.
    """

    plan: Plan | None = None


def make_problem(
    world: World, scenario: Scenario, options: PlanOptions
) -> LiteralProblem | RigidProblem:
    """Returns the scenario, transcribed and compiled as the options say.

    The rigid transcription has time steps of its own (`PlanOptions.aigo_steps`), but more, up to
    the scenario's, if a wall would be touched in less than three of them.
    """
    _LOG.info("transcribing (%s)", options.transcription)
    if options.transcription == "literal":
        make_literal = LiteralWithForces if options.force_variables else LiteralTranscription
        return LiteralProblem(make_literal(world, scenario, options.nonpenetration), options)
    steps = max(options.aigo_steps, min(_count_steps(world, scenario), scenario.num_steps))
    coarse = dataclasses.replace(scenario, time_step=scenario.duration / steps)
    make_rigid = RigidWithForces if options.force_variables else RigidTranscription
    rigid = make_rigid(world, coarse, options.relaxation)
    return RigidProblem(rigid, options, scenario.num_steps)


def _count_steps(world: World, scenario: Scenario) -> int:
    """Returns into how many steps T has to be cut for the ball to fly three before the wall."""
    distances = world.calc_signed_distance(scenario.initial_position)
    jacobian = world.calc_contact_jacobian(scenario.initial_position)
    speeds = np.maximum(-jacobian @ scenario.initial_velocity, 0.0)
    return math.ceil(_STEPS_TO_WALL * scenario.duration * float(np.max(speeds / distances)))


def plan(
    scenario: Scenario, options: PlanOptions | None = None, world: World | None = None
) -> Plan:
    """Plans for a scenario: `Planner(scenario, options, world).plan()`."""
    return Planner(scenario, options, world).plan()


class Planner:
    """Walks the road from a scenario to a plan; each step is public and may be called alone.

    Args:
        scenario: the question.
        options: numerics; the defaults if None.
        world: a plant of your own (`World.from_diagram`); built from the scenario's model if None.

    Raises:
        ScenarioError, ModelError: the scenario does not fit the world, or the model can't be used.
    """

    def __init__(
        self,
        scenario: Scenario,
        options: PlanOptions | None = None,
        world: World | None = None,
    ) -> None:
        """Builds the world, checks the scenario against it, and compiles its program."""
        self.scenario = scenario
        self.options = options or PlanOptions()
        self.world = world or World.from_scenario(scenario)
        self.world.check(scenario)
        if self.options.confirm:
            contact_delay(self.world)  # A wall without stiffness is refused before long work.
        self._seconds: defaultdict[str, float] = defaultdict(float)
        with self._clock("build"):
            self._problem = make_problem(self.world, scenario, self.options)
        self._build_seconds = self._seconds["build"]

    def plan(
        self,
        initial_position: npt.ArrayLike | None = None,
        initial_velocity: npt.ArrayLike | None = None,
        goal_position: npt.ArrayLike | None = None,
        progress: Callable[[str], None] | None = None,
    ) -> Plan:
        """Plans, with the scenario's ends or with changed ones, whose program is compiled anew.

        Ctrl-C ends the search; the best candidate so far is returned.

        Args:
            initial_position: instead of the scenario's, shape (nq,) [m].
            initial_velocity: instead of the scenario's, shape (nv,) [m/s].
            goal_position: instead of the scenario's, shape (nq,) [m].
            progress: called with a line of text before each candidate.

        Raises:
            ScenarioError: a changed end does not fit.
            PlanningError: no candidate meets the transcription's rows, or no rigid one holds in
                simulation.
        """
        ends = {
            "initial_position": initial_position,
            "initial_velocity": initial_velocity,
            "goal_position": goal_position,
        }
        changed: dict[str, Any] = {name: value for name, value in ends.items() if value is not None}
        scenario = dataclasses.replace(self.scenario, **changed) if changed else self.scenario
        self.world.check(scenario)
        self._seconds.clear()
        search = self._search(scenario, progress)
        best, replays = self._choose(search, scenario)
        rest = [candidate for candidate in search.ranked() if candidate is not best]
        num_polished = sum(candidate.is_feasible for candidate in search.ranked())
        stats = PlanStats(
            search.aigo_steps,
            num_polished,
            dict(self._seconds),
            search.box_contacts,
            search.flight_left_out,
        )
        took = ", ".join(f"{part} {seconds:.2f}" for part, seconds in self._seconds.items())
        _LOG.info("%d inner steps of AIGO; seconds: %s", search.aigo_steps, took)
        found = Plan(scenario, self.options.transcription, (best, *rest), replays, stats)
        if self.options.transcription == "rigid" and not found.holds:
            raise _nothing_holds(found, len(self.options.rungs))
        return found

    def _find_feasible(self, search: Search[Any]) -> list[Candidate]:
        """Returns the candidates that meet the rows, the best first; there is one."""
        feasible = [candidate for candidate in search.ranked() if candidate.is_feasible]
        if not feasible:
            defects = [candidate.max_defect for candidate in search.ranked()]
            raise PlanningError(
                "no candidate meets the transcription's rows",
                got=f"{len(defects)} candidates from {len(self.options.rungs)} rungs, the "
                f"smallest defect {min(defects, default=np.inf):.1e}",
                expected=f"at most {LARGEST_DEFECT:g}",
                remedy="Try another ladder, algorithm or local solver.",
            )
        return feasible

    def _search(self, scenario: Scenario, progress: Callable[[str], None] | None) -> Search[Any]:
        """Returns a finished search."""
        options, ladder = self.options, self.options.rungs

        def tell(line: str) -> None:
            _LOG.info("%s", line)
            if progress:
                progress(line)

        begun: list[Rung] = []

        def tell_rung(rung: Rung) -> None:
            begun.append(rung)
            tell(f"AIGO {len(begun)} of {len(ladder)}: {rung.describe(options.algorithm)}")

        search = self._start_search(scenario)
        try:
            for rungs in search.rungs():
                search.add_rungs(rungs, tell_rung)
            tell(f"{len(search.by_sequence)} candidates; looking for others near the best")
            search.branch()
            for number, sequence in enumerate(search.finalists()[: options.finalists], 1):
                tell(f"{len(search.by_sequence)} candidates; improving number {number}")
                search.improve(sequence)
        except KeyboardInterrupt:
            if not search.by_sequence:
                raise
            _LOG.info("interrupted: going on with what was found")
        return search

    def _start_search(self, scenario: Scenario) -> Search[Any]:
        if scenario is self.scenario:
            problem, self._seconds["build"] = self._problem, self._build_seconds
        else:
            with self._clock("build"):
                problem = make_problem(self.world, scenario, self.options)
        if isinstance(problem, LiteralProblem):
            return LiteralSearch(problem, self._clock)
        return RigidSearch(problem, self._clock)

    def _choose(self, search: Search[Any], scenario: Scenario) -> tuple[Candidate, Replays]:
        """Returns the first candidate that all replays confirm, or else the first, with replays.

        Literal plans are taken at their word, as the paper does: always the first.
        """
        feasible = self._find_feasible(search)
        first = feasible[0]
        _LOG.info("replaying the best of %d candidates", len(feasible))
        replays = self._confirm(first, scenario)
        if self.options.transcription == "rigid" and not first.holds(replays):
            search.add_left_out()
            for other in self._find_feasible(search):
                if other is not first and other.is_confirmed:
                    again = self._confirm(other, scenario)
                    if other.holds(again):
                        return other, again
        return first, replays

    def _confirm(self, candidate: Candidate, scenario: Scenario) -> Replays:
        with self._clock("replay"):
            return Replays(candidate.replay, self._replay_in_drake(candidate.trajectory, scenario))

    def _replay_in_drake(self, trajectory: Trajectory, scenario: Scenario) -> Replay | None:
        """Returns Drake's replay, if the options confirm."""
        if not self.options.confirm:
            return None
        return replay_drake(self.world, scenario, trajectory.times, trajectory.controls)

    def simulate(self, trajectory: Trajectory, scenario: Scenario | None = None) -> Replays:
        """Returns what a trajectory's control alone does: event-driven, and in Drake to confirm.

        Args:
            trajectory: in this planner's world.
            scenario: that it is for; the planner's if None.
        """
        scenario = scenario or self.scenario
        rigid = replay_event_driven(self.world, scenario, trajectory.times, trajectory.controls)
        return Replays(rigid, self._replay_in_drake(trajectory, scenario))

    @contextmanager
    def _clock(self, part: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            self._seconds[part] += time.perf_counter() - start


def _nothing_holds(found: Plan, num_rungs: int) -> PlanningError:
    """Returns the error of a search whose every candidate a replay contradicts."""
    tried = [
        f"{candidate.describe_contacts()} for {candidate.cost:.2e}, "
        f"replayed {candidate.replay.cost:.2e}"
        for candidate in found.candidates
    ]
    drake = found.replay.drake
    if drake is not None and found.best.is_confirmed:
        tried[0] += f", in Drake {drake.cost:.2e} and {drake.goal_error:.1e} m off the goal"
    error = PlanningError(
        "nothing that was planned holds in simulation",
        got=f"{len(tried)} candidates from {num_rungs} rungs of AIGO ({'; '.join(tried)})",
        expected="simulations that come near a plan's cost and goal",
        remedy="Allow more time, move the goal closer, or try another ladder.",
    )
    error.plan = found
    return error
