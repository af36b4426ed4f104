"""Boxes of one shape: only the center is optimized, and all half widths shrink together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_aigto.aigo import Box, CenterObjective, Iterate
from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import OptionsError, check_counts, check_positive


@dataclass(frozen=True, kw_only=True)
class EqualWidths:
    """Shrinks a box of fixed shape: what AIGTO Sec. II-B has for one dimension, in n.

        s ← first_share
        while s ≥ final_share
            c ← minimize over c   f̄(c, s w⁰)
            s ← s · shrink

    with w⁰ the first box's half widths, so that in its units all are equal. Sec. II-B says why w
    should be optimized too; this is what to compare that with. At `first_share` = `final_share` =
    0 it minimizes f itself, once: no boxes at all.

    Attributes:
        first_share: s at first, in [0, ∞).
        final_share: the last s is the last one that is not below, in [0, first_share].
        shrink: factor on s after each outer step, in (0, 1).
        tolerance: of the inner minimization, √(gᵀ diag(H)⁻¹ g).
        max_newton_steps: the most Newton steps for one s.
    """

    first_share: float = 1.0
    final_share: float = 1e-4
    shrink: float = 0.7
    tolerance: float = 1e-6
    max_newton_steps: int = 60

    def __post_init__(self) -> None:
        """Checks the ranges."""
        if not 0 <= self.final_share <= self.first_share < np.inf:
            raise OptionsError(
                "final_share",
                got=f"{self.final_share:g} with a first_share of {self.first_share:g}",
                expected="0 ≤ final_share ≤ first_share",
            )
        if (self.final_share == 0) != (self.first_share == 0):
            raise OptionsError(
                "final_share", got="0", expected="a number above 0, unless first_share is 0 too"
            )
        check_positive(self, "shrink", below=1.0)
        check_positive(self, "tolerance")
        check_counts(self, max_newton_steps=1)

    @property
    def max_steps(self) -> int:
        """One more than there are shares, as `minimize` asks before a step whether to end."""
        return self._num_shares + 1

    @property
    def _num_shares(self) -> int:
        if self.first_share == 0:
            return 1
        return int(np.log(self.final_share / self.first_share) / np.log(self.shrink) + 1e-9) + 1

    def init(self, f: BoxPolynomial, box: Box) -> Iterate:
        """Returns the first box; the memory is it, how many steps were taken, and the damping."""
        half_width = self.first_share * box.half_width
        mean = f.mean(box.center, half_width)
        return Iterate(Box(box.center, half_width), mean, np.inf, memory=(box, 0, 0.0))

    def step(self, f: BoxPolynomial, iterate: Iterate) -> Iterate:
        """Minimizes over the center at one share."""
        first, steps, damping = iterate.memory
        half_width = self.first_share * self.shrink**steps * first.half_width
        objective = CenterObjective(f, first.free, self.tolerance, half_width=half_width)
        found = objective.descend(iterate.box.center, self.max_newton_steps, damping)
        box, memory = Box(found.x, half_width), (first, steps + 1, found.damping)
        return Iterate(box, found.value, np.inf, found.steps, found.residual, memory)

    def terminate(self, f: BoxPolynomial, iterate: Iterate) -> bool:
        """Returns whether all shares have been taken."""
        _, steps, _ = iterate.memory
        return steps >= self._num_shares
