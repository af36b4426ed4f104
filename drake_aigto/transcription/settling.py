"""Contacts that last and begin with hops of less and less height: how long these take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.dynamics import ConstantInertia
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription.timeline import Timeline
from drake_aigto.transcription.touch import TouchSequence


@dataclass(frozen=True)
class Settling:
    """A contact of 0 < e < 1 that lasts, and may be touched at a speed.

    Hops of e, e², … that speed follow, without control, and take as long as the wall's force of a
    ball that rests, λ, takes to push by 2 e/(1 − e) m J v: the momentum p that is left of that is

        p_first = 2 e/(1 − e) m J v_first ≤ 0,    p_{k+1} = p_k + h_k λ_k,    p_last ≥ 0

    exact where λ is steady. m = (J M⁻¹ Jᵀ)⁻¹ is the mass that the contact feels.

    Attributes:
        contact: which.
        first: the knot that it is touched at.
        last: the knot that it is left at.
        mass: m [kg].
        factor: 2 e/(1 − e) m [kg].
    """

    contact: int
    first: int
    last: int
    mass: float
    factor: float

    def momenta(self, motion: Trajectory, jacobian: Floats) -> Floats:
        """Returns p at the knots first … last of a motion, shape (last − first + 1,) [N s]."""
        steps = slice(self.first, self.last)
        pushes = np.diff(motion.times)[steps] * motion.forces[steps, self.contact]
        closing = jacobian[self.contact] @ motion.velocities[self.first]
        momenta: Floats = self.factor * closing + np.append(0.0, np.cumsum(pushes))
        return momenta


def find_settlings(
    timeline: Timeline, sequence: TouchSequence, restitutions: Floats, inertia: ConstantInertia
) -> tuple[Settling, ...]:
    """Returns those of a sequence."""
    return tuple(
        Settling(i, first, last, inertia.masses[i], 2 * e / (1 - e) * inertia.masses[i])
        for touch, (first, last) in zip(sequence, timeline.spans, strict=True)
        if touch.lasts and 0 < (e := restitutions[i := touch.contact]) < 1
    )
