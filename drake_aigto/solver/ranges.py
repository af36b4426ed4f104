"""Ranges of sums over boxes, and the bounds that rows leave, by interval arithmetic.

Rounding is ignored: bounds that hold whatever is rounded are those of `certify`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.kernels import borrowing, kernel
from drake_aigto.local import PolynomialNlp
from drake_aigto.terms import FunctionKind, StackedTerms, Term, stack_terms

# Exponentials of wide boxes overflow: their range ends here.
LARGEST = 1e15

_POWER, _EXPONENTIAL = int(FunctionKind.POWER), int(FunctionKind.EXPONENTIAL)
_SINE, _COSINE = int(FunctionKind.SINE), int(FunctionKind.COSINE)
_SWEEPS = 10
_LEAST_CUT = 1e-2  # a sweep that cuts no range by this part of it is the last
_DISTANCE = 1e-9  # of new bounds from those that rows leave, relative to their size

Bounds = tuple[Floats, Floats]
Range = tuple[float, float]


@borrowing
def _affine(scale: float, offset: float, low: float, high: float) -> Range:
    """Returns the range of scale · x + offset over x in [low, high]."""
    a, b = scale * low + offset, scale * high + offset
    return min(a, b), max(a, b)


@kernel
def product(a: float, b: float, c: float, d: float) -> Range:
    """Returns the range of x y over x in [a, b], y in [c, d], with 0 · ∞ = 0."""
    products = _times(a, c), _times(a, d), _times(b, c), _times(b, d)
    return min(products), max(products)


@borrowing
def _times(a: float, b: float) -> float:
    return 0.0 if a == 0.0 or b == 0.0 else a * b


@kernel
def power_range(low: float, high: float, exponent: int) -> Range:
    """Returns the range of y^p over y in [low, high]."""
    a, b = low**exponent, high**exponent
    if exponent % 2 == 1 or exponent == 0:
        return a, b
    return (0.0 if low <= 0.0 <= high else min(a, b)), max(a, b)


@kernel
def cosine_range(first: float, last: float) -> Range:
    """Returns the least and largest cosine between two angles."""
    if not last - first < 2 * math.pi:
        return -1.0, 1.0
    a, b = math.cos(first), math.cos(last)
    has_top = math.floor(last / (2 * math.pi)) >= math.ceil(first / (2 * math.pi))
    has_bottom = math.floor(last / (2 * math.pi) - 0.5) >= math.ceil(first / (2 * math.pi) - 0.5)
    return (-1.0 if has_bottom else min(a, b)), (1.0 if has_top else max(a, b))


@kernel
def factor_range(
    kind: int, exponent: int, scale: float, offset: float, low: float, high: float, is_tight: bool
) -> Range:
    """Returns bounds of a `Factor` over x in [low, high]; all numbers of other kinds.

    Those of a sine or cosine are of its full swing, unless they are to be tight.
    """
    y_low, y_high = _affine(scale, offset, low, high)
    if kind == _POWER:
        return power_range(y_low, y_high, exponent)
    if kind == _EXPONENTIAL:
        wave = math.exp(y_low), math.exp(y_high)
    elif kind != _SINE and kind != _COSINE:
        return -np.inf, np.inf
    elif is_tight:
        turn = 0.5 * math.pi if kind == _SINE else 0.0
        wave = cosine_range(y_low - turn, y_high - turn)
    else:
        wave = -1.0, 1.0
    a, b = power_range(low, high, exponent)
    return product(a, b, wave[0], wave[1])


def _term_range(term: Term, low: Floats, high: Floats, is_tight: bool) -> Range:
    ends = term.coefficient, term.coefficient
    for f in term.factors:
        x = float(low[f.variable]), float(high[f.variable])
        factor = factor_range(int(f.kind), f.exponent, f.scale, f.offset, *x, is_tight)
        ends = _clamped(product(*ends, *_clamped(factor)))
    return ends


def _clamped(ends: Range) -> Range:
    return max(ends[0], -LARGEST), min(ends[1], LARGEST)


def sum_range(terms: Sequence[Term], low: Floats, high: Floats) -> Range:
    """Returns bounds of a sum over low ≤ x ≤ high, term by term; at most 1e15 in size.

    Args:
        terms: products of powers, sines, cosines and exponentials.
        low: lower end of each local variable (L,).
        high: upper end (L,).
    """
    ranges = [_term_range(term, low, high, True) for term in terms]
    return _clamped((sum(a for a, _ in ranges), sum(b for _, b in ranges)))


def largest_term(terms: Sequence[Term], low: Floats, high: Floats) -> float:
    """Returns the largest size of a term with factors over low ≤ x ≤ high (L,); waves swing fully.

    Where a wave is near its zero, the row is no smaller for it.
    """
    ranges = [_term_range(term, low, high, False) for term in terms if term.factors]
    return max((abs(end) for ends in ranges for end in ends), default=0.0)


def tighten(nlp: PolynomialNlp) -> Bounds:
    """Returns lower and upper bounds (n,) that hold for every feasible point.

    In a row Σ_m T_m = 0 with T_m = a_m ∏_i g_i(x_i), a term lies in minus the sum of the others'
    ranges, and a power of it in that over the range of its other factors. Sweeps over the rows go
    on while they cut (feasibility-based bounds tightening: Belotti, Lee, Liberti, Margot & Wächter
    2009, "Branching and bounds tightening techniques for non-convex MINLP", Optim. Methods Softw.
    24:597-634). Where rows leave no point at all, the bounds are those of the program.
    """
    return _sweep_rows(nlp) or (np.array(nlp.lower), np.array(nlp.upper))


def _sweep_rows(nlp: PolynomialNlp) -> Bounds | None:
    """Returns tightened bounds; None if they leave no point."""
    lower, upper = np.array(nlp.lower), np.array(nlp.upper)
    rows = nlp.blocks[len(nlp.costs) :]
    terms = stack_terms(rows)
    for _ in range(_SWEEPS if rows else 0):
        cut = _sweep(terms, lower, upper)
        if cut < 0.0:
            return None
        if cut < _LEAST_CUT:
            break
    return lower, upper


@kernel
def _sweep(stacked: StackedTerms, lower: Floats, upper: Floats) -> float:
    """Tightens the bounds by each row once, in place.

    Returns the largest part that was cut off a range; below 0 if a row leaves no point.
    """
    copies, copy_variables, sums, factors, terms, members = stacked
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
                a, b = _range_of(table[member], lower[i], upper[i])
                low[m], high[m] = product(low[m], high[m], a, b)
        behind_low[last - 1] = behind_high[last - 1] = 0.0
        for m in range(last - 1, first, -1):
            behind_low[m - 1] = behind_low[m] + low[m]
            behind_high[m - 1] = behind_high[m] + high[m]
        before_low = before_high = 0.0
        for m in range(first, last):
            # Minus the others' sum; the total less T_m would be NaN where that is infinite.
            ends = -(before_high + behind_high[m]), -(before_low + behind_low[m])
            before_low, before_high = before_low + low[m], before_high + high[m]
            cut = _tighten_factors(
                *(terms[m].coefficient, ends, table, places, lower, upper),
                members[terms[m].first_member : terms[m + 1].first_member],
            )
            if cut < 0.0:
                return -1.0
            most = max(most, cut)
    return most


@borrowing
def _tighten_factors(
    coefficient: float,
    ends: Range,
    table: Any,
    places: Ints,
    lower: Floats,
    upper: Floats,
    members: Ints,
) -> float:
    """Tightens the bounds of a term's variables in place, whose ends are given."""
    most = 0.0
    for k, member in enumerate(members):
        factor = table[member]
        if factor.kind != _POWER:
            continue
        a = b = coefficient
        for j, other in enumerate(members):
            if j != k:
                v = places[table[other].variable]
                p, q = _range_of(table[other], lower[v], upper[v])
                a, b = product(a, b, p, q)
        if a <= 0.0 <= b:
            continue
        i = places[factor.variable]
        a, b = product(ends[0], ends[1], 1.0 / b, 1.0 / a)
        y_low, y_high = _affine(factor.scale, factor.offset, lower[i], upper[i])
        a, b = _root_range(a, b, factor.exponent, y_low, y_high)
        if not a <= b:
            return -1.0
        a, b = (a - factor.offset) / factor.scale, (b - factor.offset) / factor.scale
        a, b = min(a, b), max(a, b)
        if a > LARGEST or b < -LARGEST:
            continue  # An exponential overflows, which is no proof.
        a -= _DISTANCE * max(1.0, abs(a))
        b += _DISTANCE * max(1.0, abs(b))
        if a > upper[i] or b < lower[i]:
            return -1.0
        before = upper[i] - lower[i]
        lower[i], upper[i] = max(a, lower[i]), min(b, upper[i])
        after = upper[i] - lower[i]
        if after < before:
            most = max(most, 1.0 - after / before if math.isfinite(before) else 1.0)
    return most


@borrowing
def _range_of(factor: Any, low: float, high: float) -> Range:
    """Returns bounds of a factor of `StackedTerms`."""
    f = factor
    return factor_range(f.kind, f.exponent, f.scale, f.offset, low, high, False)


@borrowing
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
