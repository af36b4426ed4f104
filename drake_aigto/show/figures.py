"""Figures: functions of axes and data. They change nothing but the axes that they are given."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib import colormaps
from matplotlib.patches import Rectangle

from drake_aigto.show.motion import Motion, color_of, motions_of_plan

if TYPE_CHECKING:
    import numpy.typing as npt
    from matplotlib.axes import Axes

    from drake_aigto.aigo import Iterate
    from drake_aigto.planning import Plan
    from drake_aigto.transcription import Transcription
    from drake_aigto.world import Scenario, World

# Motions differ in colour, and so that where they agree all are seen, in width and dashes.
_LINES: tuple[dict[str, Any], ...] = (
    {"linewidth": 5.5},
    {"linewidth": 2.6},
    {"linewidth": 1.4, "linestyle": (0, (4, 4))},
)
# A held control is all corners: sharp ones, of lines as thin as this part of its motion's.
_SHARP: dict[str, Any] = {"solid_joinstyle": "miter", "solid_capstyle": "butt"}
_THINNER = 0.5
# Planned contacts, behind everything: a bounce, one that lasts, and the wall's force meanwhile.
_BOUNCE: dict[str, Any] = {"linestyle": (0, (1, 2)), "linewidth": 1.4, "zorder": 0.5}
_CONTACT: dict[str, Any] = {"alpha": 0.15, "linewidth": 0, "zorder": 0.5}
_FORCE: dict[str, Any] = {"facecolor": "none", "hatch": "///", "linewidth": 0}
# The coordinates of one motion, from the first on, fade.
_FADING = 0.5
_WALL_COLOR = "#8a8f98"
# In ranges of what is drawn: how much of the wall is seen at least, and how far it reaches.
_WALL_SEEN, _WALL_DEPTH = 0.05, 100
_BOX_COLORMAP = "viridis"

Quantity = Literal["position", "velocity", "control"]

# In the order of `Transcription.split`.
_UNITS: dict[Quantity, str] = {"position": "m", "velocity": "m/s", "control": "N"}
_AXIS_LABELS: dict[Quantity, str] = {
    "position": "position q [m]",
    "velocity": "velocity v [m/s]",
    "control": "control u [N]",
}


def plot_plan(axes: Sequence[Axes], plan: Plan, world: World) -> None:
    """Draws a plan against what simulations made of its control.

    Args:
        axes: three, as `plot_motions` takes them.
        plan: the plan.
        world: that of its scenario.
    """
    plot_motions(axes, motions_of_plan(plan, world), world, plan.scenario)


def plot_motions(
    axes: Sequence[Axes], motions: Sequence[Motion], world: World, scenario: Scenario
) -> None:
    """Draws positions, velocities and controls over time, as AIGTO Fig. 2 has them.

    Planned contacts are dotted lines across all three, or bands where they last.

    Args:
        axes: three, for positions [m], velocities [m/s], and controls [N].
        motions: of this world; those without a control are left out of the third.
        world: has the wall.
        scenario: has the goal.
    """
    top, middle, bottom = axes
    plot_positions(top, motions, world, scenario)
    plot_velocities(middle, motions)
    plot_controls(bottom, motions)
    for upper in (top, middle):
        upper.set_xlabel("")


def plot_positions(axes: Axes, motions: Sequence[Motion], world: World, scenario: Scenario) -> None:
    """Draws q(t), the goal, and the wall where q is one coordinate.

    Args:
        axes: to draw in.
        motions: of this world.
        world: has the wall.
        scenario: has the goal, a star at T.
    """
    _plot_rows(axes, motions, [motion.positions for motion in motions])
    _mark_contacts(axes, motions)
    for goal in scenario.goal_position:
        axes.plot(
            scenario.duration, goal, "*", color="black", markersize=11, clip_on=False, zorder=5
        )
    axes.plot([], [], "*", color="black", markersize=9, label="goal")
    _shade_wall(axes, world)
    axes.set_ylabel(_AXIS_LABELS["position"])
    # Above the axes, where it hides nothing.
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, fontsize="small")


def plot_velocities(axes: Axes, motions: Sequence[Motion]) -> None:
    """Draws v(t); impacts are jumps."""
    _plot_rows(axes, motions, [motion.velocities for motion in motions])
    _mark_contacts(axes, motions)
    axes.axhline(0, color="black", linewidth=0.5)
    axes.set_ylabel(_AXIS_LABELS["velocity"])


def plot_controls(axes: Axes, motions: Sequence[Motion]) -> None:
    """Draws u(t), held between knots, of the motions that have it.

    Where a planned contact lasts, the wall's force λ(t) is shaded, in the same unit.
    """
    for index, motion in enumerate(motions):
        if motion.controls is None or motion.control_times is None:
            continue
        held = np.vstack([motion.controls, motion.controls[-1:]])
        for i, control in enumerate(held.T):
            look = {**_line(index, i), **_SHARP}
            look["linewidth"] *= _THINNER
            axes.step(motion.control_times, control, where="post", **look)
        if motion.forces is not None and np.any(motion.forces):
            _shade_forces(axes, motion.control_times, motion.forces, color_of(index))
    _mark_contacts(axes, motions)
    axes.axhline(0, color="black", linewidth=0.5)
    axes.set(xlabel="time t [s]", ylabel=_AXIS_LABELS["control"])


def plot_boxes(
    axes: Axes,
    transcription: Transcription,
    iterates: Sequence[Iterate],
    quantity: Quantity = "position",
) -> None:
    """Draws the boxes around a quantity, center ± half width over time, as AIGO shrinks them.

    Each is labelled with its largest half width.

    Args:
        axes: to draw in.
        transcription: knows which variables are which, and the wall.
        iterates: some of `AigoResult.history`, the first at the back.
        quantity: "position", "velocity" or "control".
    """
    times = transcription.GetSampleTimes()
    part = list(_AXIS_LABELS).index(quantity)
    colors = colormaps[_BOX_COLORMAP](np.linspace(0.85, 0.0, len(iterates)))
    for iterate, color in zip(iterates, colors, strict=True):
        box = iterate.box
        center, half_width = (transcription.split(y)[part] for y in (box.center, box.half_width))
        label = f"within ±{np.max(half_width):.2g} {_UNITS[quantity]}"
        for i, (c, w) in enumerate(zip(center.T, half_width.T, strict=True)):
            t = times[: len(c)]  # A control has no value at the last knot.
            axes.fill_between(t, c - w, c + w, color=color, alpha=0.3, linewidth=0)
            axes.plot(t, c, color=color, label=label if i == 0 else "")
    if quantity == "position":
        _shade_wall(axes, transcription.world)
    axes.set(xlabel="time t [s]", ylabel=_AXIS_LABELS[quantity])
    axes.legend(loc="best", fontsize="small")


def _plot_rows(
    axes: Axes, motions: Sequence[Motion], rows: Sequence[npt.NDArray[np.float64]]
) -> None:
    """Draws each motion's rows (K, n) over its times, a line a coordinate, the first labelled."""
    for index, (motion, values) in enumerate(zip(motions, rows, strict=True)):
        for i, column in enumerate(values.T):
            label = motion.label if i == 0 else ""
            axes.plot(motion.times, column, label=label, **_line(index, i))
    axes.set_xlabel("time t [s]")


