"""Boxes that follow gradients of their mean.

Face flow: of the two faces of a box in each coordinate, the worse one moves in. The paper's
Algorithm 1, and the one before it: a penalty on the size of boxes, which shrinks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy  # Not scipy.optimize, which takes a tenth of a second and few need.

from drake_aigto.aigo.algorithm import Box, Iterate
from drake_aigto.aigo.coupling import CouplingGraph
from drake_aigto.arrays import Floats, Ints
from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import OptionsError, check_counts, check_positive
from drake_aigto.kernels import kernel

_LEAST_LOG_WIDTH = float(np.log(np.finfo(float).tiny) / 4)  # w² must not underflow.
_ARMIJO, _HALVINGS = 1e-4, 40


@dataclass(frozen=True, kw_only=True)
class FaceFlow:
    """Moves the worse of two opposite faces inwards, in every coordinate at once.

    With F_i(x_i) the mean of f over the other coordinates' boxes, the *face means* of coordinate i
    are F_i(c_i ± w_i), and

        D_i = F_i(c_i − w_i) − F_i(c_i + w_i) = −2 w_i ∂f̄/∂c_i
        c_i ← c_i + α_i D_i,      w_i ← w_i − max(α_i |D_i|, ε_w w_i)

    so that boxes lose their worse parts. With this rule [5] (Labbe & Del Prete 2025, L4DC) proves
    AIGO global for one variable; there, it differs by its time step, and
    by ε_w > 0, which lets boxes end whose faces balance. The rule in many variables is ours.

    The time step is α_i = share · min_j w_j/|D_j| over the coordinates j that share it: those that
    are coupled, by way of others that are not held, or i alone. Boxes never leave the first one.

    Attributes:
        share: the part of its half width that the fastest coordinate moves in one step, in (0, 1).
        least_shrink: ε_w in (0, 1), the part of its half width that every coordinate loses at
            least.
        is_coupled: whether coupled coordinates share a time step. If not, every box loses the same
            part of its width in a step, which is faster.
        final_width: converged once every half width is at most this part of its first.
        max_steps: the most outer steps; in each, the largest w_i (of its first) halves.
    """

    share: float = 0.02
    least_shrink: float = 1e-3
    is_coupled: bool = True
    final_width: float = 1e-3
    max_steps: int = 100

    def __post_init__(self) -> None:
        """Checks the ranges."""
        check_positive(self, "share", "least_shrink", "final_width", below=1.0)
        check_counts(self, max_steps=1)

    def init(self, f: BoxPolynomial, box: Box) -> Iterate:
        """Returns the first box; the memory is that box, and each coordinate's group.

        A group moves by one time step; −1 is the group of those that are held.
        """
        groups = np.where(box.free, np.arange(f.num_variables), -1)
        if self.is_coupled:
            groups = CouplingGraph.of(f).components(box.free)
        return Iterate(box, f.mean(box.center, box.half_width), np.inf, memory=(box, groups))

    def step(self, f: BoxPolynomial, iterate: Iterate) -> Iterate:
        """Flows until the largest half width, relative to its first, has halved."""
        first, groups = iterate.memory
        center, half_width = iterate.box.center.copy(), iterate.box.half_width.copy()
        target = 0.5 * _largest_part(half_width, first.half_width)
        part, inner_steps = np.inf, 0
        means = f.gradient(center, half_width)
        while part > target and np.isfinite(means[0]):
            part = _flow(
                *(self.share, self.least_shrink, groups, means[1]),
                *(first.center, first.half_width, center, half_width),
            )
            means = f.gradient(center, half_width)
            inner_steps += 1
        return Iterate.of_gradient(Box(center, half_width), means, inner_steps, iterate.memory)

    def terminate(self, f: BoxPolynomial, iterate: Iterate) -> bool:
        """Returns whether all widths have shrunk to the final part of their first."""
        first, _ = iterate.memory
        return _largest_part(iterate.box.half_width, first.half_width) <= self.final_width


def _largest_part(half_width: Floats, first: Floats) -> float:
    """Returns max w_i/w_i⁰ over the coordinates that are not held."""
    return float(np.max(half_width[first > 0] / first[first > 0], initial=0.0))


@kernel
def _flow(
    share: float,
    least_shrink: float,
    groups: Ints,
    gradient: Floats,
    first_center: Floats,
    first_half_width: Floats,
    center: Floats,
    half_width: Floats,
) -> float:
    """Moves c and w by one step, in place; |D|/w is 2 |∂f̄/∂c|. Returns `_largest_part`."""
    fastest = np.zeros(groups.size)
    for i, group in enumerate(groups):
        if group >= 0:
            fastest[group] = max(fastest[group], abs(gradient[i]))
    largest = 0.0
    for i, group in enumerate(groups):
        if group < 0:
            continue
        c, w, g = center[i], half_width[i], gradient[i]
        move = share * w * (abs(g) / fastest[group]) if g != 0.0 else 0.0
        c -= math.copysign(move, g)
        w -= max(move, least_shrink * w)
        low = max(c - w, first_center[i] - first_half_width[i])
        high = min(c + w, first_center[i] + first_half_width[i])
        center[i], width = (low + high) / 2, (high - low) / 2
        # What rounding keeps as wide as it is would never end: it is held.
        half_width[i] = width if width < half_width[i] else 0.0
        largest = max(largest, half_width[i] / first_half_width[i])
    return largest


@dataclass(frozen=True, kw_only=True)
class _SizePenalty:
    """I_p = f̄ + ζ (log S(w) − log s)², whose size s shrinks; the memory is log s, log s_thr, A₀.

    Attributes:
        beta: β in [0, 1) of w ← w − β|Δc|; [5] uses 0.5 to 0.99.
        gamma: γ > 1, per dimension; [5] uses 1.001 to 1.05, for s itself.
        zeta: ζ > 0, in units of the cost.
        inner_steps: the most steps in which I_p is minimized.
        final_width: converged at this part of the first geometric-mean half width.
        least_shrink: the part of a half width that w − β|Δc| leaves at least, in (0, 1).
        max_steps: the most outer steps.
    """

    beta: float = 0.5
    gamma: float
    zeta: float
    inner_steps: int
    final_width: float
    least_shrink: float = 1e-2
    max_steps: int

    def __post_init__(self) -> None:
        """Checks the ranges."""
        if not 0 <= self.beta < 1:
            raise OptionsError("beta", got=f"{self.beta:g}", expected="a number in [0, 1)")
        if not self.gamma > 1:
            raise OptionsError("gamma", got=f"{self.gamma:g}", expected="a number above 1")
        check_positive(self, "zeta")
        check_positive(self, "final_width", "least_shrink", below=1.0)
        check_counts(self, inner_steps=1, max_steps=1)

    def init(self, f: BoxPolynomial, box: Box) -> Iterate:
        """Returns the first box, of the first size."""
        log_s = box.log_size
        log_s_thr = log_s + np.count_nonzero(box.free) * np.log(self.final_width)
        mean = f.mean(box.center, box.half_width)
        return Iterate(box, mean, np.inf, memory=(log_s, log_s_thr, box))

    def terminate(self, f: BoxPolynomial, iterate: Iterate) -> bool:
        """Returns whether s ≤ s_thr."""
        log_s, log_s_thr, _ = iterate.memory
        return bool(log_s <= log_s_thr)

    def _shrink(self, box: Box, center: Floats, half_width: Floats) -> Box:
        """Returns the box at another center, w ← w − β|Δc|, but at least the least part of w."""
        shrunk = half_width - self.beta * np.abs(center - box.center)
        return Box(center, np.maximum(shrunk, self.least_shrink * half_width))

    def _next_size(self, box: Box, log_s: float) -> float:
        """Returns log min(S(w), s/γⁿ)."""
        return float(min(box.log_size, log_s - np.count_nonzero(box.free) * np.log(self.gamma)))

    def _minimize(
        self, f: BoxPolynomial, box: Box, log_s: float, upper: Floats | None = None
    ) -> tuple[Box, int]:
        """Returns the end of L-BFGS-B on I_p, and its steps: over log w ≤ upper, or (c, log w)."""
        free = np.flatnonzero(box.free)
        first = free.size if upper is None else 0  # of the widths among the unknowns
        center, half_width = box.center.copy(), box.half_width.copy()

        def penalized(y: Floats) -> tuple[float, Floats]:
            center[free[:first]], half_width[free] = y[:first], np.exp(y[first:])
            mean, by_center, by_log_width = f.gradient(center, half_width)
            excess = float(free.size * np.log(2) + np.sum(y[first:]) - log_s)
            slopes = by_log_width[free] + 2 * self.zeta * excess
            slopes = np.concatenate([by_center[free[:first]], slopes])
            return mean + self.zeta * excess**2, slopes

        start = np.concatenate([center[free[:first]], np.log(half_width[free])])
        lower = np.repeat([-np.inf, _LEAST_LOG_WIDTH], [first, free.size])
        bounds = scipy.optimize.Bounds(lower, np.inf if upper is None else upper)
        options = {"maxiter": self.inner_steps, "maxcor": 20 if upper is None else 10}
        found = scipy.optimize.minimize(
            penalized, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options
        )
        center[free[:first]], half_width[free] = found.x[:first], np.exp(found.x[first:])
        return Box(center, half_width), int(found.nit)


@dataclass(frozen=True, kw_only=True)
class FullGradient(_SizePenalty):
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
    `least_shrink` of each half width. Line 4 is `inner_steps` steps of SciPy's L-BFGS-B over
    (c, log w).
    """

    gamma: float = 1.1
    zeta: float = 1e-2
    inner_steps: int = 20
    final_width: float = 1e-6
    max_steps: int = 2000

    def step(self, f: BoxPolynomial, iterate: Iterate) -> Iterate:
        """Does lines 4 to 6."""
        log_s, log_s_thr, first = iterate.memory
        box, steps = self._minimize(f, iterate.box, log_s)
        box = self._shrink(iterate.box, box.center, box.half_width)
        means = f.gradient(box.center, box.half_width)
        memory = self._next_size(box, log_s), log_s_thr, first
        return Iterate.of_gradient(box, means, steps, memory)


