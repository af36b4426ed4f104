"""The program that users add to where motions are integrated: knots, and no rows of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.symbolic import Expression

from drake_aigto.arrays import Bools, Floats
from drake_aigto.transcription.open_program import OpenProgram

_START = "initial state"


class MotionProgram(OpenProgram):
    """Costs and constraints of users on the knots of a motion that shooting integrates.

    Its variables are q_k, v_k and u_k at the scenario's time steps, k = 0 … N; only x_0 is given.
    """

    @property
    def _always_met(self) -> tuple[str, ...]:
        return (_START,)

    @property
    def _duration(self) -> Expression:
        return Expression(self._dt)

    def _is_bounded(self) -> Bools:
        return np.zeros(self.world.num_contacts, dtype=bool)

    def _add_scenario(self) -> None:
        start = np.concatenate([self.scenario.initial_position, self.scenario.initial_velocity])
        self._bound(self.state(0), start, start, _START)

    def _stage(self, k: int) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        pairs = [(self.state(), self.state(k))]
        return [*pairs, (self.input(), self.input(k))] if k < len(self._u) else pairs

    def defects(self, x: Floats) -> dict[str, float]:
        """Returns {}: a program without rows has none."""
        return {}

    def impulses(self, x: Floats) -> Floats:
        """Returns zeros, shape (N+1, m) [N s]: the program knows no contact."""
        return np.zeros((len(self._q), self.world.num_contacts))
