"""Limits of joints, actuators and distances, and whether a scenario fits a model at all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from drake_aigto.arrays import Bools, Floats, locked, read_only
from drake_aigto.dynamics import EquationsOfMotion
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.world.fields import check_size
from drake_aigto.world.files import suggest
from drake_aigto.world.model_facts import calc_servo_forces
from drake_aigto.world.model_fields import Limited
from drake_aigto.world.pair_errors import is_of_pair, name_whole
from drake_aigto.world.scenario import Scenario

_TURN = 2.0 * np.pi
_TOUCHING = 1e-3  # Of a bound: a motion that is nearer is held back by it.
# Of a bound: what rounding leaves of a start at it.
_ROUNDING = 1e-12


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
    def of(
        cls,
        plant: MultibodyPlant,
        efforts: Mapping[str, tuple[float, float]],
        joints: Limited = "model",
        thrusters: int = 0,
    ) -> Limits:
        """Returns those of a plant's joints and actuators.

        Args:
            plant: finalized.
            efforts: least and largest u by actuator, which may be narrower than the plant's, whose
                limits are the same both ways.
            joints: "ignore": those of joints count for nothing.
            thrusters: their number, which have no limits.
        """
        position = np.array([plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()])
        velocity = np.array([plant.GetVelocityLowerLimits(), plant.GetVelocityUpperLimits()])
        if joints == "ignore":
            for each in (position, velocity):
                each[:] = [[-np.inf], [np.inf]]
        control = np.array([plant.GetEffortLowerLimits(), plant.GetEffortUpperLimits()])
        free = np.tile([[-np.inf], [np.inf]], thrusters)
        control = np.hstack([control, free])
        for name, bounds in efforts.items():
            control[:, plant.GetJointActuatorByName(name).input_start()] = bounds
        return cls(read_only(position), read_only(velocity), read_only(control))

    def narrowed(self, scenario: Scenario) -> Limits:
        """Returns these bounds and a scenario's, whichever is narrower.

        Raises:
            ScenarioError: the scenario's are of another size, or leave nothing.
        """
        mine = {field.name: getattr(self, field.name) for field in fields(self)}
        found = {name: _narrow(scenario, name, bounds) for name, bounds in mine.items()}
        return self if all(found[name] is mine[name] for name in mine) else Limits(**found)

    def control_items(self, plant: MultibodyPlant, scenario: Scenario) -> list[str]:
        """Returns what bounds the control of each actuator that is bounded, and who says so."""
        bounds = self.narrowed(scenario).control
        names, units = name_controls(plant, bounds.shape[1]), list_units(plant, bounds.shape[1])
        return [
            f"{names[i]} from {' to '.join(map(_tell_origin, bounds[:, i], self.control[:, i]))} "
            f"{units[i]}"
            for i in np.flatnonzero(np.isfinite(bounds).any(axis=0))
        ]

    def active_items(
        self, plant: MultibodyPlant, scenario: Scenario, q: Floats, v: Floats, u: Floats
    ) -> list[str]:
        """Returns the bounds that a motion touches or violates, and who says so.

        Args:
            plant: of the model.
            scenario: which may have narrower bounds.
            q: positions, shape (K, nq).
            v: velocities, shape (L, nv).
            u: controls, shape (N, nu).
        """
        found, bounds = [], self.narrowed(scenario)
        for kind, names, values in (
            ("position", plant.GetPositionNames(), q),
            ("velocity", plant.GetVelocityNames(), v),
            ("control", name_controls(plant, u.shape[1]), u),
        ):
            ends, own = getattr(bounds, kind), getattr(self, kind)
            for row, side, most in ((0, -1.0, "at least"), (1, 1.0, "at most")):
                size = np.where(np.isfinite(ends[row]), np.maximum(1.0, np.abs(ends[row])), 0.0)
                near = side * ends[row] - _TOUCHING * size
                for i in np.flatnonzero((side * values).max(axis=0) >= near):
                    origin = _tell_origin(ends[row, i], own[row, i])
                    found.append(f"{kind} of {names[i]} {most} {origin}")
        return found

    def check_task(self, scenario: Scenario, is_hinge: Bools) -> None:
        """Refuses a start or a goal that is out of these bounds.

        Of angles that are compared but for turns, the goal may be any turn away.

        Raises:
            ScenarioError: one is; says which.
        """
        goal = scenario.goal_position
        if scenario.angles != "exact":
            lower, upper = self.position
            up = np.ceil(np.maximum(0.0, lower - goal) / _TURN)
            down = np.ceil(np.maximum(0.0, goal - upper) / _TURN)
            goal = goal + _TURN * np.where(is_hinge, np.where(up > 0, up, -down), 0.0)
        asked = {
            "initial_position": (scenario.initial_position, self.position),
            "initial_velocity": (scenario.initial_velocity, self.velocity),
            "goal_position": (goal, self.position),
        }
        if scenario.goal_velocity is not None:
            asked["goal_velocity"] = scenario.goal_velocity, self.velocity
        # Starts that plans choose at bounds are there to rounding.
        slack = 0.0 if scenario.periodic is None else _ROUNDING
        for name, (value, bounds) in asked.items():
            for i, (number, lower, upper) in enumerate(zip(value, *bounds, strict=True)):
                off = slack * max(1.0, abs(number))
                if not lower - off <= number <= upper + off:
                    raise ScenarioError(
                        f"{name}[{i}]",
                        got=f"{number:g}",
                        expected=f"from {lower:g} to {upper:g}, by its joint's limits and the "
                        "scenario's bounds",
                    )

    def check_servos(self, plant: MultibodyPlant, scenario: Scenario) -> None:
        """Refuses goals of joints whose servos can't hold them: a control is k times a set point.

        Raises:
            ScenarioError: k q of a goal that counts is out of the bounds of u; says which.
        """
        if not (servos := scenario.model_fields.servos):
            return
        weight = np.asarray(scenario.goal_weight)
        weight = weight.diagonal() if weight.ndim == 2 else weight
        counts = np.broadcast_to(scenario.hard_goal or weight > 0, self.velocity.shape[1])
        goal, far = scenario.goal_position, np.where(np.isfinite(self.position), self.position, 0.0)
        held, *ends = (calc_servo_forces(plant, servos, q) for q in (goal, *far))
        found, asked = list[str](), list[str]()
        for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices()):
            joint = actuator.joint()
            i, (least, most) = joint.velocity_start(), self.control[:, actuator.input_start()]
            if counts[i] and not least <= held[i] <= most:
                found.append(f"{joint.name()} at {goal[joint.position_start()]:.4g}")
                asked.append(f"{joint.name()}: {1.01 * max(abs(u[i]) for u in (held, *ends)):.3g}")
        if found:
            raise ScenarioError(
                "goal_position",
                got=f"{', '.join(found)}, out of reach of set points",
                expected="goals that servos hold by u = stiffness × set point, which limits of "
                "effort bound",
                remedy=f"Take effort_limits: {{{', '.join(asked)}}}, or softer servos.",
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
        if not self.are_any:
            return
        actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
        joints = map(plant.get_joint, plant.GetJointIndices())
        found = [
            (f"actuator {each.name()!r} of joint {each.joint().name()!r}", "effort", bounds)
            for each in actuators
            for bounds in [self.control[:, each.input_start()]]
        ]
        for joint in joints:
            q, v = joint.position_start(), joint.velocity_start()
            parts = {
                "position": self.position[:, q : q + joint.num_positions()],
                "velocity": self.velocity[:, v : v + joint.num_velocities()],
            }
            what = f"joint {joint.name()!r}"
            found += [(what, name, bounds) for name, part in parts.items() for bounds in part.T]
        what, name, (lower, upper) = next(row for row in found if np.isfinite(row[-1]).any())
        raise ModelError(
            what,
            got=f"{name} limits from {lower:g} to {upper:g}",
            expected="none, for balls are planned for without limits",
            remedy="Leave <limit> out of the model, and bound the program's variables instead.",
        )


def _tell_origin(bound: float, own: float) -> str:
    """Returns a bound, and whether it is the model's own or the scenario's."""
    return f"{bound:g} ({'model' if bound == own else 'scenario'})"


def name_controls(plant: MultibodyPlant, count: int, has_prefix: bool = True) -> list[str]:
    """Returns names of all controls: of actuators, then of thrusters."""
    names = plant.GetActuatorNames(add_model_instance_prefix=has_prefix)
    return [*names, *(f"thruster_{i + 1}" for i in range(count - len(names)))]


def list_units(plant: MultibodyPlant, count: int) -> list[str]:
    """Returns the unit of each control, (nu,)."""
    actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
    ordered = sorted(actuators, key=lambda actuator: int(actuator.input_start()))
    units = ["N" if each.joint().type_name() == "prismatic" else "N m" for each in ordered]
    return [*units, *["N"] * (count - len(units))]


def _narrow(scenario: Scenario, name: str, limits: Floats) -> Floats:
    """Returns a model's limits (2, n) cut to a scenario's bounds."""
    bounds, narrowed = (f"{name}_lower", f"{name}_upper"), limits.copy()
    if all(getattr(scenario, bound) is None for bound in bounds):
        return limits
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


def check_sizes(plant: MultibodyPlant, scenario: Scenario) -> None:
    """Refuses vectors whose length is not the plant's."""
    for name, size in (
        ("initial_position", plant.num_positions()),
        ("initial_velocity", plant.num_velocities()),
        ("goal_position", plant.num_positions()),
    ):
        check_size(name, getattr(scenario, name), size)


