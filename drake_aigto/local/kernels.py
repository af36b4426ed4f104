"""A hot loop over KKT matrices in LAPACK's lower band storage: [i − j, j] is entry (i, j)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drake_aigto.jit import njit

Floats = NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def erase_couplings(band: Floats, is_row: NDArray[np.bool_]) -> None:
    """Set W to 0 in the KKT matrix [W Aᵀ; A 0] (b + 1, size), of which `is_row` marks A's rows."""
    for j in range(band.shape[1]):
        for i in range(j, min(j + band.shape[0], band.shape[1])):
            if not is_row[i] and not is_row[j]:
                band[i - j, j] = 0.0
