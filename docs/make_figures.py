"""Draws figures of what AIGO does, into a folder: AIGTO Fig. 1 to 3, boxes, landscapes, a robot.

python -m docs.make_figures [docs/images]
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np

from benchmarks.paper_figures import (
    paper_methods,
    plot_integrated_product,
    plot_methods,
    write_numbers,
)
from drake_aigto import ModelPredictiveController, Plan, Planner, Scenario, World, plan
from drake_aigto.control import Disturbance, run_in_loop
from drake_aigto.show import (
    gradient_motions,
    motions_of_plan,
    plot_boxes,
    plot_cost_history,
    plot_cost_landscape,
    plot_mind,
    plot_phase_portrait,
    plot_run,
    plot_strobe,
    run_boxes,
)

mpl.use("Agg")

import matplotlib.pyplot as plt

_ROWS = (1, 2, 3, 4)


def draw_product(path: Path) -> None:
    """Writes the paper's Fig. 1: the penalty of complementarity, and its mean over boxes."""
    figure, row = plt.subplots(1, 3, figsize=(10, 3.4), layout="constrained", sharey=True)
    for axes, half_width in zip(row, (0.0, 1.0, 2.0), strict=True):
        plot_integrated_product(axes, half_width)
        axes.label_outer()
    figure.savefig(path, dpi=100)


def draw_methods(path: Path) -> None:
    """Writes the paper's Fig. 2 and 3: plans of three methods, for all rows of Table I."""
    figure, grid = plt.subplots(
        *(4, len(_ROWS)),
        figsize=(13, 8),
        sharex="row",
        layout="constrained",
        gridspec_kw={"height_ratios": [3, 3, 3, 1.2]},
    )
    for column, number in zip(grid.T, _ROWS, strict=True):
        scenario = Scenario.named(f"table1/{number}")
        world = World.from_scenario(scenario)
        runs = paper_methods(scenario, world)
        plot_methods(column[:3], runs, world, scenario)
        column[0].get_legend().remove()  # One for all.
        column[0].set_title(f"row {number}", fontsize="medium")
        write_numbers(column[3], runs)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    title = "plans of the paper's transcription (no simulations), φ free"
    figure.legend(handles, labels, loc="outside upper center", ncols=6, title=title)
    figure.savefig(path, dpi=90)


def draw_boxes(found: Plan, world: World, path: Path) -> None:
    """Writes how boxes shrink: bands at several temperatures, and what that costs."""
    run = run_boxes(found, world)
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    chosen = [run.result.history[i] for i in run.pick(5, smallest=0.01)]
    plot_boxes(left, run.transcription, chosen)
    plot_cost_history(right, run)
    figure.savefig(path, dpi=100)


def draw_landscape(found: Plan, world: World, path: Path) -> None:
    """Writes the phase portrait, and the landscape of bounces with each method's end."""
    scenario = found.scenario
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 5), layout="constrained")
    motions = [*motions_of_plan(found, world)[:2], gradient_motions(world, scenario)[0]]
    plot_phase_portrait(left, motions, world, scenario)
    ends = {"AIGTO, rigid transcription": found.best}
    ends |= paper_methods(scenario, world)
    plot_cost_landscape(right, world, scenario, ends)
    figure.savefig(path, dpi=100)


def draw_cart_pole(path: Path) -> None:
    """Writes the plan for a cart-pole between soft walls, in one still picture."""
    found = plan(Scenario.named("cart_pole/soft_06"))
    world = found.find_world()
    figure, axes = plt.subplots(figsize=(6.5, 4.8), layout="constrained")
    plot_strobe(axes, motions_of_plan(found, world)[0], world, found.scenario)
    figure.savefig(path, dpi=100)


def draw_in_the_loop(path: Path) -> None:
    """Writes the moment at which a kicked cart-pole's plan changes its mind."""
    planner = Planner(Scenario.named("cart_pole/soft_06"))
    controller = ModelPredictiveController(planner, period=0.01, horizon="shrinking")
    kick = Disturbance(kick=np.array([0.3, 1.5]), kick_time=0.5)
    run = run_in_loop(controller, planner.scenario, planner.world, kick)
    figure = plt.figure(figsize=(11, 6.4), layout="constrained")
    grid = figure.add_gridspec(2, 6, height_ratios=[1.35, 1])
    plot_mind([figure.add_subplot(grid[0, 2 * i : 2 * i + 2]) for i in range(3)], run)
    for coordinate in range(2):
        axes = figure.add_subplot(grid[1, 3 * coordinate : 3 * coordinate + 3])
        plot_run(axes, run, coordinate)
        handles, labels = axes.get_legend_handles_labels()
        axes.get_legend().remove()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, fontsize="small")
    figure.savefig(path, dpi=100)


def main(folder: Path) -> None:
    """Writes all of them."""
    draw_product(folder / "integrated_product.png")
    draw_methods(folder / "paper_figures.png")
    scenario = Scenario.named("table1/1")
    world = World.from_scenario(scenario)
    found = plan(scenario, world=world)
    draw_boxes(found, world, folder / "boxes.png")
    draw_landscape(found, world, folder / "landscape.png")
    draw_cart_pole(folder / "cart_pole.png")
    draw_in_the_loop(folder / "in_the_loop.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "images")
