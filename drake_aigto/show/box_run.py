"""AIGO's boxes behind a plan: they are not in its file, and cheap to have again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_aigto.aigo import AigoResult, Annealing, Iterate, SlowMotion
from drake_aigto.arrays import Floats
from drake_aigto.errors import OptionsError
from drake_aigto.paper import LiteralOptions, make_literal_problem
from drake_aigto.planning import (
    Plan,
    PlanningProblem,
    PlanOptions,
    Rung,
    SearchOptions,
    make_problem,
)
from drake_aigto.transcription import Transcription
from drake_aigto.world import Scenario, World


@dataclass(frozen=True, eq=False)
class BoxRun:
    """One run of AIGO on a scenario.

    Attributes:
        problem: that was solved.
        rung: of the ladder.
        transcription: knows which of the boxes' variables are which.
        result: with all boxes, the first and the last included; of an annealing, those after
            every Newton step.
    """

    problem: PlanningProblem
    rung: Rung
    transcription: Transcription
    result: AigoResult

    def positions(self, iterate: Iterate) -> tuple[Floats, Floats]:
        """Returns centers and half widths of the boxes around q, shape (N+1, nq) each [m]."""
        box = iterate.box
        return self.transcription.split(box.center)[0], self.transcription.split(box.half_width)[0]

    def pick(self, count: int, smallest: float = 0.0) -> list[int]:
        """Returns which iterates show best how the boxes shrink: evenly, by the logarithm of size.

        Args:
            count: at most so many, the first and the last one included.
            smallest: where the widest box around q is narrower than twice this, iterates count as
                equal [m].

        Returns:
            Places in `result.history`, increasing.
        """
        widths = [np.max(self.positions(each)[1]) for each in self.result.history]
        sizes = np.log(np.maximum(widths, max(smallest, np.finfo(float).tiny)))
        levels = np.linspace(sizes[0], sizes.min(), count - 1)
        found = [int(np.argmax(sizes <= level + 1e-9)) for level in levels]
        return sorted({*found, len(sizes) - 1})


def run_boxes(plan: Plan, world: World | None = None) -> BoxRun:
    """Runs that rung of AIGO's ladder again which the plan came from: the same boxes.

    Raises:
        OptionsError: the boxes can't be had again; says why.
        ModelError: the world has to be given (`Plan.find_world`).
    """
    world, rung = plan.find_world(world), plan.best.origin.rung
    if plan.options is None:
        raise _refuse("no options")
    if rung is None:
        raise _refuse("no rung of AIGO's ladder")
    if plan.additions:
        names = ", ".join(plan.additions)
        raise _refuse(f"costs or constraints of one's own, by name only ({names})")
    problem = _make_problem(plan.scenario, world, plan.options)
    algorithm = problem.make_algorithm(rung)
    if isinstance(algorithm, Annealing):
        algorithm = SlowMotion(algorithm)
    result = problem.run_aigo(rung, algorithm)
    return BoxRun(problem, rung, problem.start(rung.start).transcription, result)


def _refuse(what: str) -> OptionsError:
    return OptionsError(
        "the plan's boxes can't be had again",
        got=f"a plan that names {what}",
        expected="its options and the rung that it came from, of a program without additions",
    )


def _make_problem(scenario: Scenario, world: World, options: SearchOptions) -> PlanningProblem:
    """Returns the problem that a plan with such options is of."""
    if isinstance(options, LiteralOptions):
        return make_literal_problem(world, scenario, options)
    assert isinstance(options, PlanOptions)
    return make_problem(world, scenario, options)
