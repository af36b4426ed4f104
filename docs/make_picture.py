"""Draws the picture of README: row 1 of the paper's Table I, and what a rigid wall makes of it.

python docs/make_picture.py [docs/images/table1_row1.png]
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import matplotlib as mpl

from drake_aigto import Planner, PlanOptions, Scenario
from drake_aigto.baselines import gradient_from_zero
from drake_aigto.planning import PlanningProblem, make_transcription
from drake_aigto.show.figures import plot_motions
from drake_aigto.show.motion import Motion, motions_of_plan

mpl.use("Agg")

import matplotlib.pyplot as plt


def main(path: Path) -> None:
    """Writes the picture."""
    scenario = Scenario.named("table1/1")
    options = PlanOptions(transcription="literal", nonpenetration=False)
    planner = Planner(scenario, options)
    snopt = dataclasses.replace(options, local_solver="snopt")
    transcription = make_transcription(planner.world, scenario, snopt)
    gradient = gradient_from_zero(PlanningProblem(transcription, snopt))
    plan = planner.plan()
    _, rigid, _ = motions_of_plan(plan, planner.world)
    motions = [
        Motion.from_trajectory(gradient.trajectory, planner.world, "SNOPT from zero (plan)"),
        Motion.from_trajectory(plan.trajectory, planner.world, "AIGTO (plan)"),
        dataclasses.replace(rigid, label="AIGTO's control on a rigid wall (simulation)"),
    ]
    figure, axes = plt.subplots(3, 1, figsize=(8, 6), sharex=True, layout="constrained")
    plot_motions(axes, motions, planner.world, scenario)
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    default = Path(__file__).parent / "images" / "table1_row1.png"
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else default)
