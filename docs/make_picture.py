"""Draws the pictures of README into a folder.

Row 1 of the paper's Table I, planned in three ways and simulated, also as an animation of two of
them; ways between several walls; and a plan that is made again as its start is dragged.

python docs/make_picture.py [docs/images]
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter

from drake_aigto import Planner, PlanOptions, Scenario, World
from drake_aigto.paper import LiteralOptions, gradient_from_zero, make_literal_task, plan_literal
from drake_aigto.planning import Candidate
from drake_aigto.show import PLAN_LABEL, Motion, color_of, plot_motions, plot_path, run_texts

mpl.use("Agg")

import matplotlib.pyplot as plt

_WAYS = {
    "room/two_walls": "off two walls of a room",
    "room_with_block/off_the_block": "off a block in a room",
    "two_masses/handed_on": "two masses on a line",
}
# The animation: how many frames, how many more at its end, how fast; how big a ball looks [m].
_FRAMES, _REST, _FRAMES_PER_SECOND = 51, 20, 20
_RADIUS = 0.02
# Of labels over lines.
_ON_LINES = {"facecolor": "white", "edgecolor": "none", "pad": 1}
# Where the start of a ball in a room is dragged to and fro, from and to [m], its velocity [m/s],
# and in how many moves each way; how long the ball takes for its motion, in moves.
_DRAGGED, _VELOCITY, _MOVES = ((0.2, 0.92), (0.2, 0.45)), (0.6, -0.7), 30
_ROUND = 15


def make_runs(world: World, scenario: Scenario) -> Iterator[tuple[str, Candidate]]:
    """Yields the three plans, each with its title."""
    options = LiteralOptions(nonpenetration=False)
    snopt = dataclasses.replace(options, local_solver="snopt")
    problem = make_literal_task(world, scenario, snopt)
    yield "SNOPT, no boxes: brakes and turns", gradient_from_zero(problem)
    yield "AIGTO as in the paper: overshoots", plan_literal(scenario, options, world).best
    yield "with impulses at knots: holds", Planner(scenario, world=world).plan().best


def worth(run: Candidate) -> str:
    """Returns what a plan's cost is worth, beside what its simulation costs."""
    _, defect, deepest, energy = run_texts(run)
    return f"defect {defect}, penetration {deepest}, energy ratio {energy}"


def draw_row(
    runs: Sequence[tuple[str, Candidate]], world: World, scenario: Scenario, path: Path
) -> None:
    """Writes the picture of the paper's row."""
    figure, grid = plt.subplots(
        3, 3, figsize=(10, 6), sharex=True, sharey="row", layout="constrained"
    )
    for axes, (title, run) in zip(grid.T, runs, strict=True):
        motions = [
            Motion.from_trajectory(run.trajectory, world),
            Motion.from_replay(run.replay, world, "simulation of its control on a rigid wall"),
        ]
        plot_motions(axes, motions, world, scenario)
        axes[0].get_legend().remove()  # One for all.
        costs = f"cost: planned {run.cost:.1e}, simulated {run.replay.cost:.1e}"
        axes[0].set_title(f"{title}\n{costs}\n{worth(run)}", fontsize="small")
    for ax in grid[:, 1:].flat:
        ax.set_ylabel("")
    handles, labels = grid[0, 2].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3)
    figure.savefig(path, dpi=100)


