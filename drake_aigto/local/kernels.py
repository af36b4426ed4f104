"""The hot loops: values and derivatives of many small sums at a point, and banded assembly.

Shape letters: T term tables, C copies (sums bound to variables), n variables; F factors and M terms
over all tables. A symmetric matrix is kept in LAPACK's lower band storage: entry (i, j), i ≥ j, at
[i − j, j].

Numba's cache of this file does not see edits of `box.functions`: delete `__pycache__` after one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drake_aigto.box.functions import D_C, D_CC, VALUE, FunctionKind, factor_mean
from drake_aigto.jit import njit

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# The first arguments of `values_at` and `derivatives_at`; `StackedTerms` names and shapes them.
Tables = tuple[Ints, Ints, Ints, Ints, Ints, Ints, Ints, Ints, Floats, Floats, Floats, Ints, Ints]

_POWER = int(FunctionKind.POWER)


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_factor(
    kind: int, exponent: int, scale: float, offset: float, x: float, rows: Floats, f: int
) -> None:
    """Value, slope and curvature of one factor at x, into row f; the most common ones by hand."""
    if kind == _POWER and exponent == 1:
        rows[f, VALUE], rows[f, D_C], rows[f, D_CC] = scale * x + offset, scale, 0.0
    elif kind == _POWER and exponent == 2:
        y = scale * x + offset
        rows[f, VALUE], rows[f, D_C], rows[f, D_CC] = y * y, 2.0 * y * scale, 2.0 * scale * scale
    else:
        factor_mean(kind, exponent, scale, offset, x, 0.0, rows[f])


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_factors(
    table: int,
    variables: Ints,
    table_factors: Ints,
    factor_variable: Ints,
    factor_kind: Ints,
    factor_exponent: Ints,
    factor_scale: Floats,
    factor_offset: Floats,
    x: Floats,
    rows: Floats,
) -> None:
    """Evaluate a copy's factors into the first rows of (F, 6)."""
    first = table_factors[table]
    for f in range(first, table_factors[table + 1]):
        _fill_factor(
            factor_kind[f],
            factor_exponent[f],
            factor_scale[f],
            factor_offset[f],
            x[variables[factor_variable[f]]],
            rows,
            f - first,
        )


@njit(cache=True, nogil=True, error_model="numpy")
def values_at(
    copy_table: Ints,
    copy_starts: Ints,
    copy_variables: Ints,
    table_factors: Ints,
    table_terms: Ints,
    factor_variable: Ints,
    factor_kind: Ints,
    factor_exponent: Ints,
    factor_scale: Floats,
    factor_offset: Floats,
    coefficients: Floats,
    term_starts: Ints,
    members: Ints,
    x: Floats,
    values: Floats,
) -> None:
    """Fill values (C,) with every copy's sum at x (n,)."""
    if copy_table.size == 0:
        return
    rows = np.empty((np.max(table_factors[1:] - table_factors[:-1]), 6))
    for copy in range(copy_table.size):
        table = copy_table[copy]
        variables = copy_variables[copy_starts[copy] : copy_starts[copy + 1]]
        _fill_factors(
            table,
            variables,
            table_factors,
            factor_variable,
            factor_kind,
            factor_exponent,
            factor_scale,
            factor_offset,
            x,
            rows,
        )
        total = 0.0
        for m in range(table_terms[table], table_terms[table + 1]):
            product = coefficients[m]
            for a in range(term_starts[m], term_starts[m + 1]):
                product *= rows[members[a], VALUE]
            total += product
        values[copy] = total


@njit(cache=True, nogil=True, error_model="numpy")
def _add(band: Floats, i: int, j: int, value: float) -> None:
    """Add to entry (i, j) = (j, i); places below 0 stand for held variables and are left out."""
    if i < 0 or j < 0:
        return
    if i >= j:
        band[i - j, j] += value
    else:
        band[j - i, i] += value


