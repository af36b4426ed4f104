"""Sums of terms at points, in compiled code: values, slopes, and Hessians as bands, with factors.

`box.add_means` has the same at half widths of 0, for means of any width, several times slower: a
function that many terms read is computed once here, whichever sums they belong to.

Shape letters: F functions, C copies (costs, and behind them the m rows), M terms of all copies, G
factors of all terms, E entries of the rows' Jacobian, nf free variables, half bandwidth b.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array

from drake_aigto.arrays import Bools, Floats, Ints, Records
from drake_aigto.box import D_C, D_CC, VALUE, factor_mean
from drake_aigto.kernels import inner
from drake_aigto.linear import narrow_band
from drake_aigto.local.nlp import PolynomialNlp
from drake_aigto.terms import FunctionKind

_POWER, _COSINE = int(FunctionKind.POWER), int(FunctionKind.COSINE)
_SINE = int(FunctionKind.SINE)
_PARTS = 6  # of a factor's mean
_LEAST_PIVOT = 1e-14


class PointTables(NamedTuple):
    """Arrays of a program for kernels. Parts of an entry end where the next one's start.

    Attributes:
        functions: each a `Factor`, whose variable is the program's (F,).
        coefficients: of each term, times its copy's weight (M,).
        first_factors: place of a term's first factor (M + 1,).
        factors: function that a factor is (G,).
        first_terms: place of a copy's first term (C + 1,).
        num_costs: number of copies that are costs.
        slots: entry of the rows' Jacobian that a factor's derivative belongs to, or −1 (G,).
        first_entries: first entry of each row (m + 1,).
        entry_places: place of the variable that an entry is a derivative by (E,).
        places: place of each variable in the band, −1 where it is held (n,).
        bandwidth: b.
    """

    functions: Records
    coefficients: Floats
    first_factors: Ints
    factors: Ints
    first_terms: Ints
    num_costs: int
    slots: Ints
    first_entries: Ints
    entry_places: Ints
    places: Ints
    bandwidth: int

    @property
    def size(self) -> int:
        """Number of free variables nf."""
        return int(np.count_nonzero(self.places >= 0))


def make_point_tables(nlp: PolynomialNlp) -> PointTables:
    """Returns the tables of a program, its free variables in an order of narrow band."""
    terms, is_free = nlp.terms, nlp.lower != nlp.upper
    sums = terms.copies["sum_index"]
    copy_of_term, term = _expand(terms.sums["first_term"], sums)
    term_of_factor, member = _expand(terms.terms["first_member"], term)
    copy_of_factor = copy_of_term[term_of_factor]
    own = terms.factors[terms.sums["first_factor"][sums[copy_of_factor]] + terms.members[member]]
    variable = terms.copy_variables[
        terms.copies["first_variable"][copy_of_factor] + own["variable"]
    ]
    own["variable"] = variable
    functions, factors = np.unique(own, return_inverse=True)
    row = copy_of_factor - nlp.num_costs
    slots, entry_rows, entries = _entries(row, variable, is_free)
    places, bandwidth = _band(nlp, entry_rows, entries, is_free)
    return PointTables(
        functions=functions,
        coefficients=terms.terms["coefficient"][term] * nlp.copy_weights[copy_of_term],
        first_factors=_starts(term_of_factor, term.size),
        factors=factors.ravel(),
        first_terms=_starts(copy_of_term, sums.size),
        num_costs=nlp.num_costs,
        slots=slots,
        first_entries=_starts(entry_rows, nlp.num_rows),
        entry_places=places[entries],
        places=places,
        bandwidth=bandwidth,
    )


def _expand(firsts: Ints, which: Ints) -> tuple[Ints, Ints]:
    """Returns, for all that belongs to some entries, the entry's number and its own."""
    counts = np.diff(firsts)[which]
    owner = np.repeat(np.arange(which.size), counts)
    return owner, np.arange(owner.size) - np.repeat(np.cumsum(counts) - counts, counts) + (
        np.repeat(firsts[which], counts)
    )


def _starts(owners: Ints, count: int) -> Ints:
    """Returns where the entries of each owner start, which rise."""
    return np.searchsorted(owners, np.arange(count + 1))


