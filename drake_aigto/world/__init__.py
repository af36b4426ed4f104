"""The world and the question: models, readings of plants, contact geometry, scenarios."""

from drake_aigto.world.diagram import add_dry_friction, build_diagram, find_anywhere
from drake_aigto.world.files import find_model, models_directory, package_map, scenario_names
from drake_aigto.world.fingerprint import Fingerprint
from drake_aigto.world.limits import Limits
from drake_aigto.world.material import (
    DISSIPATION,
    STIFFNESS,
    read_given,
    read_material,
    set_material,
)
from drake_aigto.world.scenario import Scenario
from drake_aigto.world.task_cost import Scales, TaskCost, calc_inertia
from drake_aigto.world.world import World

__all__ = [
    "DISSIPATION",
    "STIFFNESS",
    "Fingerprint",
    "Limits",
    "Scales",
    "Scenario",
    "TaskCost",
    "World",
    "add_dry_friction",
    "build_diagram",
    "calc_inertia",
    "find_anywhere",
    "find_model",
    "models_directory",
    "package_map",
    "read_given",
    "read_material",
    "scenario_names",
    "set_material",
]
