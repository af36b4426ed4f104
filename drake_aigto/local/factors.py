"""Which factorisation a symmetric indefinite matrix gets."""

from __future__ import annotations

from drake_aigto.local.dense import DenseFactors
from drake_aigto.local.multifrontal import BandFactors
from drake_aigto.local.symmetric import SymmetricFactors

# Up to this size LAPACK takes some 40 µs however wide the band, and spares a plan, whose polish has
# ten to sixty unknowns, the seconds that Numba takes to compile the other.
_SMALL = 100
# A band at least this part of the matrix takes longer than the whole of it: per entry, blocked
# code is some ten times as fast.
_WIDE = 1 / 3


def make_factors(size: int, bandwidth: int) -> SymmetricFactors:
    """Storage for the factors of matrices of this size and half bandwidth."""
    if size <= _SMALL or bandwidth >= _WIDE * size:
        return DenseFactors(size, bandwidth)
    return BandFactors(size, bandwidth)
