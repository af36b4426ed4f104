"""Where the unknowns of a `PolynomialNlp` stand in banded KKT matrices, and their assembly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from drake_aigto.box.kernels import System, add_means
from drake_aigto.box.lanes import make_lanes
from drake_aigto.box.tapes import Order

if TYPE_CHECKING:
    from drake_aigto.local.nlp import PolynomialNlp

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_FEW = 40  # unknowns


class KktStructure:
    """The KKT matrices of a problem some of whose variables are held, ordered as bands.

        [W   Aᵀ]        W = ∇²(s f + Σ λ_i s_i c_i) over the nf free variables,
        [A   0 ]        A = s ∂c over the ma rows that read one of them

    Variables and rows are interleaved: by reverse Cuthill-McKee, or variables in the problem's
    elimination order with each row in the middle of those it reads, whichever has the smaller
    bandwidth. Of few unknowns, finding an order takes longer than it spares: they stay in theirs.

    Attributes:
        free: Variables that are not held (nf,).
        rows: Rows that read a free variable (ma,).
        variable_places: Place of each free variable among the unknowns (nf,).
        row_places: Place of each of these rows (ma,).
        size: Number of unknowns nf + ma.
        bandwidth: Half bandwidth b.
    """

    def __init__(self, nlp: PolynomialNlp) -> None:
        """Order the unknowns; variables with equal bounds are held."""
        self._nlp, self._lanes = nlp, make_lanes(nlp.terms, Order.CENTERS)
        self.free = np.flatnonzero(nlp.lower != nlp.upper)
        position = np.full(nlp.num_variables, -1)
        position[self.free] = range(self.free.size)
        rows_read, variables_read, couplings = self._reads(position)
        self.rows, row_numbers = np.unique(rows_read, return_inverse=True)
        self.size = self.free.size + self.rows.size
        incidence = np.vstack([self.free.size + row_numbers, variables_read])
        edges = np.hstack([couplings, incidence])
        places = self._order(position, edges, incidence)
        self.bandwidth = _bandwidth(places, edges)
        self.variable_places, self.row_places = np.split(places, [self.free.size])
        self._place_of_variable = np.full(nlp.num_variables, -1)
        self._place_of_variable[self.free] = self.variable_places
        self._place_of_copy = np.full(nlp.num_costs + nlp.num_rows, -1)
        self._place_of_copy[nlp.num_costs + self.rows] = self.row_places
        self._is_variable = np.zeros(self.size, dtype=bool)
        self._is_variable[self.variable_places] = True

    def _reads(self, position: Ints) -> tuple[Ints, Ints, Ints]:
        """What the copies read of the free variables.

        Returns:
            A row, and a free variable that it reads, for each such pair; and pairs of free
            variables within one term (2, P).
        """
        copies, pairs = self._nlp.terms.couplings()
        found = position[pairs].T
        is_free = np.all(found >= 0, axis=0)
        rows, found = copies[is_free] - self._nlp.num_costs, found[:, is_free]
        is_read = (rows >= 0) & (found[0] == found[1])
        return rows[is_read], found[0, is_read], found

    def _order(self, position: Ints, edges: Ints, incidence: Ints) -> Ints:
        """The place of every unknown."""
        order, are_few = self._nlp.order, self.size <= _FEW
        if order is None and not are_few:
            return self._cuthill_mckee(edges)
        kept = position if order is None else position[order]
        by_stages = self._by_stages(kept[kept >= 0], incidence)
        if are_few:
            return by_stages
        candidates = self._cuthill_mckee(edges), by_stages
        return min(candidates, key=lambda candidate: _bandwidth(candidate, edges))

    def _cuthill_mckee(self, edges: Ints) -> Ints:
        graph = coo_array((np.ones(edges.shape[1]), tuple(edges)), shape=(self.size, self.size))
        order = reverse_cuthill_mckee((graph + graph.T).tocsr(), symmetric_mode=True)
        return np.argsort(order)

    def _by_stages(self, order: Ints, incidence: Ints) -> Ints:
        """Variables as given, each row in the middle of those that it reads."""
        first, last = np.full(self.size, self.size), np.zeros(self.size, dtype=np.int64)
        first[: order.size] = last[: order.size] = rank = np.argsort(order)
        np.minimum.at(first, incidence[0], rank[incidence[1]])
        np.maximum.at(last, incidence[0], rank[incidence[1]])
        return np.argsort(np.argsort(first + last, kind="stable"))

    def assemble(self, x: Floats, scales: Floats, multipliers: Floats) -> tuple[Floats, Floats]:
        """Gradient s ∇f (nf,), and the KKT matrix in lower band storage (b + 1, size).

        Args:
            x: The point (n,).
            scales: s of each cost copy and each row (num_costs + m,).
            multipliers: λ of the rows that read a free variable (ma,).
        """
        nlp = self._nlp
        gradient = np.zeros(self.size)
        band = np.zeros((self.size, self.bandwidth + 1))
        factors = np.ones(nlp.num_costs + nlp.num_rows)
        factors[nlp.num_costs + self.rows] = multipliers
        system = System(factors, self._place_of_variable, self._place_of_copy, gradient, band)
        weights = scales * nlp.copy_weights
        add_means(self._lanes, weights, x, np.zeros(x.size), np.empty(factors.size), system)
        # In Fortran's order, which spares BLAS a copy.
        return gradient[self.variable_places], band.T

    def without_couplings(self, band: Floats) -> Floats:
        """A copy of the matrix with W = 0."""
        band = band.copy(order="F")
        for d, diagonal in enumerate(band):
            last = self.size - d
            diagonal[:last][self._is_variable[:last] & self._is_variable[d:]] = 0.0
        return band

    def steepest_slopes(self, band: Floats) -> Floats:
        """Largest entry of each row of A in absolute value (ma,)."""
        largest = np.zeros(self.size)
        for d in range(self.bandwidth + 1):
            entries = np.abs(band[d, : self.size - d])
            for places in (slice(self.size - d), slice(d, None)):
                largest[places] = np.maximum(largest[places], entries)
        return largest[self.row_places]

    def join(self, variables: Floats | float, rows: Floats | float) -> Floats:
        """A vector over all unknowns (size,) from its parts (nf,) and (ma,)."""
        joined = np.empty(self.size)
        joined[self.variable_places] = variables
        joined[self.row_places] = rows
        return joined

    def split(self, unknowns: Floats) -> tuple[Floats, Floats]:
        """Undo `join`."""
        return unknowns[self.variable_places], unknowns[self.row_places]


def _bandwidth(places: Ints, edges: Ints) -> int:
    return int(np.max(np.abs(places[edges[0]] - places[edges[1]]), initial=0))
