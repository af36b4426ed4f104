"""Draws the picture of README: row 1 of the paper's Table I, planned in three ways and simulated.

python docs/make_picture.py [docs/images/table1_row1.png]
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator
from pathlib import Path

import matplotlib as mpl

from drake_aigto import Planner, PlanOptions, Scenario, World
from drake_aigto.baselines import gradient_from_zero
from drake_aigto.planning import Candidate, LiteralProblem
from drake_aigto.show.figures import plot_motions
from drake_aigto.show.motion import Motion
from drake_aigto.transcription import LiteralTranscription

mpl.use("Agg")

import matplotlib.pyplot as plt


def make_runs(world: World, scenario: Scenario) -> Iterator[tuple[str, Candidate]]:
    """Yields the three plans, each with its title."""
    options = PlanOptions(transcription="literal", nonpenetration=False)
    snopt = dataclasses.replace(options, local_solver="snopt")
    transcription = LiteralTranscription(world, scenario, snopt.nonpenetration)
    yield (
        "SNOPT, no boxes: brakes and turns",
        gradient_from_zero(LiteralProblem(transcription, snopt)),
    )
    yield "AIGTO as in the paper: overshoots", Planner(scenario, options, world).plan().best
    yield "with impulses at knots: holds", Planner(scenario, world=world).plan().best


def main(path: Path) -> None:
    """Writes the picture."""
    scenario = Scenario.named("table1/1")
    world = World.from_scenario(scenario)
    figure, grid = plt.subplots(
        3, 3, figsize=(10, 6), sharex=True, sharey="row", layout="constrained"
    )
    for axes, (title, run) in zip(grid.T, make_runs(world, scenario), strict=True):
        motions = [
            Motion.from_trajectory(run.trajectory, world),
            Motion.from_replay(run.replay, "simulation of its control on a rigid wall"),
        ]
        plot_motions(axes, motions, world, scenario)
        axes[0].get_legend().remove()  # One for all.
        costs = f"cost: planned {run.cost:.1e}, simulated {run.replay.cost:.1e}"
        axes[0].set_title(f"{title}\n{costs}", fontsize="medium")
    for ax in grid[:, 1:].flat:
        ax.set_ylabel("")
    handles, labels = grid[0, 2].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3)
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    default = Path(__file__).parent / "images" / "table1_row1.png"
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else default)
