"""Figures: functions of axes and data. They change nothing but the axes that they are given."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.patches import Polygon, Rectangle

from drake_aigto.aigo import Iterate
from drake_aigto.arrays import Floats
from drake_aigto.errors import ModelError
from drake_aigto.planning import Plan
from drake_aigto.show import shapes
from drake_aigto.show.motion import Motion, color_of, find_row, motions_of_plan
from drake_aigto.show.words import touch_names
from drake_aigto.transcription import Transcription
from drake_aigto.world import Scenario, World

# Motions differ in color, and so that where they agree all are seen, in width and dashes.
_LINES: tuple[dict[str, Any], ...] = (
    {"linewidth": 5.5},
    {"linewidth": 2.6},
    {"linewidth": 1.4, "linestyle": (0, (4, 4))},
)
# A control per kilogram that is below this part of the largest velocity over T is rounding.
_NO_CONTROL = 1e-12
# A held control is all corners: sharp ones, of lines as thin as this part of its motion's.
_SHARP: dict[str, Any] = {"solid_joinstyle": "miter", "solid_capstyle": "butt"}
_THINNER = 0.5
# Planned contacts, behind everything: a bounce, one that lasts, and the wall's force meanwhile.
_BOUNCE: dict[str, Any] = {"linestyle": (0, (1, 2)), "linewidth": 1.4, "zorder": 0.5}
_CONTACT: dict[str, Any] = {"alpha": 0.15, "linewidth": 0, "zorder": 0.5}
_NAME: dict[str, Any] = {"rotation": 90, "fontsize": "x-small", "ha": "right"}
_NAME |= {"textcoords": "offset points", "xytext": (-2, 0)}
_NAME_WIDTH = 0.05  # of the time that is shown: names that are nearer would cover each other
HOLLOW: dict[str, Any] = {"markerfacecolor": "white", "markersize": 7, "zorder": 4}
_FORCE: dict[str, Any] = {"facecolor": "none", "hatch": "///", "linewidth": 0}
_WALL_COLOR = "#8a8f98"
# In ranges of what is drawn: how much of the wall is seen at least, and how far it reaches.
_WALL_SEEN, _WALL_DEPTH = 0.05, 100
SOLID_LOOK: dict[str, Any] = {"facecolor": _WALL_COLOR, "hatch": "//", "edgecolor": "white"}
SOLID_LOOK |= {"alpha": 0.5, "zorder": 0}
_GOAL: dict[str, Any] = {"color": "black", "markersize": 11, "clip_on": False, "zorder": 5}
# Legends are above the axes, where they hide nothing.
ABOVE: dict[str, Any] = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "fontsize": "small"}

Quantity = Literal["position", "velocity", "control"]

# In the order of `Transcription.split`: symbols, and units of sliders and of hinges.
_QUANTITIES: dict[Quantity, tuple[str, str, str]] = {
    "position": ("q", "m", "rad"),
    "velocity": ("v", "m/s", "rad/s"),
    "control": ("u", "N", "N m"),
}
_ROOM = 0.08  # around what is drawn, as a part of its range
_ARROWS = (0.2, 0.8)  # parts of the duration at which the way of time is shown


def plot_plan(
    axes: Sequence[Any] | npt.NDArray[Any], plan: Plan, world: World | None = None
) -> None:
    """Draws a plan against what simulations made of its control, in axes as of `plot_motions`.

    Raises:
        ModelError: the world has to be given (`Plan.find_world`); or from `plot_motions`.
    """
    world = plan.find_world(world)
    plot_motions(axes, motions_of_plan(plan, world), world, plan.scenario)


def plot_motions(
    axes: Sequence[Any] | npt.NDArray[Any],
    motions: Sequence[Motion],
    world: World,
    scenario: Scenario,
    coordinates: Sequence[int] | None = None,
) -> None:
    """Draws positions, velocities and controls over time, as AIGTO Fig. 2 has them.

    Planned contacts that push a coordinate are dotted lines across all three, or bands where they
    last; between several walls, each has its name.

    Args:
        axes: for positions, velocities, and controls, shape (3,), or (3, n): a column for each
            coordinate that is drawn, the legend over the first; without controls, (2, n).
        motions: those without a control are left out of the third.
        world: of the motions; has the walls.
        scenario: has the goal.
        coordinates: which are drawn; all if None.

    Raises:
        ModelError: the axes are of another shape.
    """
    columns = list(range(world.num_velocities) if coordinates is None else coordinates)
    grid = np.array(axes, dtype=object)
    grid = grid[:, np.newaxis] if grid.ndim == 1 else grid
    if grid.shape not in ((3, len(columns)), (2, len(columns))):
        raise ModelError("axes", got=grid.shape, expected=f"(3, {len(columns)})")
    for i, (top, middle, *bottom) in zip(columns, grid.T, strict=True):
        plot_positions(top, motions, world, scenario, i)
        plot_velocities(middle, motions, world, i)
        for axes_of_control in bottom:
            plot_controls(axes_of_control, motions, world, i)
            middle.set_xlabel("")
        top.set_xlabel("")
        if i != columns[0]:
            top.get_legend().remove()


def plot_positions(
    axes: Axes, motions: Sequence[Motion], world: World, scenario: Scenario, coordinate: int = 0
) -> None:
    """Draws one coordinate of q(t), the goal as a star at T, and the walls across it."""
    rows = [shapes.read_coordinates(world, scenario, motion.positions) for motion in motions]
    _plot_rows(axes, motions, rows, coordinate)
    _mark_touches(axes, motions, world, coordinate, named=True)
    if shapes.has_goal(world, scenario)[coordinate]:
        goal = shapes.find_goal(world, scenario, motions[0].positions[-1])
        is_free = scenario.duration_range is not None
        T = motions[0].times[-1] if is_free else scenario.duration
        axes.plot(T, shapes.read_coordinates(world, scenario, goal)[coordinate], "*", **_GOAL)
        axes.plot([], [], "*", color="black", markersize=9, label="goal")
    _shade_walls(axes, world, coordinate)
    axes.set_ylabel(_label("position", world, coordinate))
    axes.legend(ncols=3, **ABOVE)


def plot_velocities(
    axes: Axes, motions: Sequence[Motion], world: World, coordinate: int = 0
) -> None:
    """Draws one coordinate of v(t); impacts are jumps."""
    _plot_rows(axes, motions, [motion.velocities for motion in motions], coordinate)
    _mark_touches(axes, motions, world, coordinate)
    axes.axhline(0, color="black", linewidth=0.5)
    axes.set_ylabel(_label("velocity", world, coordinate))


def plot_controls(axes: Axes, motions: Sequence[Motion], world: World, coordinate: int = 0) -> None:
    """Draws the controls u(t) of one coordinate's actuators, of the motions that have them.

    They are held between knots. Where nothing turns and a planned contact lasts, the wall's force
    λ(t) is shaded, in the same unit.
    """
    if not _actuators(world, coordinate):
        axes.text(0.5, 0.6, "no actuator", transform=axes.transAxes, ha="center")
        axes.set_yticks([])
    for index, motion in enumerate(motions):
        if motion.controls is None or motion.control_times is None:
            continue
        held = np.vstack([motion.controls, motion.controls[-1:]])[:, _actuators(world, coordinate)]
        noise = _NO_CONTROL * np.max(np.abs(motion.velocities)) / motion.control_times[-1]
        held = np.where(np.abs(held) > noise, held, 0.0)
        look = {**line_of(index), **_SHARP}
        look["linewidth"] *= _THINNER
        axes.step(motion.control_times, held, where="post", **look)
        if motion.forces is None or not shapes.moves_straight(world):
            continue
        for contact, force in enumerate(np.vstack([motion.forces, motion.forces[-1:]]).T):
            if np.any(force) and world.constant_inertia.jacobian[contact, coordinate]:
                label = f"force of the {touch_names(world)[contact]} λ [N]"
                look = {"step": "post", "edgecolor": color_of(index), "label": label, **_FORCE}
                axes.fill_between(motion.control_times, force, **look)
                axes.legend(loc="best", fontsize="small")
    _mark_touches(axes, motions, world, coordinate)
    axes.axhline(0, color="black", linewidth=0.5)
    axes.set(xlabel="time t [s]", ylabel=_label("control", world, coordinate))


def plot_path(
    axes: Axes,
    motions: Sequence[Motion],
    world: World,
    scenario: Scenario,
    coordinates: tuple[int, int] = (0, 1),
) -> None:
    """Draws one coordinate against another, to the right and up: in a room, the ball's way.

    Walls and blocks are shaded where the ball's center can't be. Start, goal and planned bounces
    are marked. Both axes get one scale.

    Raises:
        ModelError: the world has one coordinate only.
    """
    if world.num_positions < 2:
        raise ModelError("path", got="one coordinate", expected="two", remedy="Use plot_positions.")
    pair = list(coordinates)
    for index, motion in enumerate(motions):
        axes.plot(*motion.positions[:, pair].T, label=motion.label, **line_of(index))
    for index, motion in enumerate(motions):
        starts = [touch.start for touch in motion.touches]
        # Of the two rows of an impact either will do: positions do not jump.
        at = motion.positions[np.searchsorted(motion.times, starts)][:, pair]
        label = "" if any(earlier.touches for earlier in motions[:index]) else "planned contact"
        label = label if motion.touches else ""
        axes.plot(*at.T, "o", label=label, markeredgecolor=color_of(index), **HOLLOW)
    start, goal = (q[pair] for q in (scenario.initial_position, scenario.goal_position))
    axes.plot(*start, "s", color="black", markersize=6, zorder=5, label="start")
    axes.plot(*goal, "*", **_GOAL)
    axes.plot([], [], "*", color="black", markersize=9, label="goal")
    _shade_solids(axes, world, coordinates)
    xlabel, ylabel = (_label("position", world, i) for i in pair)
    axes.set(xlabel=xlabel, ylabel=ylabel, aspect="equal")
    axes.legend(ncols=2, **ABOVE)


def plot_boxes(
    axes: Axes,
    transcription: Transcription,
    iterates: Sequence[Iterate],
    quantity: Quantity = "position",
    coordinate: int = 0,
) -> None:
    """Draws the boxes around a quantity, center ± half width over time, as AIGO shrinks them.

    Each is labeled with its temperature and its largest half width. Of `AigoResult.history`, the
    first iterate that is given is at the back; of controls, those that act on the coordinate.
    """
    times, world = transcription.GetSampleTimes(), transcription.world
    part = list(_QUANTITIES).index(quantity)
    columns = _actuators(world, coordinate) if quantity == "control" else [coordinate]
    colors = colormaps["viridis"](np.linspace(0.85, 0.0, len(iterates)))
    for iterate, color in zip(iterates, colors, strict=True):
        centers, half_widths = (
            transcription.split(y)[part][:, columns]
            for y in (iterate.box.center, iterate.box.half_width)
        )
        hot = 0 < iterate.temperature < np.inf
        label = f"temperature {iterate.temperature:.1e}: " if hot else ""
        label += f"within ±{np.max(half_widths):.2g} {_unit(quantity, world, coordinate)}"
        for c, w in zip(centers.T, half_widths.T, strict=True):
            t = times[: len(c)]  # A control has no value at the last knot.
            axes.fill_between(t, c - w, c + w, color=color, alpha=0.3, linewidth=0)
            axes.plot(t, c, color=color, label=label)
            label = ""
    if quantity == "position":
        _shade_walls(axes, world, coordinate)
    axes.set(xlabel="time t [s]", ylabel=_label(quantity, world, coordinate))
    axes.legend(**ABOVE)


def _plot_rows(
    axes: Axes, motions: Sequence[Motion], rows: Sequence[Floats], coordinate: int
) -> None:
    """Draws one coordinate of each motion's rows (K, nv) over its times, labeled."""
    for index, (motion, values) in enumerate(zip(motions, rows, strict=True)):
        axes.plot(motion.times, values[:, coordinate], label=motion.label, **line_of(index))
    axes.set_xlabel("time t [s]")


