from .constraints import ConstraintRow as ConstraintRow
from .constraints import as_bound as as_bound
from .constraints import parse_rows as parse_rows
from .costs import affine_terms as affine_terms
from .costs import evaluator_name as evaluator_name
from .costs import parse_costs as parse_costs
from .costs import shared_evaluators as shared_evaluators
from .costs import term_blocks as term_blocks
from .expressions import expression_terms as expression_terms
from .products import MAX_TERMS as MAX_TERMS
from .products import NoClosedFormError as NoClosedFormError
from .products import TooManyTermsError as TooManyTermsError
from .products import from_terms as from_terms
from .products import power as power
from .products import to_terms as to_terms
from .sums import WAVES as WAVES
from .sums import Factor as Factor
from .sums import FunctionKind as FunctionKind
from .sums import Term as Term
from .sums import TermBlock as TermBlock
from .tables import FACTOR as FACTOR
from .tables import StackedTerms as StackedTerms
from .tables import copy_weights as copy_weights
from .tables import stack_terms as stack_terms

__all__: list[str]
