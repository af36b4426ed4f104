"""Goals of frames, such as an arm's hand; and numbers of a plant from names in a scenario."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar, cast

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, FrameIndex, JacobianWrtVariable, Joint

from drake_aigto.arrays import Floats
from drake_aigto.dynamics import FrameTable, Tree, make_tree_memory
from drake_aigto.errors import ScenarioError
from drake_aigto.world.files import refuse_name
from drake_aigto.world.limits import name_controls
from drake_aigto.world.model_facts import fits
from drake_aigto.world.model_fields import Named, Thruster
from drake_aigto.world.places import RESTS, FrameGoal, Pose, PoseParts, Shift, write_plain
from drake_aigto.world.scenario import Scenario

_Item = TypeVar("_Item")

# Steps of inverse kinematics, and their damping, as a part of the largest curvature.
_STEPS, _DAMPING = 100, 1e-4


@dataclass(frozen=True, eq=False)
class FrameGoals:
    """Frames of a plant that have goals, as costs of the end: Σ w_k (p − p*)_k² + w (2 sin(θ/2))².

    Attributes:
        tree: that they are fixed to.
        table: of them, F.
    """

    tree: Tree
    table: FrameTable

    @classmethod
    def of(
        cls, plant: MultibodyPlant, tree: Tree, goals: Mapping[str, FrameGoal]
    ) -> FrameGoals | None:
        """Returns the goals of a scenario; None: there are none.

        Raises:
            ScenarioError: there is no such frame, or nothing moves it; says which.
        """
        if not goals:
            return None
        rows = []
        for name, goal in goals.items():
            frame, X_WG = find_frame(plant, name), _as_transform(goal)
            body = int(frame.body().index())
            link = int(tree.body_links[body])
            if link < 0:
                remedy = "Give the goal of a frame of a link that joints move."
                raise ScenarioError(
                    f"frame_goals[{name}]", "a frame that stands still", remedy=remedy
                )
            X = frame.GetFixedPoseInBodyFrame()
            R = tree.body_rotations[body].reshape(3, 3)
            place = tree.body_offsets[body] + R @ X.translation()
            weights = (*goal.weight.xyz, goal.weight.turn[0])
            R = R @ X.rotation().matrix()
            rows.append((link, R, place, X_WG.rotation().matrix(), X_WG.translation(), weights))
        links, *columns = zip(*rows, strict=True)
        arrays = (np.array(column, dtype=float).reshape(len(rows), -1) for column in columns)
        return cls(tree, FrameTable(np.array(links, dtype=np.int64), *arrays))

    def errors(self, q: Floats) -> Floats:
        """Returns p − p* [m] and θ [rad] of each frame, shape (…, F, 4), at q of shape (…, nq)."""
        from drake_aigto.dynamics import measure_frames

        rows = np.array(np.reshape(q, (-1, np.shape(q)[-1])), dtype=float, order="C")
        found = measure_frames(self.tree, self.table, rows, make_tree_memory(self.tree))
        found[..., 3] = np.arccos(np.clip(found[..., 3], -1.0, 1.0))
        return found.reshape(*np.shape(q)[:-1], len(self.table.links), 4)

    def cost(self, q: Floats) -> Floats:
        """Returns what the frames cost, shape (…), at q of shape (…, nq)."""
        errors = self.errors(q)
        errors[..., 3] = 2 * np.sin(errors[..., 3] / 2)
        return np.einsum("...fk,fk", errors**2, self.table.weights)

    def asked(self, q: Floats) -> tuple[Floats, Floats]:
        """Returns errors that are weighed, of positions (…, A) [m] and of turns (…, B) [rad]."""
        errors, is_asked = self.errors(q), self.table.weights > 0
        return errors[..., :3][..., is_asked[:, :3]], errors[..., 3][..., is_asked[:, 3]]


def find_frame(plant: MultibodyPlant, name: str) -> Frame:
    """Returns a frame by its name; a link's has the link's."""
    frames = [plant.get_frame(FrameIndex(i)) for i in range(1, plant.num_frames())]
    names = sorted({each.name() for each in frames if each.name()})
    found = [each for each in frames if each.name() == name]
    if len(found) != 1:
        got = f"{len(found)} of this name" if found else "no such frame"
        raise refuse_name(f"frame_goals[{name}]", name, names, got)
    return found[0]


def reach_frames(
    plant: MultibodyPlant, goals: Mapping[str, FrameGoal], q: Floats, is_free: Floats
) -> Floats:
    """Returns positions near q at which frames are nearest to their goals, shape (nq,).

    By damped Gauss-Newton steps within joint limits, along velocities that are free, (nv,): where
    a search begins.
    """
    context, world = plant.CreateDefaultContext(), plant.world_frame()
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    frames = [(find_frame(plant, name), _as_transform(g), g.weight) for name, g in goals.items()]
    for _ in range(_STEPS):
        plant.SetPositions(context, q)
        rows, errors = [np.zeros((0, plant.num_velocities()))], [np.zeros(0)]
        for frame, X_WG, weight in frames:
            J = plant.CalcJacobianSpatialVelocity(
                context, JacobianWrtVariable.kV, frame, np.zeros(3), world, world
            )
            X = frame.CalcPoseInWorld(context)
            turn = (X.rotation() @ X_WG.rotation().inverse()).ToAngleAxis()
            off = np.concatenate([turn.angle() * turn.axis(), X.translation() - X_WG.translation()])
            scale = np.sqrt([*weight.turn, *weight.xyz])
            rows.append(scale[:, np.newaxis] * J * is_free)
            errors.append(scale * off)
        A, e = np.vstack(rows), np.concatenate(errors)
        H = A.T @ A
        step = -np.linalg.solve(H + _DAMPING * (np.trace(H) + 1e-9) * np.eye(len(H)), A.T @ e)
        step *= min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-9))
        q = np.clip(q + plant.MapVelocityToQDot(context, step), lower, upper)
    return q


def _as_transform(goal: FrameGoal) -> RigidTransform:
    quaternion = np.array(goal.pose.quaternion)
    return RigidTransform(Quaternion(quaternion / np.linalg.norm(quaternion)), goal.pose.xyz)


_LOG = logging.getLogger(__name__)

# A quaternion that is longer or shorter than 1 by more than this is no rounding of files.
_UNIT = 1e-3
_FLOATING = "quaternion_floating"


def place_scenario(plant: MultibodyPlant, scenario: Scenario) -> Scenario:
    """Returns a scenario with arrays for all that is by names, and quaternions of unit length.

    Goals of joints that are not named are where these start; or of those that nothing weighs, where
    frames are at their goals. Goals `by` a shift are so far from the start. Of a motion that
    repeats the goal is hard, as far from the start as it advances, with the velocity there.

    Raises:
        ScenarioError: a name is no joint or floating body of the model, or has another size.
    """
    changed: dict[str, Any] = {}
    start = _place(plant, "initial_position", scenario.initial_position)
    if start.size != plant.num_positions():  # `check_sizes` says so.
        start = plant.GetDefaultPositions()
    for name in RESTS:
        if isinstance(value := getattr(scenario, name), Named):
            thrusters = cast("tuple[Thruster, ...]", scenario.thrusters)
            changed[name] = fill_named(plant, name, value, len(thrusters))
    goal = start
    if scenario.periodic is not None:
        goal = start + np.nan_to_num(find_advance(plant, scenario))
        changed |= {"hard_goal": True} if not scenario.hard_goal else {}
        if scenario.goal_velocity is None:
            changed["goal_velocity"] = changed.get("initial_velocity", scenario.initial_velocity)
    if scenario.frame_goals and isinstance(scenario.goal_position, Mapping):
        weights = np.asarray(changed.get("goal_weight", scenario.goal_weight))
        is_free = ~np.any(np.atleast_2d(weights), axis=0) * np.ones(plant.num_velocities())
        for _, joint, _ in _list_named(plant, "goal_position", scenario.goal_position):
            is_free[joint.velocity_start() :][: joint.num_velocities()] = 0.0
        goal = reach_frames(plant, scenario.frame_goals, start, is_free)
    for name, defaults in (("initial_position", ()), ("goal_position", (goal, start))):
        value = getattr(scenario, name)
        found = _place(plant, name, value, *defaults)
        if found is not value:
            changed[name] = found
    return dataclasses.replace(scenario, **changed) if changed else scenario


def find_advance(plant: MultibodyPlant, scenario: Scenario) -> Floats:
    """Returns by how much a motion that repeats advances, (nq,); NaN where its start is free."""
    found = np.full(plant.num_positions(), np.nan)
    for key, joint, advance in _list_named(plant, "periodic", scenario.periodic or {}):
        first, size = joint.position_start(), joint.num_positions()
        if size != joint.num_velocities():  # A body that floats; its attitude repeats.
            first, size = first + 4, size - 4
        numbers = np.array([np.nan if each is None else each for each in advance])
        _fill(f"periodic[{key}]", found, first, size, numbers)
    return found


def _place(
    plant: MultibodyPlant,
    name: str,
    value: Any,
    default: Floats | None = None,
    start: Floats | None = None,
) -> Floats:
    """Returns positions, the same object if nothing changes."""
    if isinstance(value, Named):
        found = plant.GetDefaultPositions() if default is None else np.array(default)
        for key, joint, place in _list_named(plant, name, value):
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
    has_turns = plant.num_positions() != plant.num_velocities()
    for joint in _list_joints(plant) if has_turns else ():
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


def fill_named(plant: MultibodyPlant, name: str, value: Named[Any], thrusters: int = 0) -> Floats:
    """Returns the array of a field that is given by names, of a plant with this many thrusters.

    Positions' bounds are (nq,), controls' (nu,), all others (nv,). A turn of a floating body is
    weighed and bounded as a velocity, and not bounded as a quaternion. A single weight or bound is
    that of all of a joint's coordinates; velocities are one for each.
    """
    if name.startswith("control"):
        return _fill_controls(plant, name, value, thrusters)
    rest, is_for_all = RESTS[name], name not in ("initial_velocity", "goal_velocity")
    are_positions = name in ("position_lower", "position_upper")
    total = plant.num_positions() if are_positions else plant.num_velocities()
    found: Floats = np.full(total, rest)
    for key, joint, item in _list_named(plant, name, value):
        of_key = f"{name}[{key}]"
        first, size = joint.velocity_start(), joint.num_velocities()
        if are_positions:
            first, size = joint.position_start(), joint.num_positions()
        is_floating = joint.type_name() == _FLOATING
        if isinstance(item, PoseParts):
            if not is_floating:
                got = f"xyz and turn of {key!r}, which {joint.type_name()} joint holds"
                raise ScenarioError(of_key, got, "numbers of the joint")
            numbers = np.array([*item.turn, *item.xyz])
        else:
            numbers = np.array(item)
            numbers = np.full(size, numbers[0]) if is_for_all and numbers.size == 1 else numbers
        if are_positions and is_floating:
            if not isinstance(item, PoseParts) or np.isfinite(item.turn).any():
                got, remedy = repr(write_plain(item)), "Attitudes have no bounds; weigh them."
                raise ScenarioError(of_key, got, "a bound of xyz alone", remedy)
            numbers = np.array([*np.full(4, rest), *item.xyz])
        _fill(of_key, found, first, size, numbers)
    return found


def _fill_controls(plant: MultibodyPlant, name: str, value: Named[Any], thrusters: int) -> Floats:
    """Returns bounds of controls, (nu,), by names of actuators, of their joints, or thrusters."""
    names = name_controls(plant, plant.num_actuated_dofs() + thrusters, has_prefix=False)
    known = {key: i for i, key in enumerate(names)}
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        known.setdefault(actuator.joint().name(), actuator.input_start())
    found: Floats = np.full(len(names), RESTS[name])
    for key, item in _spell_out(name, value, known, "no actuator of this name").items():
        _fill(f"{name}[{key}]", found, known[key], 1, np.ravel(item))
    return found


def _list_joints(plant: MultibodyPlant) -> list[Joint]:
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    return [joint for joint in joints if joint.num_positions()]


def _list_named(
    plant: MultibodyPlant, name: str, value: Mapping[str, _Item]
) -> Iterator[tuple[str, Joint, _Item]]:
    """Yields names, joints and what is given for them; bodies that float are their joints."""
    joints = {joint.name(): joint for joint in _list_joints(plant)}
    floating = {j.child_body().name(): j for j in joints.values() if j.type_name() == _FLOATING}
    known = {**joints, **floating}
    missing = "no joint that moves, and no floating body, of this name"
    for key, item in _spell_out(name, value, known, missing).items():
        yield key, known[key], item


def _spell_out(
    name: str, value: Mapping[str, _Item], known: Collection[str], missing: str
) -> dict[str, _Item]:
    """Returns what is given for each name: by globs, the last that fits, or else by itself."""
    found = dict[str, _Item]()
    for key, item in sorted(value.items(), key=lambda pair: pair[0] in known):
        fitting = [key] if key in known else [each for each in known if fits(each, key)]
        if not fitting:
            raise refuse_name(f"{name}[{key}]", key, sorted(known), missing)
        found.update(dict.fromkeys(fitting, item))
    return found