def _mark_touches(
    axes: Axes, motions: Sequence[Motion], world: World, coordinate: int, named: bool = False
) -> None:
    """Marks when the motions plan to touch what pushes a coordinate; the first is labeled."""
    label, names = "planned contact", touch_names(world)
    named_at: dict[str, list[float]] = {"top": [], "bottom": []}
    for index, motion in enumerate(motions):
        color, marked = color_of(index), set[tuple[str, float, float]]()
        for touch in motion.touches:
            q, name = motion.positions[find_row(motion, touch.start)], names[touch.contact]
            slope = world.calc_contact_jacobian(q)[touch.contact, coordinate]
            if not slope or (mark := (name, touch.start, touch.end)) in marked:
                continue
            marked.add(mark)
            if touch.lasts:
                axes.axvspan(touch.start, touch.end, color=color, label=label, **_CONTACT)
            else:
                axes.axvline(touch.start, color=color, label=label, **_BOUNCE)
            # Where a motion that bounces there is not, and no other name.
            height, side = (0.97, "top") if slope > 0 else (0.03, "bottom")
            apart = _NAME_WIDTH * motion.times[-1]
            is_free = all(abs(touch.start - time) > apart for time in named_at[side])
            if named and len(names) > 1 and is_free:
                named_at[side].append(touch.start)
                look = {"xycoords": axes.get_xaxis_transform(), "color": color, "va": side, **_NAME}
                axes.annotate(name, (touch.start, height), **look)
            label = ""


