"""Symmetric matrices of one sparsity: which order, which storage, which factorisation."""

from drake_aigto.linear.pattern import Pattern, find_entry, make_pattern, multiply
from drake_aigto.linear.sparse import SparseFactors, factorise
from drake_aigto.linear.storage import Factorisation, Storage, as_order, choose_storage, spread

__all__ = [
    "Factorisation",
    "Pattern",
    "SparseFactors",
    "Storage",
    "as_order",
    "choose_storage",
    "factorise",
    "find_entry",
    "make_pattern",
    "multiply",
    "spread",
]
