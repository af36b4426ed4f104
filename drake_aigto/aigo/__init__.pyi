from .algorithm import AigoResult as AigoResult
from .algorithm import Algorithm as Algorithm
from .algorithm import Box as Box
from .algorithm import Iterate as Iterate
from .algorithm import Status as Status
from .algorithm import minimize as minimize
from .annealing import Annealing as Annealing
from .annealing import BoundedAnnealing as BoundedAnnealing
from .annealing import CenterObjective as CenterObjective
from .annealing import SlowMotion as SlowMotion
from .annealing import raise_penalties as raise_penalties
from .box_search import BoxSearch as BoxSearch
from .box_search import LowPoint as LowPoint
from .box_search import SearchResult as SearchResult
from .coupling import CouplingGraph as CouplingGraph
from .coupling import Fusion as Fusion
from .gradients import Alternating as Alternating
from .gradients import FaceFlow as FaceFlow
from .gradients import FullGradient as FullGradient

__all__: list[str]
