"""Figures of the paper: its penalty's mean over boxes, and its comparison of three methods."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from drake_aigto.paper import LiteralOptions, gradient_from_random, make_literal_task, plan_literal
from drake_aigto.planning import Candidate, Origin, ProgramSolution
from drake_aigto.show import Motion, color_of, cost_text, plot_motions, run_boxes, run_texts
from drake_aigto.world import Scenario, World

_COLORMAP = "viridis"
_POINTS = 201  # along each side of a landscape
_LEVELS = 12
AIGTO, FROM_AIGTO, FROM_RANDOM = "AIGTO", "gradient from AIGTO", "gradient from a random guess"

_COLUMNS = ("cost", "defect", "in wall", "energy", "rigid")
# Of an axes' width: where the columns end, and of its height: a line.
_FIRST, _LINE, _TOP = 0.04, 0.25, 1.0
# How far velocities are shown beyond those of AIGTO's plans, as a part of their range: a gradient
# solver may end with a jump of 200 m/s at the last knot.
_BEYOND = 0.5


def plot_integrated_product(axes: Axes, half_width: float = 1.0, reach: float = 3.0) -> None:
    """Draws the mean of the penalty (xy)² over boxes around (x, y), |x|, |y| ≤ reach: AIGTO Fig. 1.

    Complementarity φλ = 0 holds on both axes; its penalty's mean over a box is least at zero alone,
    μ₂(x, w) μ₂(y, w) with μ₂(x, w) = x² + w²/3 and the half width w ≥ 0, which is why there are no
    forces among the unknowns. With w = 0 it is the penalty itself, 0 on both axes.
    """
    x = np.linspace(-reach, reach, _POINTS)
    means = x**2 + half_width**2 / 3
    values = np.outer(means, means)
    levels = np.max(values) * np.linspace(0, 1, _LEVELS) ** 3
    filled = axes.contourf(x, x, values, levels, cmap=_COLORMAP)
    filled.set_rasterized(True)  # In vector formats it is large.
    axes.contour(x, x, values, levels, colors="white", linewidths=0.5)
    for line in (axes.axhline, axes.axvline):
        line(0, color="white", linewidth=1.5, linestyle=(0, (4, 3)))
    lowest = "o" if half_width > 0 else ""
    axes.plot(0, 0, lowest, color="#D55E00", markeredgecolor="white", markersize=11)
    width = "the penalty (xy)² itself" if half_width == 0 else f"mean over ±{half_width:g}"
    axes.set(xlabel="x, such as φ(q)", ylabel="y, such as λ", title=width, aspect="equal")
    axes.figure.colorbar(filled, ax=axes, label="(xy)²", shrink=0.8, format="%.3g")


def paper_methods(
    scenario: Scenario, world: World | None = None, nonpenetration: bool = False, seed: int = 0
) -> dict[str, Candidate]:
    """Runs the three methods of AIGTO Fig. 2 on the paper's transcription, before one wall.

    AIGTO is the center of its last box, pulled towards the rows by raising their penalties, which
    are not quite met; the gradient solver that starts from it is the planner's local one, with the
    contact moved to and fro; the one that starts from a random guess, of a seed, is SNOPT. The
    paper's figures need φ ≥ 0 not to be asked for at the knots.

    Returns:
        A run, replayed on the rigid wall, by the method's name, in that order.

    Raises:
        ModelError: the world has several contacts.
        PlanningError: no candidate meets the transcription's rows.
    """
    world = world or World.from_scenario(scenario)
    options = LiteralOptions(nonpenetration=nonpenetration, confirm=False)
    plan = plan_literal(scenario, options, world)
    boxes = run_boxes(plan, world)
    center = boxes.problem.pull(boxes.result.box.center, boxes.rung)
    origin = Origin(options.algorithm, boxes.rung)
    shrunk = boxes.problem.judge(origin, center, ProgramSolution.of(boxes.transcription, center))
    snopt = dataclasses.replace(options, local_solver="snopt")
    problem = make_literal_task(world, scenario, snopt)
    random = gradient_from_random(problem, np.random.default_rng(seed))
    return {AIGTO: shrunk, FROM_AIGTO: plan.best, FROM_RANDOM: random}


def plot_methods(
    axes: Sequence[Any] | npt.NDArray[Any],
    runs: Mapping[str, Candidate],
    world: World,
    scenario: Scenario,
) -> None:
    """Draws plans of several methods over time, as AIGTO Fig. 2 and 3 have them.

    These are plans: `write_numbers` says what simulations make of them. Velocities are cut off
    where only the last method goes. Axes are as of `plot_motions`.
    """
    motions = [Motion.from_trajectory(run.trajectory, world, name) for name, run in runs.items()]
    plot_motions(axes, motions, world, scenario)
    for i, middle in enumerate(np.atleast_1d(np.asarray(axes, dtype=object)[1])):
        v = np.concatenate([motion.velocities[:, i] for motion in motions[:2]])
        beyond = _BEYOND * np.ptp(v)
        bottom, top = middle.get_ylim()
        middle.set_ylim(max(bottom, v.min() - beyond), min(top, v.max() + beyond))


def write_numbers(axes: Axes, runs: Mapping[str, Candidate]) -> None:
    """Writes what each plan costs, and what has to be known before that is believed.

    Its cost J, largest dynamics defect [m or m/s], deepest penetration, kinetic energy after /
    before its contacts, and J of its control alone on a rigid wall. Colors are those of
    `plot_methods`; axes have nothing else, and lose their frame.
    """
    axes.set_axis_off()
    ends = np.linspace(_FIRST, 1, len(_COLUMNS) + 1)[1:]
    look: dict[str, Any] = {"transform": axes.transAxes, "va": "top", "fontsize": 7.5}
    for x, name in zip(ends, _COLUMNS, strict=True):
        axes.text(x, _TOP, name, ha="right", **look)
    for i, run in enumerate(runs.values()):
        y = _TOP - (i + 1) * _LINE
        cells = (*run_texts(run, 1), cost_text(run.replay.cost, 1, run.scales.cost))
        axes.text(0, y, "■", color=color_of(i), **look)
        for x, cell in zip(ends, cells, strict=True):
            axes.text(x, y, cell, ha="right", **look)
