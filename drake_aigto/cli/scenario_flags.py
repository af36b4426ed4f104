"""A scenario from the command line: a file or a name, and flags that change its fields."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import Any, get_args, get_type_hints

import yaml

from drake_aigto.world import Scenario, scenario_names

# Field → what it is. Of the kinds of flags below, those of no other take one number.
_FIELDS = {
    "packages": "of package:// in the model, {name: folder}",
    "weld": "links that the world holds, {link: [x, y, z, roll, pitch, yaw]} [m, rad]",
    "fixed_joints": "joints that stand still, by name or glob",
    "actuators": "joints to drive where the model has no actuator, by name or glob",
    "effort_limits": "of actuators, in place of the model's, {actuator or joint: limit} [N, N m]",
    "limits": "whether the model's limits of positions and velocities count",
    "collisions": "shapes that may touch, all, none, or by name or glob",
    "material": "of shapes, {shape or glob: {stiffness: 1e6, friction: 0.5, …}}",
    "allow_ignored": "what may be left out that is not planned for, by the words of its error",
    "model": "the world: package://… or a path to an SDF, URDF or MJCF",
    "initial_position": "q(0), one number a coordinate [m, rad]",
    "initial_velocity": "v(0) [m/s, rad/s]",
    "goal_position": "where q(T) should be [m, rad]",
    "goal_velocity": "what v(T) should be [m/s, rad/s]",
    "hard_goal": "q(T) has to be the goal, and v(T) the goal's velocity if that is given",
    "angles": "how a hinge's error is measured: as it is, without turns, or as a chord",
    "duration": "T [s]",
    "time_step": "dt [s]; T is a whole number of them",
    "duration_range": "least and most that T may be [s]",
    "control_weight": "of ∫ ‖u‖² dt in the cost [1/(N² s)]; one number, or one an actuator",
    "goal_weight": "of ‖q(T) − goal‖² [1/m²]; one number, one a coordinate, or a matrix",
    "goal_velocity_weight": "of ‖v(T) − goal velocity‖² [s²/m²], of the same kinds",
    "position_weight": "of ∫ ‖q − reference‖² dt [1/(m² s)]; one number, or one a coordinate",
    "velocity_weight": "of ∫ ‖v − reference‖² dt [s/m²]; one number, or one a coordinate",
    "reference_times": "of the reference; without one, the goal is it [s]",
    "reference_positions": "q at these times",
    "reference_velocities": "v at these times",
    "position_lower": "least q; one number, or one a coordinate, -inf without bound",
    "position_upper": "largest q",
    "velocity_lower": "least v",
    "velocity_upper": "largest v",
    "control_lower": "least u; one number, or one an actuator",
    "control_upper": "largest u",
    "control_norm": "largest ‖u‖",
    "contact": "the law of contact: rigid walls, or the model's stiffness and dissipation",
    "epsilon": "literal: ε of the contact force ε/(φ + δ) [J]",
    "delta": "literal: δ of it [m]",
    "restitution": "speed after / before an impact, 0 to 1, where the model has none",
    "mass": "of the body that touches, in place of the model's [kg]",
    "friction": "μ of all that slides, in place of the model's; 0 leaves it out",
    "dry_friction": "of joints, the largest one a coordinate [N, N m]",
    "stiction_speed": "below which what rubs sticks [m/s, rad/s]",
    "ignored_shapes": "collision shapes that touch nothing, by name",
}
_CHOICES = {
    name: get_args(get_type_hints(Scenario)[name]) for name in ("angles", "contact", "limits")
}
_NAMES = ("fixed_joints", "actuators", "collisions", "allow_ignored", "ignored_shapes")
_MAPPINGS = ("packages", "weld", "effort_limits", "material")
_SWITCHES = ("hard_goal",)
_PAIRS = ("duration_range",)
_VECTORS = (
    *("initial_position", "initial_velocity", "goal_position", "goal_velocity"),
    *("control_weight", "position_weight", "velocity_weight", "reference_times"),
    *("position_lower", "position_upper", "velocity_lower", "velocity_upper"),
    *("control_lower", "control_upper", "dry_friction"),
)
_MATRICES = (
    *("goal_weight", "goal_velocity_weight", "reference_positions", "reference_velocities"),
)


def add_scenario(command: Any) -> None:
    """Adds the scenario to a command, and flags that change its fields."""
    text = f"a YAML file, or one of {', '.join(scenario_names())}"
    command.add_argument("scenario", metavar="SCENARIO", help=text)
    title, notes = "change the scenario's fields", "A row of a matrix or a table is 1,2,3."
    group = command.add_argument_group(title, notes)
    for name, text in _FIELDS.items():
        group.add_argument(f"--{name.replace('_', '-')}", help=text, **_look(name))


def _look(name: str) -> dict[str, Any]:
    """Returns how argparse reads a field."""
    if name == "model":
        return {"metavar": "URI"}
    if name in _NAMES:
        return {"metavar": "NAME", "nargs": "+"}
    if name in _MAPPINGS:
        return {"type": yaml.safe_load, "metavar": "{NAME: …}"}
    if name in _CHOICES:
        return {"choices": _CHOICES[name]}
    if name in _SWITCHES:
        return {"action": argparse.BooleanOptionalAction}
    if name in _MATRICES:
        return {"type": _read_row, "metavar": "X", "nargs": "+"}
    count: dict[str, Any] = {"nargs": "+"} if name in _VECTORS else {}
    return {"type": float, "metavar": "X", **({"nargs": 2} if name in _PAIRS else count)}


def _read_row(text: str) -> float | list[float]:
    """Returns a number, or the numbers between commas."""
    return [float(item) for item in text.split(",")] if "," in text else float(text)


def load_scenario(options: argparse.Namespace) -> Scenario:
    """Returns the named or loaded scenario with the fields that flags change."""
    scenario = read_scenario(options.scenario)
    changes = {f: getattr(options, f) for f in _FIELDS if getattr(options, f) is not None}
    for name in _NAMES:  # All and none are no names.
        if changes.get(name) in (["all"], ["none"]):
            changes[name] = changes[name][0]
    return dataclasses.replace(scenario, **changes) if changes else scenario


def is_file(name: str) -> bool:
    """Returns whether a scenario is named by its file, not as one that is shipped."""
    return Path(name).suffix in (".yaml", ".yml")


def read_scenario(name: str) -> Scenario:
    """Returns the scenario of a YAML file, or a shipped one."""
    return Scenario.load(name) if is_file(name) else Scenario.named(name)
