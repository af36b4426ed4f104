"""The whole road: scenario → world → transcription → AIGO → polish → replay → plan."""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any

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
from drake_aigto.planning.sequence import Knots, ballistic_guess, contact_knots
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import LiteralTranscription, Transcription
from drake_aigto.world import Scenario, World

if TYPE_CHECKING:
    import numpy.typing as npt

# In a candidate's origin, before the knots that its contacts were moved to.
_MOVED = "; contacts moved to knots "

# So many of the best candidates have their contacts moved.
_MOVED_CANDIDATES = 2
# Contacts this many knots apart are one proposal of AIGO's; moving them tells them apart.
_SAME = 2

_Clock = Callable[[str], AbstractContextManager[None]]

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
        feasible = [c for c in candidates if c.max_defect <= LARGEST_DEFECT]
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
                    progress(f"AIGO {number} of {len(ladder)}: {rung}")
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


def make_transcription(world: World, scenario: Scenario, options: PlanOptions) -> Transcription:
    """Returns the transcription that the options name."""
    return LiteralTranscription(world, scenario, options.nonpenetration)


class PlanningProblem:
    """A transcription compiled for AIGO and for the local solvers: the road's steps one by one.

    Costs and bounds that were added to the transcription before count.

    Attributes:
        transcription: the constrained program.
        polynomial: its penalised cost, for AIGO.
        box: where AIGO starts.
    """

    def __init__(self, transcription: Transcription, options: PlanOptions | None = None) -> None:
        """Compiles.

        Raises:
            UnsupportedTermError: a cost or constraint that has no mean in closed form.
        """
        self.transcription = transcription
        self.options = options or PlanOptions()
        order = transcription.elimination_order()
        self.polynomial: BoxPolynomial = compile_program(transcription.penalized(), order)
        self.box = Box(*transcription.initial_box())

    @cached_property
    def _nlp(self) -> PolynomialNlp:
        return compile_nlp(self.transcription.prog())

    def run_aigo(self, rung: Rung) -> AigoResult:
        """Returns what AIGO makes of the first box under a rung's weights."""
        return minimize(self._weighted(rung), self.box, self.options.make_algorithm(rung))

    def find_sequences(self, result: AigoResult, rung: Rung) -> list[Knots]:
        """Returns the contact sequences that AIGO proposes; () is a free flight.

        One is read off the box center as it is, another after pulling it towards the constraints by
        raising the rung's penalties.
        """
        center = result.box.center
        pulled = PenaltyContinuation().run(
            self._weighted(rung), self._weights(rung), center, self.box.free
        )
        return [contact_knots(self.transcription, x) for x in (center, pulled)]

    def polish(self, center: npt.NDArray[np.float64], knots: Knots) -> npt.NDArray[np.float64]:
        """Returns the local optimum next to a contact sequence, all decision variables (n,).

        The local solver starts from the ballistic guess: of AIGO's box center only the sequence is
        kept, as its penalised rows are off by far.
        """
        return self.solve_locally(ballistic_guess(self.transcription, center, knots))

    def solve_locally(self, guess: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns what the local solver makes of a guess, all decision variables (n,)."""
        if self.options.local_solver == "newton":
            x = InteriorPoint().solve(self._nlp, guess).x
        else:
            x = solve_with_drake(self.transcription.prog(), guess, self.options.local_solver).x
        return self.transcription.close_rows(x)

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


class Search:
    """Candidates by contact sequence: AIGO proposes, and the best one's contacts are moved.

    Sequences whose knots differ by no more than `_SAME` share a candidate.

    Attributes:
        candidates: so far.
        aigo_steps: inner iterations of AIGO so far.
    """

    def __init__(self, problem: PlanningProblem, clock: _Clock) -> None:
        """Starts with no candidate; the clock measures parts by name."""
        self._problem, self._clock = problem, clock
        self._centers: dict[Knots, npt.NDArray[np.float64]] = {}
        self._by_knots: dict[Knots, Candidate] = {}
        self.aigo_steps = 0

    @property
    def candidates(self) -> list[Candidate]:
        """All candidates, in the order that they were found."""
        return list(self._by_knots.values())

    def add_rung(self, rung: Rung) -> None:
        """Adds the candidate of AIGO's sequence under this rung, unless it is there.

        Raises:
            KeyboardInterrupt: AIGO was interrupted; its best so far is a candidate by now.
        """
        with self._clock("aigo"):
            result = self._problem.run_aigo(rung)
            sequences = self._problem.find_sequences(result, rung)
        self.aigo_steps += result.num_inner_steps
        for knots in sequences:
            if not any(_is_same(knots, known) for known in self._by_knots):
                self._add(f"{self._problem.options.algorithm}, {rung}", knots, result.box.center)
        if result.status is Status.INTERRUPTED:
            raise KeyboardInterrupt

    def move_contacts(self, knots: Knots, steps: Sequence[int]) -> None:
        """Moves each contact of a candidate to and fro by so many knots, while that helps.

        Args:
            knots: the candidate's sequence.
            steps: in turn; each is repeated until it does not help any more.
        """
        for step in steps:
            while (best := min([knots, *self._neighbours(knots, step)], key=self._rank)) != knots:
                knots = best

    def best_contacts(self, count: int) -> list[Knots]:
        """Returns so many sequences with contacts: first those that the polish left in contact."""
        ranked = sorted(
            filter(None, self._by_knots),
            key=lambda knots: (not self._by_knots[knots].contacts, self._rank(knots)),
        )
        return ranked[:count]

    def _neighbours(self, knots: Knots, step: int) -> Iterator[Knots]:
        """Yields the sequences with one contact moved, which are candidates by then."""
        last = self._problem.transcription.num_samples() - 1
        for i, shift in itertools.product(range(len(knots)), (-step, step)):
            moved = tuple(k + shift if j == i else k for j, k in enumerate(knots))
            if not all(a < b for a, b in itertools.pairwise((0, *moved, last))):
                continue
            if moved not in self._by_knots:
                origin = self._by_knots[knots].origin.split(_MOVED)[0]
                self._add(f"{origin}{_MOVED}{moved}", moved, self._centers[knots])
            yield moved

    def _rank(self, knots: Knots) -> tuple[bool, float]:
        """Orders sequences: those that meet the rows first, then by cost."""
        candidate = self._by_knots[knots]
        return candidate.max_defect > LARGEST_DEFECT, candidate.cost

    def _add(self, origin: str, knots: Knots, center: npt.NDArray[np.float64]) -> None:
        with self._clock("polish"):
            x = self._problem.polish(center, knots)
        with self._clock("replay"):
            self._by_knots[knots] = self._problem.judge(origin, center, x)
        self._centers[knots] = center


def _is_same(one: Knots, other: Knots) -> bool:
    return len(one) == len(other) and all(
        abs(a - b) <= _SAME for a, b in zip(one, other, strict=True)
    )
