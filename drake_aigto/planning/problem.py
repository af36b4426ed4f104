"""A transcription, compiled for AIGO and for the local solvers."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from drake_aigto.aigo import AigoResult, Box, PenaltyContinuation, minimize
from drake_aigto.box import BoxPolynomial, compile_program
from drake_aigto.local import InteriorPoint, PolynomialNlp, compile_nlp
from drake_aigto.planning.contacts import find_contacts, max_penetration
from drake_aigto.planning.drake_solvers import solve_with_drake
from drake_aigto.planning.options import PlanOptions, Rung
from drake_aigto.planning.plan import Candidate
from drake_aigto.planning.replay import replay_event_driven
from drake_aigto.planning.sequence import Knots, ballistic_guess, contact_knots
from drake_aigto.transcription import LiteralTranscription, Transcription
from drake_aigto.world import Scenario, World

if TYPE_CHECKING:
    import numpy.typing as npt


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
