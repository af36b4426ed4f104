"""The whole road: scenario → world → transcription → AIGO → polish → replay → plan."""

from __future__ import annotations

import dataclasses
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from drake_aigto.aigo import AigoResult, Box, PenaltyContinuation, Status, minimize
from drake_aigto.box import BoxPolynomial, compile_program
from drake_aigto.errors import AigtoError
from drake_aigto.local import InteriorPoint, PolynomialNlp, compile_nlp
from drake_aigto.planning.contacts import find_contacts, max_penetration
from drake_aigto.planning.options import PlanOptions, Rung
from drake_aigto.planning.plan import Candidate, Plan, PlanStats, Replays
from drake_aigto.planning.polish import solve_with_drake
from drake_aigto.planning.replay import replay_drake, replay_event_driven
from drake_aigto.transcription import LiteralTranscription, Transcription
from drake_aigto.world import Scenario, World

if TYPE_CHECKING:
    import numpy.typing as npt

# A candidate whose rows are off by more than this is no solution of the transcription [m, m/s].
LARGEST_DEFECT = 1e-6


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
        self._seconds: defaultdict[str, float] = defaultdict(float)
        with self._clock("build"):
            self.world = world or World.from_scenario(scenario)
        self.world.check(scenario)

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
        changed = {name: value for name, value in ends.items() if value is not None}
        scenario = dataclasses.replace(self.scenario, **changed) if changed else self.scenario
        self.world.check(scenario)
        with self._clock("build"):
            transcription = make_transcription(self.world, scenario, self.options)
            problem = PlanningProblem(transcription, self.options)
        candidates, steps = self._search(problem, progress)
        feasible = [c for c in candidates if c.max_defect <= LARGEST_DEFECT]
        if not feasible:
            rungs = len(self.options.ladder)
            raise PlanningError(
                "no candidate meets the transcription's rows",
                got=f"{len(candidates)} candidates of {rungs} rungs, the smallest defect "
                f"{min((c.max_defect for c in candidates), default=np.inf):.1e}",
                expected=f"{LARGEST_DEFECT:g}",
                remedy="Try another ladder, algorithm or local solver.",
            )
        best = min(feasible, key=lambda candidate: candidate.cost)
        rest = [candidate for candidate in candidates if candidate is not best]
        with self._clock("replay"):
            replays = self.replay(best, scenario)
        stats = PlanStats(steps, len(feasible), dict(self._seconds))
        return Plan(scenario, self.options.transcription, (best, *rest), replays, stats)

    def _search(
        self, problem: PlanningProblem, progress: Callable[[str], None] | None
    ) -> tuple[list[Candidate], int]:
        """Returns a candidate for every rung, and the inner iterations of AIGO in all."""
        candidates: list[Candidate] = []
        steps = 0
        try:
            for number, rung in enumerate(self.options.ladder, 1):
                if progress:
                    progress(f"candidate {number} of {len(self.options.ladder)}: {rung}")
                with self._clock("aigo"):
                    result = problem.run_aigo(rung)
                steps += result.num_inner_steps
                with self._clock("polish"):
                    x = problem.polish(result, rung)
                with self._clock("replay"):
                    origin = f"{self.options.algorithm}, {rung}"
                    candidates.append(problem.judge(origin, result.box.center, x))
                if result.status is Status.INTERRUPTED:
                    break
        except KeyboardInterrupt:
            if not candidates:
                raise
        return candidates, steps

    def replay(self, candidate: Candidate, scenario: Scenario | None = None) -> Replays:
        """Returns the candidate's replays: event-driven, and in Drake if the options confirm.

        Args:
            candidate: of this planner's world.
            scenario: that it is for; the planner's if None.
        """
        control = candidate.trajectory.times, candidate.trajectory.controls
        drake = None
        if self.options.confirm:
            drake = replay_drake(self.world, scenario or self.scenario, *control)
        return Replays(candidate.replay, drake)

    @contextmanager
    def _clock(self, part: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            self._seconds[part] += time.perf_counter() - start


def make_transcription(world: World, scenario: Scenario, options: PlanOptions) -> Transcription:
    """Returns the transcription that the options name."""
    return LiteralTranscription(world, scenario, options.nonpenetration)


class PlanningProblem:
    """A transcription compiled for AIGO and for the local solvers: the road's steps one by one.

    Costs and bounds that were added to the transcription before count.

    Attributes:
        transcription: the constrained program.
        polynomial: its penalised cost, for AIGO.
        nlp: the same costs and constraints, for the local solver of this package.
        box: where AIGO starts.
    """

    def __init__(self, transcription: Transcription, options: PlanOptions | None = None) -> None:
        """Compiles.

        Raises:
            UnsupportedTermError: a cost or constraint that has no mean in closed form.
        """
        self.transcription = transcription
        self._options = options or PlanOptions()
        order = transcription.elimination_order()
        self.polynomial: BoxPolynomial = compile_program(transcription.penalized(), order)
        self.nlp: PolynomialNlp = compile_nlp(transcription.prog())
        self.box = Box(*transcription.initial_box())

    def run_aigo(self, rung: Rung) -> AigoResult:
        """Returns what AIGO makes of the start box under a rung's weights."""
        return minimize(self._weighted(rung), self.box, self._options.make_algorithm(rung))

    def polish(self, result: AigoResult, rung: Rung) -> npt.NDArray[np.float64]:
        """Returns the feasible local optimum next to AIGO's result.

        The box center is first pulled towards the constraints by raising the rung's penalties; the
        local solver then meets them.
        """
        penalties = self._weights(rung)
        start = PenaltyContinuation().run(
            self._weighted(rung), penalties, result.box.center, self.box.free
        )
        return self.solve_locally(start)

    def solve_locally(self, guess: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns what the options' local solver makes of a guess, all decision variables (n,)."""
        if self._options.local_solver == "newton":
            return InteriorPoint().solve(self.nlp, guess).x
        return solve_with_drake(self.transcription.prog(), guess, self._options.local_solver).x

    def judge(
        self, origin: str, start: npt.NDArray[np.float64], x: npt.NDArray[np.float64]
    ) -> Candidate:
        """Returns the candidate that a local solver made of a start, replayed on the rigid wall."""
        transcription, world = self.transcription, self.transcription.world
        scenario = transcription.scenario
        trajectory = transcription.trajectory(x)
        control = trajectory.times, trajectory.controls
        return Candidate(
            origin=origin,
            start_cost=transcription.scenario_cost(start),
            start_defects=transcription.defects(start),
            trajectory=trajectory,
            cost=transcription.scenario_cost(x),
            goal_error=float(np.linalg.norm(trajectory.positions[-1] - scenario.goal_position)),
            defects=transcription.defects(x),
            max_penetration=max_penetration(world, trajectory),
            contacts=find_contacts(world, trajectory),
            replay=replay_event_driven(world, scenario, *control),
        )

    def _weights(self, rung: Rung) -> dict[str, float]:
        """Returns the rung's weights of the rows that this problem has."""
        present = self.polynomial.weights
        return {name: weight for name, weight in rung.weights.items() if name in present}

    def _weighted(self, rung: Rung) -> BoxPolynomial:
        return self.polynomial.with_weights(self._weights(rung))
