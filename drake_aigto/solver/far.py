"""Where variables have no bounds: points beyond the first box, decade by decade."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_aigto.aigo import Box
from drake_aigto.arrays import Bools, Floats
from drake_aigto.solver.ranges import LARGEST
from drake_aigto.solver.tighten import Bounds


@dataclass(frozen=True, eq=False)
class Outside:
    """What is left outside of a box by bounds (lower, upper), some of which are infinite.

    Its decade d is where the largest |z_i − c_i| / w_i of the variables without two bounds is
    between 10^(d − 1) and 10^d.

    Attributes:
        box: of half widths w around c.
        lower: shape (n,); 1e15 in size is no bound either, for ranges end there.
        upper: shape (n,).
        is_bounded: whether bounds of the program's own variables leave nothing outside, whatever
            the ranges of functions of them that have variables too.
    """

    box: Box
    lower: Floats
    upper: Floats
    is_bounded: bool = False

    @classmethod
    def of(cls, box: Box, bounds: Bounds, count: int, is_bounded: bool) -> Outside:
        """Returns what is outside in the first variables of a box, so many."""
        lower, upper = (side[:count] for side in bounds)
        return cls(Box(box.center[:count], box.half_width[:count]), lower, upper, is_bounded)

    @property
    def is_open(self) -> Bools:
        """Which variables have no two bounds, shape (n,)."""
        is_open = ((self.lower <= -LARGEST) | (self.upper >= LARGEST)) & self.box.free
        return is_open & (not self.is_bounded)

    def decade(self, z: Floats) -> float:
        """Returns the decade of a point (n,), as a real number: 0 or less in the box."""
        is_open = self.is_open
        distance = np.abs(z - self.box.center)[is_open] / self.box.half_width[is_open]
        return float(np.log10(max(1e-3, np.max(distance, initial=0.0))))

    def within(self, decade: int) -> Bounds:
        """Returns lower and upper bounds (n,) of what is in a decade or below."""
        reach = np.where(self.is_open, 10.0**decade, 1.0) * self.box.half_width
        low, high = self.box.center - reach, self.box.center + reach
        return np.maximum(low, self.lower), np.minimum(high, self.upper)

    def point(
        self, farthest: int, exponent: float, base: Floats | None, rng: np.random.Generator
    ) -> Floats:
        """Returns a point (n,).

        Args:
            farthest: the variable, without two bounds, that is farthest out.
            exponent: so many decades, 0 or more.
            base: what the others are, shape (n,); None draws them: in the box, or, every second one
                without two bounds, in any decade below.
            rng: what is drawn comes from it.
        """
        n = self.lower.size
        reach = rng.uniform(-1.0, 1.0, n)
        is_far = self.is_open & (rng.random(n) < 0.5)
        reach[is_far] = np.sign(reach[is_far]) * 10.0 ** (exponent * rng.random(n)[is_far])
        reach[farthest] = rng.choice([-1.0, 1.0]) * 10.0**exponent
        shift = reach * self.box.half_width
        ahead, back = self.box.center + shift, self.box.center - shift
        # The other way where a bound is in the way.
        z = np.where((ahead < self.lower) | (ahead > self.upper), back, ahead)
        if base is not None and np.all(np.isfinite(base)):
            z = np.where(np.arange(n) == farthest, z, base)
        return np.clip(z, self.lower, self.upper)
