"""What is thought of a plant: where it goes under a command."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import CompliantLaw, contact_law
from drake_aigto.errors import FrictionError, TrajectoryError
from drake_aigto.simulation import EVENT_DRIVEN, Compliant, Controller, HeldControl, find_springs
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
        """Returns q and v after a controller, as `predict` does; None: nobody knows.

        Nothing is recorded on the way, but between rigid walls where one may be touched, from one
        change of a control to the next.
        """
        if not (self._has_impacts and isinstance(held, HeldControl)):
            return self._lead(x, held)
        end: Floats | None = x
        for k, control in enumerate(held.controls):
            if end is None:
                break
            end = self._lead(end, HeldControl(held.times[k : k + 2], control[np.newaxis]))
        return end

    def _lead(self, x: Floats, held: Controller) -> Floats | None:
        if self._dynamics is not None:
            try:
                end = self._dynamics.lead(x, held, flies=self._has_impacts)
            except TrajectoryError:
                return None
            if end is not None:
                return end
        found = self.predict(x, held)
        return found and found[0]

    @cached_property
    def _dynamics(self) -> Compliant | None:
        """Dynamics of a motion without impacts, in flight if there are some; None: a parabola."""
        springs = find_springs(self.world, contact_law(self.world, self.scenario))
        if springs is None and not self.world.has_constant_dynamics:
            springs = CompliantLaw(*np.zeros((2, self.world.num_contacts)))
        return None if springs is None else Compliant(self.world, springs)

    @cached_property
    def _has_impacts(self) -> bool:
        return self.scenario.contact == "rigid" and bool(self.world.contacts)