def _entries(row: Ints, variable: Ints, is_free: Bools) -> tuple[Ints, Ints, Ints]:
    """Returns the slot of each factor, and the row and variable of each slot."""
    in_row = (row >= 0) & is_free[variable]
    pairs = row[in_row] * is_free.size + variable[in_row]
    found, slots = np.unique(pairs, return_inverse=True)
    all_slots = np.full(row.size, -1)
    all_slots[in_row] = slots.ravel()
    return all_slots, found // is_free.size, found % is_free.size


def _band(nlp: PolynomialNlp, rows: Ints, variables: Ints, is_free: Bools) -> tuple[Ints, int]:
    """Returns the places of all variables, where those of a row are coupled, and the bandwidth."""
    free = np.flatnonzero(is_free)
    position = np.full(is_free.size, -1)
    position[free] = np.arange(free.size)
    shape = nlp.num_rows, free.size
    jacobian = coo_array((np.ones(rows.size), (rows, position[variables])), shape=shape).tocsr()
    coupled = (jacobian.T @ jacobian).tocoo()
    in_terms = position[nlp.terms.couplings()[1]].T
    edges = np.hstack([np.vstack(coupled.coords), in_terms[:, np.all(in_terms >= 0, axis=0)]])
    places = np.full(is_free.size, -1)
    order = narrow_band(free.size, edges)
    places[free] = order
    return places, int(np.max(np.abs(order[edges[0]] - order[edges[1]]), initial=0))


@inner
def _power(y: float, exponent: int) -> float:
    """Returns y^exponent, 0 for a negative exponent: of derivatives, which have a factor 0 then."""
    if exponent < 0:
        return 0.0
    total = 1.0
    for _ in range(exponent):
        total *= y
    return total


@inner
def _set_function(tables: PointTables, f: int, x: Floats, parts: Floats) -> None:
    """Fills the value, slope and curvature of a function."""
    own = tables.functions[f]
    kind, p, scale, offset, at = own.kind, own.exponent, own.scale, own.offset, x[own.variable]
    if kind == _POWER:
        y = scale * at + offset
        parts[VALUE] = _power(y, p)
        parts[D_C] = scale * p * _power(y, p - 1)
        parts[D_CC] = scale * scale * p * (p - 1) * _power(y, p - 2)
    elif p == 0 and (kind in (_COSINE, _SINE)):
        cosine, sine = math.cos(scale * at + offset), math.sin(scale * at + offset)
        parts[VALUE] = cosine if kind == _COSINE else sine
        parts[D_C] = scale * (-sine if kind == _COSINE else cosine)
        parts[D_CC] = -scale * scale * parts[VALUE]
    else:
        factor_mean(kind, p, scale, offset, at, 0.0, parts)


class PointSystem(NamedTuple):
    """Derivatives at a point, as `differentiate` fills them.

    Attributes:
        values: of the functions (F,).
        slopes: of the functions (F,).
        curvatures: of the functions (F,).
        gradient: of the scaled costs, over the free variables in their places (nf,).
        jacobian: of the rows, its entries (E,).
        hessian: of scaled costs and rows times multipliers: entry (j + d, j) at [j, d],
            (nf, b + 1).
    """

    values: Floats
    slopes: Floats
    curvatures: Floats
    gradient: Floats
    jacobian: Floats
    hessian: Floats


def make_point_system(tables: PointTables) -> PointSystem:
    """Returns room for the derivatives of a program."""
    num_functions, size = tables.functions.size, tables.size
    values, slopes, curvatures = np.zeros((3, num_functions))
    return PointSystem(
        values=values,
        slopes=slopes,
        curvatures=curvatures,
        gradient=np.zeros(size),
        jacobian=np.zeros(tables.entry_places.size),
        hessian=np.zeros((size, tables.bandwidth + 1)),
    )


@inner
def evaluate(tables: PointTables, x: Floats, values: Floats, rows: Floats) -> float:
    """Fills the rows c(x) (m,), and the functions' values (F,); returns the costs f(x)."""
    parts = np.empty(_PARTS)
    for i in range(values.size):
        _set_function(tables, i, x, parts)
        values[i] = parts[VALUE]
    # Named once: each access of an array in a tuple counts references.
    coefficients, factors = tables.coefficients, tables.factors
    first_factors, first_terms = tables.first_factors, tables.first_terms
    f = 0.0
    for copy in range(first_terms.size - 1):
        total = 0.0
        for term in range(first_terms[copy], first_terms[copy + 1]):
            product = coefficients[term]
            for g in range(first_factors[term], first_factors[term + 1]):
                product *= values[factors[g]]
            total += product
        if copy < tables.num_costs:
            f += total
        else:
            rows[copy - tables.num_costs] = total
    return f


