"""Where a motion might bounce once more: every wall between touches that it feels."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.transcription import PhaseTranscription, Touch
from drake_aigto.world import World

# Distance of a new touch to those before and after it, as a part of the time between them.
_MARGIN = 0.2
# Of one that comes soon before the next.
_SOON = 0.05
# Less time between touches than this part of the duration has no room for another.
_LEAST_GAP = 1e-3
# Contacts are felt by each other if J M⁻¹ Jᵀ is more than this.
_FELT = 1e-9


def find_insertions(phases: PhaseTranscription, x: Floats) -> list[Touch]:
    """Returns one more bounce for each wall and each gap between the touches that it feels.

    A contact does not feel another if no impulse of it changes the other's speed, J_i M⁻¹ J_jᵀ = 0;
    their order makes no difference. A wall that was touched last, or is next, is left out, unless
    something pulls towards it. Each bounce is where the motion comes nearest to the wall, and where
    something pulls also soon before the next touch: high and late.

    Args:
        phases: the multi-phase problem of a motion.
        x: its decision variables.
    """
    world, T = phases.world, phases.scenario.duration
    times, distances = phases.sample_times(x), phases.signed_distances(x)
    felt = np.abs(world.constant_inertia.delassus) > _FELT
    pulls = find_pulls(world, phases.split(x)[0][-1])
    sequence, found = phases.contact_sequence(x), []
    for contact in range(world.num_contacts):
        touches = [t for t in sequence if felt[contact, t.contact]]
        starts, ends = [0.0, *(t.end for t in touches)], [*(t.start for t in touches), T]
        walls = [None, *(t.contact for t in touches), None]
        for gap, (start, end) in enumerate(zip(starts, ends, strict=True)):
            is_next_to_itself = contact in walls[gap : gap + 2] and pulls[contact] <= 0
            if is_next_to_itself or end - start < _LEAST_GAP * T:
                continue
            margin = _MARGIN * (end - start)
            inside = np.flatnonzero((times > start + margin) & (times < end - margin))
            nearest = inside[np.argmin(distances[inside, contact])] if inside.size else None
            time = (start + end) / 2 if nearest is None else float(times[nearest])
            found.append(Touch.bounce(time, contact))
            if pulls[contact] > 0:
                found.append(Touch.bounce(end - _SOON * (end - start), contact))
    return found


def find_pulls(world: World, q: Floats) -> Floats:
    """Returns the acceleration towards each contact at rest and without control, (m,) [m/s²]."""
    still = np.zeros(world.num_velocities), np.zeros(world.num_actuators)
    return -world.constant_inertia.jacobian @ world.calc_acceleration(q, *still)
