"""Figures of reports: of plans, and of what a plant did in the loop as plans changed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drake_aigto.control import ClosedLoopRun, PlannedPath
from drake_aigto.errors import ModelError
from drake_aigto.paper import rigid_optimum
from drake_aigto.planning import Plan
from drake_aigto.show import figures, plan_figures
from drake_aigto.show.box_playback import BoxRun
from drake_aigto.show.motion import Motion, calc_contact_forces, calc_friction, color_of
from drake_aigto.show.shapes import moves_straight, read_coordinates
from drake_aigto.world import Scenario, World

_COLUMNS = 2  # of a figure that has one for each coordinate: more could not be read
SIMULATED = "simulation in Drake"
_PLANNED: dict[str, Any] = {"linewidth": 1.6, "linestyle": (0, (4, 2)), "zorder": 3}
_GIVEN_UP: dict[str, Any] = {"color": "#8a8f98", "linewidth": 1.6, "linestyle": (0, (1, 1.5))}
_GIVEN_UP |= {"zorder": 3.5}
_KICK: dict[str, Any] = {"color": "black", "linewidth": 1.0, "linestyle": (0, (6, 3))}
_MOMENT: dict[str, Any] = {"marker": "o", "markersize": 6, "linestyle": "none", "zorder": 5}
_PALE = 0.45  # how much the simulation covers, so that plans on top of it are seen
_MARGIN = 0.02  # before and after a run, as a part of it
_MOST_NAMED = 3  # plans that have a name of their own in a legend


def figures_of_plan(
    plan: Plan, motions: Sequence[Motion], world: World, run: BoxRun | None
) -> Iterator[tuple[Figure, str]]:
    """Yields the figures of a report, each with its caption; of boxes, if there are any.

    Motions are those of the plan (`motions_of_plan`).
    """
    n = world.num_velocities
    is_driven = np.any(world.actuation, axis=1)
    for rows, coordinates in ((3, np.flatnonzero(is_driven)), (2, np.flatnonzero(~is_driven))):
        for first in range(0, len(coordinates), _COLUMNS):
            columns = coordinates[first : first + _COLUMNS].tolist()
            size = 4.5 * max(len(columns), 2), 0.5 + 2.2 * rows
            figure = Figure(figsize=size, layout="constrained")
            grid = figure.subplots(rows, len(columns), sharex=True, squeeze=False)
            figures.plot_motions(grid, motions, world, plan.scenario, columns)
            # The legend is above all, as it may be wider than one of the axes.
            handles, labels = grid[0, 0].get_legend_handles_labels()
            if legend := grid[0, 0].get_legend():
                legend.remove()
            figure.legend(handles, labels, loc="outside upper center", ncols=4, fontsize="small")
            what = "Positions, velocities, controls" if rows == 3 else "Positions, velocities"
            yield figure, f"{what}: the plan, and simulations of its control."
    if moves_straight(world):
        yield from _draw_ways(plan, motions, world)
        yield from _draw_friction(motions[0], world, plan.scenario)
    else:
        yield from draw_mechanism(motions, world, plan.scenario)
    if run is not None:
        figure = Figure(figsize=(4.5 * (n + 1), 4.2), layout="constrained")
        *panels, last = figure.subplots(1, n + 1)
        shown = [run.result.history[i] for i in run.pick(5, smallest=0.01)]
        for coordinate, axes in enumerate(panels):
            figures.plot_boxes(axes, run.transcription, shown, coordinate=coordinate)
        plan_figures.plot_cost_history(last, run)
        yield (
            figure,
            (
                "AIGO's shrinking boxes, center ± half width, and their cost. The last center only "
                "proposes a contact sequence; the plan is polished from it."
            ),
        )


def _draw_ways(plan: Plan, motions: Sequence[Motion], world: World) -> Iterator[tuple[Figure, str]]:
    """Yields the path in a plane, or what a touch costs where that is known."""
    figure = Figure(figsize=(6, 4.6), layout="constrained")
    if world.num_positions > 1:
        figures.plot_path(figure.subplots(), motions, world, plan.scenario)
        yield figure, "The path."
    elif has_landscape(plan, world):
        plan_figures.plot_cost_landscape(
            figure.subplots(), world, plan.scenario, {"plan": plan.best}
        )
        yield (
            figure,
            "Cost of motions that touch the wall once, over the time and speed of the touch, with "
            "the exact optimum, which the planner does not know.",
        )


def draw_portraits(
    motions: Sequence[Motion], world: World, scenario: Scenario
) -> tuple[Figure, str]:
    """Returns the figure of velocities against positions, with its caption."""
    rows = -(-world.num_velocities // 2)
    figure = Figure(figsize=(9, 4.2 * rows), layout="constrained")
    for coordinate in range(world.num_velocities):
        axes = figure.add_subplot(rows, 2, coordinate + 1)
        figures.plot_phase_portrait(axes, motions, world, scenario, coordinate)
    return figure, "Velocity against position, of each coordinate."


def has_landscape(plan: Plan, world: World) -> bool:
    """Returns whether the landscape of single touches has the plan on it, and its exact optimum."""
    if world.num_contacts > 1 or len(plan.best.contacts) > 1:
        return False
    try:
        rigid_optimum(world, plan.scenario)
    except ModelError:  # None is known for this world.
        return False
    return True


def draw_mechanism(
    motions: Sequence[Motion], world: World, scenario: Scenario
) -> Iterator[tuple[Figure, str]]:
    """Yields the figures of a mechanism's motions for a report, each with its caption.

    A still picture of the first two, and what contacts push with if anything is known of it.
    """
    figure, shown = Figure(figsize=(9, 5), layout="constrained"), motions[:2]
    panels = figure.subplots(1, len(shown), squeeze=False)[0]
    for index, motion in enumerate(shown):
        plan_figures.plot_strobe(panels[index], motion, world, scenario, index=index)
    # Two panels side by side have one scale.
    width, height = np.ptp(panels[0].get_xlim()), np.ptp(panels[0].get_ylim())
    figure.set_size_inches(9, float(np.clip(1.0 + 4.0 * height / width, 2.5, 7.0)))
    yield figure, "Links at evenly spaced times, the early ones pale; the goal is dashed."
    if any(np.any(calc_contact_forces(motion, world, scenario) > 0) for motion in motions):
        figure = Figure(figsize=(9, 3.6), layout="constrained")
        plan_figures.plot_contact_forces(figure.subplots(), motions, world, scenario)
        yield figure, "Contact forces over time."
    yield from _draw_friction(motions[0], world, scenario)


def _draw_friction(
    motion: Motion, world: World, scenario: Scenario
) -> Iterator[tuple[Figure, str]]:
    """Yields the figure of a motion's friction for a report, with its caption, if there is any."""
    if any(np.any(each.largest > 0) for each in calc_friction(motion, world, scenario)):
        figure = Figure(figsize=(9, 3.6), layout="constrained")
        plan_figures.plot_friction(figure.subplots(), motion, world, scenario)
        yield figure, "Friction of the plan over time, within its cone: rings stick, crosses slip."


