"""Bounds that equality rows leave: where no feasible point is, no box need search."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.jit import kernel
from drake_aigto.local import PolynomialNlp
from drake_aigto.solver.ranges import LARGEST, Range, affine, power_range, product
from drake_aigto.terms import FunctionKind, StackedTerms, stack_terms

Bounds = tuple[Floats, Floats]

_POWER, _EXPONENTIAL = int(FunctionKind.POWER), int(FunctionKind.EXPONENTIAL)
_SINE, _COSINE = int(FunctionKind.SINE), int(FunctionKind.COSINE)

_SWEEPS = 10
_LEAST_CUT = 1e-2  # a sweep that cuts no range by this part of it is the last
_ROUNDING = 1e-9  # new bounds keep this distance, relative to their size, from what rows leave


def tighten(nlp: PolynomialNlp) -> Bounds:
    """Returns lower and upper bounds (n,) that hold for every feasible point.

    In a row Σ_m T_m = 0 with T_m = a_m ∏_i g_i(x_i), a term lies in minus the sum of the others'
    ranges, and a power of it in that over the range of its other factors. Sweeps over the rows go
    on while they cut (feasibility-based bounds tightening: Belotti, Lee, Liberti, Margot & Wächter
    2009, "Branching and bounds tightening techniques for non-convex MINLP", Optim. Methods Softw.
    24:597-634). Where rows leave no point at all, the bounds are those of the program.
    """
    bounds = np.array(nlp.lower), np.array(nlp.upper)
    return bounds if _sweep_rows(nlp, *bounds) else (np.array(nlp.lower), np.array(nlp.upper))


def may_be_feasible(nlp: PolynomialNlp) -> bool:
    """Returns False if interval arithmetic, as in `tighten`, shows that no point meets all rows."""
    return _sweep_rows(nlp, np.array(nlp.lower), np.array(nlp.upper))


def _sweep_rows(nlp: PolynomialNlp, lower: Floats, upper: Floats) -> bool:
    """Tightens bounds in place; returns whether they leave a point."""
    rows = nlp.blocks[len(nlp.costs) :]
    terms = stack_terms(rows)
    cut = 1.0
    for _ in range(_SWEEPS if rows else 0):
        cut = _sweep(terms, lower, upper)
        if cut < _LEAST_CUT:
            break
    return cut >= 0.0


@kernel
def _sweep(stacked: StackedTerms, lower: Floats, upper: Floats) -> float:
    """Tightens the bounds by each row once, in place.

    Returns the largest part that was cut off a range; below 0 if a row leaves no point.
    """
    copies, copy_variables, sums, factors, terms, members, _ = stacked
    low, high = np.empty(terms.size), np.empty(terms.size)
    behind_low, behind_high = np.empty(terms.size), np.empty(terms.size)
    most = 0.0
    for copy in range(copies.size):
        first = sums[copies[copy].sum_index].first_term
        last = sums[copies[copy].sum_index + 1].first_term
        table = factors[sums[copies[copy].sum_index].first_factor :]
        places = copy_variables[copies[copy].first_variable :]
        for m in range(first, last):
            low[m] = high[m] = terms[m].coefficient
            for member in members[terms[m].first_member : terms[m + 1].first_member]:
                i = places[table[member].variable]
                a, b = _factor_range(table[member], lower[i], upper[i])
                low[m], high[m] = product(low[m], high[m], a, b)
        behind_low[last - 1] = behind_high[last - 1] = 0.0
        for m in range(last - 1, first, -1):
            behind_low[m - 1] = behind_low[m] + low[m]
            behind_high[m - 1] = behind_high[m] + high[m]
        before_low = before_high = 0.0
        for m in range(first, last):
            # Minus the others' sum; the total less T_m would be NaN where that is infinite.
            least, largest = -(before_high + behind_high[m]), -(before_low + behind_low[m])
            before_low, before_high = before_low + low[m], before_high + high[m]
            cut = _tighten_factors(
                *(terms[m].coefficient, least, largest, table, places, lower, upper),
                members[terms[m].first_member : terms[m + 1].first_member],
            )
            if cut < 0.0:
                return -1.0
            most = max(most, cut)
    return most


@kernel
def _tighten_factors(
    coefficient: float,
    least: float,
    largest: float,
    table: Any,
    places: Ints,
    lower: Floats,
    upper: Floats,
    members: Ints,
) -> float:
    """Tightens the bounds of a term's variables in place, the term being in [least, largest]."""
    most = 0.0
    for k, member in enumerate(members):
        factor = table[member]
        if factor.kind != _POWER:
            continue
        a = b = coefficient
        for j, other in enumerate(members):
            if j != k:
                v = places[table[other].variable]
                p, q = _factor_range(table[other], lower[v], upper[v])
                a, b = product(a, b, p, q)
        if a <= 0.0 <= b:
            continue
        i = places[factor.variable]
        a, b = product(least, largest, 1.0 / b, 1.0 / a)
        y_low, y_high = affine(factor.scale, factor.offset, lower[i], upper[i])
        a, b = _root_range(a, b, factor.exponent, y_low, y_high)
        if not a <= b:
            return -1.0
        a, b = (a - factor.offset) / factor.scale, (b - factor.offset) / factor.scale
        a, b = min(a, b), max(a, b)
        if a > LARGEST or b < -LARGEST:
            continue  # An exponential overflows, which is no proof.
        a -= _ROUNDING * max(1.0, abs(a))
        b += _ROUNDING * max(1.0, abs(b))
        if a > upper[i] or b < lower[i]:
            return -1.0
        before = upper[i] - lower[i]
        lower[i], upper[i] = max(a, lower[i]), min(b, upper[i])
        after = upper[i] - lower[i]
        if after < before:
            most = max(most, 1.0 - after / before if math.isfinite(before) else 1.0)
    return most


@kernel
def _factor_range(factor: Any, low: float, high: float) -> Range:
    """Returns bounds of a factor over x in [low, high]; of a wave, those of its full swing."""
    y_low, y_high = affine(factor.scale, factor.offset, low, high)
    if factor.kind == _POWER:
        return power_range(y_low, y_high, factor.exponent)
    a, b = power_range(low, high, factor.exponent)
    if factor.kind == _EXPONENTIAL:
        return product(a, b, math.exp(y_low), math.exp(y_high))
    if factor.kind == _SINE or factor.kind == _COSINE:
        return product(a, b, -1.0, 1.0)
    return -np.inf, np.inf


@kernel
def _root_range(a: float, b: float, exponent: int, low: float, high: float) -> Range:
    """Returns bounds of the y in [low, high] with y^p in [a, b]; upside down if there is none."""
    if exponent == 0:
        return -np.inf, np.inf
    root_a, root_b = abs(a) ** (1.0 / exponent), abs(b) ** (1.0 / exponent)
    if exponent % 2 == 1:
        return math.copysign(root_a, a), math.copysign(root_b, b)
    if b < 0.0:
        return 1.0, -1.0
    inner = root_a if a > 0.0 else 0.0
    return (inner if low > -inner else -root_b), (-inner if high < inner else root_b)
