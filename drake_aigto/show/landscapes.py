"""Figures of costs: what AIGO minimizes, what it costs on the way, and where methods end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.ticker import LogLocator, MaxNLocator

from drake_aigto.optima import bounce_costs, rigid_optimum
from drake_aigto.planning import Candidate
from drake_aigto.show.box_playback import BoxRun
from drake_aigto.show.motion import calc_approach_speed, color_of
from drake_aigto.world import Scenario, World

_COLORMAP = "viridis"
_POINTS = 201  # along each side of a landscape
_LEVELS = 12
# So many times the least cost is as high as a landscape is drawn.
_HIGHEST = 1e4
_MARKERS = "oDvPX<"
_MARK: dict[str, Any] = {"linestyle": "none", "markeredgecolor": "white", "markersize": 10}


def plot_integrated_product(axes: Axes, half_width: float = 1.0, reach: float = 3.0) -> None:
    """Draws the mean of the penalty (xy)² over boxes around (x, y), |x|, |y| ≤ reach: AIGTO Fig. 1.

    Complementarity φλ = 0 holds on both axes; its penalty's mean over a box is least at zero alone,
    μ₂(x, w) μ₂(y, w) with μ₂(x, w) = x² + w²/3 and the half width w ≥ 0, which is why there are no
    forces among the unknowns. With w = 0 it is the penalty itself, 0 on both axes.
    """
    x = np.linspace(-reach, reach, _POINTS)
    means = x**2 + half_width**2 / 3
    values = np.outer(means, means)
    levels = np.max(values) * np.linspace(0, 1, _LEVELS) ** 3
    filled = axes.contourf(x, x, values, levels, cmap=_COLORMAP)
    filled.set_rasterized(True)  # In vector formats it is large.
    axes.contour(x, x, values, levels, colors="white", linewidths=0.5)
    for line in (axes.axhline, axes.axvline):
        line(0, color="white", linewidth=1.5, linestyle=(0, (4, 3)))
    lowest = "o" if half_width > 0 else ""
    axes.plot(0, 0, lowest, color="#D55E00", markeredgecolor="white", markersize=11)
    width = "the penalty (xy)² itself" if half_width == 0 else f"mean over ±{half_width:g}"
    axes.set(xlabel="x, such as φ(q)", ylabel="y, such as λ", title=width, aspect="equal")
    axes.figure.colorbar(filled, ax=axes, label="(xy)²", shrink=0.8, format="%.3g")


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

    Of motions that touch it once (`optima.bounce_costs`); white is where none does. A method's end
    point is its plan's first contact. Where its legend says that it does not hold, its own cost is
    not the landscape's: a literal plan leaves the wall as it likes.

    Raises:
        ModelError: not a world of one coordinate and one wall, without bias.
    """
    optimum = rigid_optimum(world, scenario)
    contacts = {name: _first_contact(world, end) for name, end in ends.items()}
    speeds = [-v for v in optimum.impact_velocities] + [c[1] for c in contacts.values() if c]
    time = np.linspace(0, scenario.duration, _POINTS + 2)[1:-1]
    speed = np.linspace(0, 1.6 * max(speeds, default=1.0), _POINTS)
    costs = bounce_costs(world, scenario, time, speed[:, np.newaxis])
    least = np.nanmin(costs)
    shown = np.ma.masked_invalid(np.minimum(costs, _HIGHEST * least))
    levels = np.geomspace(least, _HIGHEST * least, _LEVELS + 1)
    filled = axes.contourf(time, speed, shown, levels, cmap=_COLORMAP, norm=LogNorm())
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


def _first_contact(world: World, run: Candidate) -> tuple[float, float] | None:
    """Returns when a run first touches a wall, and how fast it approaches; None if it does not."""
    if not run.contacts:
        return None
    first = run.contacts[0]
    return first.time, calc_approach_speed(world, run.trajectory, first.time, first.index)
