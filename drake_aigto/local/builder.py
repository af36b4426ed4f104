"""A `PolynomialNlp` put together from numbers, without a MathematicalProgram."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Floats, Ints
from drake_aigto.local.nlp import PolynomialNlp, check_bounds
from drake_aigto.terms import Factor, FunctionKind, Term, TermBlock

# A coefficient, and the variables that it is multiplied by; one that is there twice is squared.
Monomial = tuple[float, tuple[int, ...]]


class NlpBuilder:
    """Collects variables with bounds, costs and rows that are sums of monomials.

    Letters: K copies of a sum that has L variables of its own.
    """

    def __init__(self) -> None:
        """Starts empty."""
        self._size = 0
        self._bounds: list[tuple[Ints | int, ArrayLike, ArrayLike]] = []
        self._costs: list[TermBlock] = []
        self._rows: list[TermBlock] = []
        # Variables that stand for an affine sum: variable, coefficients, variables, offset; and for
        # a sum of products: variable, and the two variables of each product.
        self._sums: list[tuple[int, Floats, Ints, float]] = []
        self._products: list[tuple[int, Ints, Ints]] = []

    def new(self, *shape: int) -> Ints:
        """Returns new variables without bounds: their indices, of this shape."""
        first, self._size = self._size, self._size + math.prod(shape)
        return np.arange(first, self._size).reshape(shape)

    def bound(self, variables: Ints | int, lower: ArrayLike, upper: ArrayLike) -> None:
        """Adds lower ≤ x ≤ upper; the tightest of a variable's bounds count."""
        self._bounds.append((variables, lower, upper))

    def add_cost(self, name: str, monomials: Iterable[Monomial], copies: ArrayLike) -> None:
        """Adds a cost over local variables 0 … L−1, once for each row of `copies` (K, L)."""
        self._costs.append(TermBlock(name, _terms(monomials), copies))

    def add_row(self, name: str, monomials: Iterable[Monomial], copies: ArrayLike) -> None:
        """Adds rows sum = 0 over local variables 0 … L−1, one for each row of `copies` (K, L)."""
        self._rows.append(TermBlock(name, _terms(monomials), copies))

    def bound_sum(
        self,
        name: str,
        coefficients: Floats,
        variables: Ints,
        lower: float,
        upper: float,
        offset: float = 0.0,
    ) -> None:
        """Adds lower ≤ coefficients · x + offset ≤ upper as bounds, a row, or a sum's variable."""
        used = np.flatnonzero(coefficients)
        scales, read = coefficients[used], variables[used]
        if used.size == 1:
            limits = np.array([lower - offset, upper - offset]) / scales[0]
            self.bound(read[0], *np.sort(limits))
        elif lower == upper:
            self.add_row(name, [*_affine(scales), (offset - lower, ())], read)
        else:
            self.bound(self.new_sum(name, scales, read, offset), lower, upper)

    def new_sum(self, name: str, coefficients: Floats, variables: Ints, offset: float = 0.0) -> int:
        """Returns a new variable that equals coefficients · x + offset."""
        (total,) = self.new(1).tolist()
        self._sums.append((total, coefficients, variables, offset))
        row = [*_affine(coefficients), (offset, ()), (-1.0, (variables.size,))]
        self.add_row(name, row, np.append(variables, total))
        return int(total)

    def new_product(self, name: str, factors: Ints, variables: Ints) -> int:
        """Returns a new variable that equals Σ factor · variable, where factors are variables."""
        (total,) = self.new(1).tolist()
        self._products.append((total, factors, variables))
        L = factors.size
        row: list[Monomial] = [(1.0, (i, L + i)) for i in range(L)]
        copy = np.concatenate([factors, variables, [total]])
        self.add_row(name, [*row, (-1.0, (2 * L,))], copy)
        return int(total)

    def complete(self, x: Floats) -> Floats:
        """Returns a point (n,): the variables given, and the sums that have a variable.

        Those that are not given are 0.
        """
        complete = np.append(x, np.zeros(self._size - x.size))
        for total, factors, variables in self._products:
            complete[total] = complete[factors] @ complete[variables]
        for total, coefficients, variables, offset in self._sums:
            complete[total] = coefficients @ complete[variables] + offset
        return complete

    def build(self) -> PolynomialNlp:
        """Returns the problem; a small one is eliminated in the order in which variables were made.

        Raises:
            UnsupportedTermError: Bounds contradict each other.
        """
        lower, upper = np.full(self._size, -np.inf), np.full(self._size, np.inf)
        for variables, low, high in self._bounds:
            lower[variables] = np.maximum(lower[variables], low)
            upper[variables] = np.minimum(upper[variables], high)
        check_bounds(lower, upper, "unknown {}".format)
        return PolynomialNlp(self._size, tuple(self._costs), tuple(self._rows), lower, upper)


def _affine(coefficients: Floats) -> list[Monomial]:
    return [(scale, (i,)) for i, scale in enumerate(coefficients.tolist())]


def _terms(monomials: Iterable[Monomial]) -> tuple[Term, ...]:
    """Returns the monomials that are not zero."""
    return tuple(
        Term(float(coefficient), _factors(variables))
        for coefficient, variables in monomials
        if coefficient
    )


@cache
def _factors(variables: tuple[int, ...]) -> tuple[Factor, ...]:
    powers = {variable: variables.count(variable) for variable in variables}
    return tuple(Factor(i, FunctionKind.POWER, power) for i, power in powers.items())
