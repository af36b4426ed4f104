"""What decides a control while a simulation runs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats


class Held(NamedTuple):
    """A control that is held for a while."""

    control: Floats  # u, shape (nu,) [N]
    until: float  # when the controller is asked again, at the latest [s]


class Controller(ABC):
    """A digital controller: it samples the state and holds its control until the next sample.

    Attributes:
        start: of its time [s].
        end: of its time [s].
        longest_hold: the longest that a control is held [s].
        feels_contact: whether it is asked again as soon as a contact has ended, and not while one
            goes on.
    """

    start: float
    end: float
    longest_hold: float
    feels_contact: bool

    @abstractmethod
    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        """Returns the control from now on, in [start, end) [s].

        Args:
            time: now [s].
            x: (q, v), shape (nq + nv,).
            bounces: the contact of each bounce so far.
        """


class HeldControl(Controller):
    """A control that was decided before: open loop.

    Attributes:
        times: of the knots, shape (N+1,) [s].
        controls: that are held between them, shape (N, nu) [N].
    """

    feels_contact = False

    def __init__(self, times: Floats, controls: Floats) -> None:
        """Keeps controls (N, nu) [N] that are held between knots (N+1,) [s]."""
        self.times, self.controls = times, controls
        self.start, self.end = float(times[0]), float(times[-1])
        self.longest_hold = float(np.max(np.diff(times)))

    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        """Returns the control of this interval."""
        k = int(np.searchsorted(self.times, time, side="right"))
        return Held(self.controls[k - 1], float(self.times[k]))
