"""Friction along motions: what contacts rub with, and where they stick or slip."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.show.motion import Motion, calc_contact_forces, find_held
from drake_aigto.simulation.pushes import stack_rows
from drake_aigto.world import RigidLaw, Scenario, World, calc_friction_share

# Rows that are nearer to an impact than this part of the motion are at it.
_AT = 1e-12


class Friction(NamedTuple):
    """What acts along a motion of K rows, at m contacts: forces [N], or impulses [N s].

    Contacts stick where |s| < v_s; s of an impact is what it leaves.
    """

    normals: Floats  # f, shape (K, m)
    tangents: Floats  # against sliding, shape (K, m)
    largest: Floats  # μ f, shape (K, m)
    sticks: Bools  # shape (K, m)


def calc_friction(motion: Motion, world: World, scenario: Scenario) -> tuple[Friction, Friction]:
    """Returns forces while contacts last, and impulses of rigid impacts.

    Walls that yield rub by −μ f σ(s / v_s). Rigid ones, while a plan's contact lasts, by
    −μ f sign(s), and where they stick by what keeps T v̇ + Ṫ v = 0, within ±μ f; of lasting contact
    in simulations nothing is known (`calc_contact_forces`). Impulses, of walls that rub alone, are
    read off what each impact changes the velocity by, and stand in the row after it.
    """
    law = world.contact_law(scenario)
    forces = calc_contact_forces(motion, world, scenario)
    if not law.rubs:
        nothing = np.zeros_like(forces)
        smooth = Friction(forces, nothing, nothing, nothing > 0)
        return smooth, smooth._replace(normals=nothing)
    is_rigid = isinstance(law, RigidLaw)
    slips = world.rubbing.calc_slips(motion.positions, motion.velocities, yields=not is_rigid)
    sticks, largest = np.abs(slips) < world.stiction_speed, law.friction * forces
    impulses = np.zeros((2, *slips.shape))
    if is_rigid:
        held = sticks & (largest > 0)
        tangents = _hold(motion, world, forces, -largest * np.sign(slips), largest, held)
        impulses = _calc_impulses(motion, world) * (law.friction > 0)
    else:
        tangents = -largest * calc_friction_share(slips, world.stiction_speed)
    lasting = Friction(forces, tangents, largest, sticks)
    return lasting, Friction(impulses[0], impulses[1], law.friction * impulses[0], sticks)


def _hold(
    motion: Motion, world: World, forces: Floats, tangents: Floats, largest: Floats, held: Bools
) -> Floats:
    """Returns the tangents (K, m) [N], where contacts are held those that keep them from sliding.

        T M⁻¹ Tᵀ f_t = −(T v̇₀ + Ṫ v),    |f_t| ≤ μ f

    Here v̇₀ is without friction of what is held.
    """
    if motion.controls is None or not held.any():
        return tangents
    tangents = np.where(held, 0.0, tangents)
    controls = motion.controls[find_held(motion)]
    for row in np.flatnonzero(held.any(axis=1)):
        q, v, contacts = motion.positions[row], motion.velocities[row], np.flatnonzero(held[row])
        T = world.rubbing.calc_tangent_jacobian(q)
        free = world.calc_acceleration(q, v, controls[row], forces[row], tangents[row] @ T)
        sliding = T[contacts] @ free + world.rubbing.calc_tangent_bias(q, v)[contacts]
        kicks = np.linalg.solve(world.calc_mass_matrix(q), T[contacts].T)
        asked = np.linalg.lstsq(T[contacts] @ kicks, -sliding)[0]
        most = largest[row, contacts]
        tangents[row, contacts] = np.clip(asked, -most, most)
    return tangents


def _calc_impulses(motion: Motion, world: World) -> Floats:
    """Returns normal and tangential impulses, shape (2, K, m) [N s]."""
    found = np.zeros((2, len(motion.times), world.num_contacts))
    for time in {touch.start for touch in motion.impacts}:
        rows = np.flatnonzero(np.abs(motion.times - time) <= _AT * motion.times[-1])
        contacts = np.unique([t.contact for t in motion.impacts if t.start == time])
        if len(rows):
            found[:, rows[-1], contacts] = _read_impulses(motion, world, rows, contacts)
    return found


def _read_impulses(motion: Motion, world: World, rows: Ints, contacts: Ints) -> Floats:
    """Returns what makes of the first row's velocity the last one's, shape (2, contacts) [N s]."""
    q, change = motion.positions[rows[0]], np.diff(motion.velocities[rows[[0, -1]]], axis=0)[0]
    kicks = np.linalg.solve(world.calc_mass_matrix(q), stack_rows(world, q, contacts).T)
    impulses: Floats = np.linalg.lstsq(kicks, change)[0].reshape(2, -1)
    return impulses
