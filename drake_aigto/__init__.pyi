from .control import ModelPredictiveController as ModelPredictiveController
from .control import TrackingController as TrackingController
from .errors import AigtoError as AigtoError
from .jobs import plan_many as plan_many
from .planning import Plan as Plan
from .planning import Planner as Planner
from .planning import PlanningError as PlanningError
from .planning import PlanOptions as PlanOptions
from .planning import plan as plan
from .simulation import replay_drake as replay_drake
from .simulation import replay_event_driven as replay_event_driven
from .solver import AigoOptions as AigoOptions
from .solver import AigoSolver as AigoSolver
from .world import Scenario as Scenario
from .world import World as World
from .world import scenario_names as scenario_names

__all__: list[str]
__version__: str
