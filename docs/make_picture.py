"""Draws the pictures of README into a folder.

Row 1 of the paper's Table I, planned in three ways and simulated; and ways between several walls.

python docs/make_picture.py [docs/images]
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator
from pathlib import Path

import matplotlib as mpl

from drake_aigto import Planner, Scenario, World
from drake_aigto.paper import (
    LiteralOptions,
    gradient_from_zero,
    make_literal_problem,
    plan_literal,
)
from drake_aigto.planning import Candidate
from drake_aigto.show.figures import plot_motions, plot_path
from drake_aigto.show.motion import Motion

mpl.use("Agg")

import matplotlib.pyplot as plt

_WAYS = {
    "room/two_walls": "off two walls of a room",
    "room_with_block/off_the_block": "off a block in a room",
    "two_masses/handed_on": "two masses on a line",
}


def make_runs(world: World, scenario: Scenario) -> Iterator[tuple[str, Candidate]]:
    """Yields the three plans, each with its title."""
    options = LiteralOptions(nonpenetration=False)
    snopt = dataclasses.replace(options, local_solver="snopt")
    problem = make_literal_problem(world, scenario, snopt)
    yield "SNOPT, no boxes: brakes and turns", gradient_from_zero(problem)
    yield "AIGTO as in the paper: overshoots", plan_literal(scenario, options, world).best
    yield "with impulses at knots: holds", Planner(scenario, world=world).plan().best


def draw_row(path: Path) -> None:
    """Writes the picture of the paper's row."""
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


def draw_ways(path: Path) -> None:
    """Writes the picture of ways between walls."""
    figure, row = plt.subplots(1, len(_WAYS), figsize=(10, 3.7), layout="constrained")
    for axes, (name, title) in zip(row, _WAYS.items(), strict=True):
        scenario = Scenario.named(name)
        world = World.from_scenario(scenario)
        run = Planner(scenario, world=world).plan().best
        motions = [
            Motion.from_trajectory(run.trajectory, world),
            Motion.from_replay(run.replay, "simulation of its control on rigid walls"),
        ]
        plot_path(axes, motions, world, scenario)
        axes.get_legend().remove()  # One for all.
        axes.set_title(title, fontsize="medium")
    handles, labels = row[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=6, fontsize="small")
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "images"
    draw_row(folder / "table1_row1.png")
    draw_ways(folder / "ways_between_walls.png")
