"""Means of sums of products over boxes, in closed form."""

from drake_aigto.box.kernels import NO_SYSTEM, System, add_means
from drake_aigto.box.lanes import Lanes, make_lanes
from drake_aigto.box.parameters import ParametricPolynomial
from drake_aigto.box.polynomial import BoxPolynomial, NewtonSystem
from drake_aigto.box.tapes import Order

__all__ = [
    "NO_SYSTEM",
    "BoxPolynomial",
    "Lanes",
    "NewtonSystem",
    "Order",
    "ParametricPolynomial",
    "System",
    "add_means",
    "make_lanes",
]