def _actuators(world: World, coordinate: int) -> list[int]:
    """Returns which controls act on a coordinate."""
    return [int(i) for i in np.flatnonzero(world.actuation[coordinate])]


def line_of(motion: int) -> dict[str, Any]:
    """Returns how a motion is drawn, the same in every figure."""
    return {"color": color_of(motion), **_LINES[min(motion, len(_LINES) - 1)]}


def _label(quantity: Quantity, world: World, coordinate: int) -> str:
    """Returns a name for an axis, with the coordinate where there are several."""
    unit = _unit(quantity, world, coordinate)
    if world.num_velocities == 1:
        return f"{quantity} {_QUANTITIES[quantity][0]} [{unit}]"
    return f"{shapes.coordinate_names(world)[coordinate]} {quantity} [{unit}]"


def _unit(quantity: Quantity, world: World, coordinate: int) -> str:
    """Returns the unit of a quantity of one coordinate."""
    return _QUANTITIES[quantity][2 if world.turns[coordinate] else 1]


def _shade_walls(axes: Axes, world: World, coordinate: int) -> None:
    """Shades the walls across a coordinate: others have no place on an axis."""
    walls = shapes.wall_places(world, coordinate)
    if not walls:
        return
    places = [place for _, place, _ in walls]
    low, high = axes.get_ylim()
    size = max(high, *places) - min(low, *places)
    for _, place, side in walls:
        deep = place - side * _WALL_DEPTH * size
        # Added as an artist, it is no data: limits stay as they are, free to follow what comes.
        wall = Rectangle(
            (0, deep), 1, place - deep, transform=axes.get_yaxis_transform(), **SOLID_LOOK
        )
        axes.add_artist(wall)
        axes.update_datalim([(0, place - side * _WALL_SEEN * size)], updatex=False)
    axes.autoscale_view()
    name = touch_names(world)[walls[0][0]] if len(walls) == 1 else "walls"
    axes.plot([], [], color=_WALL_COLOR, linewidth=6, alpha=0.5, label=name)


