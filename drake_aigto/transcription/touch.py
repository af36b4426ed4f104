"""Contact sequences: which contacts there are, and when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Touch:
    """One contact of a sequence.

    Attributes:
        start: when the wall is touched [s].
        end: when it is left [s]; equal to `start` for a bounce, later for a contact that lasts.
        contact: which of the world's contacts.
    """

    start: float
    end: float
    contact: int = 0

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
