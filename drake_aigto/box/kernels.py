"""The hot loops: means of stacked sums over boxes, with their derivatives in (c, z = log w).

A copy of weight 0 is off: it adds nothing, also where its own mean is infinite. Derivatives come
from the product rule on a_m ∏_f μ_f, by products of what stands before and behind a factor: to
divide by μ_f would fail where it is 0. At a half width of 0 means are values.

Shape letters as in `StackedTerms`, and n variables. A symmetric matrix is kept in LAPACK's lower
band storage, transposed to be of one type for Numba however few diagonals there are: entry (i, j),
i ≥ j, at [j, i − j].

Helpers that take arrays are inlined: to call one takes as long as a short term.
Numba's cache of this file does not see edits of `functions`: delete `__pycache__` after one.
"""

from __future__ import annotations

import numpy as np

from drake_aigto.box.functions import (
    D_C,
    D_CC,
    D_CZ,
    D_Z,
    D_ZZ,
    VALUE,
    FunctionKind,
    factor_mean,
)
from drake_aigto.box.tables import Floats, Ints, Records, StackedTerms
from drake_aigto.jit import njit

_POWER = int(FunctionKind.POWER)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _fill_rows(
    copy: np.record,
    copy_variables: Ints,
    sums: Records,
    factors: Records,
    center: Floats,
    half_width: Floats,
    rows: Floats,
    variables: Ints,
) -> int:
    """Evaluate a copy's factors into rows (most_factors, 6), and look up their variables.

    Returns:
        How many they are.
    """
    first = sums[copy.sum_index].first_factor
    count = sums[copy.sum_index + 1].first_factor - first
    for f in range(count):
        factor = factors[first + f]
        i = copy_variables[copy.first_variable + factor.variable]
        variables[f] = i
        scale = factor.scale
        y, reach = scale * center[i] + factor.offset, scale * half_width[i]
        # The most common functions by hand: a fifth of the time.
        if factor.kind == _POWER and factor.exponent == 1:
            rows[f, VALUE], rows[f, D_C], rows[f, D_CC] = y, scale, 0.0
            rows[f, D_Z], rows[f, D_CZ], rows[f, D_ZZ] = 0.0, 0.0, 0.0
        elif factor.kind == _POWER and factor.exponent == 2:
            variance = reach * reach / 3.0
            rows[f, VALUE], rows[f, D_C], rows[f, D_CC] = (
                y * y + variance,
                2 * y * scale,
                2 * scale**2,
            )
            rows[f, D_Z], rows[f, D_CZ], rows[f, D_ZZ] = 2 * variance, 0.0, 4 * variance
        else:
            box = center[i], half_width[i]
            factor_mean(factor.kind, factor.exponent, scale, factor.offset, *box, rows[f])
    return count


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _multiply(
    coefficient: float,
    members: Ints,
    first: int,
    last: int,
    rows: Floats,
    before: Floats,
    partials: Floats,
) -> float:
    """The term coefficient · ∏ μ of members[first:last]; adds its derivative by each μ to partials.

    before[0], before[1], … become the coefficient times the μ that stand before each of them.
    """
    product = coefficient
    for a in range(first, last):
        before[a - first] = product
        product *= rows[members[a], VALUE]
    behind = 1.0
    for a in range(last - 1, first - 1, -1):
        partials[members[a]] += before[a - first] * behind
        behind *= rows[members[a], VALUE]
    return product


