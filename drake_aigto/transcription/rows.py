"""What rows are called, what they are measured in, and when they hold."""

from __future__ import annotations

from collections.abc import Mapping

from drake_aigto.world import Scales

NONPENETRATION, CLEARANCE = "nonpenetration", "clearance"
FLIGHT, DYNAMICS, CONTACT, RESTITUTION = "flight", "dynamics", "contact", "restitution"
KINEMATICS = "kinematics"

# Row → the unit of its defect. Those of rows that users added are parts of the task's scales.
UNITS: Mapping[str, str] = {
    **dict.fromkeys((FLIGHT, KINEMATICS, CONTACT, NONPENETRATION, CLEARANCE), "m"),
    **dict.fromkeys((DYNAMICS, RESTITUTION), "m/s"),
}


def largest_defect(defects: Mapping[str, float], scales: Scales) -> float:
    """Returns the largest defect, each as a part of the task's scale in its unit."""
    units = {"m": scales.length, "m/s": scales.velocity}
    return max(value / units.get(UNITS.get(name, ""), 1.0) for name, value in defects.items())
