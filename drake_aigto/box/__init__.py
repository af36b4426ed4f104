"""Costs as flat term tables, and their means over boxes in closed form."""

from drake_aigto.box.compile import compile_program
from drake_aigto.box.functions import FunctionKind
from drake_aigto.box.polynomial import BoxPolynomial, Factor, NewtonSystem, Term, TermBlock

__all__ = [
    "BoxPolynomial",
    "Factor",
    "FunctionKind",
    "NewtonSystem",
    "Term",
    "TermBlock",
    "compile_program",
]
