"""Dry friction as Drake has it: of joints and contacts that creep where they stick."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlantConfig

from drake_aigto.arrays import Floats

# Drake's default stiction tolerance. A plant's can be set, but not read.
STICTION_SPEED: float = MultibodyPlantConfig().stiction_tolerance  # [m/s, rad/s]


def calc_friction_share(speeds: Floats, stiction_speed: float) -> Floats:
    """Returns σ(s / v_s), the part of the largest friction that acts at a sliding speed s.

        σ(x) = x³ (10 − 15 |x| + 6 x²)    for |x| ≤ 1,    sign(x)    elsewhere

    That is the regularization of Drake's point contact, whose first two derivatives are continuous.
    Sticking contacts creep, slower than v_s.

    Args:
        speeds: s [m/s, rad/s].
        stiction_speed: v_s > 0 [m/s, rad/s].
    """
    x = np.clip(speeds / stiction_speed, -1.0, 1.0)
    return np.asarray(smooth_sign(x), dtype=np.float64)


def smooth_sign(x: Any) -> Any:
    """Returns σ(x) of a number, an array, or an expression, |x| ≤ 1; Numba compiles it, too."""
    return x**3 * (10.0 - 15.0 * abs(x) + 6.0 * x**2)