def _shade_solids(axes: Axes, world: World, coordinates: tuple[int, int]) -> None:
    """Shades all that is solid in the plane of two coordinates, and shows some of each wall."""
    seen = np.vstack([line.get_xydata() for line in axes.lines])
    low, high = np.nanmin(seen, axis=0), np.nanmax(seen, axis=0)
    for side, coordinate in enumerate(coordinates):
        places = [place for _, place, _ in shapes.wall_places(world, coordinate)]
        low[side], high[side] = min([low[side], *places]), max([high[side], *places])
    margin = _WALL_SEEN * np.max(high - low)
    window = np.array([low - margin, high + margin])
    for corners in shapes.solid_regions(world, coordinates, window):
        axes.add_artist(Polygon(corners, **SOLID_LOOK))
    axes.set(xlim=window[:, 0], ylim=window[:, 1])
    axes.plot([], [], color=_WALL_COLOR, linewidth=6, alpha=0.5, label="solid")


def plot_phase_portrait(
    axes: Axes, motions: Sequence[Motion], world: World, scenario: Scenario, coordinate: int = 0
) -> None:
    """Draws a coordinate's velocity against its position, and the walls across it.

    A bounce is a vertical line at a wall's edge. Start and the goal's position are marked.
    """

    def read(q: Floats) -> Floats:
        return shapes.read_coordinates(world, scenario, q)[..., coordinate]

    seen = [read(motion.positions) for motion in motions]
    for index, motion in enumerate(motions):
        v = motion.velocities[:, coordinate]
        axes.plot(seen[index], v, label=motion.label, **line_of(index))
    first, look = motions[0], {"arrowstyle": "-|>", "color": color_of(0), "mutation_scale": 22}
    path = np.column_stack([seen[0], first.velocities[:, coordinate]])
    for part in _ARROWS:
        row = int(part * (len(path) - 1))
        axes.annotate("", xy=path[row + 1], xytext=path[row], arrowprops=look)
    start = read(scenario.initial_position), scenario.initial_velocity[coordinate]
    axes.plot(*start, "s", color="black", markersize=7, zorder=5, label="start")
    goal = [float(read(shapes.find_goal(world, scenario, motions[0].positions[-1])))]
    goal = goal if shapes.has_goal(world, scenario)[coordinate] else []
    for place in goal:
        axes.axvline(place, color="black", linestyle=(0, (4, 3)), linewidth=1.2, label="goal")
    axes.axhline(0, color="black", linewidth=0.5)
    walls = shapes.wall_places(world, coordinate)
    places = np.concatenate([*seen, goal, [place for _, place, _ in walls]])
    size = np.ptp(places) or 1.0  # It may stand still.
    for i, (_, place, side) in enumerate(walls):
        edges = sorted((place, place - side * 2 * size))
        axes.axvspan(*edges, **SOLID_LOOK, label="" if i else "wall")
    axes.set_xlim(np.min(places) - _ROOM * size, np.max(places) + _ROOM * size)
    axes.set_xlabel(_label("position", world, coordinate))
    axes.set_ylabel(_label("velocity", world, coordinate))
    axes.legend(ncols=2, **ABOVE)
