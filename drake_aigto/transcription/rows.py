"""What rows are called, what they are measured in, and when they hold."""

from __future__ import annotations

from collections.abc import Mapping

from drake_aigto.world import Scales

NONPENETRATION, CLEARANCE = "nonpenetration", "clearance"
FLIGHT, DYNAMICS, CONTACT, RESTITUTION = "flight", "dynamics", "contact", "restitution"
KINEMATICS = "kinematics"
INTEGRATION = "integration"

# Row → the unit of its defect. Those of others are parts of the task's scales.
UNITS: Mapping[str, str] = {
    **dict.fromkeys((FLIGHT, KINEMATICS, CONTACT, NONPENETRATION, CLEARANCE), "m"),
    **dict.fromkeys((DYNAMICS, RESTITUTION), "m/s"),
}


def scaled_defects(defects: Mapping[str, float], scales: Scales) -> dict[str, float]:
    """Returns each defect as a part of the task's scale in its unit."""
    units = {"m": scales.length, "m/s": scales.velocity}
    return {name: by / units.get(UNITS.get(name, ""), 1.0) for name, by in defects.items()}


def largest_defect(defects: Mapping[str, float], scales: Scales) -> float:
    """Returns the largest of `scaled_defects`."""
    return max(scaled_defects(defects, scales).values())
