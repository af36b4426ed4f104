"""Proofs that no motion meets a hard goal: how far bounded controls bring a mass at all.

Along an axis that walls push along on their own, accelerations are within [a, b], whatever the
control. Without a wall, x(T) is between x + vT + aT²/2 and x + vT + bT²/2. At y above one wall that
the mass always falls towards, P = −a ≥ p = −b > 0, it touches by (v + √(v² + 2py))/p. The touch is
no faster than s, s² = v² + 2Py, or s² = 2P (y + v²/2p) if the mass rises at first; so it comes no
higher than e²s²/2p after it. If e²P ≤ p, the next touch is no faster than s either, and so on.
"""

from __future__ import annotations

import math

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.errors import ModelError
from drake_aigto.world import ConstantDynamics, Scenario, World

# Reaches are rounded by less than this part of the way that a mass goes.
_ROUNDING = 1e-9

Interval = tuple[float, float]


def out_of_reach(world: World, scenario: Scenario) -> str:
    """Returns why no motion meets the hard goal of a scenario; empty if that is not proven.

    Args:
        world: the scenario's.
        scenario: the question.
    """
    if not scenario.hard_goal or scenario.contact != "rigid" or world.is_hinge.any():
        return ""
    try:
        world.check_frictionless(scenario)
        dynamics = world.constant_dynamics
    except ModelError:
        return ""
    low, high = _accelerations(world, scenario, dynamics)
    for axis in range(world.num_positions):
        walls = np.flatnonzero(dynamics.kicks[:, axis])
        start = float(scenario.initial_position[axis]), float(scenario.initial_velocity[axis])
        goal, forces = float(scenario.goal_position[axis]), (float(low[axis]), float(high[axis]))
        reach, after = _free_reach(start, forces, scenario), ""
        if walls.size == 1:
            found = _reach_above(int(walls[0]), axis, world, scenario, forces)
            reach, after = found if found is not None else ((-math.inf, math.inf), "")
        elif walls.size:
            continue
        if not reach[0] <= goal <= reach[1]:
            unit = world.position_unit
            return (
                f"coordinate {axis} has to come to {goal:g} {unit}, and {after}no control brings it"
                f" anywhere but from {_shown(reach[0])} to {_shown(reach[1])} {unit}"
            )
    return ""


def _shown(place: float) -> str:
    return f"{round(place, 6) + 0.0:.4g}"


def _accelerations(
    world: World, scenario: Scenario, dynamics: ConstantDynamics
) -> tuple[Floats, Floats]:
    """Returns the least and the largest acceleration of each coordinate without contact (nv,)."""
    gain, control = dynamics.gain, world.limits.narrowed(scenario).control
    with np.errstate(invalid="ignore"):
        ends = np.where(gain == 0.0, 0.0, gain * control[:, None, :])
    low, high = np.min(ends, axis=0).sum(axis=1), np.max(ends, axis=0).sum(axis=1)
    if scenario.control_norm is not None:
        most = scenario.control_norm * np.linalg.norm(gain, axis=1)
        low, high = np.maximum(low, -most), np.minimum(high, most)
    return dynamics.drift + low, dynamics.drift + high


def _free_reach(start: Interval, forces: Interval, scenario: Scenario) -> Interval:
    """Returns where a coordinate may be in the end, if nothing is touched along it."""
    x, v = start
    first, last = scenario.duration_range or (scenario.duration, scenario.duration)
    ends = []
    for force, pick in zip(forces, (min, max), strict=True):
        turn = min(max(-v / force, first), last) if force else first
        ends.append(pick(x + v * T + 0.5 * force * T**2 for T in (first, turn, last)))
    slack = _ROUNDING * (abs(x) + abs(v) * last + max(map(abs, ends)))
    return ends[0] - slack, ends[1] + slack


def _reach_above(
    wall: int, axis: int, world: World, scenario: Scenario, forces: Interval
) -> tuple[Interval, str] | None:
    """Returns where a coordinate may be in the end above a wall that it falls towards, and why.

    None if walls of several faces, or several coordinates, or forces away from it are in play.
    """
    dynamics = world.constant_dynamics
    slope = float(dynamics.jacobian[wall, axis])
    if np.count_nonzero(dynamics.jacobian[wall]) != 1 or (wall,) not in dynamics.solids:
        return None
    y = float(slope * scenario.initial_position[axis] + dynamics.offset[wall])
    v = float(slope * scenario.initial_velocity[axis])
    least, most = sorted(-slope * force for force in forces)
    e = float(world.restitutions(scenario)[wall])
    if least <= 0.0 or not math.isfinite(most) or e**2 * most > least:
        return None
    square = 2.0 * most * (y + v**2 / (2.0 * least)) if v > 0.0 else v**2 + 2.0 * most * y
    highest = e**2 * square / (2.0 * least)
    touch = (v + math.sqrt(v**2 + 2.0 * least * y)) / least
    first = scenario.duration if scenario.duration_range is None else scenario.duration_range[0]
    after = f"after the touch that comes by {touch:.4g} s, "
    if first <= touch * (1.0 + _ROUNDING):
        free = _free_reach((y, v), (-most, -least), scenario)
        highest, after = max(highest, free[1]), ""
    highest += _ROUNDING * (abs(y) + highest)
    offset = float(dynamics.offset[wall])
    ends = sorted(((-_ROUNDING * (abs(y) + highest) - offset) / slope, (highest - offset) / slope))
    return (ends[0], ends[1]), after
