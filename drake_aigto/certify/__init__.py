"""Lower bounds: how far an answer is from the best one, at most."""

from drake_aigto.certify.certificate import Certificate, Certifier, Method, certify, relative_gap
from drake_aigto.certify.reach import out_of_reach
from drake_aigto.certify.walls import PlanBound, bound_plans

__all__ = [
    "Certificate",
    "Certifier",
    "Method",
    "PlanBound",
    "bound_plans",
    "certify",
    "out_of_reach",
    "relative_gap",
]
