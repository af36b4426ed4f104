"""The whole road: scenario → world → transcription → AIGO → polish → replay → plan."""

from __future__ import annotations

import dataclasses
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from drake_aigto.errors import AigtoError
from drake_aigto.planning.options import PlanOptions
from drake_aigto.planning.plan import LARGEST_DEFECT, Candidate, Plan, PlanStats, Replays
from drake_aigto.planning.problem import PlanningProblem, make_transcription
from drake_aigto.planning.replay import replay_drake, replay_event_driven
from drake_aigto.planning.search import Search
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scenario, World

if TYPE_CHECKING:
    import numpy.typing as npt

# So many of the best candidates have their contacts moved.
_MOVED_CANDIDATES = 2


class PlanningError(AigtoError, RuntimeError):
    """Nothing was found; the message says what was tried."""


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
        """Builds the world and checks the scenario against it."""
        self.scenario = scenario
        self.options = options or PlanOptions()
        self.world = world or World.from_scenario(scenario)
        self.world.check(scenario)
        self._seconds: defaultdict[str, float] = defaultdict(float)

    def plan(
        self,
        initial_position: npt.ArrayLike | None = None,
        initial_velocity: npt.ArrayLike | None = None,
        goal_position: npt.ArrayLike | None = None,
        progress: Callable[[str], None] | None = None,
    ) -> Plan:
        """Plans, with the scenario's ends or with changed ones.

        Ctrl-C ends the search; the best candidate so far is returned.

        Args:
            initial_position: instead of the scenario's, shape (nq,) [m].
            initial_velocity: instead of the scenario's, shape (nv,) [m/s].
            goal_position: instead of the scenario's, shape (nq,) [m].
            progress: called with a line of text before each candidate.

        Raises:
            ScenarioError: a changed end does not fit.
            PlanningError: no candidate meets the transcription's rows.
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
        with self._clock("build"):
            transcription = make_transcription(self.world, scenario, self.options)
            problem = PlanningProblem(transcription, self.options)
        candidates, steps = self._search(problem, progress)
        feasible = [candidate for candidate in candidates if candidate.is_feasible]
        if not feasible:
            defect = min((c.max_defect for c in candidates), default=np.inf)
            raise PlanningError(
                "no candidate meets the transcription's rows",
                got=f"{len(candidates)} candidates from {len(self.options.ladder)} rungs, the "
                f"smallest defect {defect:.1e}",
                expected=f"at most {LARGEST_DEFECT:g}",
                remedy="Try another ladder, algorithm or local solver.",
            )
        best = min(feasible, key=lambda candidate: candidate.cost)
        rest = [candidate for candidate in candidates if candidate is not best]
        with self._clock("replay"):
            replays = self.simulate(best.trajectory, scenario)
        stats = PlanStats(steps, len(feasible), dict(self._seconds))
        return Plan(scenario, self.options.transcription, (best, *rest), replays, stats)

    def _search(
        self, problem: PlanningProblem, progress: Callable[[str], None] | None
    ) -> tuple[list[Candidate], int]:
        """Returns the candidates, and the inner iterations of AIGO in all."""
        search = Search(problem, self._clock)
        ladder = self.options.ladder
        try:
            for number, rung in enumerate(ladder, 1):
                if progress:
                    progress(f"AIGO {number} of {len(ladder)}: {self.options.describe(rung)}")
                search.add_rung(rung)
            for knots in search.best_contacts(_MOVED_CANDIDATES):
                if progress:
                    progress(f"{len(search.candidates)} candidates; moving contacts {knots}")
                search.move_contacts(knots, self.options.knot_steps)
        except KeyboardInterrupt:
            if not search.candidates:
                raise
        return search.candidates, search.aigo_steps

    def simulate(self, trajectory: Trajectory, scenario: Scenario | None = None) -> Replays:
        """Returns what a trajectory's control alone does: event-driven, and in Drake to confirm.

        Args:
            trajectory: in this planner's world.
            scenario: that it is for; the planner's if None.
        """
        scenario = scenario or self.scenario
        control = trajectory.times, trajectory.controls
        rigid = replay_event_driven(self.world, scenario, *control)
        confirm = self.options.confirm
        return Replays(rigid, replay_drake(self.world, scenario, *control) if confirm else None)

    @contextmanager
    def _clock(self, part: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            self._seconds[part] += time.perf_counter() - start
