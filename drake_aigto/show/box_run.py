"""AIGO's boxes behind a plan: they are not in its file, and cheap to have again."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np

from drake_aigto.aigo import Annealing, SlowMotion
from drake_aigto.paper import LiteralOptions, make_literal_problem
from drake_aigto.paper.options import AlgorithmName
from drake_aigto.planning import PlanOptions, make_problem
from drake_aigto.world import World

if TYPE_CHECKING:
    import numpy.typing as npt

    from drake_aigto.aigo import AigoResult, Iterate
    from drake_aigto.planning import Plan, PlanningProblem, Rung, SearchOptions
    from drake_aigto.transcription import Transcription

    _Array = npt.NDArray[np.float64]


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

    def positions(self, iterate: Iterate) -> tuple[_Array, _Array]:
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


def run_boxes(
    plan: Plan, world: World | None = None, options: SearchOptions | None = None
) -> BoxRun:
    """Runs that rung of AIGO's ladder again which the plan came from.

    The same input gives the same boxes. Of options that are not the planner's own the plan's file
    says nothing but the algorithm and the rung; without a rung, the first one is run.

    Args:
        plan: the plan.
        world: that of its scenario; built from the model if None.
        options: that it was made with; if None, the planner's own for its transcription.

    Raises:
        ModelError, ScenarioError: the model can't be used, or the scenario does not fit.
    """
    world = world or World.from_scenario(plan.scenario)
    problem = _make_problem(plan, world, options)
    rung = plan.best.origin.rung or problem.options.ladder[0]
    algorithm = problem.make_algorithm(rung)
    if isinstance(algorithm, Annealing):
        algorithm = SlowMotion(algorithm)
    result = problem.run_aigo(rung, algorithm)
    return BoxRun(problem, rung, problem.start(rung.start).transcription, result)


def _make_problem(plan: Plan, world: World, options: SearchOptions | None) -> PlanningProblem:
    """Returns the problem that the plan is of; without options, in its own transcription."""
    if isinstance(options, PlanOptions) or (options is None and plan.transcription == "rigid"):
        return make_problem(world, plan.scenario, options)
    assert options is None or isinstance(options, LiteralOptions)
    options = options or LiteralOptions()
    if plan.best.origin.rung is not None:
        algorithm = cast(AlgorithmName, plan.best.origin.proposer)
        options = dataclasses.replace(options, algorithm=algorithm)
    return make_literal_problem(world, plan.scenario, options)
