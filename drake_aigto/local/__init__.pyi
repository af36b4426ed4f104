from .drake import as_program as as_program
from .drake import compile_nlp as compile_nlp
from .drake import solve_with_drake as solve_with_drake
from .interior_point import InteriorPoint as InteriorPoint
from .kkt import BandFactors as BandFactors
from .kkt import DenseFactors as DenseFactors
from .kkt import SparseKktFactors as SparseKktFactors
from .kkt import multiply_symmetric as multiply_symmetric
from .line_search import Progress as Progress
from .newton import NewtonLagrange as NewtonLagrange
from .nlp import LocalIterate as LocalIterate
from .nlp import LocalResult as LocalResult
from .nlp import LocalStatus as LocalStatus
from .nlp import Monomial as Monomial
from .nlp import NlpBuilder as NlpBuilder
from .nlp import PolynomialNlp as PolynomialNlp
from .nlp import Summand as Summand
from .penalty_ladder import Climb as Climb
from .penalty_ladder import PenaltyLadder as PenaltyLadder
from .penalty_newton import PenaltyTables as PenaltyTables
from .penalty_newton import make_penalty_tables as make_penalty_tables

__all__: list[str]
