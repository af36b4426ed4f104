"""Figures of friction: how much of its cone it takes, and where it sticks or slips."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drake_aigto.arrays import Bools
from drake_aigto.show.figures import ABOVE
from drake_aigto.show.friction import Friction, calc_friction
from drake_aigto.show.motion import Motion, color_of
from drake_aigto.show.text import touch_names
from drake_aigto.world import Scenario, World

# Bars of impulses are so wide, as a part of the motion.
_WIDTH = 0.01
_HATCHED: dict[str, Any] = {"facecolor": "none", "hatch": "//"}


def draw_friction(motion: Motion, world: World, scenario: Scenario) -> Iterator[tuple[Figure, str]]:
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
        _plot_forces(axes, motion, world, forces)
    if has_impulses:
        drawn.append(axes.twinx() if has_forces else axes)
        _plot_impulses(drawn[-1], motion, world, impulses)
    axes.set_xlabel("time t [s]")
    handles = [handle for each in drawn for handle in each.get_legend_handles_labels()[0]]
    if handles:
        axes.legend(handles=handles, ncols=2, **ABOVE)


def _plot_forces(axes: Axes, motion: Motion, world: World, friction: Friction) -> None:
    """Draws forces as lines, and marks on them."""
    names = touch_names(world)
    for index, contact in enumerate(_rubbing(friction)):
        force, most = friction.tangents[:, contact], friction.largest[:, contact]
        color, name = color_of(index), names[contact]
        axes.fill_between(
            motion.times, -most, most, edgecolor=color, label=f"cone of {name}", **_HATCHED
        )
        axes.plot(motion.times, force, color=color, label=f"friction of {name}")
        _mark(axes, motion, friction, contact, color, most > 0)
    axes.set_ylabel("friction [N]")


def _plot_impulses(axes: Axes, motion: Motion, world: World, friction: Friction) -> None:
    """Draws cones as bars, and marks in them."""
    names, width = touch_names(world), _WIDTH * (motion.times[-1] - motion.times[0])
    for index, contact in enumerate(_rubbing(friction)):
        struck = friction.largest[:, contact] > 0
        most, color = friction.largest[struck, contact], color_of(index)
        look: dict[str, Any] = {"edgecolor": color, "label": f"cone of {names[contact]}"}
        axes.bar(motion.times[struck], 2 * most, width, -most, **look, **_HATCHED)
        _mark(axes, motion, friction, contact, color, struck, f"{names[contact]} ")
    axes.use_sticky_edges = False
    axes.margins(y=0.1)
    axes.set_xlim(motion.times[0], motion.times[-1])
    axes.axhline(0.0, color="#888888", linewidth=0.6)
    axes.set_ylabel("friction [N s]")


def _rubbing(friction: Friction) -> list[int]:
    """Returns the contacts that rub."""
    found: list[int] = np.flatnonzero(np.any(friction.largest > 0, axis=0)).tolist()
    return found


def _mark(
    axes: Axes,
    motion: Motion,
    friction: Friction,
    contact: int,
    color: str,
    acts: Bools,
    of: str = "",
) -> None:
    """Marks where a contact sticks, by rings, and slips, by crosses, in the rows where it acts."""
    force, is_slow = friction.tangents[:, contact], friction.sticks[:, contact]
    for name, marker, rows in (("sticks", "o", is_slow), ("slips", "x", ~is_slow)):
        if np.any(at := rows & acts):
            look: dict[str, Any] = {"color": color, "fillstyle": "none", "label": f"{of}{name}"}
            axes.plot(motion.times[at], force[at], marker, **look)
