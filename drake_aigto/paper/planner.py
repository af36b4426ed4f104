"""Planning as in the paper: plans are literal, and simulations show their value."""

from __future__ import annotations

from collections.abc import Iterator

from drake_aigto.contact import contact_delay
from drake_aigto.paper.options import LiteralOptions
from drake_aigto.paper.problem import Knots, LiteralTask, make_literal_task
from drake_aigto.planning import Candidate, Plan, Progress, SequenceSearch, Stopwatch
from drake_aigto.transcription import Touch
from drake_aigto.world import Scenario, World

# Contacts this many knots apart are one proposal of AIGO's; moving them distinguishes them.
_SAME = 2


def plan_literal(
    scenario: Scenario,
    options: LiteralOptions | None = None,
    world: World | None = None,
    progress: Progress | None = None,
) -> Plan:
    """Plans as the paper does (AIGTO Sec. IV): explicit Euler, with the contact force ε/(φ + δ).

    The plan of least cost is the answer, whether simulations confirm it or not; see `Plan.holds`.
    Ctrl-C ends the search; the best candidate so far is returned. A world of your own
    (`World.from_diagram`) has one wall; before each candidate, `progress` gets a line of text.

    Raises:
        ScenarioError: the scenario does not fit the world.
        ModelError: the model can't be used, or has several contacts.
        PlanningError: no candidate meets the transcription's rows.
    """
    options, clock = options or LiteralOptions(), Stopwatch()
    world = world or World.from_scenario(scenario)
    world.check(scenario)
    world.check_frictionless(scenario)
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


class LiteralSearch(SequenceSearch):
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

    def rank(self, candidate: Candidate) -> tuple[float, ...]:
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