@inner
def _set_derivatives(tables: PointTables, x: Floats, system: PointSystem) -> None:
    """Fills the functions' values and derivatives, and clears all else."""
    parts = np.empty(_PARTS)
    values, slopes, curvatures = system.values, system.slopes, system.curvatures
    for i in range(values.size):
        _set_function(tables, i, x, parts)
        values[i], slopes[i], curvatures[i] = parts[VALUE], parts[D_C], parts[D_CC]
    system.gradient[:], system.jacobian[:] = 0.0, 0.0
    system.hessian[:] = 0.0


@inner
def differentiate(
    tables: PointTables, x: Floats, cost_scale: float, multipliers: Floats, system: PointSystem
) -> None:
    """Fills the gradient of s f, the rows' Jacobian, and ∇²(s f + Σ λ_i c_i).

    Args:
        tables: of the program.
        x: point (n,).
        cost_scale: s.
        multipliers: λ (m,).
        system: room for the derivatives.
    """
    _set_derivatives(tables, x, system)
    coefficients, factors, slots = tables.coefficients, tables.factors, tables.slots
    first_factors, first_terms = tables.first_factors, tables.first_terms
    places, functions = tables.places, tables.functions
    values, slopes, curvatures = system.values, system.slopes, system.curvatures
    gradient, jacobian, hessian = system.gradient, system.jacobian, system.hessian
    for copy in range(first_terms.size - 1):
        row = copy - tables.num_costs
        weight = cost_scale if row < 0 else multipliers[row]
        for term in range(first_terms[copy], first_terms[copy + 1]):
            first, last = first_factors[term], first_factors[term + 1]
            for g in range(first, last):
                own = factors[g]
                place = places[functions[own].variable]
                if place < 0:
                    continue
                rest = coefficients[term]
                for h in range(first, last):
                    if h != g:
                        rest *= values[factors[h]]
                if row < 0:
                    gradient[place] += cost_scale * rest * slopes[own]
                else:
                    jacobian[slots[g]] += rest * slopes[own]
                hessian[place, 0] += weight * rest * curvatures[own]
                for h in range(g + 1, last):
                    other = factors[h]
                    other_place = places[functions[other].variable]
                    if other_place < 0:
                        continue
                    mixed = weight * coefficients[term] * slopes[own] * slopes[other]
                    for k in range(first, last):
                        if k != g and k != h:
                            mixed *= values[factors[k]]
                    hessian[min(place, other_place), abs(place - other_place)] += mixed


@inner
def factorize_band(band: Floats) -> bool:
    """Overwrites a matrix with its factor L, A = L Lᵀ; False if it is not positive definite.

    It has entry (j + d, j) at [j, d], shape (size, b + 1): one row is a column from the diagonal
    on. SciPy's factors have to be called from Python, which takes as long as those of a small band.
    """
    size, width = band.shape
    for j in range(size):
        if not band[j, 0] > _LEAST_PIVOT:
            return False
        band[j, 0] = math.sqrt(band[j, 0])
        last = min(width, size - j)
        inverse = 1.0 / band[j, 0]
        for d in range(1, last):
            band[j, d] *= inverse
        for d in range(1, last):
            factor = band[j, d]
            if factor != 0.0:
                for e in range(d, last):
                    band[j + d, e - d] -= factor * band[j, e]
    return True


@inner
def solve_band(band: Floats, right: Floats) -> None:
    """Overwrites a right-hand side (size,) with the solution, given the factor L."""
    size, width = band.shape
    for j in range(size):
        right[j] /= band[j, 0]
        for d in range(1, min(width, size - j)):
            right[j + d] -= band[j, d] * right[j]
    for j in range(size - 1, -1, -1):
        total = right[j]
        for d in range(1, min(width, size - j)):
            total -= band[j, d] * right[j + d]
        right[j] = total / band[j, 0]
