"""Fields of a scenario: how each is checked and written; positions and weights by names in them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Literal, NamedTuple, TypeAlias, TypeVar, cast, get_args

import numpy as np
from pydrake.math import RollPitchYaw

from drake_aigto.arrays import Floats
from drake_aigto.errors import ScenarioError
from drake_aigto.world.fields import (
    ArrayField,
    as_bound,
    as_number,
    as_vector,
    as_weight,
    as_weight_matrix,
)
from drake_aigto.world.model_fields import Material, Named, Thruster, as_mapping

_as_weight = partial(as_weight, at_least=0.0)
_Checked = TypeVar("_Checked")

_POSE = "xyz [m], and rpy_deg [degrees], rpy [rad] or quaternion (w, x, y, z)"


class Pose(NamedTuple):
    """Where a floating body is in the world."""

    xyz: tuple[float, ...]  # [m]
    quaternion: tuple[float, ...]  # w, x, y, z, as it was given


class Shift(NamedTuple):
    """How far a goal is from the start: of a floating body along the world's axes."""

    by: tuple[float, ...]  # [m], [rad]


class PoseParts(NamedTuple):
    """Numbers of a floating body: weights or bounds of its pose or velocity, or its velocity."""

    xyz: tuple[float, ...]  # along the world's axes
    turn: tuple[float, ...]  # about them


class FrameGoal(NamedTuple):
    """Where a frame should be in the world at the end, and the weights of its error."""

    pose: Pose
    weight: PoseParts  # of the turn, one number


# Joint or floating body → its positions.
Places: TypeAlias = Named["tuple[float, ...] | Pose | Shift"]


def as_places(name: str, value: Any) -> Floats | Places:
    """Returns positions: numbers, or a mapping from joints and floating bodies to theirs."""
    if not isinstance(value, Mapping):
        return as_vector(name, value)
    return Named({key: _as_place(f"{name}[{key}]", item) for key, item in value.items()})


def _as_place(name: str, value: Any) -> tuple[float, ...] | Pose | Shift:
    """Returns the numbers of a joint, the pose of a body, or how far either is from the start."""
    if isinstance(value, Pose | Shift):
        return value
    if not isinstance(value, Mapping):
        return tuple(as_vector(name, value).tolist())
    if set(value) == {"by"}:
        return Shift(tuple(as_vector(name, value["by"]).tolist()))
    turns = [key for key in value if key != "xyz"]
    if "xyz" not in value or len(turns) > 1 or set(turns) - {"rpy_deg", "rpy", "quaternion"}:
        raise ScenarioError(name, got=repr(dict(value)), expected=f"a pose: {_POSE}; or by, alone")
    turn = as_vector(name, value[turns[0]]) if turns else np.array([1.0, 0.0, 0.0, 0.0])
    place, size = as_vector(name, value["xyz"]), 4 if turns in ([], ["quaternion"]) else 3
    if (place.size, turn.size) != (3, size):
        got = f"{place.size} and {turn.size} numbers"
        raise ScenarioError(name, got=got, expected=f"3 of xyz, and {size} of the turn")
    if size == 3:
        angles = np.deg2rad(turn) if turns == ["rpy_deg"] else turn
        turn = RollPitchYaw(angles).ToQuaternion().wxyz()
    return Pose(tuple(place.tolist()), tuple(turn.tolist()))


def as_advance(name: str, value: Any) -> tuple[float | None, ...]:
    """Returns by how much a joint or a body advances per period; None where its start is free."""
    items = value if isinstance(value, list | tuple | np.ndarray) else [value]
    return tuple(None if item is None else as_number(name, item) for item in items)


def as_frame_goal(name: str, value: Any) -> FrameGoal:
    """Returns the goal of a frame, from its pose and a mapping of weights."""
    if isinstance(value, FrameGoal):
        return value
    if not isinstance(value, Mapping) or not isinstance(value.get("weight"), Mapping):
        expected = f"a pose: {_POSE}; and weight: {{xyz: ..., turn: ...}}"
        raise ScenarioError(name, got=repr(value), expected=expected)
    pose = _as_place(name, {key: item for key, item in value.items() if key != "weight"})
    weight = _as_parts(f"{name}.weight", value["weight"], _as_weight)
    if not isinstance(pose, Pose):
        raise ScenarioError(name, got=repr(dict(value)), expected=f"a pose: {_POSE}")
    assert isinstance(weight, PoseParts), "it is a mapping"
    if len(set(weight.turn)) > 1 or not any((*weight.xyz, *weight.turn)):
        expected = "one number for the turn, and one weight above 0"
        raise ScenarioError(f"{name}.weight", got=repr(value["weight"]), expected=expected)
    return FrameGoal(pose, weight)


def check_repeats(goal: Any, speed_weight: Any, weight: Any) -> None:
    """Refuses goals of a motion that repeats beside the start, to which it returns.

    Args:
        goal: of the position, as it is given.
        speed_weight: of the final velocity.
        weight: of positions that have no reference but the goal.

    Raises:
        ScenarioError: there is one.
    """
    if isinstance(goal, Named) and goal:
        raise ScenarioError(
            "goal_position",
            got=f"{write_plain(goal)}, and periodic",
            expected="none, as the motion ends where it starts, or advances from there",
            remedy="Of what advances periodic says how far: {x: 0.4}.",
        )
    if np.any(speed_weight):
        got = f"{write_plain(speed_weight)}, and periodic"
        raise ScenarioError("goal_velocity_weight", got, "none, as v(T) = v(0)")
    if np.any(weight):
        raise ScenarioError(
            "position_weight",
            got="periodic, and no reference",
            expected="reference_positions, as the goal moves with the start",
        )


