"""What Algorithm 1 and the one before it share: a penalty on the size of boxes, which shrinks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from drake_aigto.aigo.algorithm import Box, as_positive
from drake_aigto.arrays import Floats
from drake_aigto.errors import OptionsError

LEAST_LOG_WIDTH = float(np.log(np.finfo(float).tiny) / 4)  # w² must not underflow.


@dataclass(frozen=True, kw_only=True)
class SizePenalty:
    """I_p = f̄ + ζ (log S(w) − log s)², whose size s shrinks.

    Attributes:
        beta: β in [0, 1), in w ← w − β|Δc|.
        gamma: γ > 1 in s ← min(S(w), s/γ), per dimension.
        zeta: ζ > 0, in units of the cost.
        final_width: converged at this part of the first geometric-mean half width.
        least_shrink: the part of a half width that w − β|Δc| leaves at least, in (0, 1).
        max_steps: the most outer steps.
    """

    beta: float
    gamma: float
    zeta: float
    final_width: float
    least_shrink: float
    max_steps: int

    _counts: ClassVar[tuple[str, ...]] = ("max_steps",)

    def __post_init__(self) -> None:
        """Checks the ranges."""
        if not 0 <= self.beta < 1:
            raise OptionsError("beta", got=f"{self.beta:g}", expected="a number in [0, 1)")
        if not self.gamma > 1:
            raise OptionsError("gamma", got=f"{self.gamma:g}", expected="a number above 1")
        as_positive("zeta", self.zeta)
        as_positive("final_width", self.final_width, below=1.0)
        as_positive("least_shrink", self.least_shrink, below=1.0)
        for name in self._counts:
            if getattr(self, name) < 1:
                raise OptionsError(name, got=getattr(self, name), expected="1 or more")

    def _sizes(self, box: Box) -> tuple[float, float]:
        """Returns log s = log S(w), and log s_thr."""
        log_s = box.log_size
        return log_s, log_s + np.count_nonzero(box.free) * np.log(self.final_width)

    def _shrink(self, half_width: Floats, shift: Floats) -> Floats:
        """Returns w − β|Δc|, but at least the least part of w."""
        shrunk: Floats = half_width - self.beta * np.abs(shift)
        return np.maximum(shrunk, self.least_shrink * half_width)

    def _next_size(self, box: Box, log_s: float) -> float:
        """Returns log min(S(w), s/γⁿ)."""
        return float(min(box.log_size, log_s - np.count_nonzero(box.free) * np.log(self.gamma)))

    def _penalty(self, z: Floats, log_s: float) -> tuple[float, float]:
        """Returns ζ (Σ log 2 e^z_i − log s)², and its derivative by any z_i."""
        excess = float(z.size * np.log(2) + np.sum(z) - log_s)
        return self.zeta * excess**2, 2 * self.zeta * excess
