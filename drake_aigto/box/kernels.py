"""The hot loops: box means of a term block, with gradient and banded Hessian.

Shape letters: K copies of a block, L variables a copy, F factors, M terms, n unknowns of a system.
Every function adds into its outputs, so that blocks can be summed in place. A block of weight 0 is
off: it adds nothing, also where its own mean is infinite.

Numba's cache of this file does not see edits of `functions`: delete `__pycache__` after one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drake_aigto.box.functions import D_C, D_CC, D_CZ, D_Z, D_ZZ, VALUE, factor_mean
from drake_aigto.jit import njit

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# A block's weight and term table: the first arguments of `block_mean` and `block_newton`.
WeightedTable = tuple[float, Ints, Ints, Ints, Ints, Floats, Floats, Floats, Ints, Ints]


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_factors(
    copy_variables: Ints,
    factor_variable: Ints,
    factor_kind: Ints,
    factor_exponent: Ints,
    factor_scale: Floats,
    factor_offset: Floats,
    center: Floats,
    half_width: Floats,
    rows: Floats,
) -> None:
    """Evaluate the F factors of one copy into rows (F, 6)."""
    for f in range(factor_variable.size):
        i = copy_variables[factor_variable[f]]
        factor_mean(
            factor_kind[f],
            factor_exponent[f],
            factor_scale[f],
            factor_offset[f],
            center[i],
            half_width[i],
            rows[f],
        )


@njit(cache=True, nogil=True, error_model="numpy")
def block_mean(
    weight: float,
    variables: Ints,
    factor_variable: Ints,
    factor_kind: Ints,
    factor_exponent: Ints,
    factor_scale: Floats,
    factor_offset: Floats,
    coefficients: Floats,
    starts: Ints,
    members: Ints,
    center: Floats,
    half_width: Floats,
    gradient_c: Floats,
    gradient_z: Floats,
) -> float:
    """Weighted mean of a block's K copies; adds its gradient in (c, z = log w).

    By the product rule on a_m ∏_f μ_f, every factor's partner being the product of the others. That
    product is formed anew, since dividing by μ_f fails where it is 0.

    Args:
        weight: Common factor.
        variables: Variable of each copy's local variables (K, L).
        factor_variable: Local variable of each factor (F,).
        factor_kind: Its `FunctionKind` (F,).
        factor_exponent: Its power (F,).
        factor_scale: Factor inside its function (F,).
        factor_offset: Term inside its function (F,).
        coefficients: Coefficient of each term (M,).
        starts: Term m's factors are members[starts[m]:starts[m + 1]] (M + 1,).
        members: Factors of the terms, one term after the other.
        center: Box center of every variable.
        half_width: Box half width of every variable, ≥ 0.
        gradient_c: Added to, over every variable; empty for the mean alone.
        gradient_z: Added to, over every variable; empty for the mean alone.
    """
    if weight == 0.0:
        return 0.0
    rows = np.empty((factor_variable.size, 6))
    with_gradient = gradient_c.size > 0
    total = 0.0
    for k in range(variables.shape[0]):
        _fill_factors(
            variables[k],
            factor_variable,
            factor_kind,
            factor_exponent,
            factor_scale,
            factor_offset,
            center,
            half_width,
            rows,
        )
        for m in range(coefficients.size):
            first, last = starts[m], starts[m + 1]
            coefficient = weight * coefficients[m]
            product = coefficient
            for a in range(first, last):
                product *= rows[members[a], VALUE]
            total += product
            if not with_gradient:
                continue
            for a in range(first, last):
                others = coefficient
                for b in range(first, last):
                    if b != a:
                        others *= rows[members[b], VALUE]
                i = variables[k, factor_variable[members[a]]]
                gradient_c[i] += others * rows[members[a], D_C]
                gradient_z[i] += others * rows[members[a], D_Z]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _add_to_band(band: Floats, i: int, j: int, value: float) -> None:
    """Add to entry (i, j) = (j, i) of a symmetric matrix in LAPACK's lower band storage."""
    if i >= j:
        band[i - j, j] += value
    else:
        band[j - i, i] += value


@njit(cache=True, nogil=True, error_model="numpy")
def block_newton(
    weight: float,
    variables: Ints,
    factor_variable: Ints,
    factor_kind: Ints,
    factor_exponent: Ints,
    factor_scale: Floats,
    factor_offset: Floats,
    coefficients: Floats,
    starts: Ints,
    members: Ints,
    center: Floats,
    half_width: Floats,
    position: Ints,
    stride: int,
    gradient: Floats,
    band: Floats,
) -> float:
    """Weighted mean of a block's K copies; adds gradient and Hessian of the Newton system.

    The arguments up to half_width are those of `block_mean`. `position` is the place of each
    variable in the elimination order; `stride` is 2 for unknowns (c_i, z_i) at 2·position and
    2·position + 1, or 1 for c_i alone at position. `gradient` (n,) and `band` in lower band storage
    (rows, n) are added to.
    """
    if weight == 0.0:
        return 0.0
    rows = np.empty((factor_variable.size, 6))
    total = 0.0
    for k in range(variables.shape[0]):
        _fill_factors(
            variables[k],
            factor_variable,
            factor_kind,
            factor_exponent,
            factor_scale,
            factor_offset,
            center,
            half_width,
            rows,
        )
        for m in range(coefficients.size):
            first, last = starts[m], starts[m + 1]
            coefficient = weight * coefficients[m]
            product = coefficient
            for a in range(first, last):
                product *= rows[members[a], VALUE]
            total += product
            for a in range(first, last):
                row_a = rows[members[a]]
                i = stride * position[variables[k, factor_variable[members[a]]]]
                others = coefficient
                for b in range(first, last):
                    if b != a:
                        others *= rows[members[b], VALUE]
                gradient[i] += others * row_a[D_C]
                band[0, i] += others * row_a[D_CC]
                if stride == 2:
                    gradient[i + 1] += others * row_a[D_Z]
                    band[1, i] += others * row_a[D_CZ]
                    band[0, i + 1] += others * row_a[D_ZZ]
                for b in range(a + 1, last):
                    row_b = rows[members[b]]
                    j = stride * position[variables[k, factor_variable[members[b]]]]
                    pair = coefficient
                    for d in range(first, last):
                        if d != a and d != b:
                            pair *= rows[members[d], VALUE]
                    _add_to_band(band, i, j, pair * row_a[D_C] * row_b[D_C])
                    if stride == 2:
                        _add_to_band(band, i, j + 1, pair * row_a[D_C] * row_b[D_Z])
                        _add_to_band(band, i + 1, j, pair * row_a[D_Z] * row_b[D_C])
                        _add_to_band(band, i + 1, j + 1, pair * row_a[D_Z] * row_b[D_Z])
    return total
