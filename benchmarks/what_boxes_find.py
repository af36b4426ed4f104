"""What do the boxes find on Table I, and what does the search over contact knots add?

    python -m benchmarks.what_boxes_find

Prints the least cost of the literal transcription, φ free, of: AIGO's own contact sequences,
polished; the same after moving contacts to and fro, as `plan` does; and every tenth knot polished,
without any boxes.
"""

from __future__ import annotations

import dataclasses

from drake_aigto.planning import LiteralProblem, Planner, PlanOptions
from drake_aigto.planning.plan import LARGEST_DEFECT
from drake_aigto.transcription import LiteralTranscription
from drake_aigto.world import Scenario

STRIDE = 10


def grid_cost(problem: LiteralProblem) -> float:
    """Returns the least cost over contacts at every tenth knot."""
    transcription = problem.transcription
    center = problem.box.center
    knots = range(STRIDE // 2, transcription.num_samples() - 1, STRIDE)
    polished = [problem.polish(center, (k,))[1] for k in knots]
    solutions = [x for x in polished if max(transcription.defects(x).values()) <= LARGEST_DEFECT]
    return min(transcription.scenario_cost(x) for x in solutions)


def main() -> None:
    """Prints a line for every row and algorithm."""
    for row in (1, 2, 3, 4):
        scenario = Scenario.named(f"table1/{row}")
        options = PlanOptions(transcription="literal", nonpenetration=False, confirm=False)
        planner = Planner(scenario, options)
        transcription = LiteralTranscription(planner.world, scenario, nonpenetration=False)
        grid = grid_cost(LiteralProblem(transcription, options))
        for algorithm in ("annealing", "full gradient"):
            moving = dataclasses.replace(options, algorithm=algorithm)
            still = dataclasses.replace(moving, knot_steps=())
            costs = [Planner(scenario, o, planner.world).plan().cost for o in (still, moving)]
            print(
                f"row {row}  {algorithm:13}  sequences of AIGO {costs[0]:.1e}  moved {costs[1]:.1e}"
                f"  every {STRIDE}th knot, no boxes {grid:.1e}",
                flush=True,
            )


if __name__ == "__main__":
    main()
