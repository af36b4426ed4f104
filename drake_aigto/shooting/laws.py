"""Feedback laws about one motion, of which the best from a state is found by where each leads."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import AnyMechanism
from drake_aigto.shooting.descent import descend
from drake_aigto.shooting.problem import ShootingProblem
from drake_aigto.shooting.solve import ShootingOptions, Smoothing
from drake_aigto.shooting.tables import Pass, make_memory


class FeedbackLaws:
    """Laws u = u_k + K_k (x − x_k) about a motion, cut to the bounds of the control.

    Each is right near the motion, and only as far as contacts stay as they are there. Farther off,
    the problem itself tells which one is best: that of the least cost to go, if it is followed to
    the end (parallel rollout, Chang, Givan & Chong 2004). Chosen anew at each sample, they cost no
    more than the best of them, if the problem is right and the sample's knot is now.
    """

    def __init__(
        self,
        problem: ShootingProblem,
        states: Floats,
        controls: Floats,
        gains: Sequence[Floats],
        substeps: int,
        order: int,
    ) -> None:
        """Takes the laws of a problem without phases.

        Args:
            problem: its times, cost and bounds.
            states: x_k, shape (N + 1, nq + n).
            controls: u_k, shape (N, nu).
            gains: K_k of each law, shape (N, nu, 2n).
            substeps: see `ShootingProblem.simulate`.
            order: see `ShootingOptions`.
        """
        options = ShootingOptions((Smoothing(0.0, 1, 1.0),), substeps, order)
        self._problem, self._program = problem, problem.make_program(options)
        self._motion, self._gains = (np.array(states), np.array(controls)), gains
        self._steps = substeps, order
        self._follow = Pass(first=0)
        self._memories = [make_memory(self._program) for _ in gains]
        for memory, each in zip(self._memories, gains, strict=True):
            memory.sweep.gains[...] = each

    def judged_by(self, mechanism: AnyMechanism) -> FeedbackLaws:
        """Returns the same laws, where another mechanism tells which one is best."""
        problem = dataclasses.replace(self._problem, mechanism=mechanism)
        return FeedbackLaws(problem, *self._motion, self._gains, *self._steps)

    def find_best(self, k: int, x: Floats) -> int:
        """Returns which law costs least from a state (nq + n,) at a knot; the first of equals."""
        best, least = 0, np.inf
        for i, memory in enumerate(self._memories):
            memory.states[k] = x
            follow = self._follow._replace(most=least, first=k)
            cost = descend(self._program, *self._motion, False, follow, memory).cost
            if cost < least:
                best, least = i, cost
        return best
