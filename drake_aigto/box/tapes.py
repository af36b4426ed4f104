"""Sums of terms as tapes: straight-line programs for their means and derivatives.

f̄ is multilinear in the means μ_f of a sum's factors, so that with

    P_f = ∂f̄/∂μ_f = Σ_terms a ∏_{g≠f} μ_g,      P_fg = ∂²f̄/∂μ_f ∂μ_g

all its derivatives are those of the factors' means, put together: Σ_fg P_fg ∇μ_f ∇μ_gᵀ over the
factors of two variables is their block of the Hessian. P is made of products of what stands before,
between and behind factors: to divide by μ_f would fail where it is 0.

A tape is a list of operations  row_to (+)= factor · row_a · row_b  on rows of numbers, one number
for each copy of the sum, so that a kernel reads it once for many copies (`kernels`). Sums that
differ in their coefficients alone share a tape.
"""

from __future__ import annotations

import enum
import functools
import itertools
import math
from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from drake_aigto.arrays import Records, locked
from drake_aigto.box.functions import D_C, D_CC, D_CZ, D_Z, D_ZZ, VALUE
from drake_aigto.terms import FunctionKind

# row_to = factor · row_a · row_b, or += where it adds.
OPERATION = np.dtype(
    [*((name, np.int64) for name in ("to", "adds", "a", "b")), ("factor", np.float64)], align=True
)

ONES, MEAN = 0, 1  # The first rows: ones, and the sum's mean.

_LARGEST_POWER = 12  # Larger ones are left to `factor_mean`, as are all other functions.
_KEPT, _LONGEST_KEPT = 256, 1000  # Tapes that are kept, of sums of no more terms than that.

Argument = tuple[int, float, float]  # Local variable x, scale and offset of y = scale·x + offset.
Function = tuple[int, int, int, float, float]  # Variable, kind, exponent, scale and offset.
_Scaled = tuple[float, int]  # A factor and a row.
_Key = TypeVar("_Key", bound=Hashable)


class Order(enum.Enum):
    """Derivatives of a mean that a tape computes, as parts of the factors' means, after its value.

    Without the value, `MEAN` would be (), which Debian's Python 3.11.2 makes an `object` in enums.
    """

    MEAN = (VALUE,)
    GRADIENT = (VALUE, D_C, D_Z)
    CENTERS = (VALUE, D_C, D_CC)  # Gradient and Hessian in c alone.
    BOXES = (VALUE, D_C, D_Z, D_CC, D_CZ, D_ZZ)

    @property
    def num_unknowns(self) -> int:
        """Unknowns of a variable: c and z, or c alone."""
        return 1 if self is Order.CENTERS else 2


# Second derivatives by one variable: the part, and by which of its unknowns (c, z) it is.
_CURVATURES = {D_CC: (0, 0), D_CZ: (1, 0), D_ZZ: (1, 1)}
_SLOPES = D_C, D_Z


@dataclass(frozen=True, eq=False)
class MeanTape:
    """The program of one sum, for many copies of it.

    Rows are, one after the other: ones; the mean; y and (scale · w)² of each argument; the six of
    each function that the kernel evaluates, of a cosine also the sine's; each term's coefficient;
    and others that operations set.
    """

    operations: Records  # Records of `OPERATION` in their order, read-only
    num_variables: int  # Local variables, 0 … num_variables − 1
    # The gradient: row, local variable, and its unknown, 0 for c and 1 for z.
    slopes: tuple[tuple[int, int, int], ...]
    # The Hessian, each pair of unknowns once: row, local variable, its unknown, the other variable
    # and its unknown.
    curvatures: tuple[tuple[int, int, int, int, int], ...]
    arguments: tuple[Argument, ...]  # Of the powers that the tape evaluates
    functions: tuple[Function, ...]  # Functions that the kernel evaluates
    num_terms: int  # Number of coefficients
    num_rows: int  # Number of all rows


def make_tape(
    factors: tuple[Function, ...], members: tuple[tuple[int, ...], ...], order: Order
) -> MeanTape:
    """Returns the tape of a sum.

    Args:
        factors: Its different factors.
        members: The factors of each term.
        order: Which derivatives it computes.
    """
    make = _make_and_keep if len(members) <= _LONGEST_KEPT else _make_and_keep.__wrapped__
    return make(factors, members, order)


@functools.lru_cache(_KEPT)
def _make_and_keep(
    factors: tuple[Function, ...], members: tuple[tuple[int, ...], ...], order: Order
) -> MeanTape:
    return _Writer(factors, members, order).write()


