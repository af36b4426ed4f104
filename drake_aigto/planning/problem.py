"""A transcription, compiled for AIGO and for the local solvers: the road's steps one by one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np
from pydrake.solvers import MathematicalProgram

from drake_aigto.aigo import AigoResult, Box, PenaltyContinuation, minimize
from drake_aigto.box import BoxPolynomial, compile_program
from drake_aigto.local import InteriorPoint, PolynomialNlp, compile_nlp
from drake_aigto.local.drake_solvers import solve_with_drake
from drake_aigto.planning.contacts import find_contacts, max_penetration
from drake_aigto.planning.options import PlanOptions, Rung, StartName
from drake_aigto.planning.plan import Candidate
from drake_aigto.planning.replay import replay_event_driven
from drake_aigto.transcription import Transcription

if TYPE_CHECKING:
    import numpy.typing as npt

Sequence = TypeVar("Sequence")
TranscriptionT = TypeVar("TranscriptionT", bound=Transcription)

# Of the local solver; a candidate that needs more is one whose phases vanish.
_MAX_ITERATIONS = 200
# A box around the motion without control has this part of the first box's size at the end.
_COAST_SHARE = 0.2


@dataclass(frozen=True, eq=False)
class Start(Generic[TranscriptionT]):
    """Where AIGO starts.

    Attributes:
        transcription: the constrained program.
        polynomial: its penalised cost.
        box: the first box.
    """

    transcription: TranscriptionT
    polynomial: BoxPolynomial
    box: Box


class PlanningProblem(ABC, Generic[TranscriptionT, Sequence]):
    """A transcription compiled for AIGO and for the local solvers.

    Costs and bounds that were added to the transcription before count. What a contact sequence is,
    and how one is polished, is the subclass's.

    Attributes:
        transcription: the constrained program.
        polynomial: its penalised cost, for AIGO.
        box: where AIGO starts, around the straight line from start to goal.
    """

    # Of the local solver's cost, in `cost_scale`, in turn until it converges.
    _cost_units: tuple[float, ...] = (1.0,)

    def __init__(self, transcription: TranscriptionT, options: PlanOptions | None = None) -> None:
        """Compiles.

        Raises:
            UnsupportedTermError: a cost or constraint that has no mean in closed form.
        """
        self.transcription = transcription
        self.options = options or PlanOptions()
        first = Start(transcription, _compile(transcription), Box(*transcription.initial_box()))
        self.polynomial, self.box = first.polynomial, first.box
        self._starts: dict[StartName, Start[TranscriptionT]] = {"line": first}

    def start(self, name: StartName) -> Start[TranscriptionT]:
        """Returns where a rung of this start begins."""
        if name not in self._starts:
            self._starts[name] = self._start_coasting()
        return self._starts[name]

    def _start_coasting(self) -> Start[TranscriptionT]:
        """Returns a box around the motion without control, on the rigid wall."""
        times = self.transcription.GetSampleTimes()
        world, scenario = self.transcription.world, self.transcription.scenario
        controls = np.zeros((len(times) - 1, world.num_actuators))
        coast = replay_event_driven(world, scenario, times, controls)
        # Of the two rows of an impact on a knot, the first: velocities before impulses.
        rows = np.searchsorted(coast.times, times)
        q, v = coast.positions[rows], coast.velocities[rows]
        around = self._transcribe_around(q)
        polynomial = self.polynomial if around is self.transcription else _compile(around)
        return Start(around, polynomial, Box(*around.box_around(q, v, _COAST_SHARE)))

    def _transcribe_around(self, positions: npt.NDArray[np.float64]) -> TranscriptionT:
        """Returns the transcription for boxes around a path, shape (N+1, nq) [m]."""
        return self.transcription

    @cached_property
    def _nlp(self) -> PolynomialNlp:
        return compile_nlp(self.transcription.prog())

    def run_aigo(self, rung: Rung) -> AigoResult:
        """Returns what AIGO makes of the rung's first box under its weights."""
        algorithm = self.options.make_algorithm(rung, self.transcription.cost_scale())
        start = self.start(rung.start)
        return minimize(start.polynomial.with_weights(self._weights(rung)), start.box, algorithm)

    def pull(self, center: npt.NDArray[np.float64], rung: Rung) -> npt.NDArray[np.float64]:
        """Returns a box center pulled towards the constraints by raising the rung's penalties."""
        return PenaltyContinuation().run(
            self._weighted(rung), self._weights(rung), center, self.box.free
        )

    @abstractmethod
    def find_sequences(self, result: AigoResult, rung: Rung) -> list[Sequence]:
        """Returns the contact sequences that AIGO proposes; () is a free flight."""

    @abstractmethod
    def polish(
        self, center: npt.NDArray[np.float64], sequence: Sequence
    ) -> tuple[Transcription, npt.NDArray[np.float64]]:
        """Returns the local optimum next to a contact sequence that was read off a box center.

        Returns:
            The transcription that was solved, and all of its decision variables.
        """

    def solve_locally(self, guess: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns what the local solver makes of a guess, all decision variables (n,)."""
        x = self.solve_program(self.transcription.prog(), guess, lambda: self._nlp)
        return self.transcription.close_rows(x)

    def solve_program(
        self,
        prog: MathematicalProgram,
        guess: npt.NDArray[np.float64],
        compiled: Callable[[], PolynomialNlp] | None = None,
        max_iterations: int | None = None,
    ) -> npt.NDArray[np.float64]:
        """Returns what the local solver makes of a guess for any program.

        Args:
            prog: the program.
            guess: all its decision variables.
            compiled: gives it compiled, if there is a better way than `compile_nlp`; called where
                the local solver is ours.
            max_iterations: of our local solver, which then only runs once.
        """
        if self.options.local_solver != "newton":
            return solve_with_drake(prog, guess, self.options.local_solver).x
        nlp = compiled() if compiled else compile_nlp(prog)
        most = max_iterations or _MAX_ITERATIONS
        for factor in self._cost_units:
            unit = factor * self.transcription.cost_scale()
            result = InteriorPoint(max_iterations=most, cost_unit=unit).solve(nlp, guess)
            if result.is_success or max_iterations:
                break
        return result.x

    def judge(
        self,
        origin: str,
        start: npt.NDArray[np.float64],
        solved: Transcription,
        x: npt.NDArray[np.float64],
    ) -> Candidate:
        """Returns the candidate that a local solver made of a start, replayed on the rigid wall.

        Args:
            origin: how it came about.
            start: decision variables of this problem's transcription.
            solved: the transcription that the local solver solved.
            x: its decision variables.
        """
        world, scenario = solved.world, solved.scenario
        trajectory = solved.trajectory(x)
        return Candidate(
            origin=origin,
            start_cost=self.transcription.scenario_cost(start),
            start_defects=self.transcription.defects(start),
            trajectory=trajectory,
            cost=solved.scenario_cost(x),
            goal_error=float(np.linalg.norm(trajectory.positions[-1] - scenario.goal_position)),
            defects=solved.defects(x),
            max_penetration=max_penetration(world, trajectory),
            contacts=find_contacts(world, trajectory),
            replay=replay_event_driven(world, scenario, trajectory.times, trajectory.controls),
        )

    def _weights(self, rung: Rung) -> dict[str, float]:
        """Returns the rung's weights of the rows that this problem has."""
        unit = self.transcription.cost_scale()
        rows = self.transcription.prog().GetAllConstraints()
        names = {row.evaluator().get_description() for row in rows} & set(self.polynomial.weights)
        return {name: unit * rung.weights.get(name, rung.others) for name in sorted(names)}

    def _weighted(self, rung: Rung) -> BoxPolynomial:
        return self.polynomial.with_weights(self._weights(rung))


def _compile(transcription: Transcription) -> BoxPolynomial:
    return compile_program(transcription.penalized(), transcription.elimination_order())
