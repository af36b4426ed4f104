"""Analytical Integral Global Optimization: boxes shrink onto a low point of their own mean."""

from drake_aigto.aigo.algorithm import AigoResult, Algorithm, Box, Iterate, Status, minimize
from drake_aigto.aigo.annealing import Annealing, BoundedAnnealing, SlowMotion
from drake_aigto.aigo.box_search import BoxSearch, LowPoint, SearchResult
from drake_aigto.aigo.continuation import PenaltyContinuation
from drake_aigto.aigo.equal_widths import EqualWidths
from drake_aigto.aigo.face_flow import FaceFlow, Pace
from drake_aigto.aigo.size_penalty import Alternating, FullGradient

__all__ = [
    "AigoResult",
    "Algorithm",
    "Alternating",
    "Annealing",
    "BoundedAnnealing",
    "Box",
    "BoxSearch",
    "EqualWidths",
    "FaceFlow",
    "FullGradient",
    "Iterate",
    "LowPoint",
    "Pace",
    "PenaltyContinuation",
    "SearchResult",
    "SlowMotion",
    "Status",
    "minimize",
]
