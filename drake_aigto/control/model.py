"""What is thought of a plant: where it goes under a command."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import contact_law
from drake_aigto.errors import FrictionError, TrajectoryError
from drake_aigto.simulation import (
    EVENT_DRIVEN,
    Compliant,
    CompliantMotion,
    Controller,
    find_springs,
)
from drake_aigto.world import Scenario, World


@dataclass(frozen=True, eq=False)
class Model:
    """A world and its scenario, which one thread at a time simulates."""

    world: World
    scenario: Scenario

    def predict(self, x: Floats, held: Controller) -> tuple[Floats, list[int]] | None:
        """Returns q and v after a controller, and the contacts that bounce; None: nobody knows."""
        state = self.world.split(x)
        try:
            found = EVENT_DRIVEN.simulate(self.world, self.scenario, held, state=state)
        except (TrajectoryError, FrictionError):
            return None
        return np.concatenate([found.positions[-1], found.velocities[-1]]), found.bounces

    def find_end(self, x: Floats, held: Controller) -> Floats | None:
        """Returns q and v after a controller, the same as `predict` does; None: nobody knows.

        Where there are no impacts nothing is recorded on the way.
        """
        if self._dynamics is None:
            found = self.predict(x, held)
            return found and found[0]
        motion = CompliantMotion(self._dynamics, self.world.split(x), held.start)
        try:
            return motion.lead(held)
        except TrajectoryError:
            return None

    @cached_property
    def _dynamics(self) -> Compliant | None:
        """Dynamics of a motion without impacts; None: it has some, or is a parabola."""
        springs = find_springs(self.world, contact_law(self.world, self.scenario))
        return None if springs is None else Compliant(self.world, springs)
