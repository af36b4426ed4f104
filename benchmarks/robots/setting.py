"""A shipped scenario as the judge takes it: its fields, and its model by hand."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from benchmarks.robots.mechanics import MECHANISMS, Mechanism
from drake_aigto.world import Scenario

_STIFFNESS = 200.0  # of soft walls [N/m]


class Weights(NamedTuple):
    """What a motion costs, by coordinate (n,) and by control."""

    position: np.ndarray
    velocity: np.ndarray
    control: np.ndarray
    final_position: np.ndarray
    final_velocity: np.ndarray
    goal: np.ndarray
    goal_velocity: np.ndarray
    is_chordal: np.ndarray


class Setting(NamedTuple):
    """A question as the judge takes it."""

    mechanism: Mechanism
    start: np.ndarray  # q and v (2n,)
    duration: float
    weights: Weights
    stiffness: float  # of walls [N/m]; 0: rigid
    restitution: float
    ranges: np.ndarray  # of q and v (2, 2n)
    units: np.ndarray  # half of the ranges, 1 where there is none (2n,)
    norm: float  # of the control, at most
    is_hard: bool  # whether q has to be the goal at the end


def model_of(scenario: Scenario) -> str:
    """Returns the name of a scenario's model, without folder and ending."""
    return scenario.model.rpartition("/")[2].removesuffix(".sdf")


def setting_of(scenario: Scenario) -> Setting:
    """Returns what the judge takes, of a scenario whose model is one of `MECHANISMS`."""
    mechanism = MECHANISMS[model_of(scenario)]
    n, nu = mechanism.coordinates, mechanism.controls

    def spread(value: Any, size: int, default: float = 0.0) -> np.ndarray:
        values = np.asarray(default if value is None else value, dtype=float)
        return np.array(np.broadcast_to(values, size))

    low, high = np.full(2 * n, -np.inf), np.full(2 * n, np.inf)
    low[: len(mechanism.least)], high[: len(mechanism.most)] = mechanism.least, mechanism.most
    low[n:] = spread(scenario.velocity_lower, n, -np.inf)
    high[n:] = spread(scenario.velocity_upper, n, np.inf)
    weights = Weights(
        position=spread(scenario.position_weight, n),
        velocity=spread(scenario.velocity_weight, n),
        control=spread(scenario.control_weight, nu),
        final_position=spread(scenario.goal_weight, n),
        final_velocity=spread(scenario.goal_velocity_weight, n),
        goal=spread(scenario.goal_position, n),
        goal_velocity=spread(scenario.goal_velocity, n),
        is_chordal=(scenario.angles == "chordal") & np.isin(np.arange(n), mechanism.hinges),
    )
    return Setting(
        mechanism,
        np.concatenate([scenario.initial_position, scenario.initial_velocity]),
        scenario.duration,
        weights,
        _STIFFNESS if scenario.contact == "compliant" else 0.0,
        scenario.restitution,
        np.array([low, high]),
        np.where(np.isfinite(high - low), (high - low) / 2, 1.0),
        scenario.control_norm or np.inf,
        scenario.hard_goal,
    )
