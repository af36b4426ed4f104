"""The units that a task has of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.world.scenario import Scenario
from drake_aigto.world.world import World


@dataclass(frozen=True)
class Scales:
    """Units in which tolerances are given, so that a verdict is the same at every size.

    Attributes:
        length: L, the longest of the ways to the goal and, from both ends, to the walls [m].
        time: T, the duration [s].
        cost: w_f L², what it costs to end L off the goal; without a goal weight w_u T (m L/T²)²,
            with m the `inertia`.
    """

    length: float
    time: float
    cost: float

    @classmethod
    def of(cls, world: World, scenario: Scenario) -> Scales:
        """Returns the scales of a scenario in its world."""
        length, T = _calc_length(world, scenario), scenario.duration
        push = calc_inertia(world, scenario.initial_position) * length / T**2
        effort = scenario.control_weight * T * push**2
        return cls(length, T, scenario.goal_weight * length**2 or effort)

    @property
    def velocity(self) -> float:
        """L/T [m/s]."""
        return self.length / self.time


def calc_inertia(world: World, q: Floats) -> float:
    """Returns the largest entry of B⁺ M(q): control per acceleration [kg]."""
    return float(np.abs(world.inverse_actuation @ world.calc_mass_matrix(q)).max())


def _calc_length(world: World, scenario: Scenario) -> float:
    q0, goal = scenario.initial_position, scenario.goal_position
    # A joint askew to the wall has to go farther than φ.
    steepness = np.linalg.norm(world.calc_contact_jacobian(q0), axis=1)
    ways = world.calc_signed_distance(np.array([q0, goal])) / steepness
    return float(max(np.max(np.abs(goal - q0)), np.max(ways)))
