"""Units of a mechanism's task: lengths, speeds and times that are its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import calc_levers
from drake_aigto.world import Scenario, World

# A mechanism's own time is that of its fastest coordinate, but at least this part of the duration.
_SHORTEST = 0.05


@dataclass(frozen=True, eq=False)
class Measures:
    """Units of a task: scaling its lengths, masses and times scales them, and nothing else.

    Attributes:
        position: 1 rad of a hinge. Of a slider, the longest of the ways of sliders and of the
            distances of contacts at the start and the goal; without any, what the start moves by
            in the duration, or the radius at which the inertia of hinges equals a slider's;
            shape (n,) [rad, m].
        velocity: that in the duration, shape (n,) [rad/s, m/s].
        length: the farthest that `position` moves a contact along its normal; without contacts the
            longest unit of sliders [m].
        period: the time in which forces without control move the fastest coordinate by its unit
            and back, at most the duration [s].
        duration: T [s].
    """

    position: Floats
    velocity: Floats
    length: float
    period: float
    duration: float

    @property
    def speed(self) -> float:
        """The length in the duration [m/s]."""
        return self.length / self.duration

    @classmethod
    def of(cls, world: World, scenario: Scenario) -> Measures:
        """Returns the units of a scenario in its world."""
        T = scenario.duration
        position = np.where(world.turns, 1.0, _measure_sliders(world, scenario))
        ends = np.array([scenario.initial_position, scenario.goal_position])
        levers = calc_levers(world.reaches, world.calc_signed_distance(ends))
        ways = np.linalg.norm(world.calc_contact_jacobian(ends) * position, axis=-1) * levers
        length = float(np.max(ways, initial=0.0)) or float(np.max(position))
        # π √(unit / acceleration) of the fastest coordinate near the ends.
        steps = np.vstack([np.zeros(len(position)), np.diag(position) / 2, -np.diag(position) / 2])
        q = world.add(ends[:, np.newaxis], steps).reshape(-1, world.num_positions)
        bias = world.calc_bias(q, np.zeros((len(q), len(position))))[..., np.newaxis]
        falls = np.abs(np.linalg.solve(world.calc_mass_matrix(q), bias))[..., 0]
        fastest = float(np.max(falls / position, initial=0.0))
        period = np.pi / np.sqrt(fastest) if fastest > 0 else T
        period = float(np.clip(period, _SHORTEST * T, T))
        return cls(position, position / T, length, period, T)


def _measure_sliders(world: World, scenario: Scenario) -> float:
    """Returns the unit of all sliders [m]."""
    q, v, is_slider = scenario.initial_position, scenario.initial_velocity, ~world.turns
    ends = np.array([q, scenario.goal_position])
    ways = np.abs(world.subtract(ends[1], ends[0]))[is_slider]
    distances = world.calc_signed_distance(ends)
    R = world.reaches
    distances = np.where(R > 0, R / calc_levers(R, distances) - R, distances)
    distances = np.abs(distances).ravel()
    if (found := np.max(np.concatenate([ways, distances]), initial=0.0)) > 0:
        return float(found)
    if (moved := np.max(np.abs(v[is_slider]), initial=0.0) * scenario.duration) > 0:
        return float(moved)
    inertias = np.diag(world.calc_mass_matrix(q))
    if is_slider.all() or not is_slider.any():
        return 1.0
    return float(np.sqrt(np.max(inertias[~is_slider]) / np.max(inertias[is_slider])))