def motion_of_run(run: ClosedLoopRun) -> Motion:
    """Returns the motion that was simulated, with the control that was held."""
    motion = Motion.from_replay(run.replay, run.true_world, SIMULATED)
    return motion.under(run.control_times, run.controls)


def motions_of_switches(run: ClosedLoopRun) -> list[Motion]:
    """Returns the first plan, and each that was taken in place of another; none is a simulation."""
    paths = [run.plan, *(switch.after for switch in run.switches)]
    times = [0.0, *(switch.time for switch in run.switches)]
    return [
        Motion.from_path(f"plan at {time:.2f} s (not a simulation)", run.world, p.times, p.states)
        for time, p in zip(times, paths, strict=True)
    ]


def plot_run(axes: Axes, run: ClosedLoopRun, coordinate: int = 0) -> None:
    """Draws one coordinate of a run, over the plans that its controller had.

    The thick line is the simulation. Dashed lines are plans from when they were taken; dotted gray
    ones are those that were given up for them, as they would have gone on. A circle is the moment.
    """
    motion = motion_of_run(run)
    world = run.true_world
    figures.plot_positions(axes, [motion], world, run.scenario, coordinate)
    axes.lines[0].set(alpha=_PALE)
    limits = axes.get_ylim()
    first: dict[str, Any] = {"label": "first plan", "color": color_of(1), **_PLANNED}
    _draw_path(axes, run, run.plan, coordinate, **first)
    for index, switch in enumerate(run.switches):
        color = color_of(2 + index % 4)
        rows = read_coordinates(world, run.scenario, motion.positions)
        q = np.interp(switch.time, motion.times, rows[:, coordinate])
        label = "plan given up" if index == 0 else ""
        _draw_path(axes, run, switch.before, coordinate, switch.time, label=label, **_GIVEN_UP)
        label = f"plan taken at {switch.time:.2f} s" if index < _MOST_NAMED else ""
        look = {"label": label, "color": color, **_PLANNED}
        _draw_path(axes, run, switch.after, coordinate, switch.time, **look)
        axes.plot(switch.time, q, markeredgecolor=color, markerfacecolor="white", **_MOMENT)
    _mark_kick(axes, run)
    axes.set(xlim=_find_span(run))
    values = [limits]  # And those of all lines within the time that is shown.
    for line in axes.lines:
        t, y = np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)
        if line.get_transform() == axes.transData and np.any(seen := t <= axes.get_xlim()[1]):
            values.append((np.min(y[seen]), np.max(y[seen])))
    axes.set(ylim=(float(np.min(values)), float(np.max(values))))
    axes.legend(ncols=3, **figures.ABOVE)


