"""Figures of plans and simulations for reports; of mechanisms and friction, for any axes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from pydrake.geometry import Capsule, Cylinder, Sphere
from pydrake.math import RigidTransform
from scipy.spatial import ConvexHull

from drake_aigto.arrays import Floats
from drake_aigto.errors import ModelError
from drake_aigto.paper import rigid_optimum
from drake_aigto.planning import Plan
from drake_aigto.show.box_playback import BoxRun
from drake_aigto.show.cost_figures import plot_cost_history, plot_cost_landscape
from drake_aigto.show.figures import (
    ABOVE,
    HOLLOW,
    SOLID_LOOK,
    line_of,
    plot_boxes,
    plot_motions,
    plot_path,
    plot_phase_portrait,
)
from drake_aigto.show.motion import (
    Friction,
    Motion,
    calc_contact_forces,
    calc_friction,
    color_of,
    motions_of_plan,
    positions_at,
    time_span,
)
from drake_aigto.show.shapes import Actor, find_goal, has_goal, moves_straight
from drake_aigto.show.stage import Stage
from drake_aigto.show.text import touch_names
from drake_aigto.world import Scenario, World

_COLUMNS = 2  # of a figure that has one for each coordinate: more could not be read
_COUNT = 12
_PALEST = 0.15  # The first of the links that are drawn: how much they cover.
_AROUND = np.linspace(0, 2 * np.pi, 33)[:-1]  # of what is round [rad]
_GOAL: dict[str, Any] = {"facecolor": "none", "edgecolor": "#007a55", "linewidth": 1.3}
_GOAL |= {"linestyle": (0, (3, 2)), "zorder": 4}
_BEHIND: dict[str, Any] = {"facecolor": "#eceff3", "zorder": 0}
_NAME: dict[str, Any] = {"ha": "center", "va": "bottom", "fontsize": "small"}
_NAME |= {"textcoords": "offset points", "xytext": (0, 4)}
_WIDTH = 0.01  # of bars of impulses, as a part of the motion
_HATCHED: dict[str, Any] = {"facecolor": "none", "hatch": "//"}


def figures_of_plan(plan: Plan, world: World, run: BoxRun | None) -> Iterator[tuple[Figure, str]]:
    """Yields the figures of a report, each with its caption; of boxes, if there are any."""
    n, motions = world.num_positions, motions_of_plan(plan, world)
    for first in range(0, n, _COLUMNS):
        columns = range(first, min(first + _COLUMNS, n))
        figure = Figure(figsize=(4.5 * max(len(columns), 2), 7), layout="constrained")
        grid = figure.subplots(3, len(columns), sharex=True)
        plot_motions(grid, motions, world, plan.scenario, columns)
        yield figure, "Positions, velocities, controls: the plan, and simulations of its control."
    if moves_straight(world):
        yield _draw_states(plan, motions, world)
        yield from _draw_friction(motions[0], world, plan.scenario)
    else:
        yield from draw_mechanism(motions, world, plan.scenario)
    if run is not None:
        figure = Figure(figsize=(4.5 * (n + 1), 4.2), layout="constrained")
        *panels, last = figure.subplots(1, n + 1)
        shown = [run.result.history[i] for i in run.pick(5, smallest=0.01)]
        for coordinate, axes in enumerate(panels):
            plot_boxes(axes, run.transcription, shown, coordinate=coordinate)
        plot_cost_history(last, run)
        yield (
            figure,
            (
                "AIGO's boxes, center ± half width, as they shrink, and what that costs. The last "
                "center only proposes a contact sequence; the plan is polished from it."
            ),
        )


def _draw_states(plan: Plan, motions: Sequence[Motion], world: World) -> tuple[Figure, str]:
    """Returns a figure of states against each other, and what a touch costs where that is known."""
    n = world.num_positions
    figure = Figure(figsize=(4.5 * max(n + (n > 1), 2), 4.6), layout="constrained")
    *portraits, last = figure.subplots(1, max(n + (n > 1), 2))
    for coordinate, axes in enumerate(portraits):
        plot_phase_portrait(axes, motions, world, plan.scenario, coordinate)
    if n > 1:
        plot_path(last, motions, world, plan.scenario)
        return figure, "Velocity against position, and the path."
    if not has_landscape(plan, world):
        figure.delaxes(last)
        return figure, "Velocity against position."
    plot_cost_landscape(last, world, plan.scenario, {"plan": plan.best})
    return figure, (
        "Velocity against position; and what motions cost that touch the wall once, by when and "
        "how fast, with the exact optimum, which the planner does not know."
    )


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

    A still picture of the first two if they keep to a plane, velocities against positions, and what
    contacts push with if anything is known of it.
    """
    figure = Figure(figsize=(9, 5), layout="constrained")
    try:
        shown = motions[:2]
        panels = figure.subplots(1, len(shown), squeeze=False)[0]
        for index, motion in enumerate(shown):
            plot_strobe(panels[index], motion, world, scenario, index=index)
        # Two panels side by side have one scale.
        width, height = np.ptp(panels[0].get_xlim()), np.ptp(panels[0].get_ylim())
        figure.set_size_inches(9, float(np.clip(1.0 + 4.0 * height / width, 2.5, 7.0)))
        yield figure, "Links at evenly spaced times, the early ones pale; the goal is dashed."
    except ModelError:  # They keep to no plane.
        pass
    rows = -(-world.num_positions // 2)
    figure = Figure(figsize=(9, 4.2 * rows), layout="constrained")
    for coordinate in range(world.num_positions):
        axes = figure.add_subplot(rows, 2, coordinate + 1)
        plot_phase_portrait(axes, motions, world, scenario, coordinate)
    yield figure, "Velocity against position, of each coordinate."
    if any(np.any(calc_contact_forces(motion, world, scenario) > 0) for motion in motions):
        figure = Figure(figsize=(9, 3.6), layout="constrained")
        plot_contact_forces(figure.subplots(), motions, world, scenario)
        yield figure, "What contacts push with over time."
    yield from _draw_friction(motions[0], world, scenario)


def plot_strobe(
    axes: Axes,
    motion: Motion,
    world: World,
    scenario: Scenario,
    count: int = _COUNT,
    index: int = 0,
) -> None:
    """Draws links and walls as they are seen in the plane of motion, the links at several times.

    Times are evenly spaced from the first to the last; early links are pale. The way of what can
    touch, or else of the ends of links, is a line, contacts are hollow circles, and the goal is a
    dashed outline. Both axes have one scale, and places are those of the world.

    Args:
        axes: x to the right and y up, as Meshcat's playback has them [m].
        motion: planned or simulated.
        world: of the motion.
        scenario: has the goal.
        count: of the times.
        index: of the motion, in pictures of several: it has the same color in all.

    Raises:
        ModelError: the motion keeps to no plane.
    """
    is_asked = has_goal(world, scenario)
    goal = find_goal(world, scenario, motion.positions[-1])
    stage = Stage(world, np.vstack([motion.positions, goal]))
    if not stage.is_flat:
        raise ModelError(
            "the picture of a motion",
            got="links that keep to no plane",
            expected="one plane in which all links move",
            remedy="Watch the motion in Meshcat.",
        )
    q = motion.positions[0]
    # From the back to the front: in a plane, none comes nearer as it moves.
    moving = [actor for actor in stage.actors if actor.moves]
    moving.sort(key=lambda actor: np.sum(stage.extent([actor], q[np.newaxis])[:, 2]))
    for actor in stage.actors:
        if not actor.moves:
            look = SOLID_LOOK if stage.is_in_the_way(actor) else _BEHIND
            _draw(axes, stage, [actor], q, look)
    moments = positions_at(motion, np.linspace(*time_span([motion]), count))
    for alpha, q in zip(np.linspace(_PALEST, 1, count), moments, strict=True):
        for actor in moving:
            color = actor.color
            own = (color.r(), color.g(), color.b()) if color else to_rgb(color_of(index))
            look = {"facecolor": own, "edgecolor": "#222222", "linewidth": 0.4}
            _draw(axes, stage, [actor], q, {**look, "alpha": alpha, "zorder": 2 + alpha})
    asked = [actor for actor in moving if np.any(stage.movers_of(actor.index) & is_asked)]
    _draw(axes, stage, asked, goal, _GOAL)
    line: dict[str, Any] = {"color": color_of(index), "linewidth": 1.2}
    for way in stage.trace(motion.positions):
        axes.plot(*way[:, :2].T, alpha=0.8, zorder=3.5, **line)
    axes.plot([], [], label=motion.label, **line)
    touches = stage.place_touches(motion, motion.impacts)
    if len(touches):
        axes.plot(*touches.T, "o", markeredgecolor=color_of(index), label="contact", **HOLLOW)
    axes.plot([], [], color=_GOAL["edgecolor"], linestyle=_GOAL["linestyle"], label="goal")
    xlabel, ylabel = (_name_axis(axis) for axis in stage.X_WT.rotation().matrix().T[:2])
    (left, bottom), (right, top) = stage.low, stage.high
    axes.set(xlim=(left, right), ylim=(bottom, top), xlabel=xlabel, ylabel=ylabel, aspect="equal")
    axes.legend(ncols=3, **ABOVE)


def _draw(
    axes: Axes, stage: Stage, actors: Sequence[Actor], q: Floats, look: dict[str, Any]
) -> None:
    """Draws the outlines of shapes at q."""
    for actor in actors:
        X_TS = stage.X_WT.inverse() @ stage.pose(actor, q)
        points = np.vstack(list(_find_points(actor, X_TS)))[:, :2]
        axes.add_patch(Polygon(points[ConvexHull(points).vertices], **look))


def _find_points(actor: Actor, X_TS: RigidTransform) -> Iterator[Floats]:
    """Yields points in T, shape (k, 3) each, whose hull is a shape as it is seen along T's z."""
    shape = actor.shape
    circle = np.column_stack([np.cos(_AROUND), np.sin(_AROUND), 0 * _AROUND])
    if isinstance(shape, Sphere):
        yield X_TS.translation() + shape.radius() * circle
    elif isinstance(shape, Cylinder | Capsule):
        for end in (-1, 1):
            middle = np.array([0.0, 0.0, end * shape.length() / 2])
            if isinstance(shape, Capsule):
                yield X_TS.multiply(middle) + shape.radius() * circle
            else:
                yield X_TS.multiply((middle + shape.radius() * circle).T).T
    else:
        yield X_TS.multiply(actor.corners.T).T


def _name_axis(axis: Floats) -> str:
    """Returns which of the world's axes is nearest to a direction, with its unit."""
    largest = int(np.argmax(np.abs(axis)))
    return f"{'' if axis[largest] > 0 else '−'}{'xyz'[largest]} [m]"


def plot_contact_forces(
    axes: Axes, motions: Sequence[Motion], world: World, scenario: Scenario
) -> None:
    """Draws what contacts push with over time, λ(t) [N]; of several, their names at the peaks.

    Soft ones follow their law, whether planned or simulated; of rigid ones, what a plan holds.
    """
    names = touch_names(world)
    for index, motion in enumerate(motions):
        forces = calc_contact_forces(motion, world, scenario)
        label = motion.label
        for contact in np.flatnonzero(np.any(forces > 0, axis=0)):
            axes.plot(motion.times, forces[:, contact], label=label, **line_of(index))
            label = ""
            peak = np.argmax(forces[:, contact])
            if index == 0:
                at = motion.times[peak], forces[peak, contact]
                axes.annotate(names[contact], at, color=color_of(index), **_NAME)
    axes.set(xlabel="time t [s]", ylabel="contact force λ [N]")
    if axes.lines:
        axes.margins(y=0.12)
        axes.legend(ncols=2, **ABOVE)
    else:
        axes.text(0.5, 0.5, "no force of a contact", transform=axes.transAxes, ha="center")


def _draw_friction(
    motion: Motion, world: World, scenario: Scenario
) -> Iterator[tuple[Figure, str]]:
    """Yields the figure of a motion's friction for a report, with its caption, if there is any."""
    if any(np.any(each.largest > 0) for each in calc_friction(motion, world, scenario)):
        figure = Figure(figsize=(9, 3.6), layout="constrained")
        plot_friction(figure.subplots(), motion, world, scenario)
        yield figure, "Friction of the first over time, within its cone: rings stick, crosses slip."


def plot_friction(axes: Axes, motion: Motion, world: World, scenario: Scenario) -> None:
    """Draws the friction of walls over time [N], within its cone ±μ f, which is hatched.

    Rings are where it sticks, |s| < v_s, crosses where it slips. Impacts on rigid walls have
    impulses [N s], which are bars, and s is what an impact leaves of it. Where there are forces,
    too, impulses have an axis of their own at the right.
    """
    forces, impulses = calc_friction(motion, world, scenario)
    has_impulses = bool(np.any(impulses.largest > 0))
    has_forces = bool(np.any(forces.largest > 0)) or not has_impulses
    drawn = [axes] * has_forces
    if has_forces:
        _plot_tangents(axes, motion, world, forces)
        axes.set_ylabel("friction [N]")
    if has_impulses:
        drawn.append(axes.twinx() if has_forces else axes)
        _plot_tangents(drawn[-1], motion, world, impulses, are_impulses=True)
        drawn[-1].use_sticky_edges = False
        drawn[-1].margins(y=0.1)
        drawn[-1].set_xlim(motion.times[0], motion.times[-1])
        drawn[-1].axhline(0.0, color="#888888", linewidth=0.6)
        drawn[-1].set_ylabel("friction [N s]")
    axes.set_xlabel("time t [s]")
    handles = [handle for each in drawn for handle in each.get_legend_handles_labels()[0]]
    if handles:
        axes.legend(handles=handles, ncols=2, **ABOVE)


def _plot_tangents(
    axes: Axes, motion: Motion, world: World, friction: Friction, are_impulses: bool = False
) -> None:
    """Draws cones and friction in them: forces as lines, impulses as bars, and marks on them."""
    sliding = np.flatnonzero(np.any(friction.largest > 0, axis=0)).tolist()
    width = _WIDTH * (motion.times[-1] - motion.times[0])
    for index, contact in enumerate(sliding):
        name, color = touch_names(world)[contact], color_of(index)
        force, most = friction.tangents[:, contact], friction.largest[:, contact]
        acts = most > 0
        look: dict[str, Any] = {"edgecolor": color, "label": f"cone of {name}", **_HATCHED}
        if are_impulses:
            axes.bar(motion.times[acts], 2 * most[acts], width, -most[acts], **look)
        else:
            axes.fill_between(motion.times, -most, most, **look)
            axes.plot(motion.times, force, color=color, label=f"friction of {name}")
        is_slow = friction.sticks[:, contact]
        for mode, marker, rows in (("sticks", "o", is_slow), ("slips", "x", ~is_slow)):
            if np.any(at := rows & acts):
                look = {"color": color, "fillstyle": "none"}
                label = f"{name} {mode}" if are_impulses else mode
                axes.plot(motion.times[at], force[at], marker, label=label, **look)
