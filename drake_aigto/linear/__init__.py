"""Symmetric matrices of one sparsity: which order, which storage, which factorisation."""

from drake_aigto.linear.pattern import Pattern, make_pattern
from drake_aigto.linear.storage import Factorisation, Storage, as_order, choose_storage, spread

__all__ = [
    "Factorisation",
    "Pattern",
    "Storage",
    "as_order",
    "choose_storage",
    "make_pattern",
    "spread",
]