def _draw_path(
    axes: Axes,
    run: ClosedLoopRun,
    path: PlannedPath,
    coordinate: int,
    since: float = 0.0,
    **look: Any,
) -> None:
    """Draws a coordinate of a plan from a time on."""
    motion = Motion.from_path("", run.world, path.times, path.states).since(since)
    rows = read_coordinates(run.world, run.scenario, motion.positions)
    axes.plot(motion.times, rows[:, coordinate], **look)


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
    axes.legend(ncols=3, **figures.ABOVE)


def plot_mind(row: Sequence[Axes], run: ClosedLoopRun, index: int = 0) -> None:
    """Draws a moment at which a plan changed, for a mechanism, in three axes.

    What the plan would have gone on to do, what the one does that was taken, and what the plant did
    from there on.

    Raises:
        ControlError: there was no such moment.
    """
    switch, world = run.switches[index], run.true_world
    paths = {"plan that was given up": switch.before, "plan that was taken": switch.after}
    motions = [Motion.from_path(label, world, p.times, p.states) for label, p in paths.items()]
    for axes, color, motion in zip(row, (3, 2, 0), [*motions, motion_of_run(run)], strict=True):
        plan_figures.plot_strobe(axes, motion.since(switch.time), world, run.scenario, index=color)


def figures_of_run(run: ClosedLoopRun) -> Iterator[tuple[Figure, str]]:
    """Yields the figures of a run, each with its caption."""
    world = run.true_world
    yield (
        _draw_rows(run),
        "The simulated motion over the plans, which are dashed from when they were taken and "
        "dotted as they would have continued; and the control that was held.",
    )
    if moves_straight(world) and world.num_positions > 1:
        figure = Figure(figsize=(6, 5), layout="constrained")
        motions = [motion_of_run(run), *motions_of_switches(run)]
        figures.plot_path(figure.subplots(), motions, world, run.scenario)
        yield figure, "The simulated path, and the planned ones."
    moments = [] if moves_straight(run.world) else run.switches[:_MOST_NAMED]
    for index, switch in enumerate(moments):
        figure = Figure(figsize=(12, 3.9), layout="constrained")
        plot_mind(figure.subplots(1, 3), run, index)
        text = f"The motions from {switch.time:.2f} s on; early links are pale."
        yield figure, text
    if run.ticks:
        figure = Figure(figsize=(9, 3.2), layout="constrained")
        plot_promises(figure.subplots(), run)
        yield figure, "The promised cost to go over time: of plans, not of a simulation."


def _draw_rows(run: ClosedLoopRun) -> Figure:
    """Returns a figure of all coordinates over time, and of the controls below them."""
    world = run.true_world
    driven = [int(i) for i in np.flatnonzero(world.actuation.any(axis=1))]
    n = world.num_velocities
    heights = [2.0] * n + [1.0] * len(driven)
    figure = Figure(figsize=(9, 1.2 + 1.3 * sum(heights)), layout="constrained")
    rows = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights, squeeze=False)[:, 0]
    for coordinate, axes in enumerate(rows[:n]):
        plot_run(axes, run, coordinate)
        if coordinate:
            axes.get_legend().remove()
    for coordinate, axes in zip(driven, rows[n:], strict=True):
        figures.plot_controls(axes, [motion_of_run(run)], world, coordinate)
        _mark_kick(axes, run)
    for axes in rows[:-1]:
        axes.set_xlabel("")
    return figure
