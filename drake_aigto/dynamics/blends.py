"""Numbers and sums of worlds between known ones, which nothing is read or compiled for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np


class Blend(NamedTuple):
    """Shares s_k of worlds that differ from a first one: f = f₀ + Σ s_k (f_k − f₀)."""

    first: Any
    others: tuple[Any, ...]
    shares: tuple[float, ...]

    @classmethod
    def of(cls, first: Any, shares: Sequence[tuple[Any, float]]) -> Blend:
        """Returns shares of others, each with its own."""
        return cls(first, tuple(other for other, _ in shares), tuple(each for _, each in shares))

    def mix(self, read: Callable[[Any], Any]) -> Any:
        """Returns f of an array that is read off each, of numbers or of Expressions."""
        found = mine = read(self.first)
        with np.errstate(invalid="ignore"):  # As Drake's arithmetic on Expressions looks for NaN.
            for other, share in zip(self.others, self.shares, strict=True):
                if share and (theirs := read(other)) is not mine:
                    found = found + share * (theirs - mine)
        return found

    def are_alike(self, read: Callable[[Any], tuple[Any, ...]]) -> bool:
        """Returns whether arrays that are read off each are the same of all."""
        mine = read(self.first)
        return all(all(map(np.array_equal, mine, read(other))) for other in self.others)
