"""A motion over a horizon: what a controller that plans again holds on to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import TouchSequence


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion over a horizon.

    Attributes:
        trajectory: states and controls at knots, in the context's time.
        cost: J from the first knot on.
        touches: the contacts that are come into, by time, which is the context's.
    """

    trajectory: Trajectory
    cost: float
    touches: TouchSequence

    def calc_control(self, time: float) -> Floats:
        """Returns u at a time, shape (nu,); before and after the horizon its first and last."""
        times, controls = self.trajectory.times, self.trajectory.controls
        k = int(np.searchsorted(times, time, side="right")) - 1
        return np.array(controls[min(max(k, 0), len(controls) - 1)])

    def calc_state(self, time: float) -> Floats:
        """Returns q and v at a time, shape (2n,); beyond the horizon its first and last."""
        times = self.trajectory.times
        state, _ = self.trajectory.to_piecewise()
        return np.array(state.value(min(max(time, times[0]), times[-1]))[:, 0])