def by_name(
    check: Callable[[str, Any], _Checked], check_part: Callable[[str, Any], Any]
) -> Callable[[str, Any], _Checked]:
    """Returns the check of numbers that may be by names of joints and bodies, as `RESTS` has them.

    Args:
        check: of an array, or of a number for all.
        check_part: of a joint's numbers, and of those along a body's axes, or about them.
    """

    def as_named(name: str, value: Any) -> Any:
        if not isinstance(value, Mapping):
            return check(name, value)
        as_parts = partial(_as_parts, check=check_part, rest=RESTS[name])
        return Named({key: as_parts(f"{name}[{key}]", item) for key, item in value.items()})

    return as_named


def _as_parts(
    name: str, value: Any, check: Callable[[str, Any], Any], rest: float = 0.0
) -> tuple[Any, ...]:
    """Returns numbers of a joint, or those along a body's axes and about them."""
    if isinstance(value, PoseParts):
        return value
    if not isinstance(value, Mapping):
        return tuple(np.ravel(check(name, value)).tolist())
    if set(value) - set(PoseParts._fields):
        raise ScenarioError(name, got=repr(dict(value)), expected="xyz and turn")
    found = [np.ravel(check(name, value.get(part, rest))) for part in PoseParts._fields]
    for numbers in found:
        if numbers.size not in (1, 3):
            raise ScenarioError(name, got=f"{numbers.size} numbers", expected="1 or 3")
    return PoseParts(*(tuple(np.broadcast_to(numbers, 3).tolist()) for numbers in found))


# Fields that may be by names, but for positions, and their number for what is not named.
RESTS = {
    **dict.fromkeys(("goal_weight", "goal_velocity_weight"), 0.0),
    **dict.fromkeys(("position_weight", "velocity_weight"), 0.0),
    **dict.fromkeys(("initial_velocity", "goal_velocity", "dry_friction"), 0.0),
    **dict.fromkeys(("position_lower", "velocity_lower", "control_lower"), -math.inf),
    **dict.fromkeys(("position_upper", "velocity_upper", "control_upper"), math.inf),
}

REQUIRED = ("initial_position", "goal_position")

BOUNDS: dict[str, dict[str, Any]] = {
    "duration": {"above": 0.0, "unit": "s"},
    "time_step": {"above": 0.0, "unit": "s"},
    "control_norm": {"above": 0.0},
    "epsilon": {"above": 0.0, "unit": "J"},
    "delta": {"at_least": 0.0, "unit": "m"},
    "restitution": {"at_least": 0.0, "at_most": 1.0},
    "mass": {"above": 0.0, "unit": "kg"},
    "friction": {"at_least": 0.0},
    "stiction_speed": {"above": 0.0, "unit": "m/s"},
}
# Without these something is left as it is: without bound, or as the model has it.
OPTIONAL = ("control_norm", "mass", "friction")

Angles = Literal["exact", "modulo", "chordal"]
ContactKind = Literal["rigid", "compliant"]
CHOICES = {"angles": get_args(Angles), "contact": get_args(ContactKind)}

# What AIGTO's task has none of, or has as one number for all coordinates.
WEIGHTS = ("control_weight", "goal_weight")
EXTRAS = (
    *("goal_velocity", "hard_goal", "angles", "duration_range"),
    *("goal_velocity_weight", "position_weight", "velocity_weight"),
    *("reference_times", "reference_positions", "reference_velocities"),
    *("position_lower", "position_upper", "velocity_lower", "velocity_upper"),
    *("control_lower", "control_upper", "control_norm", "contact", "dry_friction"),
    *("stiction_speed", "clearance", "frame_goals", "periodic"),
)

Weight = ArrayField[Any]  # A float of one number, an array of several.
Bound = ArrayField[float | Floats | None]
Vector = ArrayField[Floats | None]
as_running = by_name(_as_weight, _as_weight)
as_final = by_name(as_weight_matrix, _as_weight)
as_velocity = by_name(as_vector, as_vector)
as_limit = by_name(as_bound, as_bound)
as_friction = by_name(*[partial(as_vector, at_least=0.0)] * 2)
as_positions = cast(Callable[[str, object], Floats], as_places)  # Names are replaced by numbers.
as_clearance = as_mapping(partial(as_number, above=0.0, unit="m"), "{ball against left_wall: 0.05}")
as_period = as_mapping(as_advance, "{x: 0.4}, or {} if all repeats")
as_frames = as_mapping(as_frame_goal, "{hand: {xyz: [0.5, 0, 0.3], weight: {xyz: 100}}}")
as_price = partial(as_weight, above=0.0)  # At zero no optimum is unique.


def write_plain(value: Any) -> Any:
    """Returns a field's value as numbers, texts, lists and dicts, as a file has it."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, FrameGoal):
        return {**write_plain(value.pose), "weight": write_plain(value.weight)}
    if isinstance(value, Pose | PoseParts | Shift | Thruster):
        return {name: write_plain(item) for name, item in value._asdict().items()}
    if isinstance(value, Material):
        return {name: item for name, item in value._asdict().items() if item is not None}
    if isinstance(value, Mapping):
        return {name: write_plain(item) for name, item in value.items()}
    return list(map(write_plain, value)) if isinstance(value, tuple) else value
