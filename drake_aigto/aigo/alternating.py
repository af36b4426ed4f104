"""The algorithm of [5]: a line search in the center, then a few BFGS steps in the widths."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy  # Not scipy.optimize, which takes a tenth of a second and few need.

from drake_aigto.aigo.algorithm import Box, Iterate
from drake_aigto.aigo.size_penalty import LEAST_LOG_WIDTH, SizePenalty
from drake_aigto.arrays import Floats
from drake_aigto.box import BoxPolynomial

_ARMIJO, _HALVINGS = 1e-4, 40


@dataclass(frozen=True, kw_only=True)
class Alternating(SizePenalty):
    """AIGO as it was first published ([5]: Labbe & Del Prete 2025, L4DC, PMLR 283:711-722).

        while s > s_thr
            c ← line search along −∂f̄/∂c
            w ← w − β |Δc|
            s ← min(S(w), s/γ)
            w ← `width_steps` BFGS steps in w alone on   I_p(c, w, s, ζ)

    It differs from the print as `FullGradient` does, for the same reason: S(w) = ∏ 2w_i underflows
    in hundreds of dimensions. Sizes are logarithms, I_p = f̄ + ζ (log S(w) − log s)², γ acts per
    dimension, the loop ends at a part `final_width` of the first geometric-mean half width ([5]:
    s_thr = 0.5ⁿ), and BFGS is SciPy's L-BFGS-B over log w. The line search tries the step by which
    the fastest center moves half its half width, and halves it until f̄ descends (Armijo).

    Boxes never leave the first one.

    Attributes:
        beta: β in [0, 1); [5] uses 0.5 to 0.99.
        gamma: γ > 1, per dimension; [5] uses 1.001 to 1.05, for s itself.
        zeta: ζ > 0, in units of the cost.
        width_steps: the most BFGS steps in w.
        final_width: converged at this part of the first geometric-mean half width.
        least_shrink: the part of a half width that w − β|Δc| leaves at least, in (0, 1).
        max_steps: the most outer steps.
    """

    beta: float = 0.5
    gamma: float = 1.02
    zeta: float = 1.0
    width_steps: int = 2
    final_width: float = 1e-3
    least_shrink: float = 1e-2
    max_steps: int = 5000

    _counts: ClassVar[tuple[str, ...]] = ("width_steps", "max_steps")

    def init(self, f: BoxPolynomial, box: Box) -> Iterate:
        """Returns the first box; the memory is log s, log s_thr and the first box."""
        mean = f.mean(box.center, box.half_width)
        return Iterate(box, mean, np.inf, memory=(*self._sizes(box), box))

    def step(self, f: BoxPolynomial, iterate: Iterate) -> Iterate:
        """Runs the loop's body once."""
        log_s, log_s_thr, first = iterate.memory
        free = first.free
        center = self._search_line(f, iterate.box, first)
        shift = center - iterate.box.center
        box = Box(center, self._shrink(iterate.box.half_width, shift))
        log_s = self._next_size(box, log_s)
        box, inner_steps = self._fit_widths(f, box, first, log_s)
        mean, gradient_c, gradient_z = f.gradient(box.center, box.half_width)
        return Iterate(
            box,
            mean,
            temperature=float(np.sum(gradient_z)) / max(1, int(np.count_nonzero(free))),
            inner_steps=inner_steps + 1,
            residual=float(np.linalg.norm(gradient_c[free])),
            memory=(log_s, log_s_thr, first),
        )

    def terminate(self, f: BoxPolynomial, iterate: Iterate) -> bool:
        """Returns whether s ≤ s_thr."""
        log_s, log_s_thr, _ = iterate.memory
        return log_s <= log_s_thr

    def _search_line(self, f: BoxPolynomial, box: Box, first: Box) -> Floats:
        """Returns the next center, no box being moved out of the first one."""
        mean, gradient, _ = f.gradient(box.center, box.half_width)
        gradient[~first.free] = 0.0
        fastest = float(
            np.max(np.abs(gradient[first.free] / box.half_width[first.free]), initial=0.0)
        )
        if not (fastest > 0 and np.isfinite(fastest)):
            return box.center
        room = first.half_width - box.half_width
        length = 0.5 / fastest
        for _ in range(_HALVINGS):
            tried = np.clip(
                box.center - length * gradient, first.center - room, first.center + room
            )
            decrease = float(gradient @ (tried - box.center))
            if f.mean(tried, box.half_width) <= mean + _ARMIJO * decrease:
                return tried
            length /= 2
        return box.center

    def _fit_widths(self, f: BoxPolynomial, box: Box, first: Box, log_s: float) -> tuple[Box, int]:
        """Returns the box after BFGS in log w on the penalized mean, and the number of steps."""
        free = np.flatnonzero(first.free)
        center, half_width = box.center, box.half_width.copy()
        room = first.half_width[free] - np.abs(center[free] - first.center[free])
        start = np.log(half_width[free])

        def penalized(z: Floats) -> tuple[float, Floats]:
            half_width[free] = np.exp(z)
            mean, _, gradient_z = f.gradient(center, half_width)
            penalty, slope = self._penalty(z, log_s)
            return mean + penalty, gradient_z[free] + slope

        upper = np.maximum(start, np.log(np.maximum(room, np.exp(LEAST_LOG_WIDTH))))
        found = scipy.optimize.minimize(
            penalized,
            start,
            jac=True,
            method="L-BFGS-B",
            bounds=scipy.optimize.Bounds(np.full(free.size, LEAST_LOG_WIDTH), upper),
            options={"maxiter": self.width_steps},
        )
        half_width[free] = np.exp(found.x)
        return Box(center, half_width), int(found.nit)
