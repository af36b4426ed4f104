"""Where a motion might come to rest, and jump: at each wall that something pulls it towards."""

from __future__ import annotations

import dataclasses
import math

from drake_aigto.arrays import Floats
from drake_aigto.planning.insertions import find_pulls
from drake_aigto.transcription import PhaseTranscription, TouchSequence

# Rests are tried that last at least this part of the duration, and end as long before its end.
_LEAST = 0.02


def find_rests(phases: PhaseTranscription, x: Floats) -> list[TouchSequence]:
    """Returns a sequence with each touch as a contact that lasts, and no later ones of that wall.

    Off an elastic wall no bounce ends in rest. The contact is left in time for the cheapest
    jump to the goal's distance d from the wall, against the acceleration a towards it: from rest,
    of all durations √(6 d/a) takes the least effort, 3 (d + a τ²/2)²/τ³.

    Args:
        phases: the multi-phase problem of a motion.
        x: its decision variables.
    """
    world, scenario, T = phases.world, phases.scenario, phases.scenario.duration
    pulls = find_pulls(world, scenario.goal_position)
    heights = world.calc_signed_distance(scenario.goal_position)
    sequence, found = phases.contact_sequence(x), []
    for place, touch in enumerate(sequence):
        i = touch.contact
        if pulls[i] <= 0 or phases.restitutions[i] == 1:
            continue
        left = min(T - touch.start, math.sqrt(6 * max(heights[i], 0.0) / pulls[i]))
        end = min(max(T - left, touch.start + _LEAST * T), (1 - _LEAST) * T)
        if end > touch.start:
            after = (other for other in sequence[place + 1 :] if other.contact != i)
            rest = dataclasses.replace(touch, end=end)
            found.append((*sequence[:place], rest, *after))
    return found
