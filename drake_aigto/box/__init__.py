"""Means of sums of products over boxes, in closed form."""

from drake_aigto.box.functions import D_C, D_CC, D_CZ, D_Z, D_ZZ, VALUE, factor_mean
from drake_aigto.box.kernels import NO_SYSTEM, System, add_means
from drake_aigto.box.lanes import Lanes, make_lanes
from drake_aigto.box.polynomial import BoxPolynomial, NewtonSystem, ParametricPolynomial
from drake_aigto.box.tapes import Order

__all__ = [
    "D_C",
    "D_CC",
    "D_CZ",
    "D_Z",
    "D_ZZ",
    "NO_SYSTEM",
    "VALUE",
    "BoxPolynomial",
    "Lanes",
    "NewtonSystem",
    "Order",
    "ParametricPolynomial",
    "System",
    "add_means",
    "factor_mean",
    "make_lanes",
]
