from .diagram import find_anywhere as find_anywhere
from .files import find_model as find_model
from .files import models_directory as models_directory
from .files import package_map as package_map
from .files import scenario_names as scenario_names
from .files import scenario_summaries as scenario_summaries
from .fingerprint import Fingerprint as Fingerprint
from .limits import Limits as Limits
from .material import DISSIPATION as DISSIPATION
from .material import STIFFNESS as STIFFNESS
from .material import read_given as read_given
from .material import read_material as read_material
from .material import read_property as read_property
from .material import set_material as set_material
from .model_facts import FixableError as FixableError
from .model_fields import Material as Material
from .model_fields import ModelFields as ModelFields
from .model_reader import add_dry_friction as add_dry_friction
from .model_reader import build_diagram as build_diagram
from .scenario import Scenario as Scenario
from .space import SpaceWorld as SpaceWorld
from .task_cost import Scales as Scales
from .task_cost import TaskCost as TaskCost
from .task_cost import calc_inertia as calc_inertia
from .task_cost import take_nearest_turn as take_nearest_turn
from .world import World as World

__all__: list[str]
