"""Where bodies were: dots on the way, one every moment, in Meshcat."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.show.motion import Motion

SECONDS = 0.05  # from dot to dot
# Impacts that follow sooner than this end no leg: a rest begins with ever smaller ones [s].
_SHORTEST_LEG = 0.03


def find_dots(motion: Motion) -> Floats:
    """Returns q every so many seconds and at the end, shape (d, nq) [m]."""
    begin, end = motion.times[0], motion.times[-1]
    return _positions_at(motion, np.append(np.arange(begin, end, SECONDS), end))


def find_legs(motion: Motion) -> list[Floats]:
    """Returns the same from impact to impact, both ends included, each of shape (k, nq) [m]."""
    begin, end = float(motion.times[0]), float(motion.times[-1])
    breaks = [begin]
    for touch in motion.impacts:
        if min(touch.start - breaks[-1], end - touch.start) > _SHORTEST_LEG:
            breaks.append(touch.start)
    dots = np.arange(begin, end, SECONDS)
    return [
        _positions_at(motion, np.array([a, *dots[(dots > a) & (dots < b)], b]))
        for a, b in zip(breaks, [*breaks[1:], end], strict=True)
    ]


def _positions_at(motion: Motion, times: Floats) -> Floats:
    return np.column_stack([np.interp(times, motion.times, q) for q in motion.positions.T])
