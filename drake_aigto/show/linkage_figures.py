"""Figures of mechanisms: a motion in one still picture, and what contacts push with over time."""

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
from drake_aigto.show.coordinates import find_goal, has_goal
from drake_aigto.show.figures import ABOVE, HOLLOW, SOLID_LOOK, line_of, plot_phase_portrait
from drake_aigto.show.friction_figures import draw_friction
from drake_aigto.show.linkage import Linkage
from drake_aigto.show.motion import (
    Motion,
    calc_contact_forces,
    color_of,
    find_row,
    positions_at,
    time_span,
)
from drake_aigto.show.stage import Actor
from drake_aigto.show.text import touch_names
from drake_aigto.world import Scenario, World

_COUNT = 12
_PALEST = 0.15  # The first of the links that are drawn: how much they cover.
_AROUND = np.linspace(0, 2 * np.pi, 33)[:-1]  # of what is round [rad]
_GOAL: dict[str, Any] = {"facecolor": "none", "edgecolor": "#007a55", "linewidth": 1.3}
_GOAL |= {"linestyle": (0, (3, 2)), "zorder": 4}
_BEHIND: dict[str, Any] = {"facecolor": "#eceff3", "zorder": 0}
_NAME: dict[str, Any] = {"ha": "center", "va": "bottom", "fontsize": "small"}
_NAME |= {"textcoords": "offset points", "xytext": (0, 4)}


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
        figure.set_size_inches(9, _find_height(panels[0]))
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
    yield from draw_friction(motions[0], world, scenario)


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
    linkage = Linkage(world, np.vstack([motion.positions, goal]))
    if not linkage.is_flat:
        raise ModelError(
            "the picture of a motion",
            got="links that keep to no plane",
            expected="one plane in which all links move",
            remedy="Watch the motion in Meshcat.",
        )
    moving = _find_moving(linkage)
    for actor in linkage.actors:
        if not actor.moves:
            look = SOLID_LOOK if linkage.is_in_the_way(actor) else _BEHIND
            _draw(axes, linkage, [actor], motion.positions[0], look)
    moments = positions_at(motion, np.linspace(*time_span([motion]), count))
    for alpha, q in zip(np.linspace(_PALEST, 1, count), moments, strict=True):
        for actor in moving:
            look = {"facecolor": _color(actor, index), "edgecolor": "#222222", "linewidth": 0.4}
            _draw(axes, linkage, [actor], q, {**look, "alpha": alpha, "zorder": 2 + alpha})
    asked = [actor for actor in moving if np.any(linkage.movers_of(actor.index) & is_asked)]
    _draw(axes, linkage, asked, goal, _GOAL)
    _draw_ways(axes, linkage, motion, color_of(index))
    letters = [_name_axis(axis) for axis in linkage.X_WT.rotation().matrix().T[:2]]
    (left, bottom), (right, top) = linkage.low, linkage.high
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.set(xlabel=f"{letters[0]} [m]", ylabel=f"{letters[1]} [m]")
    axes.legend(ncols=3, **ABOVE)


def _find_height(axes: Axes) -> float:
    """Returns how high a figure of two panels side by side has to be for their one scale [in]."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    return float(np.clip(1.0 + 4.0 * (top - bottom) / (right - left), 2.5, 7.0))


def _draw_ways(axes: Axes, linkage: Linkage, motion: Motion, color: str) -> None:
    """Draws the way of what tells the motion, and where contacts are."""
    for way in linkage.trace(motion.positions)[..., :2].transpose(1, 0, 2):
        axes.plot(*way.T, color=color, linewidth=1.2, alpha=0.8, zorder=3.5)
    axes.plot([], [], color=color, linewidth=1.2, label=motion.label)
    X_TW = linkage.X_WT.inverse()
    impacts = [(i.contact, motion.positions[find_row(motion, i.start)]) for i in motion.impacts]
    touches = [X_TW.multiply(linkage.touch(*impact)[0])[:2] for impact in impacts]
    if touches:
        axes.plot(*np.array(touches).T, "o", markeredgecolor=color, label="contact", **HOLLOW)
    axes.plot([], [], color=_GOAL["edgecolor"], linestyle=_GOAL["linestyle"], label="goal")


def _find_moving(linkage: Linkage) -> list[Actor]:
    """Returns the links' shapes, from the back to the front."""
    moving = [actor for actor in linkage.actors if actor.moves]
    return sorted(moving, key=lambda actor: _depth(linkage, actor))


def _depth(linkage: Linkage, actor: Actor) -> float:
    """Returns how far from who looks on a shape of a flat mechanism is, wherever it moves."""
    q = np.zeros(linkage.num_positions)
    return float(linkage.places(actor, q[np.newaxis])[0, 2])


def _color(actor: Actor, index: int) -> tuple[float, float, float]:
    """Returns a link's own color, or its motion's."""
    if actor.color is None:
        return to_rgb(color_of(index))
    return actor.color.r(), actor.color.g(), actor.color.b()


def _draw(
    axes: Axes, linkage: Linkage, actors: Sequence[Actor], q: Floats, look: dict[str, Any]
) -> None:
    """Draws the outlines of shapes at q."""
    for actor in actors:
        X_TS = linkage.X_WT.inverse() @ linkage.pose(actor, q)
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
    """Returns which of the world's axes is nearest to a direction."""
    largest = int(np.argmax(np.abs(axis)))
    return ("" if axis[largest] > 0 else "−") + "xyz"[largest]


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
