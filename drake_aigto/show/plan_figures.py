"""Figures of links, contact forces, friction and costs, for any axes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.ticker import LogLocator, MaxNLocator
from pydrake.geometry import Capsule, Cylinder, Sphere
from pydrake.math import RigidTransform
from scipy.spatial import ConvexHull

from drake_aigto import paper
from drake_aigto.arrays import Floats
from drake_aigto.planning import Candidate, PlanOptions, make_ball_task
from drake_aigto.show.box_playback import BoxRun
from drake_aigto.show.figures import ABOVE, HOLLOW, SOLID_LOOK, line_of
from drake_aigto.show.motion import (
    PLAN_LABEL,
    SIMULATION_LABELS,
    Friction,
    Motion,
    calc_approach_speed,
    calc_contact_forces,
    calc_friction,
    color_of,
    positions_at,
    time_span,
)
from drake_aigto.show.shapes import Actor, find_goal, has_goal
from drake_aigto.show.stage import Stage
from drake_aigto.show.words import touch_names
from drake_aigto.simulation import replay_event_driven
from drake_aigto.world import Scenario, World

_COUNT = 12
_PALEST = 0.15  # The first of the links that are drawn: how much they cover.
_AROUND = np.linspace(0, 2 * np.pi, 33)[:-1]  # of what is round [rad]
_GOAL: dict[str, Any] = {"facecolor": "none", "edgecolor": "#007a55", "linewidth": 1.3}
_GOAL |= {"linestyle": (0, (3, 2)), "zorder": 4}
_BEHIND: dict[str, Any] = {"facecolor": "#eceff3", "zorder": -1}
_NAME: dict[str, Any] = {"ha": "center", "va": "bottom", "fontsize": "small"}
_NAME |= {"textcoords": "offset points", "xytext": (0, 4)}
_MOST_LISTED = 12  # in a legend
_WIDTH = 0.01  # of bars of impulses, as a part of the motion
_HATCHED: dict[str, Any] = {"facecolor": "none", "hatch": "//"}
_COLORMAP = "viridis"
_POINTS = 201  # along each side of a landscape
_LEVELS = 12
# A landscape is drawn up to this many times the least cost.
_HIGHEST = 1e4
_MARKERS = "oDvPX<"
_MARK: dict[str, Any] = {"linestyle": "none", "markeredgecolor": "white", "markersize": 10}
_ONE_WALL, _SEVERAL = "SNOPT from zero", "SNOPT from a random guess"
_RIGID = SIMULATION_LABELS["event-driven"]


def plot_strobe(
    axes: Axes,
    motion: Motion,
    world: World,
    scenario: Scenario,
    count: int = _COUNT,
    index: int = 0,
) -> None:
    """Draws links and walls as they are seen in the plane of motion, the links at several times.

    Motions that keep to no plane are drawn as `Stage` sees them, from a little above.

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
    """
    goal = find_goal(world, scenario, motion.positions[-1])
    stage = Stage(world, np.vstack([motion.positions, goal]))
    draw_still(axes, stage, motion.positions[0])
    moments = positions_at(motion, np.linspace(*time_span([motion]), count))
    for alpha, q in zip(np.linspace(_PALEST, 1, count), moments, strict=True):
        draw_moving(axes, stage, q, index, alpha)
    draw_goal(axes, stage, world, scenario, goal)
    line: dict[str, Any] = {"color": color_of(index), "linewidth": 1.2}
    for way in stage.trace(motion.positions):
        axes.plot(*way[:, :2].T, alpha=0.8, zorder=3.5, **line)
    axes.plot([], [], label=motion.label, **line)
    touches = stage.place_touches(motion, motion.impacts)
    if len(touches):
        axes.plot(*touches.T, "o", markeredgecolor=color_of(index), label="contact", **HOLLOW)
    axes.plot([], [], color=_GOAL["edgecolor"], linestyle=_GOAL["linestyle"], label="goal")
    xlabel, ylabel = (_name_axis(axis) for axis in stage.X_WT.rotation().matrix().T[:2])
    ylabel = ylabel if stage.is_flat else "up, seen from above [m]"
    (left, bottom), (right, top) = stage.low, stage.high
    axes.set(xlim=(left, right), ylim=(bottom, top), xlabel=xlabel, ylabel=ylabel, aspect="equal")
    axes.legend(ncols=3, **ABOVE)


def draw_still(axes: Axes, stage: Stage, q: Floats) -> None:
    """Draws what stands still."""
    for actor in (actor for actor in stage.actors if not actor.moves):
        look = SOLID_LOOK if stage.is_in_the_way(actor) else _BEHIND
        _draw(axes, stage, [actor], q, look)


def draw_goal(axes: Axes, stage: Stage, world: World, scenario: Scenario, goal: Floats) -> None:
    """Draws outlines at the goal of links whose end matters."""
    is_asked = has_goal(world, scenario)
    asked = [a for a in stage.actors if a.moves and np.any(stage.movers_of(a.index) & is_asked)]
    _draw(axes, stage, asked, goal, _GOAL)


def draw_moving(axes: Axes, stage: Stage, q: Floats, index: int, alpha: float) -> list[Polygon]:
    """Draws links at q in their colors in the motion of an index (`Stage.color`)."""
    # From the back to the front: in a plane, none comes nearer as it moves.
    moving = [actor for actor in stage.actors if actor.moves]
    moving.sort(key=lambda actor: np.sum(stage.extent([actor], q[np.newaxis])[:, 2]))
    patches = []
    for actor in moving:
        color = stage.color(actor, index)
        own = color.r(), color.g(), color.b()
        look = {"facecolor": own, "edgecolor": "#222222", "linewidth": 0.4}
        patches += _draw(axes, stage, [actor], q, {**look, "alpha": alpha, "zorder": 2 + alpha})
    return patches


def _draw(
    axes: Axes, stage: Stage, actors: Sequence[Actor], q: Floats, look: dict[str, Any]
) -> list[Polygon]:
    """Draws the outlines of shapes at q."""
    patches = []
    for actor in actors:
        X_TS = stage.X_WT.inverse() @ stage.pose(actor, q)
        points = np.vstack(list(_find_points(actor, X_TS)))[:, :2]
        patches.append(Polygon(points[ConvexHull(points).vertices], **look))
        axes.add_patch(patches[-1])
    return patches


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
        yield X_TS.multiply(actor.points.T).T


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
    named = dict[str, Any]()
    for each in drawn:
        for handle, label in zip(*each.get_legend_handles_labels(), strict=True):
            named.setdefault(label, handle)
    listed = [*named.values()]
    if (more := len(listed) - _MOST_LISTED) > 0:
        listed[_MOST_LISTED:] = [Line2D([], [], linestyle="none", label=f"{more} more")]
    if listed:
        axes.legend(handles=listed, ncols=2, **ABOVE)


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
    optimum = paper.rigid_optimum(world, scenario)
    contacts: dict[str, tuple[float, float] | None] = dict.fromkeys(ends)
    for name, end in ends.items():
        for first in end.contacts[:1]:
            speed = calc_approach_speed(world, end.trajectory, first.time, first.index)
            contacts[name] = first.time, speed
    speeds = [-v for v in optimum.impact_velocities] + [c[1] for c in contacts.values() if c]
    time = np.linspace(0, scenario.duration, _POINTS + 2)[1:-1]
    rates = np.linspace(0, 1.6 * max(speeds, default=1.0), _POINTS)
    costs = paper.bounce_costs(world, scenario, time, rates[:, np.newaxis])
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
        options = paper.LiteralOptions(nonpenetration=False, local_solver="snopt")
        run = paper.gradient_from_zero(paper.make_literal_task(world, scenario, options))
        planned = Motion.from_trajectory(run.trajectory, world, f"{_ONE_WALL}: {PLAN_LABEL}")
        simulated = Motion.from_replay(run.replay, world, f"{_ONE_WALL}: {_RIGID}")
        return [planned, simulated.under(run.trajectory.times, run.trajectory.controls)]
    world.check_plain(scenario)
    problem = make_ball_task(world, scenario, PlanOptions(relaxation=0.0, local_solver="snopt"))
    transcription = problem.transcription
    found = problem.solve_locally(paper.random_guess(transcription, np.random.default_rng(seed)))
    times, controls = transcription.GetSampleTimes(), transcription.split(found)[2]
    replay = replay_event_driven(world, scenario, times, controls)
    simulated = Motion.from_replay(replay, world, f"{_SEVERAL}: {_RIGID}")
    return [simulated.under(times, controls)]
