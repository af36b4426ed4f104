"""Touches with friction at an edge of their mode: beyond it the cost may fall further."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.contact import Closed, Mode, RigidLaw, find_other_mode
from drake_aigto.planning.mechanisms.modes import CREEP, in_order, split_hold
from drake_aigto.planning.mechanisms.phases import BouncingResult, find_slopes
from drake_aigto.transcription import Touch, TouchSequence
from drake_aigto.world import World

# A sticking contact is at the edge if it takes this part of the available friction.
_EDGE = 0.98


def switch_modes(world: World, law: RigidLaw, motion: BouncingResult) -> TouchSequence | None:
    """Returns a motion's touches, with bounces at an edge in the mode beyond it; None if none is.

    Beyond an edge the cost may fall further, as stick becomes slip there, or slip ends.
    """
    n, (_, before) = world.num_positions, find_slopes(world, motion)
    touches = []
    for touch, knot in motion.starts:
        other = None
        if knot is not None and not touch.lasts:
            state = motion.states[knot, :n], before[knot - 1]
            other = find_other_mode(world, law, touch.contact, touch.mode, *state)
        touches.append(touch if other is None else replace(touch, mode=other))
    return tuple(touches) if tuple(touches) != motion.touches else None


def lead_over_edges(world: World, law: RigidLaw, motion: BouncingResult) -> TouchSequence | None:
    """Returns a motion's touches, with sustained ones led over edges of modes; None if none is.

    Contacts that stick with all available friction slip, and contacts that hardly slip stick.
    """
    touches = in_order(
        [part for touch in motion.touches for part in _split(world, law, motion, touch)]
    )
    return touches if touches != motion.touches else None


def _split(world: World, law: RigidLaw, motion: BouncingResult, touch: Touch) -> Iterator[Touch]:
    """Yields the parts of a touch, each in the mode that it is at the edge to."""
    starts = motion.times[:-1]
    knots = np.flatnonzero((starts >= touch.start) & (starts < touch.end))
    if not (touch.lasts and law.friction[touch.contact] and len(knots)):
        yield touch
        return
    modes = np.full(len(knots), touch.mode, dtype=np.int64)
    if touch.mode:
        q, v = np.split(motion.states, 2, axis=1)
        slips = world.rubbing.calc_slips(q, v)[:, touch.contact]
        modes[np.abs(slips[knots]) <= CREEP * np.max(np.abs(slips))] = 0
        modes[0] = touch.mode  # It may begin at rest.
    else:
        normal, tangent = _calc_forces(world, law, motion, touch.contact, knots)
        is_at_edge = np.abs(tangent) >= _EDGE * law.friction[touch.contact] * normal
        modes[is_at_edge & (normal > 0)] = -np.sign(tangent[is_at_edge & (normal > 0)])
    yield from split_hold(touch, starts[knots], modes)


def _calc_forces(
    world: World, law: RigidLaw, motion: BouncingResult, contact: int, knots: Ints
) -> tuple[Floats, Floats]:
    """Returns f_n and f_t of a contact that is held from knots on, shape (K,) each [N]."""
    found = np.zeros((2, len(knots)))
    for row, knot in enumerate(knots.tolist()):
        phase = int(np.searchsorted(motion.knots, knot, side="right"))
        held = np.flatnonzero(motion.held[phase])
        modes = tuple(
            Mode(int(motion.modes[phase, i]) if law.friction[i] else Mode.FORWARD) for i in held
        )
        state, control = motion.states[knot], motion.controls[knot]
        push = Closed(world, held, modes, law.friction[held]).calc_push(state, control)
        found[:, row] = push.normal[held == contact][0], push.tangent[held == contact][0]
    return found[0], found[1]
