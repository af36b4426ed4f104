"""What is known of a task in closed form: a bound on flights, and whether contacts make a plan."""

from __future__ import annotations

import numpy as np

from drake_aigto.dynamics import ConstantDynamics
from drake_aigto.world import Scenario, World


def least_flight_cost(dynamics: ConstantDynamics, scenario: Scenario) -> float:
    """Returns what a motion that touches nothing costs at least.

    Without walls, and with a control that is free at any time, which is affine in t then:

        d = goal − q₀ − T v₀ − ½ T² a₀,   G = M⁻¹ B,   J ≥ dᵀ (I/w_f + T³/(3 w_u) G Gᵀ)⁻¹ d
    """
    w_u, w_f, T = scenario.control_weight, scenario.goal_weight, scenario.duration
    if w_f == 0:
        return 0.0
    way = scenario.goal_position - scenario.initial_position
    way = way - T * scenario.initial_velocity - T**2 / 2 * dynamics.drift
    compliance = np.eye(way.size) / w_f + T**3 / (3 * w_u) * dynamics.gain @ dynamics.gain.T
    return float(way @ np.linalg.solve(compliance, way))


def unfolds(dynamics: ConstantDynamics, world: World, scenario: Scenario) -> bool:
    """Returns whether plans of the same contacts, in the same order, are expected to be one plan.

    Mirrored at each wall that it bounces off, and with nothing but controls that bends it, a motion
    is a free flight to the goal's image, and the cost of that is convex, if in the image
    accelerations cost what they do here. A block can be passed on two sides, and under gravity a
    ball bounces high and late or low and early; and of two masses the lighter one is cheaper.
    """
    return bool(
        world.num_solids == world.num_contacts
        and np.all(world.restitutions(scenario) > 0)
        and not np.any(dynamics.drift)
        and _mirrors_keep_costs(dynamics)
    )


def _mirrors_keep_costs(dynamics: ConstantDynamics) -> bool:
    """Returns whether G Gᵀ, of G = M⁻¹ B, is its own image in each wall's mirror.

    The mirror changes velocities as an elastic impact does.
    """
    worth = dynamics.gain @ dynamics.gain.T
    for J, kick in zip(dynamics.jacobian, dynamics.kicks, strict=True):
        mirror = np.eye(J.size) - 2 * np.outer(kick, J) / (J @ kick)
        if not np.allclose(mirror @ worth @ mirror.T, worth, atol=1e-9 * np.max(worth)):
            return False
    return True
