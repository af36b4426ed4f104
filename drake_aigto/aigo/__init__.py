"""Analytical Integral Global Optimization: boxes shrink onto a low point of their own mean."""

from drake_aigto.aigo.algorithm import AigoResult, Algorithm, Box, Iterate, Status, minimize
from drake_aigto.aigo.annealing import Annealing
from drake_aigto.aigo.continuation import PenaltyContinuation
from drake_aigto.aigo.full_gradient import FullGradient

__all__ = [
    "AigoResult",
    "Algorithm",
    "Annealing",
    "Box",
    "FullGradient",
    "Iterate",
    "PenaltyContinuation",
    "Status",
    "minimize",
]
