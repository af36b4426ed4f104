"""AIGTO beside gradient solvers: the paper's comparison, and what plays beside a plan."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from drake_aigto.baselines import run_baseline
from drake_aigto.paper import (
    LiteralOptions,
    gradient_from_random,
    gradient_from_zero,
    make_literal_problem,
    plan_literal,
)
from drake_aigto.planning import Candidate, Origin
from drake_aigto.show.box_playback import run_boxes
from drake_aigto.show.figures import plot_motions
from drake_aigto.show.motion import PLAN_LABEL, SIMULATION_LABELS, Motion, color_of
from drake_aigto.show.text import cost_text, run_texts
from drake_aigto.simulation.replay import replay_event_driven
from drake_aigto.world import Scenario, World

AIGTO, FROM_AIGTO, FROM_RANDOM = "AIGTO", "gradient from AIGTO", "gradient from a random guess"

_COLUMNS = ("cost", "defect", "in wall", "energy", "rigid")
# Of an axes' width: where the columns end, and of its height: a line.
_FIRST, _LINE, _TOP = 0.04, 0.25, 1.0
# How far velocities are shown beyond those of AIGTO's plans, as a part of their range: a gradient
# solver may end with a jump of 200 m/s at the last knot.
_BEYOND = 0.5
_ONE_WALL, _SEVERAL = "SNOPT from zero", "SNOPT from a random guess"
_RIGID = SIMULATION_LABELS["event-driven"]
# Of `run_baseline`: no clock ends the only guess, and any result does.
_SECONDS, _ANY_COST = 3600.0, 1e300


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
    shrunk = boxes.problem.judge(origin, center, boxes.transcription, center)
    snopt = dataclasses.replace(options, local_solver="snopt")
    problem = make_literal_problem(world, scenario, snopt)
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


def gradient_motions(world: World, scenario: Scenario, seed: int = 0) -> list[Motion]:
    """Returns what SNOPT plans without AIGO, and what a rigid simulation makes of its control.

    With one contact, of the paper's literal transcription with φ free, from a guess of zeros: the
    plan and its simulation. With several, of the rigid transcription from one random guess, of a
    seed: the simulation, as the rows of such plans are seldom met.
    """
    if world.num_contacts == 1:
        return _literal_motions(world, scenario)
    found = run_baseline("snopt", world, scenario, _SECONDS, seed, _ANY_COST)
    assert found.times is not None and found.controls is not None
    replay = replay_event_driven(world, scenario, found.times, found.controls)
    simulated = Motion.from_replay(replay, f"{_SEVERAL}: {_RIGID}")
    return [simulated.under(found.times, found.controls)]


def _literal_motions(world: World, scenario: Scenario) -> list[Motion]:
    options = LiteralOptions(nonpenetration=False, local_solver="snopt")
    run = gradient_from_zero(make_literal_problem(world, scenario, options))
    planned = Motion.from_trajectory(run.trajectory, world, f"{_ONE_WALL}: {PLAN_LABEL}")
    simulated = Motion.from_replay(run.replay, f"{_ONE_WALL}: {_RIGID}")
    return [planned, simulated.under(run.trajectory.times, run.trajectory.controls)]
