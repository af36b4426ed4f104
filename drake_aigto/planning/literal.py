"""Literal plans: contact knots read off AIGO's boxes, polished, and moved to and fro."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from drake_aigto.aigo import AigoResult
from drake_aigto.planning.options import Rung
from drake_aigto.planning.plan import Candidate
from drake_aigto.planning.problem import PlanningProblem
from drake_aigto.planning.search import Search
from drake_aigto.transcription import LiteralTranscription, Touch, Transcription

if TYPE_CHECKING:
    import numpy.typing as npt

# A knot counts as a contact if it comes this much nearer to the wall than start and goal.
_NEARER = 0.25

# Contacts this many knots apart are one proposal of AIGO's; moving them tells them apart.
_SAME = 2

Knots = tuple[int, ...]


class LiteralProblem(PlanningProblem[LiteralTranscription, Knots]):
    """The literal transcription: a contact sequence is the knot at the wall, or ()."""

    def find_sequences(self, result: AigoResult, rung: Rung) -> list[Knots]:
        """Returns the contact sequences that AIGO proposes; () is a free flight.

        One is read off the box center as it is, another after pulling it towards the constraints.
        """
        center = result.box.center
        return [contact_knots(self.transcription, x) for x in (center, self.pull(center, rung))]

    def polish(
        self, center: npt.NDArray[np.float64], sequence: Knots
    ) -> tuple[LiteralTranscription, npt.NDArray[np.float64]]:
        """Returns the transcription, and its local optimum next to a contact sequence.

        The local solver starts from the ballistic guess: of AIGO's box center only the sequence is
        kept, as its penalised rows are off by far.
        """
        guess = ballistic_guess(self.transcription, center, sequence)
        return self.transcription, self.solve_locally(guess)


class LiteralSearch(Search[Knots]):
    """AIGO proposes contact knots, and those of the best candidates are moved."""

    def improve(self, sequence: Knots) -> None:
        """Moves each contact of a candidate to and fro by so many knots, while that helps.

        Each of the options' knot steps is repeated until it does not help any more.
        """
        for step in self.problem.options.knot_steps:
            while (best := self._best([sequence, *self._neighbours(sequence, step)])) != sequence:
                sequence = best

    def finalists(self) -> list[Knots]:
        """Returns sequences with contacts: first those that the polish left in contact."""
        return sorted(
            filter(None, self.by_sequence),
            key=lambda knots: (
                not self.by_sequence[knots].contacts,
                *self.rank(self.by_sequence[knots]),
            ),
        )

    def is_known(self, sequence: Knots) -> bool:
        """Returns whether there is a candidate of nearly these knots."""
        return any(
            len(sequence) == len(known)
            and all(abs(a - b) <= _SAME for a, b in zip(sequence, known, strict=True))
            for known in self.by_sequence
        )

    def rank(self, candidate: Candidate) -> tuple[float, ...]:
        """Orders by feasibility and by the cost that is promised."""
        return not candidate.is_feasible, candidate.cost

    def _best(self, sequences: list[Knots]) -> Knots:
        return min(sequences, key=lambda knots: self.rank(self.by_sequence[knots]))

    def _neighbours(self, knots: Knots, step: int) -> Iterator[Knots]:
        """Yields the sequences with one contact moved, which are candidates by then."""
        last = self.problem.transcription.num_samples() - 1
        for i, shift in itertools.product(range(len(knots)), (-step, step)):
            moved = tuple(k + shift if j == i else k for j, k in enumerate(knots))
            if not all(a < b for a, b in itertools.pairwise((0, *moved, last))):
                continue
            if moved not in self.by_sequence:
                times = self.problem.transcription.GetSampleTimes()[list(knots)]
                touches = tuple(map(Touch.bounce, times))
                origin = self.by_sequence[knots].origin.changed("moved", touches)
                self.add(origin, self.centers[knots], moved)
            yield moved


def contact_knots(transcription: Transcription, x: npt.NDArray[np.float64]) -> Knots:
    """Returns the contact sequence of decision variables: the knot that is deepest, or none.

    The rows need not hold: AIGO's box centers are read before any polish. One contact is all that
    the literal transcription needs, as one knot at the wall gives an impulse of any size; further
    visits to the wall are slack of the penalties.
    """
    scenario, world = transcription.scenario, transcription.world
    distances = np.min(transcription.signed_distances(x), axis=1)
    ends = (scenario.initial_position, scenario.goal_position)
    near = _NEARER * min(float(np.min(world.calc_signed_distance(q))) for q in ends)
    deepest = int(np.argmin(distances[1:-1])) + 1
    return (deepest,) if distances[deepest] < near else ()


def ballistic_guess(
    transcription: Transcription, x: npt.NDArray[np.float64], knots: Knots
) -> npt.NDArray[np.float64]:
    """Returns a guess that flies straight from the start over the contacts to the goal, u = 0.

    Only the contacts' knots, and where along the wall they are, are taken from x.

    Args:
        transcription: whose decision variables these are.
        x: AIGO's box center, shape (n,).
        knots: of the contacts, increasing.
    """
    scenario = transcription.scenario
    positions, _, controls = transcription.split(x)
    last = len(positions) - 1
    stops = {0: scenario.initial_position, last: scenario.goal_position}
    stops |= {k: _onto_wall(transcription, positions[k]) for k in knots}
    path = np.vstack(
        [scenario.initial_position]
        + [
            np.linspace(stops[first], stops[second], second - first + 1)[1:]
            for first, second in itertools.pairwise(sorted(stops))
        ]
    )
    steps = np.diff(path, axis=0) / transcription.time_step()
    velocities = np.vstack([steps, steps[-1:]])
    return transcription.vector_of(path, velocities, np.zeros(controls.shape))


def _onto_wall(transcription: Transcription, q: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Returns the nearest q with φ(q) = 0, exact for an affine φ."""
    J = transcription.world.calc_contact_jacobian(q)
    moved: npt.NDArray[np.float64] = q - np.linalg.pinv(J) @ (
        transcription.world.calc_signed_distance(q)
    )
    return moved
