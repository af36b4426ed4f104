"""AIGO for any polynomial MathematicalProgram, called as Drake's own solvers are."""

from drake_aigto.solver.options import AigoOptions
from drake_aigto.solver.result import AigoDetails, AigoStatus
from drake_aigto.solver.solver import AigoSolver

__all__ = ["AigoDetails", "AigoOptions", "AigoSolver", "AigoStatus"]
