"""What it costs at least to land on a floor, rest there, and jump: closed forms."""

from __future__ import annotations

import math

from phase_solutions import effort, find_least, goal_cost

from drake_aigto import Scenario


def least_rest(
    height: float,
    duration: float,
    e: float,
    mass: float,
    gravity: float,
    control_weight: float = 1e-3,
    goal_weight: float = 1.0,
) -> tuple[float, float, float]:
    """Returns the least cost of a fall from rest to a floor and a jump back up to that height.

    There has to be time for the hops in between.

    Returns:
        The cost, when it lands, and when it jumps [s].
    """
    # The weight is as much control as it takes: ∫(v̇ + g)² = ∫v̇² + 2 g Δv + g² t, from rest to rest.
    heavy = Scenario(
        initial_position=height,
        initial_velocity=0.0,
        goal_position=height,
        duration=duration,
        time_step=duration,
        control_weight=mass**2 * control_weight,
        goal_weight=goal_weight,
    )

    def jump(time: float) -> float:
        return goal_cost(heavy, height + gravity * time**2 / 2, time)

    def land(time: float) -> float:
        return heavy.control_weight * (effort(-height, 0.0, time) + gravity**2 * time)

    jump_time, jump_cost = find_least(jump, 1e-3, 0.75 * duration)
    land_time, land_cost = math.sqrt(2 * height / gravity), 0.0
    if e == 1:  # It lands without speed; else it settles by hops that cost nothing.
        land_time, land_cost = find_least(land, 1e-3, 0.75 * duration)
    return land_cost + jump_cost, land_time, duration - jump_time
