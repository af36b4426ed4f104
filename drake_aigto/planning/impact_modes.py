"""How impacts with friction end: what a simulation says of them, and what else may be best."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.planning.held_modes import in_order
from drake_aigto.simulation.coulomb import Mobility, Mode, calc_impulse
from drake_aigto.transcription import Touch, TouchSequence
from drake_aigto.world import RigidLaw, World

# An impact is at the edge of its mode where it sticks with this part of the friction there is, or
# where what slips has this part of the approach's speed left.
_EDGE = 0.02
# Where a c − b² is this part of a c, nothing moves along the wall that does not leave it, too: what
# has one coordinate never sticks.
_STIFF = 1e-9


def read_mode(world: World, law: RigidLaw, contact: int, q: Floats, v: Floats) -> int:
    """Returns how an impact ends, 0 if it sticks, else the sign of the slip; 0 without friction.

    What does not approach the wall counts as if it did, as fast as it leaves it.
    """
    friction = float(law.friction[contact])
    if not friction:
        return 0
    mobility, rate, slip = _measure(world, contact, q, v)
    speed = max(abs(rate), np.finfo(float).tiny)
    return int(calc_impulse(mobility, -speed, slip, law.restitution[contact], friction).mode)


def find_other_mode(world: World, law: RigidLaw, touch: Touch, q: Floats, v: Floats) -> int | None:
    """Returns which mode a touch is at the edge to, if at any, given the state before it."""
    contact, mode = touch.contact, touch.mode
    friction = float(law.friction[contact])
    if not friction:
        return None
    mobility, rate, slip = _measure(world, contact, q, v)
    e = float(law.restitution[contact])
    if mode != Mode.STICK:
        along = -mode * friction
        p = -(1 + e) * rate / (mobility.a + along * mobility.b)
        after = slip + (mobility.b + along * mobility.c) * p
        return int(Mode.STICK) if mode * after <= _EDGE * abs(rate) else None
    a, b, c = mobility
    room = a * c - b**2
    if room <= _STIFF * a * c:
        return -1 if slip < 0 else 1
    normal = ((1 + e) * -rate * c + b * slip) / room
    tangent = (b * (1 + e) * rate - a * slip) / room
    is_at_edge = abs(tangent) >= (1 - _EDGE) * friction * normal
    return -int(np.sign(tangent)) if is_at_edge else None


def _measure(world: World, contact: int, q: Floats, v: Floats) -> tuple[Mobility, float, float]:
    """Returns what impulses change, φ̇ and s."""
    J = world.calc_contact_jacobian(q)[contact]
    T = world.rubbing.calc_tangent_jacobian(q)[contact]
    return Mobility.of(J, T, world.calc_mass_matrix(q)), float(J @ v), float(T @ v)


def list_mode_changes(law: RigidLaw, touches: TouchSequence) -> Iterator[TouchSequence]:
    """Yields sequences in which one touch with friction is in another mode."""
    for place, touch in enumerate(touches):
        for mode in (-1, 0, 1) if law.friction[touch.contact] else ():
            if mode != touch.mode:
                changed = replace(touch, mode=mode)
                yield in_order((*touches[:place], changed, *touches[place + 1 :]))
