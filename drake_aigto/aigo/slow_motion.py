"""Annealing with every Newton step an iterate of its own, to be watched or stepped by hand."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from drake_aigto.aigo.algorithm import Box, Iterate
from drake_aigto.aigo.annealing import Annealing
from drake_aigto.box import BoxPolynomial


@dataclass(frozen=True)
class SlowMotion:
    """Annealing's boxes, Newton step by Newton step.

    An outer step is one Newton step, and keeps the temperature; or none, where the box is
    stationary or has had its most steps, and lowers it.

    Attributes:
        annealing: what is watched.
    """

    annealing: Annealing

    @property
    def max_steps(self) -> int:
        """As many as the annealing may take at all its temperatures."""
        return self.annealing.max_steps * (self.annealing.max_newton_steps + 1)

    def init(self, f: BoxPolynomial, box: Box) -> Iterate:
        """Returns the first box; the memory is the annealing's, and steps at the temperature."""
        return _with_memory(self.annealing.init(f, box), 0)

    def step(self, f: BoxPolynomial, iterate: Iterate) -> Iterate:
        """Takes one Newton step, or goes on to the next temperature."""
        memory, taken = iterate.memory
        if taken == self.annealing.max_newton_steps:
            cooled = iterate.temperature * self.annealing.cooling
            return dataclasses.replace(
                iterate, temperature=cooled, inner_steps=0, memory=(memory, 0)
            )
        one = dataclasses.replace(self.annealing, max_newton_steps=1)
        after = one.step(f, dataclasses.replace(iterate, memory=memory))
        if after.inner_steps == 0:
            return _with_memory(after, 0)
        after = dataclasses.replace(after, temperature=iterate.temperature)
        return _with_memory(after, taken + 1)

    def terminate(self, f: BoxPolynomial, iterate: Iterate) -> bool:
        """Returns whether the annealing has ended."""
        memory, _ = iterate.memory
        return self.annealing.terminate(f, dataclasses.replace(iterate, memory=memory))


def _with_memory(iterate: Iterate, taken: int) -> Iterate:
    return dataclasses.replace(iterate, memory=(iterate.memory, taken))
