"""Figures of friction: how much of its cone it takes, and where it sticks or slips."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from drake_aigto.arrays import Floats
from drake_aigto.show.figures import ABOVE
from drake_aigto.show.motion import Motion, calc_contact_forces, color_of
from drake_aigto.show.text import touch_names
from drake_aigto.world import RigidLaw, Scenario, World, calc_friction_share

# Rows that are nearer to an impact than this part of the motion are at it.
_AT = 1e-12
# Bars of impulses are so wide, as a part of the motion.
_WIDTH = 0.01


class Friction(NamedTuple):
    """Friction along a motion of K rows, at m contacts; of rigid walls as impulses [N s]."""

    forces: Floats  # against sliding, shape (K, m) [N]
    largest: Floats  # μ f, shape (K, m) [N]
    slips: Floats  # s, shape (K, m) [m/s]


def calc_friction(motion: Motion, world: World, scenario: Scenario) -> Friction:
    """Returns what walls rub with: those that yield by −μ f σ(s / v_s), rigid ones in impacts.

    Impulses are read off what each impact changes the velocity by, and stand in the row after it,
    with the slip that is left.
    """
    law = world.contact_law(scenario)
    if isinstance(law, RigidLaw):
        return _calc_impulses(motion, world, law)
    largest = law.friction * calc_contact_forces(motion, world, scenario)
    slips = world.rubbing.calc_slips(motion.positions, motion.velocities, yields=True)
    return Friction(-largest * calc_friction_share(slips, world.stiction_speed), largest, slips)


def _calc_impulses(motion: Motion, world: World, law: RigidLaw) -> Friction:
    slips = world.rubbing.calc_slips(motion.positions, motion.velocities)
    forces, largest = np.zeros_like(slips), np.zeros_like(slips)
    for time in {touch.start for touch in motion.impacts} if law.rubs else ():
        rows = np.flatnonzero(np.abs(motion.times - time) <= _AT * motion.times[-1])
        contacts = sorted({touch.contact for touch in motion.impacts if touch.start == time})
        if not len(rows):
            continue
        q, change = motion.positions[rows[0]], motion.velocities[rows[-1]]
        J = world.calc_contact_jacobian(q)[contacts]
        T = world.rubbing.calc_tangent_jacobian(q)[contacts]
        kicks = np.linalg.solve(world.calc_mass_matrix(q), np.vstack([J, T]).T)
        impulses = np.linalg.lstsq(kicks, change - motion.velocities[rows[0]])[0]
        normal, tangent = np.split(impulses, 2)
        largest[rows[-1], contacts] = law.friction[contacts] * normal
        forces[rows[-1], contacts] = tangent
    return Friction(forces, largest, slips)


def plot_friction(axes: Axes, motion: Motion, world: World, scenario: Scenario) -> None:
    """Draws the friction of walls over time [N], within its cone ±μ f, which is hatched.

    Rings are where it sticks, |s| < v_s, crosses where it slips. Of rigid walls these are impulses
    [N s] and bars, and s is what an impact leaves of it.
    """
    friction, names = calc_friction(motion, world, scenario), touch_names(world)
    is_rigid = scenario.contact == "rigid"
    look: dict[str, Any] = {"facecolor": "none", "hatch": "//"}
    for index, contact in enumerate(np.flatnonzero(np.any(friction.largest > 0, axis=0))):
        force, most = friction.forces[:, contact], friction.largest[:, contact]
        is_slow = np.abs(friction.slips[:, contact]) < world.stiction_speed
        color = color_of(index)
        look |= {"edgecolor": color, "label": f"cone of {names[contact]}"}
        if is_rigid:
            struck, width = most > 0, _WIDTH * (motion.times[-1] - motion.times[0])
            axes.bar(motion.times[struck], 2 * most[struck], width, -most[struck], **look)
        else:
            axes.fill_between(motion.times, -most, most, **look)
            axes.plot(motion.times, force, color=color, label=f"friction of {names[contact]}")
        for name, marker, rows in (("sticks", "o", is_slow), ("slips", "x", ~is_slow)):
            at = rows & (most > 0)
            if is_rigid and not at.any():
                continue
            label = f"{names[contact]} {name}" if is_rigid else name
            axes.plot(
                motion.times[at], force[at], marker, color=color, fillstyle="none", label=label
            )
    axes.set(xlabel="time t [s]", ylabel="friction [N s]" if is_rigid else "friction [N]")
    if is_rigid:
        axes.use_sticky_edges = False
        axes.margins(y=0.1)
        axes.set_xlim(motion.times[0], motion.times[-1])
        axes.axhline(0.0, color="#888888", linewidth=0.6)
    if axes.lines:
        axes.legend(ncols=2, **ABOVE)
