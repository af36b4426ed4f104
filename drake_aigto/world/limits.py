"""How far joints and actuators of a model go."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from drake_aigto.arrays import Floats
from drake_aigto.errors import ModelError, ScenarioError


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
                    expected=f"from {lower:g} to {upper:g}, the limits of its joint",
                )

    def check_none(self, plant: MultibodyPlant) -> None:
        """Refuses a model with limits, for whoever plans without them.

        Raises:
            ModelError: there is one; names it.
        """
        for what, name, bounds in self._find(plant):
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
