"""Local optima of polynomial programs with equality rows and bounds, by banded Newton steps."""

from drake_aigto.local.interior_point import InteriorPoint
from drake_aigto.local.newton_lagrange import NewtonLagrange
from drake_aigto.local.nlp import PolynomialNlp, compile_nlp
from drake_aigto.local.result import LocalIterate, LocalResult, LocalStatus

__all__ = [
    "InteriorPoint",
    "LocalIterate",
    "LocalResult",
    "LocalStatus",
    "NewtonLagrange",
    "PolynomialNlp",
    "compile_nlp",
]
