"""Optimal control of any mechanism by multiple shooting, between compliant or rigid walls.

Differential dynamic programming (Mayne 1966) in the Gauss-Newton form, on motions that need not
be roll-outs, with bounded controls (Tassa, Mansard & Todorov 2014) and an augmented Lagrangian for
all other bounds. NumPy and Numba only.
"""

from drake_aigto.shooting.added import NO_TERMS, AddedTerms
from drake_aigto.shooting.bounds import EXPAND, PENALIZE, visit_bounds
from drake_aigto.shooting.descent import expand_motion
from drake_aigto.shooting.hold import hold
from drake_aigto.shooting.optimal_control import FreeStart, Phases
from drake_aigto.shooting.problem import ShootingProblem, limit_states
from drake_aigto.shooting.program import IMPLICIT
from drake_aigto.shooting.solve import ShootingOptions, ShootingResult, Smoothing
from drake_aigto.shooting.tables import make_memory

__all__ = [
    "EXPAND",
    "IMPLICIT",
    "NO_TERMS",
    "PENALIZE",
    "AddedTerms",
    "FreeStart",
    "Phases",
    "ShootingOptions",
    "ShootingProblem",
    "ShootingResult",
    "Smoothing",
    "expand_motion",
    "hold",
    "limit_states",
    "make_memory",
    "visit_bounds",
]
