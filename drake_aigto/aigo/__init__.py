"""Analytical Integral Global Optimization: boxes shrink onto a low point of their own mean."""

from drake_aigto.aigo.algorithm import AigoResult, Algorithm, Box, Iterate, Status, minimize
from drake_aigto.aigo.annealing import (
    Annealing,
    BoundedAnnealing,
    CenterObjective,
    SlowMotion,
    raise_penalties,
)
from drake_aigto.aigo.box_search import BoxSearch, LowPoint, SearchResult
from drake_aigto.aigo.coupling import CouplingGraph, Fusion
from drake_aigto.aigo.gradients import Alternating, FaceFlow, FullGradient

__all__ = [
    "AigoResult",
    "Algorithm",
    "Alternating",
    "Annealing",
    "BoundedAnnealing",
    "Box",
    "BoxSearch",
    "CenterObjective",
    "CouplingGraph",
    "FaceFlow",
    "FullGradient",
    "Fusion",
    "Iterate",
    "LowPoint",
    "SearchResult",
    "SlowMotion",
    "Status",
    "minimize",
    "raise_penalties",
]
