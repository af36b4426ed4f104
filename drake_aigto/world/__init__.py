"""The world and the question: models, plants read as expressions, contact geometry, scenarios."""

from drake_aigto.world.constant import ConstantDynamics, ConstantInertia
from drake_aigto.world.contact import Contact
from drake_aigto.world.equations import EquationsOfMotion
from drake_aigto.world.files import package_map
from drake_aigto.world.fingerprint import Fingerprint
from drake_aigto.world.friction import add_dry_friction, calc_friction_share
from drake_aigto.world.law import CompliantLaw, ContactLaw, RigidLaw
from drake_aigto.world.limits import Limits
from drake_aigto.world.scales import Scales
from drake_aigto.world.scenario import Scenario
from drake_aigto.world.scenario_files import scenario_names
from drake_aigto.world.spring_rates import compile_springs
from drake_aigto.world.task_cost import TaskCost
from drake_aigto.world.world import World

__all__ = [
    "CompliantLaw",
    "ConstantDynamics",
    "ConstantInertia",
    "Contact",
    "ContactLaw",
    "EquationsOfMotion",
    "Fingerprint",
    "Limits",
    "RigidLaw",
    "Scales",
    "Scenario",
    "TaskCost",
    "World",
    "add_dry_friction",
    "calc_friction_share",
    "compile_springs",
    "package_map",
    "scenario_names",
]
