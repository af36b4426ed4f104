from .control import ModelPredictiveController as ModelPredictiveController
from .control import TrackingController as TrackingController
from .dynamics import Contact as Contact
from .errors import AigtoError as AigtoError
from .errors import ControlError as ControlError
from .errors import FrictionError as FrictionError
from .errors import ModelError as ModelError
from .errors import OptionsError as OptionsError
from .errors import OutputFileError as OutputFileError
from .errors import PlanFileError as PlanFileError
from .errors import ProgramError as ProgramError
from .errors import ResultsFileError as ResultsFileError
from .errors import ScenarioError as ScenarioError
from .errors import StudyError as StudyError
from .errors import TrajectoryError as TrajectoryError
from .errors import UnsupportedTermError as UnsupportedTermError
from .jobs import Answer as Answer
from .jobs import plan_many as plan_many
from .planning import Candidate as Candidate
from .planning import Plan as Plan
from .planning import Planner as Planner
from .planning import PlanningError as PlanningError
from .planning import PlanOptions as PlanOptions
from .planning import plan as plan
from .simulation import Replay as Replay
from .simulation import replay_drake as replay_drake
from .simulation import replay_event_driven as replay_event_driven
from .solver import AigoDetails as AigoDetails
from .solver import AigoOptions as AigoOptions
from .solver import AigoSolver as AigoSolver
from .solver import AigoStatus as AigoStatus
from .trajectory import Trajectory as Trajectory
from .world import Scenario as Scenario
from .world import World as World
from .world import scenario_names as scenario_names

__all__: list[str]
__version__: str
