"""Fields of a scenario: how each is checked and written, and which AIGTO's task has none of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Literal, cast, get_args

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.world.fields import ArrayField, as_number, as_weight, as_weight_matrix
from drake_aigto.world.model_fields import Material, Thruster, as_mapping
from drake_aigto.world.places import (
    FrameGoal,
    Pose,
    PoseWeight,
    Shift,
    as_frame_goal,
    as_places,
    by_name,
)

REQUIRED = ("initial_position", "initial_velocity", "goal_position")

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
    *("stiction_speed", "clearance", "frame_goals"),
)

# Whole numbers of steps are recognized up to this relative error: 1.0 / 0.005 is not 200 exactly.
STEP_TOLERANCE = 1e-9

Weight = ArrayField[Any]  # A float of one number, an array of several.
Bound = ArrayField[float | Floats | None]
Vector = ArrayField[Floats | None]
as_running = by_name(partial(as_weight, at_least=0.0))
as_final = by_name(as_weight_matrix)
as_positions = cast(Callable[[str, object], Floats], as_places)  # Names are replaced by numbers.
as_clearance = as_mapping(partial(as_number, above=0.0, unit="m"), "{ball against left_wall: 0.05}")
as_frames = as_mapping(as_frame_goal, "{hand: {xyz: [0.5, 0, 0.3], weight: {xyz: 100}}}")
as_price = partial(as_weight, above=0.0)  # At zero no optimum is unique.


def write_plain(value: Any) -> Any:
    """Returns a field's value as numbers, texts, lists and dicts, as a file has it."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, FrameGoal):
        return {**write_plain(value.pose), "weight": write_plain(value.weight)}
    if isinstance(value, Pose | PoseWeight | Shift | Thruster):
        return {name: write_plain(item) for name, item in value._asdict().items()}
    if isinstance(value, Material):
        return {name: item for name, item in value._asdict().items() if item is not None}
    if isinstance(value, Mapping):
        return {name: write_plain(item) for name, item in value.items()}
    return list(map(write_plain, value)) if isinstance(value, tuple) else value
