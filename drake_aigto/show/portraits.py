"""Phase portraits: velocity against position."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from drake_aigto.show.coordinates import coordinate_names, wall_places
from drake_aigto.show.figures import SOLID_LOOK, line_of
from drake_aigto.show.motion import Motion, color_of
from drake_aigto.world import Scenario, World

_ROOM = 0.08  # around what is drawn, as a part of its range
_ARROWS = (0.2, 0.8)  # parts of the duration at which the way of time is shown


def plot_phase_portrait(
    axes: Axes,
    motions: Sequence[Motion],
    world: World,
    scenario: Scenario,
    coordinate: int = 0,
) -> None:
    """Draws a coordinate's velocity against its position, and the walls across it.

    A bounce is a vertical line at a wall's edge. Start and the goal's position are marked; no
    velocity is asked for at the goal.
    """
    drawn = []
    for index, motion in enumerate(motions):
        q, v = motion.positions[:, coordinate], motion.velocities[:, coordinate]
        axes.plot(q, v, label=motion.label, **line_of(index))
        drawn.append((q, v))
        for part in _ARROWS if index == 0 else ():
            row = int(part * (len(q) - 1))
            here, ahead = ((q[i], v[i]) for i in (row, row + 1))
            look = {"arrowstyle": "-|>", "color": color_of(index), "mutation_scale": 22}
            axes.annotate("", xy=ahead, xytext=here, arrowprops=look)
    start = scenario.initial_position[coordinate], scenario.initial_velocity[coordinate]
    axes.plot(*start, "s", color="black", markersize=7, zorder=5, label="start")
    goal = scenario.goal_position[coordinate]
    axes.axvline(goal, color="black", linestyle=(0, (4, 3)), linewidth=1.2, label="goal")
    axes.axhline(0, color="black", linewidth=0.5)
    walls = wall_places(world, coordinate)
    places = [place for _, place, _ in walls]
    low = min(*(np.min(q) for q, _ in drawn), goal, *places)
    high = max(*(np.max(q) for q, _ in drawn), goal, *places)
    room = _ROOM * (high - low)
    axes.set_xlim(low - room, high + room)
    for i, (_, place, side) in enumerate(walls):
        edge = place - side * 2 * (high - low)
        axes.axvspan(*sorted((place, edge)), **SOLID_LOOK, label="" if i else "wall")
    axes.set_xlim(low - room, high + room)
    name = "" if world.num_positions == 1 else f"{coordinate_names(world)[coordinate]} "
    axes.set(xlabel=f"{name}position [m]", ylabel=f"{name}velocity [m/s]")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, fontsize="small")
