"""Hot loops of the local solver.

KKT matrices are in LAPACK's lower band storage: [i − j, j] is entry (i, j).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drake_aigto.box.functions import VALUE, factor_mean
from drake_aigto.box.tables import StackedTerms
from drake_aigto.jit import njit

Floats = NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def erase_couplings(band: Floats, is_row: NDArray[np.bool_]) -> None:
    """Set W to 0 in the KKT matrix [W Aᵀ; A 0] (b + 1, size), of which `is_row` marks A's rows."""
    for j in range(band.shape[1]):
        for i in range(j, min(j + band.shape[0], band.shape[1])):
            if not is_row[i] and not is_row[j]:
                band[i - j, j] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def fill_magnitudes(
    stacked: StackedTerms, weights: Floats, x: Floats, first: int, magnitudes: Floats
) -> None:
    """Fill magnitudes (K,) with Σ |weight · term| at x (n,), of K copies from the first one on."""
    copies, copy_variables, sums, factors, terms, members, most_factors = stacked
    sizes, row = np.empty(most_factors), np.empty(6)
    for copy in range(first, first + magnitudes.size):
        number, first_variable = copies[copy].sum_index, copies[copy].first_variable
        first_factor = sums[number].first_factor
        for f in range(first_factor, sums[number + 1].first_factor):
            factor = factors[f]
            value = x[copy_variables[first_variable + factor.variable]]
            factor_mean(factor.kind, factor.exponent, factor.scale, factor.offset, value, 0.0, row)
            sizes[f - first_factor] = abs(row[VALUE])
        magnitude = 0.0
        for m in range(sums[number].first_term, sums[number + 1].first_term):
            size = abs(weights[copy] * terms[m].coefficient)
            for a in range(terms[m].first_member, terms[m + 1].first_member):
                size *= sizes[members[a]]
            magnitude += size
        magnitudes[copy - first] = magnitude
