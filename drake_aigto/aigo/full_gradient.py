"""The paper's Algorithm 1: the full gradient over centers and half widths together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy  # Not scipy.optimize, which takes a tenth of a second and few need.

from drake_aigto.aigo.algorithm import Box, Iterate
from drake_aigto.aigo.size_penalty import LEAST_LOG_WIDTH, SizePenalty
from drake_aigto.arrays import Floats, Ints
from drake_aigto.box import BoxPolynomial


@dataclass(frozen=True, kw_only=True)
class FullGradient(SizePenalty):
    """AIGTO Algorithm 1, line by line.

        2   s ← S(w)
        3   while s > s_thr
        4       c, w ← minimize over (c, w)   I_p(c, w, s, ζ)
        5       w ← w − β |Δc|
        6       s ← min(S(w), s/γ)

    In hundreds of dimensions S(w) = ∏ 2w_i underflows, so this differs from the print as follows.
    The size is compared in logarithms, I_p = f̄ + ζ (log S(w) − log s)²: the mean instead of the
    integral, whose factor S would be 0. γ acts per dimension, s/γⁿ, and the loop ends when the
    geometric-mean half width is `final_width` of the first one's. Line 5 leaves at least
    `least_shrink` of each half width. Line 4 is SciPy's L-BFGS-B over (c, log w), cut off by its
    count.

    Attributes:
        beta: β of line 5, in [0, 1).
        gamma: γ > 1 of line 6, per dimension.
        zeta: ζ > 0, in units of the cost.
        final_width: converged at this part of the first geometric-mean half width.
        least_shrink: the part of a half width that line 5 leaves at least, in (0, 1).
        inner_steps: the most L-BFGS steps in line 4.
        max_steps: the most outer steps.
    """

    beta: float = 0.5
    gamma: float = 1.1
    zeta: float = 1e-2
    final_width: float = 1e-6
    least_shrink: float = 1e-2
    inner_steps: int = 20
    max_steps: int = 2000

    _counts: ClassVar[tuple[str, ...]] = ("inner_steps", "max_steps")

    def init(self, f: BoxPolynomial, box: Box) -> Iterate:
        """Does line 2; the memory is log s, and log s_thr."""
        mean = f.mean(box.center, box.half_width)
        return Iterate(box, mean, np.inf, memory=self._sizes(box))

    def step(self, f: BoxPolynomial, iterate: Iterate) -> Iterate:
        """Does lines 4 to 6."""
        log_s, log_s_thr = iterate.memory
        free = np.flatnonzero(iterate.box.free)
        center, half_width, inner_steps = self._minimize(f, iterate.box, free, log_s)
        half_width = self._shrink(half_width, center - iterate.box.center)
        box = Box(center, half_width)
        mean, gradient_c, gradient_z = f.gradient(center, half_width)
        log_s = self._next_size(box, log_s)
        return Iterate(
            box,
            mean,
            temperature=float(np.mean(gradient_z[free])),
            inner_steps=inner_steps,
            residual=float(np.linalg.norm(gradient_c[free])),
            memory=(log_s, log_s_thr),
        )

    def terminate(self, f: BoxPolynomial, iterate: Iterate) -> bool:
        """Does line 3."""
        log_s, log_s_thr = iterate.memory
        return log_s <= log_s_thr

    def _minimize(
        self, f: BoxPolynomial, box: Box, free: Ints, log_s: float
    ) -> tuple[Floats, Floats, int]:
        """Does line 4; returns c, w and the number of steps."""
        n = free.size
        center, half_width = box.center.copy(), box.half_width.copy()

        def penalized(y: Floats) -> tuple[float, Floats]:
            center[free], half_width[free] = y[:n], np.exp(y[n:])
            mean, gradient_c, gradient_z = f.gradient(center, half_width)
            penalty, slope = self._penalty(y[n:], log_s)
            return mean + penalty, np.concatenate([gradient_c[free], gradient_z[free] + slope])

        start = np.concatenate([center[free], np.log(half_width[free])])
        bounds = scipy.optimize.Bounds(np.repeat([-np.inf, LEAST_LOG_WIDTH], n), np.inf)
        options = {"maxiter": self.inner_steps, "maxcor": 20}
        found = scipy.optimize.minimize(
            penalized, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options
        )
        center[free], half_width[free] = found.x[:n], np.exp(found.x[n:])
        return center, half_width, int(found.nit)
