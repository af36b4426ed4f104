"""Figures of friction: how much of its cone it takes, and where it sticks or slips."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from drake_aigto.arrays import Floats
from drake_aigto.show.figures import ABOVE
from drake_aigto.show.motion import Motion, calc_contact_forces, color_of
from drake_aigto.show.text import touch_names
from drake_aigto.world import CompliantLaw, Scenario, World, calc_friction_share


class Friction(NamedTuple):
    """Friction of soft walls along a motion of K rows, at m contacts."""

    forces: Floats  # against sliding, shape (K, m) [N]
    largest: Floats  # μ f, shape (K, m) [N]
    slips: Floats  # s, shape (K, m) [m/s]


def calc_friction(motion: Motion, world: World, scenario: Scenario) -> Friction:
    """Returns what walls that yield rub with, −μ f σ(s / v_s); nothing where they are rigid."""
    law = world.contact_law(scenario)
    largest = np.zeros((len(motion.times), world.num_contacts))
    if isinstance(law, CompliantLaw):
        largest = law.friction * calc_contact_forces(motion, world, scenario)
    slips = world.rubbing.calc_slips(motion.positions, motion.velocities, yields=True)
    return Friction(-largest * calc_friction_share(slips, world.stiction_speed), largest, slips)


def plot_friction(axes: Axes, motion: Motion, world: World, scenario: Scenario) -> None:
    """Draws the friction of soft walls over time [N], within its cone ±μ f, which is hatched.

    Rings are where it sticks, |s| < v_s, crosses where it slips.
    """
    friction, names = calc_friction(motion, world, scenario), touch_names(world)
    for index, contact in enumerate(np.flatnonzero(np.any(friction.largest > 0, axis=0))):
        force, most = friction.forces[:, contact], friction.largest[:, contact]
        is_slow = np.abs(friction.slips[:, contact]) < world.stiction_speed
        color, label = color_of(index), f"cone of {names[contact]}"
        axes.fill_between(
            motion.times, -most, most, facecolor="none", edgecolor=color, hatch="//", label=label
        )
        axes.plot(motion.times, force, color=color, label=f"friction of {names[contact]}")
        for name, marker, rows in (("sticks", "o", is_slow), ("slips", "x", ~is_slow)):
            at = rows & (most > 0)
            axes.plot(
                motion.times[at], force[at], marker, color=color, fillstyle="none", label=name
            )
    axes.set(xlabel="time t [s]", ylabel="friction [N]")
    if axes.lines:
        axes.legend(ncols=2, **ABOVE)
