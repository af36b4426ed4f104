"""Figures of what a plant did in the loop, and of the moments at which plans changed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drake_aigto.control import ClosedLoopRun, PlannedPath
from drake_aigto.errors import ModelError
from drake_aigto.show.figures import ABOVE, plot_controls, plot_path, plot_positions
from drake_aigto.show.motion import Motion, color_of
from drake_aigto.show.plan_figures import plot_strobe
from drake_aigto.show.shapes import moves_straight

SIMULATED = "simulation in Drake"
_PLANNED: dict[str, Any] = {"linewidth": 1.6, "linestyle": (0, (4, 2)), "zorder": 3}
_GIVEN_UP: dict[str, Any] = {"color": "#8a8f98", "linewidth": 1.6, "linestyle": (0, (1, 1.5))}
_GIVEN_UP |= {"zorder": 3.5}
_KICK: dict[str, Any] = {"color": "black", "linewidth": 1.0, "linestyle": (0, (6, 3))}
_MOMENT: dict[str, Any] = {"marker": "o", "markersize": 6, "linestyle": "none", "zorder": 5}
_PALE = 0.45  # how much the simulation covers, so that plans on top of it are seen
_SAME_TIME = 1e-9  # rounding [s]
_MARGIN = 0.02  # before and after a run, as a part of it
_MOST_NAMED = 3  # plans that have a name of their own in a legend


def motion_of_run(run: ClosedLoopRun) -> Motion:
    """Returns the motion that was simulated, with the control that was held."""
    motion = Motion.from_replay(run.replay, SIMULATED)
    return motion.under(run.control_times, run.controls)


def motions_of_switches(run: ClosedLoopRun) -> list[Motion]:
    """Returns the first plan, and each that was taken in place of another; none is a simulation."""
    paths = [run.plan, *(switch.after for switch in run.switches)]
    times = [0.0, *(switch.time for switch in run.switches)]
    return [
        Motion.from_path(f"plan at {time:.2f} s (not a simulation)", path.times, path.states)
        for time, path in zip(times, paths, strict=True)
    ]


def plot_run(axes: Axes, run: ClosedLoopRun, coordinate: int = 0) -> None:
    """Draws one coordinate of a run, over the plans that its controller had.

    The thick line is the simulation. Dashed lines are plans from when they were taken; dotted gray
    ones are those that were given up for them, as they would have gone on. A circle is the moment.
    """
    motion = motion_of_run(run)
    world = run.true_world
    plot_positions(axes, [motion], world, run.scenario, coordinate)
    axes.lines[0].set(alpha=_PALE)
    limits = axes.get_ylim()
    _draw_path(axes, run.plan, coordinate, label="first plan", color=color_of(1), **_PLANNED)
    for index, switch in enumerate(run.switches):
        color = color_of(2 + index % 4)
        q = np.interp(switch.time, motion.times, motion.positions[:, coordinate])
        label = "plan given up" if index == 0 else ""
        _draw_path(axes, switch.before, coordinate, switch.time, label=label, **_GIVEN_UP)
        label = f"plan taken at {switch.time:.2f} s" if index < _MOST_NAMED else ""
        look = {"label": label, "color": color, **_PLANNED}
        _draw_path(axes, switch.after, coordinate, switch.time, **look)
        axes.plot(switch.time, q, markeredgecolor=color, markerfacecolor="white", **_MOMENT)
    _mark_kick(axes, run)
    axes.set(xlim=_find_span(run))
    values = [limits]  # And those of all lines within the time that is shown.
    for line in axes.lines:
        t, y = np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)
        if line.get_transform() == axes.transData and np.any(seen := t <= axes.get_xlim()[1]):
            values.append((np.min(y[seen]), np.max(y[seen])))
    axes.set(ylim=(float(np.min(values)), float(np.max(values))))
    axes.legend(ncols=3, **ABOVE)


def _draw_path(
    axes: Axes, path: PlannedPath, coordinate: int, since: float = 0.0, **look: Any
) -> None:
    """Draws a coordinate of a plan from a time on."""
    motion = Motion.from_path("", path.times, path.states)
    shown = motion.times >= since - _SAME_TIME
    axes.plot(motion.times[shown], motion.positions[shown, coordinate], **look)


def _find_span(run: ClosedLoopRun) -> tuple[float, float]:
    """Returns from when to when is drawn [s]."""
    return -_MARGIN * run.duration, (1 + _MARGIN) * run.duration


def _mark_kick(axes: Axes, run: ClosedLoopRun) -> None:
    if run.disturbance.kick.any():
        axes.axvline(run.disturbance.kick_time, label="kick", **_KICK)


def plot_promises(axes: Axes, run: ClosedLoopRun) -> None:
    """Draws what plans promise at each tick from there on, and where another one was taken."""
    times = np.array([tick.time for tick in run.ticks])
    costs = np.array([tick.cost for tick in run.ticks])
    axes.plot(times, costs, color=color_of(0), label="what the plan costs from there on")
    taken = np.array([tick.has_switched for tick in run.ticks], dtype=bool)
    look = {"markeredgecolor": color_of(2), "markerfacecolor": "white", **_MOMENT}
    axes.plot(times[taken], costs[taken], label="another plan is taken", **look)
    _mark_kick(axes, run)
    axes.set(xlabel="time t [s]", ylabel="cost J", xlim=_find_span(run))
    axes.set_ylim(bottom=0)
    axes.legend(ncols=3, **ABOVE)


def plot_mind(row: Sequence[Axes], run: ClosedLoopRun, index: int = 0) -> None:
    """Draws a moment at which a plan changed, for a mechanism in a plane, in three axes.

    What the plan would have gone on to do, what the one does that was taken, and what the plant did
    from there on.

    Raises:
        ControlError: there was no such moment.
        ModelError: the links keep to no plane.
    """
    switch, motion = run.switches[index], motion_of_run(run)
    paths = {
        "plan that was given up": switch.before,
        "plan that was taken": switch.after,
        SIMULATED: PlannedPath(motion.times, np.hstack([motion.positions, motion.velocities])),
    }
    world = run.true_world
    for axes, color, (label, path) in zip(row, (3, 2, 0), paths.items(), strict=True):
        kept = path.times >= switch.time - _SAME_TIME
        shown = Motion.from_path(label, path.times[kept], path.states[kept])
        plot_strobe(axes, shown, world, run.scenario, index=color)


def figures_of_run(run: ClosedLoopRun) -> Iterator[tuple[Figure, str]]:
    """Yields the figures of a run, each with its caption."""
    world = run.true_world
    yield (
        _draw_rows(run),
        "What was simulated, over the plans: dashed from when they were taken, dotted as they "
        "would have gone on; and the control that was held.",
    )
    if moves_straight(world) and world.num_positions > 1:
        figure = Figure(figsize=(6, 5), layout="constrained")
        motions = [motion_of_run(run), *motions_of_switches(run)]
        plot_path(figure.subplots(), motions, world, run.scenario)
        yield figure, "The way that was simulated, and those that were planned."
    moments = [] if moves_straight(run.world) else run.switches[:_MOST_NAMED]
    for index, switch in enumerate(moments):
        figure = Figure(figsize=(12, 3.9), layout="constrained")
        try:
            plot_mind(figure.subplots(1, 3), run, index)
        except ModelError:  # The links keep to no plane.
            break
        text = f"The moment at {switch.time:.2f} s, and what came after it; early links pale."
        yield figure, text
    if run.ticks:
        figure = Figure(figsize=(9, 3.2), layout="constrained")
        plot_promises(figure.subplots(), run)
        yield figure, "What plans promise as time goes on: plans, no simulation."


def _draw_rows(run: ClosedLoopRun) -> Figure:
    """Returns a figure of all coordinates over time, and of the controls below them."""
    world = run.true_world
    driven = [int(i) for i in np.flatnonzero(world.actuation.any(axis=1))]
    n = world.num_positions
    heights = [2.0] * n + [1.0] * len(driven)
    figure = Figure(figsize=(9, 1.2 + 1.3 * sum(heights)), layout="constrained")
    rows = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights, squeeze=False)[:, 0]
    for coordinate, axes in enumerate(rows[:n]):
        plot_run(axes, run, coordinate)
        if coordinate:
            axes.get_legend().remove()
    for coordinate, axes in zip(driven, rows[n:], strict=True):
        plot_controls(axes, [motion_of_run(run)], world, coordinate)
        _mark_kick(axes, run)
    for axes in rows[:-1]:
        axes.set_xlabel("")
    return figure
