"""Shipped scenarios whose lengths, masses and times are multiplied, and nothing else."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drake_aigto import Scenario, World

_MODELS = Path(__file__).parents[1] / "models"
ET.register_namespace("drake", "drake.mit.edu")  # Its prefix counts.

# Powers of length, mass and time in the numbers of an element of SDF.
_OF_LINKS = {
    **dict.fromkeys(("radius", "length", "size"), (1, 0, 0)),
    "mass": (0, 1, 0),
    **dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), (2, 1, 0)),
    "point_contact_stiffness": (0, 1, -2),
    "hunt_crossley_dissipation": (-1, 0, 1),
}
# The same of a joint that slides, and the power of length that is added if it turns.
_OF_JOINTS = {
    "lower": ((1, 0, 0), -1),
    "upper": ((1, 0, 0), -1),
    "velocity": ((1, 0, -1), -1),
    "effort": ((1, 1, -2), 1),
    "damping": ((0, 1, -1), 2),
    "friction": ((1, 1, -2), 1),
}


class Factors(NamedTuple):
    length: float
    mass: float
    time: float

    def multiply(self, powers: tuple[int, int, int]) -> float:
        """Returns the factor of a quantity with these powers of the units."""
        return float(np.prod(np.power(np.array(self, dtype=float), powers)))


def scale_model(name: str, folder: Path, factors: Factors) -> Path:
    """Writes a shipped SDF and those that it includes with other units, and returns its path."""
    tree = ET.parse(_MODELS / name)

    def scale(element: ET.Element, powers: tuple[int, int, int]) -> None:
        each = np.array((element.text or "").split(), dtype=float)
        if element.tag not in ("effort", "velocity") or np.all(each >= 0):  # Else there is none.
            element.text = " ".join(map(repr, (factors.multiply(powers) * each).tolist()))

    def visit(element: ET.Element, joint: str | None) -> None:
        tag, text = element.tag.rpartition("}")[-1], element.text or ""
        joint = element.get("type") if tag == "joint" else joint
        if tag == "pose":
            x = np.array(text.split(), dtype=float)
            x[:3] *= factors.length
            element.text = " ".join(map(repr, x.tolist()))
        elif tag == "uri":
            element.text = scale_model(Path(text).name, folder, factors).as_uri()
        elif tag in _OF_LINKS:
            scale(element, _OF_LINKS[tag])
        elif joint and tag in _OF_JOINTS:
            (length, *rest), more = _OF_JOINTS[tag]
            turns = joint in ("revolute", "continuous")
            scale(element, (length + turns * more, rest[0], rest[1]))
        for each in element:
            visit(each, joint)

    visit(tree.getroot(), None)
    tree.write(folder / name)
    return folder / name


def scale_scenario(name: str, folder: Path, factors: Factors) -> Scenario:
    """Returns a shipped scenario in other units: its cost is the same.

    Gravity is Drake's: where it counts, lengths have to go with the square of times.

    Args:
        name: of the scenario.
        folder: that models are written to.
        factors: of lengths, masses and times.
    """
    scenario, (length, mass, time) = Scenario.named(name), factors
    world = World.from_scenario(scenario)
    q = np.where(world.is_hinge, 1.0, length)
    levers = np.where(world.is_hinge, length, 1.0)  # Of torques, beside forces.
    u = np.max(np.where(world.actuation != 0, levers[:, np.newaxis], 0.0), axis=0)
    u *= factors.multiply((1, 1, -2))
    v = q / time
    changes: dict[str, Any] = {
        "model": str(scale_model(Path(scenario.model).name, folder, factors)),
        "duration": time * scenario.duration,
        "time_step": time * scenario.time_step,
    }
    units = {"position": q, "velocity": v, "control": u, "goal_weight": q}
    for field in dataclasses.fields(Scenario):
        name, value = field.name, getattr(scenario, field.name)
        unit = next((unit for word, unit in units.items() if word in name), None)
        if name.endswith("weight"):
            is_running = not name.startswith("goal")
            changes[name] = _scale_weight(value, unit, time if is_running else 1.0)
        elif unit is not None and value is not None:
            changes[name] = float(value * unit[0]) if name == "control_norm" else value * unit
    if scenario.reference_times is not None:
        changes["reference_times"] = time * scenario.reference_times
    if world.friction_coefficients(scenario).any():
        changes["stiction_speed"] = scenario.stiction_speed * length / time
    if scenario.mass is not None:
        changes["mass"] = mass * scenario.mass
    return dataclasses.replace(scenario, **changes)


def _scale_weight(weight: Any, unit: Any, time: float) -> Any:
    """Returns a weight of squares of what has these units; a number stays one if it can."""
    weight = np.asarray(weight, dtype=float)
    if weight.ndim == 2:
        return weight / np.outer(unit, unit) / time
    if weight.ndim == 0 and (weight == 0 or np.all(unit == unit[0])):
        return float(weight / unit[0] ** 2 / time)
    return weight / unit**2 / time
