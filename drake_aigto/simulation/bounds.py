"""What a scenario and its model bound, and by how much a motion misses that."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.world import Limits, Scales, Scenario, TaskCost, World

BOUNDS, HARD_GOAL = "bounds", "hard goal"


def state_scales(world: World, scenario: Scenario) -> Floats:
    """Returns how much of q and v is much: 1 rad or a length, and that in T, shape (2n,)."""
    scales = Scales.of(world, scenario)
    q = np.where(world.is_hinge, 1.0, scales.length)
    return np.concatenate([q, q / scales.time])


def calc_excess(world: World, scenario: Scenario, positions: Floats, velocities: Floats) -> Floats:
    """Returns how far a motion is below and above its bounds of q and v at most, (2, 2n), ≥ 0."""
    bounds = world.bounds(scenario)
    lower, upper = np.hstack([bounds.position, bounds.velocity])
    x = np.hstack([positions, velocities])
    return np.maximum([np.max(lower - x, axis=0), np.max(x - upper, axis=0)], 0.0)


def narrow_bounds(bounds: Limits, states: Floats, excess: Floats) -> Limits:
    """Returns bounds of q and v that are within what states (K, 2n) have, less an excess (2, 2n).

    Where both ends are passed by more than all that is between, all there is left is a point.
    """
    lower, upper = np.hstack([bounds.position, bounds.velocity])
    lower = np.where(excess[0] > 0, np.maximum(lower, states.min(axis=0)) + excess[0], lower)
    upper = np.where(excess[1] > 0, np.minimum(upper, states.max(axis=0)) - excess[1], upper)
    ends = np.array([np.minimum(lower, upper), np.maximum(lower, upper)])
    position, velocity = np.split(ends, 2, axis=1)
    return dataclasses.replace(bounds, position=position, velocity=velocity)


def calc_violations(
    world: World, scenario: Scenario, positions: Floats, velocities: Floats
) -> dict[str, float]:
    """Returns by how much a motion misses its bounds, and its end a hard goal, by name.

    Each is the largest of all coordinates, in parts of `state_scales`; nothing of a plain task in a
    model without limits. Positions and velocities are shape (K, n), the start the first.
    """
    if scenario.is_plain and not world.limits.are_any:
        return {}
    bounds, units = world.bounds(scenario), state_scales(world, scenario)
    missed: dict[str, float] = {}
    if np.any(np.isfinite(np.hstack([bounds.position, bounds.velocity]))):
        excess = calc_excess(world, scenario, positions, velocities)
        missed[BOUNDS] = float(np.max(excess / units))
    if scenario.hard_goal:
        task = TaskCost.of(world, scenario)
        off = [task.goal_errors(positions[-1])]
        if scenario.goal_velocity is not None:
            off.append(velocities[-1] - task.goal_velocity)
        ends = np.concatenate(off)
        missed[HARD_GOAL] = float(np.max(np.abs(ends) / units[: len(ends)]))
    return missed
