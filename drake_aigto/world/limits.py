"""How far joints and actuators of a model go."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from drake_aigto.arrays import Bools, Floats, locked
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.world.scenario import Scenario

_TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class Limits:
    """Bounds that a model gives, each (2, n): lower and upper ones, infinite where there is none.

    Attributes:
        position: of q [m, rad].
        velocity: of v [m/s, rad/s].
        control: of u [N, N m].
    """

    position: Floats
    velocity: Floats
    control: Floats

    @classmethod
    def of(cls, plant: MultibodyPlant) -> Limits:
        """Returns those of a plant's joints and actuators."""
        pairs = (
            (plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()),
            (plant.GetVelocityLowerLimits(), plant.GetVelocityUpperLimits()),
            (plant.GetEffortLowerLimits(), plant.GetEffortUpperLimits()),
        )
        arrays = [np.array(pair, dtype=float) for pair in pairs]
        for array in arrays:
            array.flags.writeable = False
        return cls(*arrays)

    def narrowed(self, scenario: Scenario) -> Limits:
        """Returns these bounds and a scenario's, whichever is narrower.

        Raises:
            ScenarioError: the scenario's are of another size, or leave nothing.
        """
        names = [field.name for field in fields(self)]
        if all(getattr(scenario, bound) is None for name in names for bound in _bounds_of(name)):
            return self
        return Limits(*(_narrow(scenario, name, getattr(self, name)) for name in names))

    def check_task(self, scenario: Scenario, is_hinge: Bools) -> None:
        """Refuses a start or a goal that is out of these bounds.

        Of angles that are compared but for turns, the goal may be any turn away.

        Raises:
            ScenarioError: one is; says which.
        """
        goal = scenario.goal_position
        if scenario.angles != "exact":
            goal = np.where(is_hinge, _turn_into(goal, self.position), goal)
        self.check_within("initial_position", self.position, scenario.initial_position)
        self.check_within("initial_velocity", self.velocity, scenario.initial_velocity)
        self.check_within("goal_position", self.position, goal)
        if scenario.goal_velocity is not None:
            self.check_within("goal_velocity", self.velocity, scenario.goal_velocity)

    @staticmethod
    def check_within(name: str, bounds: Floats, value: Floats) -> None:
        """Refuses positions or velocities of this name that are out of their bounds.

        Raises:
            ScenarioError: one is; says which.
        """
        for i, (number, lower, upper) in enumerate(zip(value, *bounds, strict=True)):
            if not lower <= number <= upper:
                raise ScenarioError(
                    f"{name}[{i}]",
                    got=f"{number:g}",
                    expected=f"from {lower:g} to {upper:g}, by its joint's limits and the "
                    "scenario's bounds",
                )

    @cached_property
    def are_any(self) -> bool:
        """Whether anything is bounded."""
        return any(np.isfinite(each).any() for each in (self.position, self.velocity, self.control))

    def check_none(self, plant: MultibodyPlant) -> None:
        """Refuses a model with limits, for whoever plans without them.

        Raises:
            ModelError: there is one; names it.
        """
        # Asked at every tick of a controller, and a plant is slow to be looked through.
        for what, name, bounds in self._find(plant) if self.are_any else ():
            raise ModelError(
                what,
                got=f"{name} limits from {bounds[0]:g} to {bounds[1]:g}",
                expected="none, for balls are planned for without limits",
                remedy="Leave <limit> out of the model, and bound the program's variables instead.",
            )

    def _find(self, plant: MultibodyPlant) -> Iterator[tuple[str, str, Floats]]:
        """Yields whose limits are finite, what they limit, and both."""
        for index in plant.GetJointActuatorIndices():
            actuator = plant.get_joint_actuator(index)
            joint = f"actuator {actuator.name()!r} of joint {actuator.joint().name()!r}"
            bounds = self.control[:, actuator.input_start()]
            if np.any(np.isfinite(bounds)):
                yield joint, "effort", bounds
        for index in plant.GetJointIndices():
            joint = plant.get_joint(index)
            for name, array, start, size in (
                ("position", self.position, joint.position_start(), joint.num_positions()),
                ("velocity", self.velocity, joint.velocity_start(), joint.num_velocities()),
            ):
                for bounds in array[:, start : start + size].T:
                    if np.any(np.isfinite(bounds)):
                        yield f"joint {joint.name()!r}", name, bounds


def _bounds_of(name: str) -> tuple[str, str]:
    """Returns a scenario's fields that bound positions, velocities or controls."""
    return f"{name}_lower", f"{name}_upper"


def _narrow(scenario: Scenario, name: str, limits: Floats) -> Floats:
    """Returns a model's limits (2, n) cut to a scenario's bounds."""
    bounds, narrowed = _bounds_of(name), limits.copy()
    for row, bound, narrower in zip(narrowed, bounds, (np.maximum, np.minimum), strict=True):
        given = getattr(scenario, bound)
        if given is None:
            continue
        if np.size(given) not in (1, row.size):
            raise ScenarioError(
                bound, got=f"{np.size(given)} values", expected=f"{row.size}, or one for all"
            )
        narrower(row, given, out=row)
    for i, (lower, upper) in enumerate(narrowed.T):
        if lower > upper:
            raise ScenarioError(
                f"{' and '.join(bounds)}, [{i}]",
                got=f"nothing from {lower:g} to {upper:g}",
                expected=f"bounds within the model's limits, {limits[0, i]:g} to {limits[1, i]:g}",
            )
    return locked(narrowed)


def _turn_into(angles: Floats, bounds: Floats) -> Floats:
    """Returns angles but for turns, within bounds where any turn leads there."""
    lower, upper = bounds
    up = np.ceil(np.maximum(0.0, lower - angles) / _TURN)
    down = np.ceil(np.maximum(0.0, angles - upper) / _TURN)
    return angles + _TURN * np.where(up > 0, up, -down)
