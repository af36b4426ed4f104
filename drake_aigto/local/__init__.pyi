from .builder import Monomial as Monomial
from .builder import NlpBuilder as NlpBuilder
from .compile import compile_nlp as compile_nlp
from .drake_solvers import solve_with_drake as solve_with_drake
from .interior_point import InteriorPoint as InteriorPoint
from .newton_lagrange import NewtonLagrange as NewtonLagrange
from .nlp import PolynomialNlp as PolynomialNlp
from .penalty_ladder import Climb as Climb
from .penalty_ladder import PenaltyLadder as PenaltyLadder
from .points import PointTables as PointTables
from .points import make_point_tables as make_point_tables
from .result import LocalIterate as LocalIterate
from .result import LocalResult as LocalResult
from .result import LocalStatus as LocalStatus

__all__: list[str]