@njit(cache=True, nogil=True, error_model="numpy")
def add_means(
    stacked: StackedTerms,
    weights: Floats,
    center: Floats,
    half_width: Floats,
    values: Floats,
    gradient_c: Floats,
    gradient_z: Floats,
) -> float:
    """Weighted means of the copies; returns their sum, and adds its gradient.

    Args:
        stacked: The sums.
        weights: Factor of each copy (C,).
        center: Box center of every variable (n,).
        half_width: Box half width of every variable (n,), ≥ 0.
        values: Filled with weight · mean of every copy (C,).
        gradient_c: Added to (n,); empty for the means alone.
        gradient_z: Added to (n,); empty for the means alone.
    """
    # Unpacked, as Numba counts references at every use of an array within a tuple.
    copies, copy_variables, sums, factors, terms, members, most_factors, longest_term = stacked
    rows, variables = np.empty((most_factors, 6)), np.empty(most_factors, np.int64)
    partials, before = np.empty(most_factors), np.empty(longest_term)
    with_gradient = gradient_c.size > 0
    total = 0.0
    for copy in range(copies.size):
        values[copy] = 0.0
        if weights[copy] == 0.0:
            continue
        num_factors = _fill_rows(
            copies[copy], copy_variables, sums, factors, center, half_width, rows, variables
        )
        for f in range(num_factors):
            partials[f] = 0.0
        value = 0.0
        for m in range(
            sums[copies[copy].sum_index].first_term, sums[copies[copy].sum_index + 1].first_term
        ):
            first, last = terms[m].first_member, terms[m + 1].first_member
            coefficient = weights[copy] * terms[m].coefficient
            if with_gradient:
                value += _multiply(coefficient, members, first, last, rows, before, partials)
            else:
                for a in range(first, last):
                    coefficient *= rows[members[a], VALUE]
                value += coefficient
        if with_gradient:
            for f in range(num_factors):
                gradient_c[variables[f]] += partials[f] * rows[f, D_C]
                gradient_z[variables[f]] += partials[f] * rows[f, D_Z]
        values[copy] = value
        total += value
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _add(band: Floats, i: int, j: int, value: float) -> None:
    """Add to entry (i, j) = (j, i) of a symmetric matrix."""
    if i >= j:
        band[j, i - j] += value
    else:
        band[i, j - i] += value


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _add_pair(
    band: Floats, stride: int, i: int, j: int, others: float, row_i: Floats, row_j: Floats
) -> None:
    """Add the Hessian of others · μ_i μ_j between two variables at places i and j, if both ≥ 0."""
    if i < 0 or j < 0:
        return
    _add(band, i, j, others * row_i[D_C] * row_j[D_C])
    if stride == 2:
        _add(band, i, j + 1, others * row_i[D_C] * row_j[D_Z])
        _add(band, i + 1, j, others * row_i[D_Z] * row_j[D_C])
        _add(band, i + 1, j + 1, others * row_i[D_Z] * row_j[D_Z])


@njit(cache=True, nogil=True, error_model="numpy")
def add_newton_system(
    stacked: StackedTerms,
    weights: Floats,
    multipliers: Floats,
    center: Floats,
    half_width: Floats,
    variable_places: Ints,
    copy_places: Ints,
    stride: int,
    gradient: Floats,
    band: Floats,
) -> float:
    """Add the KKT matrix [W Aᵀ; A 0] of the copies' means, and the gradient of what has no row.

        W = Σ multiplier · weight · ∇²mean,      A's row of a copy: weight · ∇mean

    Args:
        stacked: The sums.
        weights: Factor of each copy (C,).
        multipliers: Factor of each copy's Hessian (C,).
        center: Box center of every variable (n,).
        half_width: Box half width of every variable (n,), ≥ 0.
        variable_places: Place of each variable's first unknown in the matrix, −1 for a variable
            that is held (n,).
        copy_places: Place of each copy that is one of A's rows, −1 for one that is not (C,).
        stride: 2 for unknowns (c_i, z_i), which stand next to each other, or 1 for c_i alone.
        gradient: weight · ∇mean of the copies of place −1 is added (size,).
        band: Added to (size, number of diagonals).

    Returns:
        The sum of weight · mean over all copies.
    """
    # Unpacked, as Numba counts references at every use of an array within a tuple.
    copies, copy_variables, sums, factors, terms, members, most_factors, longest_term = stacked
    rows, variables = np.empty((most_factors, 6)), np.empty(most_factors, np.int64)
    places = np.empty(most_factors, np.int64)
    partials, before = np.empty(most_factors), np.empty(longest_term)
    total = 0.0
    for copy in range(copies.size):
        if weights[copy] == 0.0:
            continue
        num_factors = _fill_rows(
            copies[copy], copy_variables, sums, factors, center, half_width, rows, variables
        )
        for f in range(num_factors):
            partials[f] = 0.0
            places[f] = variable_places[variables[f]]
        value = 0.0
        for m in range(
            sums[copies[copy].sum_index].first_term, sums[copies[copy].sum_index + 1].first_term
        ):
            first, last = terms[m].first_member, terms[m + 1].first_member
            coefficient = weights[copy] * terms[m].coefficient
            value += _multiply(coefficient, members, first, last, rows, before, partials)
            behind = multipliers[copy]
            for a in range(last - 1, first, -1):
                f = members[a]
                between = behind
                for b in range(a - 1, first - 1, -1):
                    g = members[b]
                    pair = before[b - first] * between
                    _add_pair(band, stride, places[f], places[g], pair, rows[f], rows[g])
                    between *= rows[g, VALUE]
                behind *= rows[f, VALUE]
        total += value
        for f in range(num_factors):
            i, curvature = places[f], multipliers[copy] * partials[f]
            if i < 0:
                continue
            band[i, 0] += curvature * rows[f, D_CC]
            if stride == 2:
                band[i, 1] += curvature * rows[f, D_CZ]
                band[i + 1, 0] += curvature * rows[f, D_ZZ]
            for part in range(stride):
                slope = partials[f] * rows[f, D_C + part]
                if copy_places[copy] < 0:
                    gradient[i + part] += slope
                else:
                    _add(band, copy_places[copy], i + part, slope)
    return total
