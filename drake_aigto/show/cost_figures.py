"""Figures of costs: what AIGO minimizes and where plans end; and what a gradient solver plans."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.ticker import LogLocator, MaxNLocator

from drake_aigto.paper import (
    LiteralOptions,
    bounce_costs,
    gradient_from_zero,
    make_literal_task,
    random_guess,
    rigid_optimum,
)
from drake_aigto.planning import Candidate, PlanOptions, make_ball_task
from drake_aigto.show.box_playback import BoxRun
from drake_aigto.show.motion import (
    PLAN_LABEL,
    SIMULATION_LABELS,
    Motion,
    calc_approach_speed,
    color_of,
)
from drake_aigto.simulation import replay_event_driven
from drake_aigto.world import Scenario, World

_COLORMAP = "viridis"
_POINTS = 201  # along each side of a landscape
_LEVELS = 12
# A landscape is drawn up to this many times the least cost.
_HIGHEST = 1e4
_MARKERS = "oDvPX<"
_MARK: dict[str, Any] = {"linestyle": "none", "markeredgecolor": "white", "markersize": 10}
_ONE_WALL, _SEVERAL = "SNOPT from zero", "SNOPT from a random guess"
_RIGID = SIMULATION_LABELS["event-driven"]


def plot_cost_history(axes: Axes, run: BoxRun) -> Axes:
    """Draws cost against iteration as boxes shrink; returns the right scale, that of defects.

    The mean over the box is what AIGO minimizes, penalties included; J is the cost of the motion at
    the box's center, which counts for nothing while its rows are off: the largest of their defects
    has a scale of its own, at the right.
    """
    history = run.result.history
    steps = np.cumsum([iterate.inner_steps for iterate in history])
    centers = [iterate.box.center for iterate in history]
    means = [iterate.mean for iterate in history]
    costs = [run.transcription.scenario_cost(center) for center in centers]
    defects = [max(run.transcription.defects(center).values()) for center in centers]
    right = axes.twinx()
    lines = [
        *axes.plot(steps, means, color=color_of(0), linewidth=2.5, label="mean over the box"),
        *axes.plot(steps, costs, color=color_of(2), linewidth=2, label="J at its center"),
        *right.plot(
            steps,
            defects,
            color=color_of(1),
            linewidth=2,
            linestyle=(0, (4, 2)),
            label="largest defect there (right)",
        ),
    ]
    for each in (axes, right):
        each.set_yscale("log")
        each.yaxis.set_major_locator(LogLocator(numticks=8))
    axes.set(xlabel="iteration", ylabel="cost [J]")
    right.set_ylabel("defect [m or m/s]", color=color_of(1))
    right.tick_params(axis="y", colors=color_of(1))
    axes.legend(handles=lines, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, fontsize=9)
    return right


def plot_cost_landscape(
    axes: Axes, world: World, scenario: Scenario, ends: Mapping[str, Candidate]
) -> None:
    """Draws the least cost over when and how fast a rigid wall is touched, and where methods end.

    Of motions that touch it once (`paper.bounce_costs`); white is where none does. A method's end
    point is its plan's first contact. Where its legend says that it does not hold, its own cost is
    not the landscape's: a literal plan leaves the wall as it likes.

    Raises:
        ModelError: not a world of one coordinate and one wall, without bias.
    """
    optimum = rigid_optimum(world, scenario)
    contacts: dict[str, tuple[float, float] | None] = dict.fromkeys(ends)
    for name, end in ends.items():
        for first in end.contacts[:1]:
            speed = calc_approach_speed(world, end.trajectory, first.time, first.index)
            contacts[name] = first.time, speed
    speeds = [-v for v in optimum.impact_velocities] + [c[1] for c in contacts.values() if c]
    time = np.linspace(0, scenario.duration, _POINTS + 2)[1:-1]
    rates = np.linspace(0, 1.6 * max(speeds, default=1.0), _POINTS)
    costs = bounce_costs(world, scenario, time, rates[:, np.newaxis])
    least = np.nanmin(costs)
    shown = np.ma.masked_invalid(np.minimum(costs, _HIGHEST * least))
    levels = np.geomspace(least, _HIGHEST * least, _LEVELS + 1)
    filled = axes.contourf(time, rates, shown, levels, cmap=_COLORMAP, norm=LogNorm())
    filled.set_rasterized(True)  # In vector formats it is large.
    bar = axes.figure.colorbar(filled, ax=axes, label="least J of a motion that touches there")
    bar.ax.yaxis.set_major_locator(LogLocator(numticks=6))
    if optimum.bounce_times:
        at = optimum.bounce_times[0], -optimum.impact_velocities[0]
        axes.plot(*at, "*", color="#E69F00", label="exact optimum", **{**_MARK, "markersize": 20})
    for i, ((name, contact), end) in enumerate(zip(contacts.items(), ends.values(), strict=True)):
        verdict = "holds" if end.is_confirmed else "fails in simulation"
        place = contact or (np.nan, np.nan)
        label = f"{name}: {verdict}{'' if contact else ', no contact'}"
        axes.plot(*place, _MARKERS[i % len(_MARKERS)], color=color_of(i + 1), label=label, **_MARK)
    axes.set(xlabel="time of the touch [s]", ylabel="speed of approach [m/s]")
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize="small")


def gradient_motions(world: World, scenario: Scenario, seed: int = 0) -> list[Motion]:
    """Returns what SNOPT plans without AIGO, and what a rigid simulation makes of its control.

    With one contact, of the paper's literal transcription with φ free, from a guess of zeros: the
    plan and its simulation. With several, of the rigid transcription from one random guess, of a
    seed: the simulation, as the rows of such plans are seldom met.
    """
    if world.num_contacts == 1:
        options = LiteralOptions(nonpenetration=False, local_solver="snopt")
        run = gradient_from_zero(make_literal_task(world, scenario, options))
        planned = Motion.from_trajectory(run.trajectory, world, f"{_ONE_WALL}: {PLAN_LABEL}")
        simulated = Motion.from_replay(run.replay, f"{_ONE_WALL}: {_RIGID}")
        return [planned, simulated.under(run.trajectory.times, run.trajectory.controls)]
    world.check_plain(scenario)
    problem = make_ball_task(world, scenario, PlanOptions(relaxation=0.0, local_solver="snopt"))
    transcription = problem.transcription
    found = problem.solve_locally(random_guess(transcription, np.random.default_rng(seed)))
    times, controls = transcription.GetSampleTimes(), transcription.split(found)[2]
    replay = replay_event_driven(world, scenario, times, controls)
    simulated = Motion.from_replay(replay, f"{_SEVERAL}: {_RIGID}")
    return [simulated.under(times, controls)]
