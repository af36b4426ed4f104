"""Symmetric matrices of one sparsity: which order, which storage, which factorization."""

from drake_aigto.linear.pattern import Pattern, find_entry, make_pattern, multiply
from drake_aigto.linear.sparse import SparseFactors, factorize
from drake_aigto.linear.storage import (
    Factorization,
    Storage,
    as_order,
    choose_storage,
    narrow_band,
    spread,
)
from drake_aigto.linear.triangular import factor_in_place, solve_factored, solve_factors

__all__ = [
    "Factorization",
    "Pattern",
    "SparseFactors",
    "Storage",
    "as_order",
    "choose_storage",
    "factor_in_place",
    "factorize",
    "find_entry",
    "make_pattern",
    "multiply",
    "narrow_band",
    "solve_factored",
    "solve_factors",
    "spread",
]
