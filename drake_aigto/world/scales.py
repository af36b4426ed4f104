"""The units that a task has of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.world.scenario import Scenario
from drake_aigto.world.task_cost import TaskCost
from drake_aigto.world.world import World

# When a reference is looked at, over the duration.
_LOOKS = 21


@dataclass(frozen=True)
class Scales:
    """Units in which tolerances are given, so that a verdict is the same at every size.

    Angles count as lengths, at 1 m from the hinge.

    Attributes:
        length: L, the longest of the ways to the goal and, from both ends, to the walls; 1 m if
            there is no way to go [m].
        time: T, the duration [s].
        cost: w_f L², what it costs to end L off the goal, and of a task with other terms, what it
            costs to stay at the start. If that is nothing, w_u T (m L/T²)², with m the `inertia`.
    """

    length: float
    time: float
    cost: float

    @classmethod
    def of(cls, world: World, scenario: Scenario) -> Scales:
        """Returns the scales of a scenario in its world."""
        length, T = _calc_length(world, scenario), scenario.duration
        push = calc_inertia(world, scenario.initial_position) * length / T**2
        effort = float(np.max(scenario.control_weight)) * T * push**2
        if scenario.is_plain:
            return cls(length, T, scenario.goal_weight * length**2 or effort)
        return cls(length, T, _calc_cost_of_staying(world, scenario) or effort)

    @property
    def velocity(self) -> float:
        """L/T [m/s]."""
        return self.length / self.time


def calc_inertia(world: World, q: Floats) -> float:
    """Returns the largest entry of B⁺ M(q): control per acceleration [kg]."""
    return float(np.abs(world.inverse_actuation @ world.calc_mass_matrix(q)).max())


def _calc_cost_of_staying(world: World, scenario: Scenario) -> float:
    cost, T = TaskCost.of(world, scenario), scenario.duration
    state = scenario.initial_position, scenario.initial_velocity
    times, no_control = np.linspace(0.0, T, _LOOKS), np.zeros(world.num_actuators)
    return float(T * np.mean(cost.running(times, *state, no_control)) + cost.final(*state))


def _calc_length(world: World, scenario: Scenario) -> float:
    q0, goal = scenario.initial_position, scenario.goal_position
    # A slider askew to the wall has to go farther than φ; of a hinge no such factor is the same
    # all the way.
    jacobian = world.calc_contact_jacobian(q0)
    steepness = 1.0 if world.is_hinge.any() else np.linalg.norm(jacobian, axis=1)
    ways = world.calc_signed_distance(np.array([q0, goal])) / steepness
    return float(max(np.max(np.abs(goal - q0)), np.max(ways, initial=0.0))) or 1.0
