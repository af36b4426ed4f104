"""Contact sequences: which contacts there are, and when."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Touch:
    """One contact of a sequence.

    Attributes:
        start: when the wall is touched [s].
        end: when it is left [s]; equal to `start` for a bounce, later for a contact that lasts.
    """

    start: float
    end: float

    @classmethod
    def bounce(cls, time: float) -> Touch:
        """Returns a touch that takes no time."""
        return cls(float(time), float(time))

    @property
    def lasts(self) -> bool:
        """Whether it is more than a bounce."""
        return self.end > self.start

    @property
    def joints(self) -> tuple[float, ...]:
        """When phases meet here: once for a bounce, twice for a contact that lasts [s]."""
        return (self.start, self.end) if self.lasts else (self.start,)


# In the order of time; () is a free flight.
TouchSequence = tuple[Touch, ...]
