"""What do the boxes find on Table I, and what does the search over contact knots add?

    python -m benchmarks.what_boxes_find

Prints the least cost of the literal transcription, φ free, of: AIGO's own contact sequences,
polished; the same after moving contacts to and fro, as `plan` does; and every tenth knot polished,
without any boxes.
"""

from __future__ import annotations

import dataclasses
from typing import get_args

from drake_aigto.paper import LiteralOptions, LiteralProblem, make_literal_problem, plan_literal
from drake_aigto.paper.options import AlgorithmName
from drake_aigto.planning.candidate import LARGEST_DEFECT
from drake_aigto.transcription.rows import largest_defect
from drake_aigto.world import Scenario, World

STRIDE = 10


def grid_cost(problem: LiteralProblem) -> float:
    """Returns the least cost over contacts at every tenth knot."""
    transcription = problem.transcription
    center = problem.box.center
    knots = range(STRIDE // 2, transcription.num_samples() - 1, STRIDE)
    polished = [problem.polish(center, (k,))[1] for k in knots]
    solutions = [
        x
        for x in polished
        if largest_defect(transcription.defects(x), problem.scales) <= LARGEST_DEFECT
    ]
    return min(transcription.scenario_cost(x) for x in solutions)


def main() -> None:
    """Prints a line for every row and algorithm."""
    for row in (1, 2, 3, 4):
        scenario = Scenario.named(f"table1/{row}")
        world = World.from_scenario(scenario)
        options = LiteralOptions(nonpenetration=False, confirm=False)
        grid = grid_cost(make_literal_problem(world, scenario, options))
        for algorithm in get_args(AlgorithmName)[:2]:
            moving = dataclasses.replace(options, algorithm=algorithm)
            still = dataclasses.replace(moving, knot_steps=())
            costs = [plan_literal(scenario, each, world).cost for each in (still, moving)]
            print(
                f"row {row}  {algorithm:13}  sequences of AIGO {costs[0]:.1e}  moved {costs[1]:.1e}"
                f"  every {STRIDE}th knot, no boxes {grid:.1e}",
                flush=True,
            )


if __name__ == "__main__":
    main()
