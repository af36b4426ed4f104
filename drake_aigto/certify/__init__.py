"""Lower bounds: how far an answer is from the best one, at most."""

from drake_aigto.certify import intervals
from drake_aigto.certify.certificate import Certificate, Certifier, Method, certify, relative_gap
from drake_aigto.certify.enclosures import enclose_all
from drake_aigto.certify.flights import Line, Wall
from drake_aigto.certify.formulas import formula_of, read_formulas
from drake_aigto.certify.infeasibility import explain_infeasibility, is_infeasible
from drake_aigto.certify.plans import PlanBound, bound_plans, fold, out_of_reach
from drake_aigto.certify.relaxation import Relaxation
from drake_aigto.certify.relaxation_kernels import safe_bound
from drake_aigto.certify.scip import write_sum
from drake_aigto.certify.tape import Operation, Tape, make_tape
from drake_aigto.certify.touches import bound_line

__all__ = [
    "Certificate",
    "Certifier",
    "Line",
    "Method",
    "Operation",
    "PlanBound",
    "Relaxation",
    "Tape",
    "Wall",
    "bound_line",
    "bound_plans",
    "certify",
    "enclose_all",
    "explain_infeasibility",
    "fold",
    "formula_of",
    "intervals",
    "is_infeasible",
    "make_tape",
    "out_of_reach",
    "read_formulas",
    "relative_gap",
    "safe_bound",
    "write_sum",
]
