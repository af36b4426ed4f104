"""Where the unknowns of a `PolynomialNlp` stand in banded KKT matrices, and their assembly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from drake_aigto.local.kernels import derivatives_at, erase_couplings

if TYPE_CHECKING:
    from drake_aigto.local.nlp import PolynomialNlp

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class KktStructure:
    """The KKT matrices of a problem some of whose variables are held, ordered as bands.

        [W   Aᵀ]        W = ∇²(s f + Σ λ_i s_i c_i) over the nf free variables,
        [A   0 ]        A = s ∂c over the ma rows that read one of them

    Variables and rows are interleaved: by reverse Cuthill-McKee, or variables in the problem's
    elimination order with each row in the middle of those it reads, whichever has the smaller
    bandwidth.

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
        self._nlp = nlp
        self.free = np.flatnonzero(nlp.lower != nlp.upper)
        position = np.full(nlp.num_variables, -1)
        position[self.free] = range(self.free.size)
        rows_read, variables_read = self._incidence(position)
        self.rows, row_numbers = np.unique(rows_read, return_inverse=True)
        self.size = self.free.size + self.rows.size
        incidence = np.vstack([self.free.size + row_numbers, variables_read])
        edges = np.hstack([self._couplings(position), incidence])
        candidates = [self._cuthill_mckee(edges)]
        if nlp.order is not None:
            kept = position[nlp.order]
            candidates.append(self._by_stages(kept[kept >= 0], incidence))
        places = min(candidates, key=lambda candidate: _bandwidth(candidate, edges))
        self.bandwidth = _bandwidth(places, edges)
        self.variable_places, self.row_places = np.split(places, [self.free.size])
        self._place_of_variable = np.full(nlp.num_variables, -1)
        self._place_of_variable[self.free] = self.variable_places
        self._place_of_copy = np.full(nlp.num_costs + nlp.num_rows, -1)
        self._place_of_copy[nlp.num_costs + self.rows] = self.row_places
        self._is_row = np.zeros(self.size, dtype=bool)
        self._is_row[self.row_places] = True

    def _couplings(self, position: Ints) -> Ints:
        """Pairs of free variables within one term, shape (2, P)."""
        pairs = [b.variables[:, b.couplings()].reshape(-1, 2) for b in self._nlp.blocks]
        found = position[np.concatenate([np.empty((0, 2), dtype=np.int64), *pairs])].T
        return found[:, np.all(found >= 0, axis=0)]

    def _incidence(self, position: Ints) -> tuple[Ints, Ints]:
        """A row, and a free variable that it reads, for each such pair."""
        rows, variables = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
        first = -self._nlp.num_costs
        for block in self._nlp.blocks:
            count = len(block.variables)
            if first >= 0:
                read = position[block.variables[:, np.unique(block.couplings())]]
                copies = np.broadcast_to(np.arange(first, first + count)[:, None], read.shape)
                rows.append(copies[read >= 0])
                variables.append(read[read >= 0])
            first += count
        return np.concatenate(rows), np.concatenate(variables)

    def _cuthill_mckee(self, edges: Ints) -> Ints:
        if self.size == 0:
            return np.arange(0)
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
        gradient = np.zeros(nlp.num_variables)
        # In Fortran's order, which spares BLAS a copy.
        band = np.zeros((self.bandwidth + 1, self.size), order="F")
        weights = np.ones(nlp.num_costs + nlp.num_rows)
        weights[nlp.num_costs + self.rows] = multipliers
        derivatives_at(
            *nlp.tables,
            x,
            scales * nlp.copy_weights,
            weights,
            self._place_of_variable,
            self._place_of_copy,
            gradient,
            band,
        )
        return gradient[self.free], band

    def without_couplings(self, band: Floats) -> Floats:
        """A copy of the matrix with W = 0."""
        band = band.copy(order="F")
        erase_couplings(band, self._is_row)
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