@dataclass(frozen=True, kw_only=True)
class Alternating(_SizePenalty):
    """AIGO as it was first published ([5]: Labbe & Del Prete 2025, L4DC, PMLR 283:711-722).

        while s > s_thr
            c ← line search along −∂f̄/∂c
            w ← w − β |Δc|
            s ← min(S(w), s/γ)
            w ← `inner_steps` BFGS steps in w alone on   I_p(c, w, s, ζ)

    It differs from the print as `FullGradient` does, for the same reason ([5]: s_thr = 0.5ⁿ); BFGS
    is SciPy's L-BFGS-B over log w. The line search tries the step by which the fastest center moves
    half its half width, and halves it until f̄ descends (Armijo).

    Boxes never leave the first one.
    """

    gamma: float = 1.02
    zeta: float = 1.0
    inner_steps: int = 2
    final_width: float = 1e-3
    max_steps: int = 5000

    def step(self, f: BoxPolynomial, iterate: Iterate) -> Iterate:
        """Runs the loop's body once."""
        log_s, log_s_thr, first = iterate.memory
        center = self._search_line(f, iterate.box, first)
        box = self._shrink(iterate.box, center, iterate.box.half_width)
        log_s = self._next_size(box, log_s)
        room = (first.half_width - np.abs(center - first.center))[box.free]
        widest = np.log(np.maximum(room, np.exp(_LEAST_LOG_WIDTH)))
        upper = np.maximum(np.log(box.half_width[box.free]), widest)
        box, steps = self._minimize(f, box, log_s, upper)
        means = f.gradient(box.center, box.half_width)
        return Iterate.of_gradient(box, means, steps + 1, (log_s, log_s_thr, first))

    def _search_line(self, f: BoxPolynomial, box: Box, first: Box) -> Floats:
        """Returns the next center, no box being moved out of the first one."""
        mean, gradient, _ = f.gradient(box.center, box.half_width)
        gradient[~box.free] = 0.0
        speeds = np.abs(gradient[box.free] / box.half_width[box.free])
        fastest = float(np.max(speeds, initial=0.0))
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
