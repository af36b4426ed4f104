from .direct import add_rows as add_rows
from .direct import factor_in_place as factor_in_place
from .direct import factorize_band as factorize_band
from .direct import factorize_indefinite as factorize_indefinite
from .direct import solve_band as solve_band
from .direct import solve_factored as solve_factored
from .direct import solve_factors as solve_factors
from .direct import solve_indefinite as solve_indefinite
from .storage import Factorization as Factorization
from .storage import Pattern as Pattern
from .storage import SparseFactors as SparseFactors
from .storage import Storage as Storage
from .storage import as_order as as_order
from .storage import choose_storage as choose_storage
from .storage import count_fill as count_fill
from .storage import eliminate as eliminate
from .storage import factorize as factorize
from .storage import find_entry as find_entry
from .storage import make_pattern as make_pattern
from .storage import minimum_degree as minimum_degree
from .storage import multiply as multiply
from .storage import narrow_band as narrow_band
from .storage import spread as spread

__all__: list[str]
