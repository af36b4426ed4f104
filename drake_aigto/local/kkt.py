"""KKT matrices of a program: places of the unknowns, assembly, factors and inertia.

A matrix is kept in LAPACK's lower band storage (b + 1, size), in Fortran's order; or, where there
is a `Pattern`, as its entries (1, E). Its diagonal is the beginning of the first row either way.
"""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod

import numpy as np
from scipy.linalg.blas import dsbmv
from scipy.linalg.lapack import dsytrf, dsytrs

from drake_aigto import linear
from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.box import Order, System, add_means, make_lanes
from drake_aigto.terms import StackedTerms

_LOG = logging.getLogger(__name__)

_FEW = 40  # unknowns
_RESIDUAL = 1e-13  # of the largest entry on the right, where refinement stops
_BLOCK = 64  # columns that dsytrf eliminates at a time

# Added to the diagonal of W, and the least that is taken off the zeros below A: a matrix with a
# positive semidefinite W is quasidefinite then (Vanderbei 1995), and no pivot is 0 in any order.
# Refinement takes both out. Less for rows, as those that depend on each other would hinder it.
_SHIFT, _ROW_SHIFT = 1e-9, 1e-10
_LARGEST_ERROR = 1e-6  # of a refined solution's product, for a right-hand side of ones and −1


def make_factors(storage: linear.Storage, is_row: Bools) -> SymmetricFactors:
    """Returns room for factors of KKT matrices, of whose unknowns (size,) some belong to rows."""
    if storage.pattern is not None:
        return SparseKktFactors(storage.pattern, is_row)
    kind = DenseFactors if storage.factorization is linear.Factorization.DENSE else BandFactors
    return kind(storage.size, storage.bandwidth)


class SymmetricFactors(ABC):
    """Factors of one symmetric matrix at a time, all of the same sparsity."""

    _pattern: linear.Pattern | None = None
    _refinements = 2
    _matrix: Floats
    _is_singular: bool

    def factorize(self, matrix: Floats) -> int:
        """Factorizes a matrix, which must not change as long as `solve` is called.

        Returns the number of negative eigenvalues, −1 if the matrix is singular or not finite.
        """
        self._matrix = matrix
        negative = self._factorize(matrix) if np.isfinite(matrix).all() else -1
        self._is_singular = negative < 0
        return negative

    def solve(self, right: Floats) -> Floats:
        """Returns the refined solution for a right-hand side (size,); NaN after a −1."""
        if self._is_singular:
            return np.full(right.size, np.nan)
        solution = self._solve(right)
        goal = _RESIDUAL * max_norm(right)
        for _ in range(self._refinements):
            rest = right - self._multiply(solution)
            if not max_norm(rest) > goal:
                break
            solution += self._solve(rest)
        return solution

    def _multiply(self, x: Floats) -> Floats:
        return multiply_symmetric(self._matrix, x, self._pattern)

    @abstractmethod
    def _factorize(self, matrix: Floats) -> int:
        """As `factorize`, of finite entries; no `solve` follows where it is −1."""

    @abstractmethod
    def _solve(self, right: Floats) -> Floats:
        """Returns the solution (size,) as the factors have it."""


class BandFactors(SymmetricFactors):
    """LDLᵀ that keeps the band: O(n b²) work, O(n b) memory (`linear.factorize_indefinite`)."""

    def __init__(self, size: int, bandwidth: int) -> None:
        """Allocates, which costs as much as filling the arrays."""
        capacity = 4 * (bandwidth + 2)
        self._work = np.empty((capacity, capacity)), np.empty(capacity, dtype=np.int64)
        self._columns = (
            np.empty(size, dtype=np.int64),
            np.empty((size, 2)),
            np.empty(size + 1, dtype=np.int64),
            np.empty(size * capacity, dtype=np.int64),
            np.empty(size * capacity),
        )

    def _factorize(self, matrix: Floats) -> int:
        front, active = self._work
        return linear.factorize_indefinite(matrix.T, front, active, *self._columns)

    def _solve(self, right: Floats) -> Floats:
        solution = right.copy()
        linear.solve_indefinite(*self._columns, solution)
        return solution


