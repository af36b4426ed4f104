"""From names of joints and bodies in a scenario to the numbers of a plant."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint

from drake_aigto.arrays import Floats
from drake_aigto.errors import ScenarioError
from drake_aigto.world.files import suggest
from drake_aigto.world.frames import reach_frames
from drake_aigto.world.model_fields import Named
from drake_aigto.world.places import Pose, PoseWeight, Shift
from drake_aigto.world.scenario import Scenario

_LOG = logging.getLogger(__name__)

# A quaternion that is longer or shorter than 1 by more than this is no rounding of files.
_UNIT = 1e-3
_FLOATING = "quaternion_floating"


def place_scenario(plant: MultibodyPlant, scenario: Scenario) -> Scenario:
    """Returns a scenario with all positions and weights as arrays, quaternions of unit length.

    Goals of joints that are not named are where these start; or of those that nothing weighs, where
    frames are at their goals. Goals `by` a shift are so far from the start.

    Raises:
        ScenarioError: a name is no joint or floating body of the model, or has another size.
    """
    changed: dict[str, Any] = {}
    start = _place(plant, "initial_position", scenario.initial_position)
    if start.size != plant.num_positions():  # `check_sizes` says so.
        start = plant.GetDefaultPositions()
    for name in _WEIGHTS:
        if isinstance(value := getattr(scenario, name), Named):
            changed[name] = _weigh(plant, name, value)
    goal = start
    if scenario.frame_goals and isinstance(scenario.goal_position, Mapping):
        weights = np.asarray(changed.get("goal_weight", scenario.goal_weight))
        is_free = ~np.any(np.atleast_2d(weights), axis=0) * np.ones(plant.num_velocities())
        for joint in (_find(plant, "goal_position", key) for key in scenario.goal_position):
            is_free[joint.velocity_start() :][: joint.num_velocities()] = 0.0
        goal = reach_frames(plant, scenario.frame_goals, start, is_free)
    for name, defaults in (("initial_position", ()), ("goal_position", (goal, start))):
        value = getattr(scenario, name)
        found = _place(plant, name, value, *defaults)
        if found is not value:
            changed[name] = found
    return dataclasses.replace(scenario, **changed) if changed else scenario


_WEIGHTS = ("goal_weight", "goal_velocity_weight", "position_weight", "velocity_weight")


def _place(
    plant: MultibodyPlant,
    name: str,
    value: Any,
    default: Floats | None = None,
    start: Floats | None = None,
) -> Floats:
    """Returns positions, the same object if nothing changes."""
    found = plant.GetDefaultPositions() if default is None else np.array(default)
    if isinstance(value, Named):
        for key, place in value.items():
            joint = _find(plant, name, key)
            if isinstance(place, Shift):
                place = _shift(f"{name}[{key}]", joint, place, start)
            is_pose = isinstance(place, Pose)
            numbers = np.array([*place.quaternion, *place.xyz] if is_pose else place)
            if is_pose and joint.type_name() != _FLOATING:
                got = f"a pose of {key!r}, which {joint.type_name()} joint {joint.name()!r} holds"
                raise ScenarioError(name, got, f"{joint.num_positions()} numbers of the joint")
            _fill(f"{name}[{key}]", found, joint.position_start(), joint.num_positions(), numbers)
    elif value.size == plant.num_positions():
        found = value
    else:  # `check_sizes` says what is wrong.
        return np.asarray(value)
    return _normalize(plant, name, found)


def _shift(name: str, joint: Joint, shift: Shift, start: Floats | None) -> Floats:
    """Returns positions of a joint that are so far from the start; a body keeps its attitude."""
    if start is None:
        remedy = "Only goals are relative to the start."
        raise ScenarioError(name, f"by {list(shift.by)}", "its positions at the start", remedy)
    found = np.array(start[joint.position_start() :][: joint.num_positions()])
    moved = found[4:] if joint.type_name() == _FLOATING else found
    by = np.empty_like(moved)
    _fill(name, by, 0, by.size, np.array(shift.by))
    moved += by
    return found


def _fill(name: str, into: Floats, first: int, size: int, numbers: Floats) -> None:
    if numbers.size != size:
        got = f"{numbers.size} number{'s' if numbers.size > 1 else ''}"
        raise ScenarioError(name, got=got, expected=f"{size}, as the joint has")
    into[first : first + size] = numbers


def _normalize(plant: MultibodyPlant, name: str, q: Floats) -> Floats:
    """Returns positions with quaternions of unit length; reports those that are far from it."""
    found = q
    for joint in _list_joints(plant):
        if joint.type_name() != _FLOATING:
            continue
        part = slice(joint.position_start(), joint.position_start() + 4)
        length = float(np.linalg.norm(q[part]))
        if not length > _UNIT:
            raise ScenarioError(
                name,
                got=f"the quaternion {q[part].tolist()} of {joint.name()!r}",
                expected="one of unit length",
                remedy="1, 0, 0, 0 turns by nothing.",
            )
        if abs(length - 1) > _UNIT:
            text = "%s: the quaternion of %r has the length %.6g; it is made a unit quaternion"
            _LOG.warning(text, name, joint.name(), length)
        if length != 1.0:
            found = np.array(found)
            found[part] /= length
    return found


def _weigh(plant: MultibodyPlant, name: str, value: Named[Any]) -> Floats:
    """Returns weights of all velocities' coordinates, 0 where none is given."""
    found = np.zeros(plant.num_velocities())
    for key, weight in value.items():
        joint = _find(plant, name, key)
        size = joint.num_velocities()
        if isinstance(weight, PoseWeight):
            if joint.type_name() != _FLOATING:
                got = f"a pose's weights of {key!r}, which {joint.type_name()} joint holds"
                raise ScenarioError(name, got, f"1 or {size} numbers")
            numbers = np.array([*weight.turn, *weight.xyz])
        else:
            numbers = np.array(weight)
            numbers = np.full(size, numbers[0]) if numbers.size == 1 else numbers
        _fill(f"{name}[{key}]", found, joint.velocity_start(), size, numbers)
    return found


def _list_joints(plant: MultibodyPlant) -> list[Joint]:
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    return [joint for joint in joints if joint.num_positions()]


def _find(plant: MultibodyPlant, name: str, key: str) -> Joint:
    """Returns a joint by its name, or by that of the body that it lets float."""
    joints = {joint.name(): joint for joint in _list_joints(plant)}
    floating = {j.child_body().name(): j for j in joints.values() if j.type_name() == _FLOATING}
    known = {**joints, **floating}
    if key not in known:
        raise ScenarioError(
            f"{name}[{key}]",
            got="no joint that moves, and no floating body, of this name",
            expected=f"one of {', '.join(sorted(known))}",
            hint=suggest(key, sorted(known)),
        )
    return known[key]
