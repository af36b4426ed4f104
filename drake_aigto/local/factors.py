"""The factors that a storage of KKT matrices asks for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drake_aigto.linear import Factorization, Storage
from drake_aigto.local.dense import DenseFactors
from drake_aigto.local.multifrontal import BandFactors
from drake_aigto.local.sparse import SparseKktFactors
from drake_aigto.local.symmetric import SymmetricFactors


def make_factors(storage: Storage, is_row: NDArray[np.bool_]) -> SymmetricFactors:
    """Returns room for factors of KKT matrices, of whose unknowns (size,) some belong to rows."""
    if storage.pattern is not None:
        return SparseKktFactors(storage.pattern, is_row)
    kind = DenseFactors if storage.factorization is Factorization.DENSE else BandFactors
    return kind(storage.size, storage.bandwidth)