class DenseFactors(SymmetricFactors):
    """P A Pᵀ = L D Lᵀ with 1×1 and 2×2 pivots (Bunch & Kaufman 1977): n³/3 work, n² memory."""

    def __init__(self, size: int, bandwidth: int) -> None:
        """Allocates."""
        # Below and on the diagonal, entry (i, j) of a matrix in Fortran's order is i + j size =
        # (i − j) + j (size + 1) away from its start: the rows of the second view are its columns
        # from the diagonal on. Their surplus entries end up above it, where nothing reads them.
        entries = np.zeros(size * (size + 1))
        self._whole = entries[: size * size].reshape((size, size), order="F")
        self._columns = entries.reshape(size, size + 1)[:, : bandwidth + 1]
        self._lower, self._pivots = self._whole, np.zeros(size, dtype=np.int32)

    def _factorize(self, matrix: Floats) -> int:
        size = matrix.shape[1]
        if size == 0:
            return 0
        self._columns[:] = matrix.T
        self._lower, self._pivots, info = dsytrf(self._whole, lower=1, lwork=_BLOCK * size)
        if info != 0:
            return -1
        # Both rows of a 2×2 pivot are marked by a minus; its determinant is negative by choice.
        is_single = self._pivots > 0
        singles = np.count_nonzero(is_single)
        negative = np.count_nonzero(is_single & (self._lower.diagonal() < 0.0))
        return int(negative + (size - singles) // 2)

    def _solve(self, right: Floats) -> Floats:
        if right.size == 0:
            return right
        return dsytrs(self._lower, self._pivots, right, lower=1)[0]


class SparseKktFactors(SymmetricFactors):
    """L D Lᵀ with a diagonal D, in an order of little fill.

    Factors are those of a matrix whose diagonal is shifted a little, and solutions are refined.
    Where refinement does not converge, as pivots were too small, the matrix counts as singular: its
    owner then shifts it further.
    """

    _refinements = 10
    _factors: linear.SparseFactors

    def __init__(self, pattern: linear.Pattern, is_row: Bools) -> None:
        """Takes the pattern, and which unknowns are multipliers of rows (size,)."""
        self._pattern = self._sparsity = pattern
        self._is_row = is_row
        self._probe = np.where(np.arange(is_row.size) % 2, -1.0, 1.0)

    def _factorize(self, matrix: Floats) -> int:
        values = matrix[0].copy()
        diagonal = values[: self._is_row.size]
        shifted = np.where(self._is_row, np.minimum(diagonal, -_ROW_SHIFT), diagonal + _SHIFT)
        values[: shifted.size] = shifted
        factors = linear.factorize(self._sparsity, values)
        if factors is None:
            return -1
        self._factors, self._is_singular = factors, False
        error = max_norm(self._multiply(self.solve(self._probe)) - self._probe)
        return factors.num_negative if error <= _LARGEST_ERROR else -1

    def _solve(self, right: Floats) -> Floats:
        return self._factors.solve(right)


def multiply_symmetric(matrix: Floats, x: Floats, pattern: linear.Pattern | None = None) -> Floats:
    """Returns the product of a symmetric matrix with a vector (size,)."""
    if x.size == 0:
        return x
    if pattern is not None:
        return linear.multiply(pattern, matrix[0], x)
    return dsbmv(matrix.shape[0] - 1, 1.0, matrix, x, lower=1)


def max_norm(values: Floats) -> float:
    """Returns the largest absolute value, 0 of nothing."""
    return float(np.abs(values).max()) if values.size else 0.0


class KktStructure:
    """The KKT matrices of a problem some of whose variables are held.

        [W   Aᵀ]        W = ∇²(s f + Σ λ_i s_i c_i) over the nf free variables,
        [A   0 ]        A = s ∂c over the ma rows that read one of them

    Variables and rows are interleaved: by reverse Cuthill-McKee, or variables in the problem's
    elimination order with each row in the middle of those it reads, whichever has the smaller
    bandwidth. Of few unknowns, finding an order takes longer than it spares: they stay in theirs.
    Where the band is wide, and another order leaves a sparse L, the matrices are sparse.

    Attributes:
        free: Variables that are not held (nf,).
        rows: Rows that read a free variable (ma,).
        variable_places: Place of each free variable among the unknowns (nf,).
        row_places: Place of each of these rows (ma,).
        size: Number of unknowns nf + ma.
        is_row: Which of the unknowns, in their places, belong to rows (size,).
        storage: How the matrices are stored and factorized, and why.
    """

    def __init__(
        self,
        terms: StackedTerms,
        copy_weights: Floats,
        num_costs: int,
        is_free: Bools,
        order: Ints | None,
    ) -> None:
        """Orders the unknowns.

        Args:
            terms: The costs and, behind them, the rows.
            copy_weights: Weight of each copy.
            num_costs: Number of copies that are costs.
            is_free: Which variables are not held (n,).
            order: The problem's elimination order (n,), if it has one.
        """
        self._terms, self._lanes = terms, make_lanes(terms, Order.CENTERS)
        self._copy_weights, self._num_costs, self._order = copy_weights, num_costs, order
        self.free = np.flatnonzero(is_free)
        position = np.full(is_free.size, -1)
        position[self.free] = range(self.free.size)
        rows_read, variables_read, couplings = self._reads(position)
        self.rows, row_numbers = np.unique(rows_read, return_inverse=True)
        self.size = self.free.size + self.rows.size
        incidence = np.vstack([self.free.size + row_numbers, variables_read])
        edges = np.hstack([couplings, incidence])
        orders = self._orders(position, edges, incidence)
        self.storage = linear.choose_storage(self.size, edges, orders, may_be_dense=True)
        places = self.storage.places
        self.variable_places, self.row_places = np.split(places, [self.free.size])
        self._place_of_variable = np.full(is_free.size, -1)
        self._place_of_variable[self.free] = self.variable_places
        self._place_of_copy = np.full(copy_weights.size, -1)
        self._place_of_copy[num_costs + self.rows] = self.row_places
        self.is_row = np.zeros(self.size, dtype=bool)
        self.is_row[self.row_places] = True
        if self.storage.is_large:
            _LOG.info("KKT matrices: %s", self.storage)

    @property
    def bandwidth(self) -> int:
        """Half bandwidth b of the narrowest band that was found."""
        return self.storage.bandwidth

    def _reads(self, position: Ints) -> tuple[Ints, Ints, Ints]:
        """Returns the free variables that copies read.

        Returns:
            A row, and a free variable that it reads, for each such pair; and pairs of free
            variables within one term (2, P).
        """
        copies, pairs = self._terms.couplings()
        found = position[pairs].T
        is_free = np.all(found >= 0, axis=0)
        rows, found = copies[is_free] - self._num_costs, found[:, is_free]
        is_read = (rows >= 0) & (found[0] == found[1])
        return rows[is_read], found[0, is_read], found

    def _orders(self, position: Ints, edges: Ints, incidence: Ints) -> list[Ints]:
        """Returns the places of all unknowns in orders that may have a narrow band."""
        orders = [] if self.size <= _FEW else [linear.narrow_band(self.size, edges)]
        if orders and self._order is None:
            return orders
        kept = position if self._order is None else position[self._order]
        # Variables as given, each row in the middle of those that it reads.
        order = kept[kept >= 0]
        first, last = np.full(self.size, self.size), np.zeros(self.size, dtype=np.int64)
        first[: order.size] = last[: order.size] = rank = np.argsort(order)
        np.minimum.at(first, incidence[0], rank[incidence[1]])
        np.maximum.at(last, incidence[0], rank[incidence[1]])
        return [*orders, np.argsort(np.argsort(first + last, kind="stable"))]

    def assemble(
        self, x: Floats, scales: Floats, multipliers: Floats, values: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """Returns the gradient s ∇f (nf,) and the KKT matrix, (b + 1, size) or (1, E).

        Args:
            x: The point (n,).
            scales: s of each cost copy and each row (num_costs + m,).
            multipliers: λ of the rows that read a free variable (ma,).
            values: Filled with s f_i of each cost copy and s c_i of each row, if given.
        """
        gradient, pattern = np.zeros(self.size), self.storage.pattern
        shape = (self.size, self.bandwidth + 1) if pattern is None else (pattern.rows.size, 1)
        band = np.zeros(shape)
        factors = np.ones(self._copy_weights.size)
        factors[self._num_costs + self.rows] = multipliers
        system = System(
            *(factors, self._place_of_variable, self._place_of_copy, gradient, band, pattern),
            penalties=None,
        )
        if values is None:
            values = np.empty(factors.size)
        add_means(self._lanes, scales * self._copy_weights, x, np.zeros(x.size), values, system)
        # In Fortran's order, which spares BLAS a copy.
        return gradient[self.variable_places], band.T

    def multiply(self, matrix: Floats, x: Floats) -> Floats:
        """Returns the product of a matrix with a vector over all unknowns (size,)."""
        return multiply_symmetric(matrix, x, self.storage.pattern)

    def without_couplings(self, matrix: Floats) -> Floats:
        """Returns a copy of a matrix with W = 0."""
        matrix, pattern = matrix.copy(order="F"), self.storage.pattern
        if pattern is not None:
            matrix[0, ~(self.is_row[pattern.rows] | self.is_row[pattern.columns])] = 0.0
            return matrix
        is_variable = ~self.is_row
        for d, diagonal in enumerate(matrix):
            last = self.size - d
            diagonal[:last][is_variable[:last] & is_variable[d:]] = 0.0
        return matrix

    def steepest_slopes(self, matrix: Floats, units: Floats | float = 1.0) -> Floats:
        """Returns the largest entry of each row of A in absolute value, per unit (ma,).

        Args:
            matrix: The KKT matrix.
            units: Factor of each unknown's column, 1 for those of rows (size,).
        """
        largest, pattern = np.zeros(self.size), self.storage.pattern
        units = np.broadcast_to(units, self.size)
        if pattern is not None:
            i, j = pattern.rows, pattern.columns
            entries = np.abs(matrix[0]) * units[i] * units[j]
            np.maximum.at(largest, i, entries)
            np.maximum.at(largest, j, entries)
            return largest[self.row_places]
        for d in range(self.bandwidth + 1):
            first, last = slice(self.size - d), slice(d, None)
            entries = np.abs(matrix[d, first]) * units[first] * units[last]
            for places in (first, last):
                largest[places] = np.maximum(largest[places], entries)
        return largest[self.row_places]

    def join(self, variables: Floats | float, rows: Floats | float) -> Floats:
        """Returns a vector over all unknowns (size,) from its parts (nf,) and (ma,)."""
        joined = np.empty(self.size)
        joined[self.variable_places] = variables
        joined[self.row_places] = rows
        return joined

    def split(self, unknowns: Floats) -> tuple[Floats, Floats]:
        """Undoes `join`."""
        return unknowns[self.variable_places], unknowns[self.row_places]
