"""Contact sequences: which contacts there are, and when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drake_aigto.contact import calc_time_to_wall
from drake_aigto.world import Scenario, World

# What is touched within this part of the duration without control is touched whatever the control:
# to brake before would take the inverse of that in force.
AT_ONCE = 1e-6


@dataclass(frozen=True)
class Touch:
    """One contact of a sequence.

    Attributes:
        start: when the wall is touched [s]; 0 for a contact that lasts and is there from the start.
        end: when it is left [s]; equal to `start` for a bounce, later for a contact that lasts.
        contact: which of the world's contacts.
        mode: how the impact ends where the contact rubs, and how it goes on as it lasts: 0 if it
            sticks, else the sign of the slip. A contact that lasts on in another mode is another
            touch, which starts when the one before ends.
    """

    start: float
    end: float
    contact: int = 0
    mode: int = 0

    @classmethod
    def bounce(cls, time: float, contact: int = 0) -> Touch:
        """Returns a touch that takes no time."""
        return cls(float(time), float(time), contact)

    @property
    def lasts(self) -> bool:
        """Whether it is more than a bounce."""
        return self.end > self.start

    @property
    def joints(self) -> tuple[float, ...]:
        """When phases meet here: once for a bounce, twice for a contact that lasts [s]."""
        return (self.start, self.end) if self.lasts else (self.start,)


# In the order of their starts; () is a free flight. Touches of different contacts may overlap, and
# start together.
TouchSequence = tuple[Touch, ...]


def joint_times(sequence: Sequence[Touch]) -> tuple[float, ...]:
    """Returns when a sequence's phases meet, each time once, in order [s]."""
    return tuple(sorted({time for touch in sequence for time in touch.joints}))


def touches_at_once(world: World, scenario: Scenario) -> TouchSequence:
    """Returns the bounces right after the start, which no control of any reasonable size prevents.

    A solid is entered as the last of its faces is passed.
    """
    q, v = scenario.initial_position, scenario.initial_velocity
    J, u = world.calc_contact_jacobian(q), np.zeros(world.num_actuators)
    curves = zip(
        world.calc_signed_distance(q).tolist(),
        (J @ v).tolist(),
        (J @ world.calc_acceleration(q, v, u)).tolist(),
        strict=True,
    )
    times = [calc_time_to_wall(*curve) if curve[0] > 0 else 0.0 for curve in curves]
    entries = ((max(times[i] for i in faces), faces) for faces in world.solids)
    return tuple(
        Touch.bounce(time, max(faces, key=lambda i: times[i]))
        for time, faces in sorted(entries)
        if time < AT_ONCE * scenario.duration
    )