def find_least_distances(
    world: EquationsOfMotion, reaches: Floats, clearance: Mapping[str, float]
) -> Floats:
    """Returns the least φ of each contact, shape (m,) [m]; −∞ where shapes may touch.

    Of two spheres that move about each other φ = (l² − R²)/(2R), l the distance of their centers
    and R their reach, so that a distance d between them is φ = d + d²/(2R). The clearance d is by
    names or globs of pairs, also of shapes that touch with their ends.
    """
    names = [contact.name for contact in world.contacts]
    least, num_faces = np.full(len(names), -np.inf), world.are_of_one_solid.sum(axis=1)
    for glob, distance in clearance.items():
        chosen = [i for i, name in enumerate(names) if is_of_pair(name, glob)]
        if not chosen:
            known = list(dict.fromkeys(map(name_whole, names)))
            raise ScenarioError(
                f"clearance: {glob!r}",
                got="no pair of this name that can touch",
                expected=f"one of {', '.join(known)}" if known else "a model with contacts",
                hint=suggest(glob, known),
            )
        for i in chosen:
            if num_faces[i] > 1:
                raise ScenarioError(
                    f"clearance: {names[i]!r}",
                    got=f"a box with {num_faces[i]} faces that can be touched",
                    expected="a half space, a sphere, or a box with one such face",
                    remedy="Bound positions, or make the box larger in the model.",
                )
            phi = distance + (distance**2 / (2 * reaches[i]) if reaches[i] else 0.0)
            least[i] = max(least[i], phi)
    return least


def check_clearance(world: EquationsOfMotion, lacks: Floats) -> None:
    """Refuses a start whose contacts lack some distance to the least ones, shape (m,) [m]."""
    if np.any(lacks > 0):
        i = int(np.argmax(lacks))
        raise ScenarioError(
            "initial_position",
            got=f"{lacks[i]:.3g} m too near ({name_whole(world.contacts[i].name)})",
            expected="one that keeps the scenario's clearance",
            remedy="Start farther away, or ask for less clearance.",
        )
