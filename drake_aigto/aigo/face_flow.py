"""Face flow: of the two faces of a box in each coordinate, the worse one moves in."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drake_aigto.aigo.algorithm import Box, Iterate
from drake_aigto.aigo.coupling import CouplingGraph
from drake_aigto.arrays import Floats, Ints
from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import check_counts, check_positive
from drake_aigto.kernels import kernel


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
        center[i], half_width[i] = (low + high) / 2, (high - low) / 2
        largest = max(largest, half_width[i] / first_half_width[i])
    return largest
