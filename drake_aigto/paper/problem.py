"""The literal transcription, compiled: contacts read off AIGO's boxes, polishes, and guesses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from drake_aigto.aigo import AigoResult, Algorithm, Alternating, Annealing, FullGradient
from drake_aigto.arrays import Floats, interpolate
from drake_aigto.paper.literal import LiteralTranscription
from drake_aigto.paper.options import LiteralOptions
from drake_aigto.planning import Candidate, Origin, ProgramTask, Rung
from drake_aigto.transcription import Transcription
from drake_aigto.world import Scenario, World

# A knot counts as a contact if it comes this much nearer to the wall than start and goal.
_NEARER = 0.25
# Those that need no temperature.
_ALGORITHMS: Mapping[str, Algorithm] = {
    "full gradient": FullGradient(),
    "alternating": Alternating(),
}

Knots = tuple[int, ...]


def make_literal_task(
    world: World, scenario: Scenario, options: LiteralOptions | None = None
) -> LiteralTask:
    """Returns the scenario, literally transcribed and compiled."""
    options = options or LiteralOptions()
    return LiteralTask(LiteralTranscription(world, scenario, options.nonpenetration), options)


class LiteralTask(ProgramTask):
    """The literal transcription: a contact sequence is the knot at the wall, or ()."""

    transcription: LiteralTranscription
    options: LiteralOptions

    transcription_name: ClassVar[str] = "literal"

    def __init__(
        self, transcription: LiteralTranscription, options: LiteralOptions | None = None
    ) -> None:
        """Compiles; the transcription decides whether φ ≥ 0 is a constraint."""
        options = options or LiteralOptions()
        super().__init__(transcription, options, options.ladder)

    def make_algorithm(self, rung: Rung) -> Algorithm:
        """Returns the options' algorithm."""
        annealing = Annealing(initial_temperature=rung.temperature * self._cost_scale)
        return _ALGORITHMS.get(self.options.algorithm, annealing)

    @property
    def algorithm_name(self) -> str:
        """The options' algorithm."""
        return self.options.algorithm

    def find_sequences(self, result: AigoResult, rung: Rung) -> list[Knots]:
        """Returns the contact sequences that AIGO proposes; () is a free flight.

        One is read off the box center itself, another after pulling it towards the constraints.
        """
        center = result.box.center
        return [contact_knots(self.transcription, x) for x in (center, self.pull(center, rung))]

    def polish(self, center: Floats, sequence: Knots) -> tuple[LiteralTranscription, Floats]:
        """Returns the transcription, and its local optimum next to a contact sequence.

        The local solver starts from the ballistic guess: of AIGO's box center only the sequence is
        kept, as its penalized rows are off by far.
        """
        guess = ballistic_guess(self.transcription, center, sequence)
        return self.transcription, self.solve_locally(guess)


def contact_knots(transcription: Transcription, x: Floats) -> Knots:
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


def ballistic_guess(transcription: Transcription, x: Floats, knots: Knots) -> Floats:
    """Returns a guess that flies straight from the start over the contacts to the goal, u = 0.

    Of x, AIGO's box center of shape (n,), it takes the positions of contacts along the wall, at
    increasing knots.
    """
    scenario = transcription.scenario
    positions, _, controls = transcription.split(x)
    last = len(positions) - 1
    stops = {0: scenario.initial_position, last: scenario.goal_position}
    every = range(transcription.world.num_contacts)
    stops |= {k: transcription.world.move_onto(positions[k], every) for k in knots}
    path = interpolate(range(last + 1), sorted(stops), np.array([stops[k] for k in sorted(stops)]))
    steps = np.diff(path, axis=0) / transcription.time_step()
    velocities = np.vstack([steps, steps[-1:]])
    return transcription.vector_of(path, velocities, np.zeros(controls.shape))


def gradient_from_zero(problem: LiteralTask) -> Candidate:
    """Returns the result of the problem's local solver from a guess of zeros."""
    start = np.zeros(problem.transcription.prog().num_vars())
    return _run(problem, "zero", start)


def gradient_from_random(problem: LiteralTask, generator: np.random.Generator) -> Candidate:
    """Returns the local solver's result from a guess, uniform over the first box of AIGO."""
    return _run(problem, "random", random_guess(problem.transcription, generator))


def random_guess(transcription: Transcription, generator: np.random.Generator) -> Floats:
    """Returns all decision variables, uniform over the first box of AIGO."""
    center, half_width = transcription.initial_box()
    return generator.uniform(center - half_width, center + half_width)


def _run(problem: LiteralTask, proposer: str, start: Floats) -> Candidate:
    x = problem.solve_locally(start)
    return problem.judge(Origin(proposer), start, problem.transcription, x)
