from .added import NO_TERMS as NO_TERMS
from .added import AddedTerms as AddedTerms
from .bounds import EXPAND as EXPAND
from .bounds import PENALIZE as PENALIZE
from .bounds import visit_bounds as visit_bounds
from .descent import LINEARIZE as LINEARIZE
from .descent import descend as descend
from .descent import travel as travel
from .hold import hold_contacts as hold_contacts
from .laws import FeedbackLaws as FeedbackLaws
from .optimal_control import FreeStart as FreeStart
from .optimal_control import Phases as Phases
from .problem import ShootingProblem as ShootingProblem
from .problem import limit_states as limit_states
from .program import IMPLICIT as IMPLICIT
from .program import TWO_STAGES as TWO_STAGES
from .program import is_implicit as is_implicit
from .solve import ShootingOptions as ShootingOptions
from .solve import ShootingResult as ShootingResult
from .solve import Smoothing as Smoothing
from .tables import Pass as Pass
from .tables import make_memory as make_memory

__all__: list[str]
