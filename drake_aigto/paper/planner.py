"""Planning in the paper's transcription; simulations show what its plans are worth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal, get_args

import numpy as np

from drake_aigto import planning
from drake_aigto.aigo import AigoResult, Algorithm, Alternating, Annealing, FullGradient
from drake_aigto.arrays import Floats, interpolate
from drake_aigto.contact import contact_delay
from drake_aigto.errors import OptionsError
from drake_aigto.paper.transcriptions import LiteralTranscription
from drake_aigto.transcription import DYNAMICS, KINEMATICS, NONPENETRATION, Touch, Transcription
from drake_aigto.world import Scenario, World

Knots = tuple[int, ...]
AlgorithmName = Literal["annealing", "full gradient", "alternating"]

# Contacts this many knots apart are one proposal of AIGO's; moving them distinguishes them.
_SAME = 2
# A knot counts as a contact if it comes this much nearer to the wall than start and goal.
_NEARER = 0.25
# Those that need no temperature.
_ALGORITHMS: Mapping[str, Algorithm] = {
    "full gradient": FullGradient(),
    "alternating": Alternating(),
}


def _literal_rung(temperature: float, kinematics: float, dynamics: float) -> planning.Rung:
    weights = {KINEMATICS: kinematics, DYNAMICS: dynamics, NONPENETRATION: 5e-4}
    return planning.Rung(temperature, weights)


# Light dynamics rows keep the paper's contact alive while boxes are wide: a heavy (φ + δ)² (…)² is
# least at φ ≈ 0 with no impulse, the collapse of AIGTO Fig. 1. Light kinematics rows let the mass
# jump to the wall at once. The first rung alone finds the bounce of all of Table I by annealing; a
# heavy and cold one ends in free flight; Algorithm 1 needs the lightest.
LITERAL_LADDER = (
    _literal_rung(1e-4, 1e3, 1e-2),
    _literal_rung(1e-5, 1e2, 1e0),
    _literal_rung(1e-4, 1e3, 1e-3),
    _literal_rung(1e-5, 1e2, 1e-4),
    _literal_rung(1e-4, 1e1, 1e-4),
)


@dataclass(frozen=True, kw_only=True)
class LiteralOptions(planning.SearchOptions):
    """Numerics of a plan in the paper's transcription (`LiteralTranscription`).

    Attributes:
        ladder: the starts of AIGO; candidates come out of each. Local_solver, finalists, threads
            and confirm: see `SearchOptions`.
        nonpenetration: whether φ(q_k) ≥ 0 is a constraint. The paper's figures need it off.
        algorithm: "annealing"; or "full gradient", the paper's Algorithm 1, or "alternating", the
            one before it.
        knot_steps: numbers of knots by which contacts of finalists are moved, in turn.
    """

    ladder: tuple[planning.Rung, ...] = field(default=LITERAL_LADDER, repr=False)
    nonpenetration: bool = True
    algorithm: AlgorithmName = "annealing"
    knot_steps: tuple[int, ...] = (16, 8, 4, 2, 1)

    def __post_init__(self) -> None:
        """Checks the choices."""
        super().__post_init__()
        self._check_choice("algorithm", get_args(AlgorithmName))
        if not self.ladder:
            raise OptionsError("ladder", got="no rung", expected="at least one")


def plan_literal(
    scenario: Scenario,
    options: LiteralOptions | None = None,
    world: World | None = None,
    progress: planning.Progress | None = None,
) -> planning.Plan:
    """Plans as the paper does (AIGTO Sec. IV): explicit Euler, with the contact force ε/(φ + δ).

    The plan of least cost is the answer, whether simulations confirm it or not; see `Plan.holds`.
    Ctrl-C ends the search; the best candidate so far is returned. A world of your own
    (`World.from_diagram`) has one wall; before each candidate, `progress` gets a line of text.

    Raises:
        ScenarioError: the scenario does not fit the world.
        ModelError: the model can't be used, or has several contacts.
        PlanningError: no candidate meets the transcription's rows.
    """
    options, clock = options or LiteralOptions(), planning.Stopwatch()
    world = world or World.from_scenario(scenario)
    world.check(scenario)
    world.rubbing.check_none(scenario.friction)
    if options.confirm:
        contact_delay(world)  # A wall without stiffness is refused before long work.
    with clock("build"):
        problem = make_literal_task(world, scenario, options)
    search = LiteralSearch(problem, clock)
    search.run(progress)
    best = search.find_feasible()[0]
    search.confirm(best)
    search.add_idle()
    return search.make_plan(scenario, best)


class LiteralSearch(planning.SequenceSearch):
    """AIGO proposes contact knots, and those of the best candidates are moved."""

    task: LiteralTask

    def improve(self, sequence: Knots) -> None:
        """Moves a candidate's contact back and forth by knots, while that helps.

        Each of the options' knot steps is repeated until it does not help any more.
        """
        for step in self.task.options.knot_steps:
            while (best := min(self._around(sequence, step), key=self.rank_of)) != sequence:
                sequence = best

    def finalists(self) -> list[Knots]:
        """Returns sequences with a contact: first those that the polish left in contact."""
        return sorted(
            filter(None, self.by_sequence),
            key=lambda knots: (not self.by_sequence[knots].contacts, *self.rank_of(knots)),
        )

    def is_known(self, sequence: Knots) -> bool:
        """Returns whether there is a candidate of nearly this knot."""
        return any(
            len(sequence) == len(known)
            and all(abs(a - b) <= _SAME for a, b in zip(sequence, known, strict=True))
            for known in self.by_sequence
        )

    def rank(self, candidate: planning.Candidate) -> tuple[float, ...]:
        """Orders by feasibility and by the cost that is promised."""
        return not candidate.is_feasible, candidate.cost

    def _around(self, sequence: Knots, step: int) -> Iterator[Knots]:
        """Yields a sequence and those with its contact moved, which are candidates by then."""
        yield sequence
        (knot,), times = sequence, self.task.transcription.GetSampleTimes()
        for moved in (knot - step, knot + step):
            if 0 < moved < len(times) - 1:
                if (moved,) not in self.by_sequence:
                    touch = Touch.bounce(times[knot])
                    origin = self.by_sequence[sequence].origin.changed("moved", (touch,))
                    self.add(origin, self.centers[sequence], (moved,))
                yield (moved,)


def make_literal_task(
    world: World, scenario: Scenario, options: LiteralOptions | None = None
) -> LiteralTask:
    """Returns the scenario, literally transcribed and compiled."""
    options = options or LiteralOptions()
    return LiteralTask(LiteralTranscription(world, scenario, options.nonpenetration), options)


class LiteralTask(planning.ProgramTask):
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

    def make_algorithm(self, rung: planning.Rung) -> Algorithm:
        """Returns the options' algorithm."""
        annealing = Annealing(initial_temperature=rung.temperature * self._cost_scale)
        return _ALGORITHMS.get(self.options.algorithm, annealing)

    @property
    def algorithm_name(self) -> str:
        """The options' algorithm."""
        return self.options.algorithm

    def find_sequences(self, result: AigoResult, rung: planning.Rung) -> list[Knots]:
        """Returns the contact sequences that AIGO proposes; () is a free flight.

        One is read off the box center itself, another after pulling it towards the constraints.
        """
        center = result.box.center
        return [contact_knots(self.transcription, x) for x in (center, self.pull(center, rung))]

    def polish(self, center: Floats, sequence: Knots) -> planning.ProgramSolution:
        """Returns the local optimum next to a contact sequence.

        The local solver starts from the ballistic guess: of AIGO's box center only the sequence is
        kept, as its penalized rows are off by far.
        """
        guess = ballistic_guess(self.transcription, center, sequence)
        return planning.ProgramSolution.of(self.transcription, self.solve_locally(guess))


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


def gradient_from_zero(problem: LiteralTask) -> planning.Candidate:
    """Returns the result of the problem's local solver from a guess of zeros."""
    start = np.zeros(problem.transcription.prog().num_vars())
    return _run(problem, "zero", start)


def gradient_from_random(
    problem: LiteralTask, generator: np.random.Generator
) -> planning.Candidate:
    """Returns the local solver's result from a guess, uniform over the first box of AIGO."""
    return _run(problem, "random", random_guess(problem.transcription, generator))


def random_guess(transcription: Transcription, generator: np.random.Generator) -> Floats:
    """Returns all decision variables, uniform over the first box of AIGO."""
    center, half_width = transcription.initial_box()
    return generator.uniform(center - half_width, center + half_width)


def _run(problem: LiteralTask, proposer: str, start: Floats) -> planning.Candidate:
    x = problem.solve_locally(start)
    return problem.judge(
        planning.Origin(proposer), start, planning.ProgramSolution.of(problem.transcription, x)
    )
