"""When to give up: steps that change nothing but rounding."""

from __future__ import annotations

import math
from dataclasses import dataclass

_PATIENCE = 5  # idle steps in a row
_LOWER = 0.9  # of a violation or an error: lower by more than rounding


@dataclass
class Progress:
    """Counts idle steps.

    A step is idle where φ changes by no more than its rounding and is no lower than ever since such
    steps began, and neither the violation nor the optimality error falls. For bounds on rounding
    are generous, and near a degenerate solution the gradient tells the way for long after φ no
    longer does.
    """

    _idle_steps: int = 0
    _least_barrier: float = math.inf
    _least_error: float = math.inf

    @property
    def has_ended(self) -> bool:
        """Whether several steps in a row were idle."""
        return self._idle_steps >= _PATIENCE

    def restart(self) -> None:
        """Forgets all steps."""
        self._idle_steps, self._least_barrier, self._least_error = 0, math.inf, math.inf

    def add(
        self,
        violations: tuple[float, float],
        barriers: tuple[float, float],
        rounding: float,
        error: float,
    ) -> None:
        """Counts a step.

        Args:
            violations: θ before and after.
            barriers: φ before and after.
            rounding: How far φ may be off.
            error: Optimality error before.
        """
        if abs(barriers[1] - barriers[0]) > rounding or violations[1] < _LOWER * violations[0]:
            self.restart()
            return
        has_fallen = barriers[1] < self._least_barrier or error < _LOWER * self._least_error
        self._idle_steps = 0 if has_fallen else self._idle_steps + 1
        self._least_barrier = min(self._least_barrier, barriers[1])
        self._least_error = min(self._least_error, error)