@njit(cache=True, nogil=True, error_model="numpy")
def derivatives_at(
    copy_table: Ints,
    copy_starts: Ints,
    copy_variables: Ints,
    table_factors: Ints,
    table_terms: Ints,
    factor_variable: Ints,
    factor_kind: Ints,
    factor_exponent: Ints,
    factor_scale: Floats,
    factor_offset: Floats,
    coefficients: Floats,
    term_starts: Ints,
    members: Ints,
    x: Floats,
    scales: Floats,
    multipliers: Floats,
    variable_places: Ints,
    copy_places: Ints,
    gradient: Floats,
    band: Floats,
) -> None:
    """Add the KKT matrix [W Aᵀ; A 0] at x to a band, and the gradient of what has no row.

    Args:
        copy_table: Term table of each copy (C,).
        copy_starts: Copy c's variables are copy_variables[copy_starts[c]:copy_starts[c + 1]].
        copy_variables: Variables of the copies, one copy after the other.
        table_factors: Table t's factors are table_factors[t] to table_factors[t + 1] (T + 1,).
        table_terms: Its terms, likewise (T + 1,).
        factor_variable: Place of each factor's variable among its copy's variables (F,).
        factor_kind: Its `FunctionKind` (F,).
        factor_exponent: Its power (F,).
        factor_scale: Factor inside its function (F,).
        factor_offset: Term inside its function (F,).
        coefficients: Coefficient of each term (M,).
        term_starts: Term m's factors are members[term_starts[m]:term_starts[m + 1]] (M + 1,).
        members: Factors of the terms, counted from the table's first.
        x: The point (n,).
        scales: Factor s of each copy (C,).
        multipliers: Factor λ of each copy's Hessian (C,): W = Σ λ s ∇²copy.
        variable_places: Row of each variable in the matrix, −1 for one that is held (n,).
        copy_places: Row of each copy that is one of A's, −1 for one that is not (C,).
        gradient: s ∇copy of the copies with place −1 is added (n,).
        band: Added to, lower band storage.
    """
    if copy_table.size == 0:
        return
    rows = np.empty((np.max(table_factors[1:] - table_factors[:-1]), 6))
    for copy in range(copy_table.size):
        table = copy_table[copy]
        variables = copy_variables[copy_starts[copy] : copy_starts[copy + 1]]
        _fill_factors(
            table,
            variables,
            table_factors,
            factor_variable,
            factor_kind,
            factor_exponent,
            factor_scale,
            factor_offset,
            x,
            rows,
        )
        place, multiplier = copy_places[copy], multipliers[copy]
        base = table_factors[table]
        for m in range(table_terms[table], table_terms[table + 1]):
            first, last = term_starts[m], term_starts[m + 1]
            coefficient = scales[copy] * coefficients[m]
            for a in range(first, last):
                variable = variables[factor_variable[base + members[a]]]
                i = variable_places[variable]
                others = coefficient
                for b in range(first, last):
                    if b != a:
                        others *= rows[members[b], VALUE]
                slope = others * rows[members[a], D_C]
                if place < 0:
                    gradient[variable] += slope
                else:
                    _add(band, place, i, slope)
                _add(band, i, i, multiplier * others * rows[members[a], D_CC])
                for b in range(a + 1, last):
                    pair = multiplier * coefficient * rows[members[a], D_C] * rows[members[b], D_C]
                    for d in range(first, last):
                        if d != a and d != b:
                            pair *= rows[members[d], VALUE]
                    j = variable_places[variables[factor_variable[base + members[b]]]]
                    _add(band, i, j, pair)


@njit(cache=True, nogil=True, error_model="numpy")
def erase_couplings(band: Floats, is_row: NDArray[np.bool_]) -> None:
    """Set W to 0 in the KKT matrix [W Aᵀ; A 0] (b + 1, size), of which `is_row` marks A's rows."""
    for j in range(band.shape[1]):
        for i in range(j, min(j + band.shape[0], band.shape[1])):
            if not is_row[i] and not is_row[j]:
                band[i - j, j] = 0.0
