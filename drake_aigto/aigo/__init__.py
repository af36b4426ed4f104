"""Analytical Integral Global Optimization: boxes shrink onto a low point of their own mean."""

from drake_aigto.aigo.algorithm import AigoResult, Algorithm, Box, Iterate, Status, minimize
from drake_aigto.aigo.alternating import Alternating
from drake_aigto.aigo.annealing import Annealing
from drake_aigto.aigo.bounded_annealing import BoundedAnnealing
from drake_aigto.aigo.box_search import BoxSearch, LowPoint, SearchResult
from drake_aigto.aigo.continuation import PenaltyContinuation
from drake_aigto.aigo.equal_widths import EqualWidths
from drake_aigto.aigo.face_flow import FaceFlow, Pace
from drake_aigto.aigo.full_gradient import FullGradient
from drake_aigto.aigo.slow_motion import SlowMotion

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
