"""Analytical Integral Global Optimization: boxes shrink onto a low point of their own mean."""

from drake_aigto.aigo.algorithm import AigoResult, Algorithm, Box, Iterate, Status, minimize
from drake_aigto.aigo.annealing import Annealing, BoundedAnnealing, SlowMotion
from drake_aigto.aigo.box_search import BoxSearch, LowPoint, SearchResult
from drake_aigto.aigo.coupling import CouplingGraph
from drake_aigto.aigo.face_flow import FaceFlow
from drake_aigto.aigo.fusion import Fusion
from drake_aigto.aigo.newton import CenterObjective, raise_penalties
from drake_aigto.aigo.size_penalty import Alternating, FullGradient

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
