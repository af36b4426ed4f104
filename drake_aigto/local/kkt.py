"""Where the unknowns of a program stand in KKT matrices, and their assembly."""

from __future__ import annotations

import logging

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.box import Order, System, add_means, make_lanes
from drake_aigto.linear import choose_storage, narrow_band
from drake_aigto.local.factors import multiply
from drake_aigto.terms import StackedTerms

_LOG = logging.getLogger(__name__)

_FEW = 40  # unknowns


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
            num_costs: How many copies are costs.
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
        self.storage = choose_storage(self.size, edges, orders, may_be_dense=True)
        places = self.storage.places
        self.variable_places, self.row_places = np.split(places, [self.free.size])
        self._place_of_variable = np.full(is_free.size, -1)
        self._place_of_variable[self.free] = self.variable_places
        self._place_of_copy = np.full(copy_weights.size, -1)
        self._place_of_copy[num_costs + self.rows] = self.row_places
        self.is_row = np.zeros(self.size, dtype=bool)
        self.is_row[self.row_places] = True
        if self.storage.is_worth_telling:
            _LOG.info("KKT matrices: %s", self.storage)

    @property
    def bandwidth(self) -> int:
        """Half bandwidth b of the narrowest band that was found."""
        return self.storage.bandwidth

    def _reads(self, position: Ints) -> tuple[Ints, Ints, Ints]:
        """Returns what the copies read of the free variables.

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
        orders = [] if self.size <= _FEW else [narrow_band(self.size, edges)]
        if orders and self._order is None:
            return orders
        kept = position if self._order is None else position[self._order]
        return [*orders, self._by_stages(kept[kept >= 0], incidence)]

    def _by_stages(self, order: Ints, incidence: Ints) -> Ints:
        """Returns variables as given, each row in the middle of those that it reads."""
        first, last = np.full(self.size, self.size), np.zeros(self.size, dtype=np.int64)
        first[: order.size] = last[: order.size] = rank = np.argsort(order)
        np.minimum.at(first, incidence[0], rank[incidence[1]])
        np.maximum.at(last, incidence[0], rank[incidence[1]])
        return np.argsort(np.argsort(first + last, kind="stable"))

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
            factors, self._place_of_variable, self._place_of_copy, gradient, band, pattern
        )
        if values is None:
            values = np.empty(factors.size)
        add_means(self._lanes, scales * self._copy_weights, x, np.zeros(x.size), values, system)
        # In Fortran's order, which spares BLAS a copy.
        return gradient[self.variable_places], band.T

    def multiply(self, matrix: Floats, x: Floats) -> Floats:
        """Returns the product of a matrix with a vector over all unknowns (size,)."""
        return multiply(matrix, x, self.storage.pattern)

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

    def steepest_slopes(self, matrix: Floats) -> Floats:
        """Returns the largest entry of each row of A in absolute value (ma,)."""
        largest, pattern = np.zeros(self.size), self.storage.pattern
        if pattern is not None:
            for ends in (pattern.rows, pattern.columns):
                np.maximum.at(largest, ends, np.abs(matrix[0]))
            return largest[self.row_places]
        for d in range(self.bandwidth + 1):
            entries = np.abs(matrix[d, : self.size - d])
            for places in (slice(self.size - d), slice(d, None)):
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
