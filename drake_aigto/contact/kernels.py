"""Laws of compliant contact and smooth friction in compiled code, with derivatives."""

from __future__ import annotations

import numpy as np

from drake_aigto.contact.laws import NO_ROOM
from drake_aigto.dynamics import smooth_sign
from drake_aigto.kernels import inner

_bend = inner(smooth_sign)


@inner
def find_share(y: float) -> float:
    """Returns σ of a speed y in parts of the stiction speed (`calc_friction_share`)."""
    return _bend(min(max(y, -1.0), 1.0))


@inner
def calc_share(y: float) -> tuple[float, float]:
    """Returns σ and dσ/dy of a speed y in parts of the stiction speed."""
    size = abs(y)
    if not size < 1.0:
        return np.sign(y), 0.0
    share = y * y * y * (10.0 - 15.0 * size + 6.0 * y * y)
    return share, 30.0 * y * y * (1.0 - size) ** 2


@inner
def find_gap(reach: float, distance: float) -> tuple[float, float]:
    """Returns the distance of surfaces [m] and ∂l/∂φ at a distance φ (`CompliantLaw.find_gaps`)."""
    if reach == 0.0:
        return distance, 1.0
    apart = np.sqrt(max(reach**2 + 2.0 * reach * distance, NO_ROOM))
    return apart - reach, reach / apart