class _Writer:
    """Writes one tape."""

    def __init__(
        self, factors: tuple[Function, ...], members: tuple[tuple[int, ...], ...], order: Order
    ) -> None:
        """Assigns the rows that operations do not set."""
        self._factors, self._members, self._order = factors, members, order
        self._operations: list[tuple[int, bool, int, int, float]] = []
        self._num_rows = MEAN + 1
        powers = [factor for factor in factors if _is_power(factor)]
        self._arguments = self._new_rows(dict.fromkeys(map(_argument, powers)), 2)
        functions = dict.fromkeys(_evaluated(f) for f in factors if not _is_power(f))
        pairs = [function for function in functions if function[1] == FunctionKind.COSINE]
        self._functions = self._new_rows(pairs, 12)
        self._functions |= self._new_rows((f for f in functions if f not in self._functions), 6)
        self._coefficients = self._new_rows(range(len(members)))
        self._scratch = self._new_rows(range(2 + max(map(len, members), default=0)))
        self._monomials: dict[tuple[Argument, int, int], int] = {}
        self._moments: dict[tuple[Argument, int, int], _Scaled] = {}
        self._partials: dict[int, int] = {}
        self._pairs: dict[tuple[int, int], int] = {}
        self._slopes: dict[tuple[int, int], int] = {}
        self._curvatures: dict[tuple[int, int, int, int], int] = {}

    def write(self) -> MeanTape:
        """Returns the tape: factors, then terms, then what they make of the variables."""
        parts = [self._parts(factor) for factor in self._factors]
        values = [part[VALUE][1] for part in parts]
        self._operations.append((MEAN, False, ONES, ONES, 0.0))
        for coefficient, term in zip(self._coefficients.values(), self._members, strict=True):
            self._write_term(coefficient, term, values)
        for f, partial in self._partials.items():
            self._write_variable(self._factors[f][0], partial, parts[f])
        for (f, g), pair in self._pairs.items():
            self._write_pair(f, g, pair, parts)
        operations = locked(np.array(self._operations, dtype=OPERATION))
        return MeanTape(
            *(operations, max((factor[0] for factor in self._factors), default=-1) + 1),
            tuple((row, *key) for key, row in self._slopes.items()),
            tuple((row, *key) for key, row in self._curvatures.items()),
            *(tuple(self._arguments), tuple(self._functions)),
            *(len(self._members), self._num_rows),
        )

    def _new_rows(self, keys: Iterable[_Key], each: int = 1) -> dict[_Key, int]:
        """Gives each key a number of rows; returns the first ones."""
        rows = dict(zip(keys, itertools.count(self._num_rows, each), strict=False))
        self._num_rows += each * len(rows)
        return rows

    def _set(self, a: int, b: int, to: int | None = None) -> int:
        """Sets a row, a new one if None, to a product; returns it."""
        if to is None:
            (to,) = self._new_rows((None,)).values()
        self._operations.append((to, False, a, b, 1.0))
        return to

    def _add(self, sums: dict[_Key, int], key: _Key, a: _Scaled, b: _Scaled) -> None:
        """Adds a product to one of some sums, whose row the first product sets."""
        adds = key in sums
        if not adds:
            sums |= self._new_rows((key,))
        self._operations.append((sums[key], adds, a[1], b[1], a[0] * b[0]))

    def _parts(self, factor: Function) -> dict[int, _Scaled]:
        """Returns the value and derivatives of a factor, those left out being 0 or not needed."""
        needed: tuple[int, ...] = self._order.value
        if not _is_power(factor):
            first = self._functions[_evaluated(factor)]
            first += 6 if factor[1] == FunctionKind.SINE else 0
            return {part: (1.0, first + part) for part in needed}
        y, p, scale = _argument(factor), factor[2], factor[3]
        makers: dict[int, tuple[float, int, int]] = {
            VALUE: (1.0, p, 0),
            D_C: (p * scale, p - 1, 0),
            D_CC: (p * (p - 1) * scale**2, p - 2, 0),
            D_Z: (1.0, p, 1),
            D_CZ: (p * scale, p - 1, 1),
            D_ZZ: (1.0, p, 2),
        }
        found = {}
        for part in needed:
            by, power, times = makers[part]
            if power >= (2 if times else 0):
                found[part] = self._moment(y, power, times, by)
        return found

    def _moment(self, y: Argument, p: int, times: int, factor: float) -> _Scaled:
        """Returns factor · (w ∂/∂w)^times of Σ_j C(p, 2j)/(2j + 1) y^{p−2j} w^{2j}, y^p's mean."""
        key = y, p, times
        if key not in self._moments:
            summands = [
                (math.comb(p, 2 * j) / (2 * j + 1) * (2.0 * j) ** times, self._monomial(y, p, j))
                for j in range(1 if times else 0, p // 2 + 1)
            ]
            if len(summands) > 1:
                (row,) = self._new_rows((None,)).values()
                for number, (by, monomial) in enumerate(summands):
                    self._operations.append((row, number > 0, ONES, monomial, by))
                summands = [(1.0, row)]
            (self._moments[key],) = summands
        by, row = self._moments[key]
        return factor * by, row

    def _monomial(self, y: Argument, p: int, j: int) -> int:
        """Returns the row of y^{p−2j} w^{2j}."""
        powers = p - 2 * j, j
        if powers in ((0, 0), (1, 0), (0, 1)):
            return ONES if powers == (0, 0) else self._arguments[y] + powers[1]
        key = y, *powers
        if key not in self._monomials:
            # Halves of a pure power, or the pure powers of a product.
            both = min(powers) > 0
            split = (p - 2 * j, 0) if both else (powers[0] // 2, powers[1] // 2)
            rest = powers[0] - split[0], powers[1] - split[1]
            rows = (self._monomial(y, a + 2 * b, b) for a, b in (split, rest))
            self._monomials[key] = self._set(*rows)
        return self._monomials[key]

    def _write_term(self, coefficient: int, term: tuple[int, ...], values: list[int]) -> None:
        """Adds coefficient · ∏ μ to the mean, and its derivatives by each μ, and each two of them.

        before[a] is the coefficient times the μ that stand before the term's factor a.
        """
        last, also_last, *scratch = self._scratch.values()
        before = [coefficient]
        for f, row in zip(term[:-1], scratch, strict=False):
            before.append(self._set(before[-1], values[f], row))
        value = values[term[-1]] if term else ONES
        self._operations.append((MEAN, True, before[-1], value, 1.0))
        if self._order is Order.MEAN:
            return
        with_pairs = self._order is not Order.GRADIENT
        behind = ONES
        for a in reversed(range(len(term))):
            self._add(self._partials, term[a], (1.0, before[a]), (1.0, behind))
            between = behind
            for b in reversed(range(a if with_pairs else 0)):
                f, g = sorted((term[b], term[a]), key=lambda f: self._factors[f][0])
                self._add(self._pairs, (f, g), (1.0, before[b]), (1.0, between))
                if b > 0:
                    between = self._times(between, values[term[b]], also_last)
            if a > 0:
                behind = self._times(behind, values[term[a]], last)

    def _times(self, product: int, value: int, to: int) -> int:
        return value if product == ONES else self._set(product, value, to)

    def _write_variable(self, variable: int, partial: int, parts: dict[int, _Scaled]) -> None:
        """Adds P_f times a factor's derivatives to those by its variable."""
        for part, scaled in parts.items():
            if part in _SLOPES:
                self._add(self._slopes, (variable, _SLOPES.index(part)), (1.0, partial), scaled)
            elif part in _CURVATURES:
                one, other = _CURVATURES[part]
                key = variable, one, variable, other
                self._add(self._curvatures, key, (1.0, partial), scaled)

    def _write_pair(self, f: int, g: int, pair: int, parts: list[dict[int, _Scaled]]) -> None:
        """Adds P_fg ∂μ_f ∂μ_g to the derivatives by the variables of f and g."""
        half, *_ = self._scratch.values()
        for unknown, part in enumerate(_SLOPES):
            if part not in parts[f]:
                continue
            by, row = parts[f][part]
            product = by, pair if row == ONES else self._set(pair, row, half)
            for other_unknown, other_part in enumerate(_SLOPES):
                if other_part in parts[g]:
                    key = self._factors[f][0], unknown, self._factors[g][0], other_unknown
                    self._add(self._curvatures, key, product, parts[g][other_part])


def _is_power(factor: Function) -> bool:
    """Returns whether a tape evaluates it, rather than the kernel."""
    return factor[1] == FunctionKind.POWER and factor[2] <= _LARGEST_POWER


def _evaluated(factor: Function) -> Function:
    """Returns what the kernel evaluates for a factor: of sines the cosine, which brings them."""
    variable, kind, exponent, scale, offset = factor
    kind = FunctionKind.COSINE if kind == FunctionKind.SINE else kind
    return variable, kind, exponent, scale, offset


def _argument(factor: Function) -> Argument:
    variable, _, _, scale, offset = factor
    return variable, scale, offset