def animate(
    ours: Candidate, snopt: Candidate, world: World, scenario: Scenario, path: Path
) -> None:
    """Writes the same row in motion: two plans, each above the simulation of its control."""
    lanes = []
    for name, run in (("drake_aigto", ours), ("SNOPT", snopt)):
        planned = Motion.from_trajectory(run.trajectory, world)
        simulated = Motion.from_replay(run.replay, world)
        lanes.append((f"{name}: {PLAN_LABEL}, cost {run.cost:.1e}; {worth(run)}", planned))
        lanes.append((f"its control, simulated on a rigid wall: {run.replay.cost:.1e}", simulated))
    figure, axes = plt.subplots(figsize=(6.4, 3.0), layout="constrained")
    heights = -np.arange(len(lanes))
    for height, (label, _) in zip(heights, lanes, strict=True):
        look = {"fontsize": "x-small", "color": color_of(-height // 2), "bbox": _ON_LINES}
        axes.text(0.0, height + 0.3, label, **look)
        axes.axhline(height, color="0.85", linewidth=1, zorder=0)
    axes.axvspan(-0.1, -_RADIUS, color="#8a8f98")
    axes.axvline(*scenario.goal_position, color="black", linestyle=":", linewidth=1)
    axes.set(xlim=(-0.1, 1.1), ylim=(-3.5, 0.75), yticks=[])
    axes.set_xlabel("distance from the wall [m]; dotted: goal")
    colors = [color_of(-height // 2) for height in heights]
    faces = [color if i % 2 else "white" for i, color in enumerate(colors)]
    balls = axes.scatter(np.zeros(4), heights, s=130, c=faces, edgecolors=colors, linewidths=2)

    def show(time: float) -> None:
        places = [np.interp(time, motion.times, motion.positions[:, 0]) for _, motion in lanes]
        balls.set_offsets(np.column_stack([places, heights]))
        axes.set_title(f"t = {time:.2f} s, slowed down", fontsize="small", loc="right")

    times = [*np.linspace(0.0, scenario.duration, _FRAMES), *[scenario.duration] * _REST]
    animation = FuncAnimation(figure, show, times, init_func=lambda: None)
    animation.save(path, PillowWriter(fps=_FRAMES_PER_SECOND), dpi=100)


def animate_dragging(path: Path) -> None:
    """Writes what `show.Live` does: as the start is dragged, braking becomes bouncing, and back.

    The best candidate is a line with the ball on it, the next that touches something else a ghost.
    """
    planner = Planner(Scenario.named("room/bank_shot"), PlanOptions(confirm=False))
    world, (first, last) = planner.world, np.array(_DRAGGED)
    walls = [contact.name.split()[-1].replace("_", " ") for contact in world.contacts]
    figure, axes = plt.subplots(figsize=(4.4, 5.4), layout="constrained")
    figure.get_layout_engine().set(rect=(0.0, 0.0, 1.0, 0.78))  # Texts are above.

    def show(move: int) -> None:
        part = (1 - np.cos(np.pi * move / _MOVES)) / 2
        start = (1 - part) * first + part * last
        found = planner.plan(initial_position=start, initial_velocity=_VELOCITY)
        shown: dict[tuple[int, ...], Candidate] = {}
        for each in found.candidates:
            if each.is_feasible:
                shown.setdefault(tuple(contact.index for contact in each.contacts), each)
        motions = [Motion.from_trajectory(c.trajectory, world) for c in list(shown.values())[:2]]
        axes.clear()
        plot_path(axes, motions, world, found.scenario)
        axes.get_legend().remove()
        for line in axes.lines:
            is_ghost = line.get_color() == color_of(1)
            line.set(linewidth=1.5 if is_ghost else 3.0, alpha=0.5 if is_ghost else 1.0)
        time = found.scenario.duration * (move % _ROUND) / (_ROUND - 1)
        q = [np.interp(time, motions[0].times, each) for each in motions[0].positions.T]
        axes.plot(*q, "o", color=color_of(0), markersize=15, zorder=6)
        texts = []
        for word, each in zip(("plan", "next best"), shown.values(), strict=False):
            touched = " and ".join(walls[contact.index] for contact in each.contacts)
            deed = f"bounces off {touched}" if touched else "brakes"
            costs = f"cost {each.cost:.1e}, simulated {each.replay.cost:.1e}"
            texts.append(f"{word}: {deed}\n    {costs}\n    {worth(each)}")
        axes.set(xlabel="", ylabel="", xticks=[], yticks=[])
        for index, text in enumerate(texts):
            look = {"color": color_of(index), "fontsize": "small", "in_layout": False}
            axes.text(
                0.04, 0.98 - 0.11 * index, text, va="top", transform=figure.transFigure, **look
            )

    animation = FuncAnimation(figure, show, range(2 * _MOVES), init_func=lambda: None)
    animation.save(path, PillowWriter(fps=_FRAMES_PER_SECOND // 2), dpi=80)


def draw_ways(path: Path) -> None:
    """Writes the picture of ways between walls."""
    figure, row = plt.subplots(1, len(_WAYS), figsize=(10, 3.7), layout="constrained")
    for axes, (name, title) in zip(row, _WAYS.items(), strict=True):
        scenario = Scenario.named(name)
        world = World.from_scenario(scenario)
        run = Planner(scenario, world=world).plan().best
        motions = [
            Motion.from_trajectory(run.trajectory, world),
            Motion.from_replay(run.replay, world, "simulation of its control on rigid walls"),
        ]
        plot_path(axes, motions, world, scenario)
        axes.get_legend().remove()  # One for all.
        axes.set_title(title, fontsize="medium")
    handles, labels = row[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=6, fontsize="small")
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "images"
    row = Scenario.named("table1/1")
    wall = World.from_scenario(row)
    three = list(make_runs(wall, row))
    draw_row(three, wall, row, folder / "table1_row1.png")
    animate(three[-1][1], three[0][1], wall, row, folder / "plan_and_snopt.gif")
    draw_ways(folder / "ways_between_walls.png")
    animate_dragging(folder / "live.gif")
