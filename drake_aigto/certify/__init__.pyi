from . import intervals as intervals
from .certificate import Certificate as Certificate
from .certificate import Certifier as Certifier
from .certificate import Method as Method
from .certificate import certify as certify
from .certificate import relative_gap as relative_gap
from .enclosures import enclose_all as enclose_all
from .flights import Line as Line
from .flights import Wall as Wall
from .formulas import formula_of as formula_of
from .formulas import read_formulas as read_formulas
from .infeasibility import explain_infeasibility as explain_infeasibility
from .infeasibility import is_infeasible as is_infeasible
from .plans import PlanBound as PlanBound
from .plans import bound_plans as bound_plans
from .plans import fold as fold
from .plans import out_of_reach as out_of_reach
from .relaxation import Relaxation as Relaxation
from .relaxation_kernels import safe_bound as safe_bound
from .scip import write_sum as write_sum
from .tape import Operation as Operation
from .tape import Tape as Tape
from .tape import make_tape as make_tape
from .touches import bound_line as bound_line

__all__: list[str]