def _mark_contacts(axes: Axes, motions: Sequence[Motion]) -> None:
    """Marks when the motions plan to be at the wall; the first is labelled."""
    label = "planned contact"
    for index, motion in enumerate(motions):
        for start, end in motion.contacts:
            if end > start:
                axes.axvspan(start, end, color=color_of(index), label=label, **_CONTACT)
            else:
                axes.axvline(start, color=color_of(index), label=label, **_BOUNCE)
            label = ""


def _shade_forces(
    axes: Axes, times: npt.NDArray[np.float64], forces: npt.NDArray[np.float64], color: str
) -> None:
    """Shades from 0 to the wall's forces (N, m), held between knots, and says what that is."""
    for i, force in enumerate(np.vstack([forces, forces[-1:]]).T):
        label = "force of the wall λ [N]" if i == 0 else ""
        axes.fill_between(times, force, step="post", edgecolor=color, label=label, **_FORCE)
    axes.legend(loc="best", fontsize="small")


def _line(motion: int, coordinate: int) -> dict[str, Any]:
    """Returns how a motion's coordinate is drawn, the same in every figure."""
    look = _LINES[min(motion, len(_LINES) - 1)]
    return {"color": color_of(motion), "alpha": _FADING**coordinate, **look}


def _shade_wall(axes: Axes, world: World) -> None:
    """Shades where φ(q) < 0, if q is one coordinate: otherwise the wall is no place on an axis."""
    if world.num_positions != 1:
        return
    at_zero = float(world.calc_signed_distance(np.zeros(1))[0])
    slope = float(world.calc_contact_jacobian(np.zeros(1))[0, 0])  # One joint slides: φ is affine.
    face, outwards = -at_zero / slope, np.sign(slope)
    low, high = axes.get_ylim()
    size = max(high, face) - min(low, face)
    deep = face - outwards * _WALL_DEPTH * size
    # Added as an artist, it is no data: limits stay as they are, free to follow what comes later.
    wall = Rectangle((0, deep), 1, face - deep, transform=axes.get_yaxis_transform(), zorder=0)
    wall.set(facecolor=_WALL_COLOR, alpha=0.5, hatch="//", edgecolor="white")
    axes.add_artist(wall)
    axes.update_datalim([(0, face - outwards * _WALL_SEEN * size)], updatex=False)
    axes.autoscale_view()
    axes.plot([], [], color=_WALL_COLOR, linewidth=6, alpha=0.5, label="wall")
