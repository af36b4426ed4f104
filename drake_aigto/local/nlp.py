"""`PolynomialNlp`: costs, equality rows and bounds as flat tables."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Floats, locked
from drake_aigto.box import NO_SYSTEM, Lanes, Order, add_means, make_lanes
from drake_aigto.errors import OptionsError, UnsupportedTermError
from drake_aigto.linear import as_order
from drake_aigto.local.kkt import KktStructure
from drake_aigto.terms import TermBlock, copy_weights, stack_terms


def check_bounds(lower: Floats, upper: Floats, name: Callable[[int], str]) -> None:
    """Refuses bounds (n,) that contradict each other; messages call a variable by its name.

    Raises:
        UnsupportedTermError: A variable has no value.
    """
    bad = np.flatnonzero((lower > upper) | np.isposinf(lower) | np.isneginf(upper))
    if bad.size:
        i = int(bad[0])
        raise UnsupportedTermError(
            f"the bounds of {name(i)} leave it no value",
            got=f"[{lower[i]:g}, {upper[i]:g}]",
            expected="lower ≤ upper",
            remedy="Relax one of the constraints on it.",
        )


class PolynomialNlp:
    """A program with equality constraints and bounds, of sums of products.

        minimize f(x)    subject to    c(x) = 0,    lower ≤ x ≤ upper

    with n variables and m rows. f and every c_i are sums of terms a ∏_j g_j(x_j) as in
    `BoxPolynomial`; copies of one sum share one table.

    Args:
        num_variables: n.
        costs: Blocks whose copies sum up to f.
        rows: Blocks each copy of which is one c_i.
        lower: Lower bounds (n,), −∞ where there is none.
        upper: Upper bounds (n,).
        order: Elimination order of the variables for banded systems; None leaves it to the solver.

    Attributes:
        costs: As given.
        row_names: Name of the constraint that each row came from (m,).
    """

    def __init__(
        self,
        num_variables: int,
        costs: tuple[TermBlock, ...],
        rows: tuple[TermBlock, ...],
        lower: Floats,
        upper: Floats,
        order: ArrayLike | None = None,
    ) -> None:
        """Stacks the blocks."""
        self.num_variables = num_variables
        self.lower, self.upper = locked(lower), locked(upper)
        self.order = None if order is None else as_order(order, num_variables)
        self.costs, self.blocks = costs, (*costs, *rows)
        self.terms = stack_terms(self.blocks)
        self.copy_weights = locked(copy_weights(self.blocks))
        self.num_costs = sum(len(block.variables) for block in costs)
        self.row_names = tuple(block.name for block in rows for _ in block.variables)

    def with_bounds(self, lower: Floats, upper: Floats) -> PolynomialNlp:
        """The same costs and rows within other bounds.

        Raises:
            UnsupportedTermError: They contradict each other.
        """
        check_bounds(lower, upper, "unknown {}".format)
        other = copy.copy(self)
        if np.array_equal(lower != upper, self.lower != self.upper):
            other.__dict__["kkt_structure"] = self.kkt_structure
        else:
            other.__dict__.pop("kkt_structure", None)
        other.lower, other.upper = locked(lower), locked(upper)
        return other

    @cached_property
    def kkt_structure(self) -> KktStructure:
        """Where its unknowns stand in KKT matrices, found once."""
        return KktStructure(
            self.terms, self.copy_weights, self.num_costs, self.lower != self.upper, self.order
        )

    @cached_property
    def _lanes(self) -> Lanes:
        return make_lanes(self.terms, Order.MEAN)

    @cached_property
    def _magnitude_lanes(self) -> Lanes:
        return self._lanes._replace(are_magnitudes=True)

    @property
    def num_rows(self) -> int:
        """Number of equality rows m."""
        return len(self.row_names)

    def evaluate(self, x: ArrayLike) -> tuple[float, Floats]:
        """Returns f(x) and c(x) (m,)."""
        costs, rows = self._sums(x)
        return float(np.sum(costs)), rows

    def cost_magnitude(self, x: ArrayLike) -> float:
        """Returns Σ |terms| of f at x: f(x) is known to some roundings of it, whatever cancels."""
        return float(np.sum(self._sums(x, are_magnitudes=True)[0]))

    def row_magnitudes(self, x: ArrayLike) -> Floats:
        """Returns Σ |terms| of every row at x (m,)."""
        return self._sums(x, are_magnitudes=True)[1]

    def _sums(self, x: ArrayLike, are_magnitudes: bool = False) -> tuple[Floats, Floats]:
        """Returns the weighted costs, and the rows (m,), of terms or of their absolute values."""
        x, weights = self._checked(x), self.copy_weights.copy()
        values = np.empty(weights.size)
        lanes = self._magnitude_lanes if are_magnitudes else self._lanes
        add_means(lanes, weights, x, np.zeros(x.size), values, NO_SYSTEM)
        return values[: self.num_costs], values[self.num_costs :]

    def _checked(self, x: ArrayLike) -> Floats:
        # Copied, as the weights, for Numba would compile once more for arrays that are read-only.
        x = np.array(x, dtype=float, order="C")
        if x.shape != (self.num_variables,):
            raise OptionsError(
                "the point", got=f"shape {x.shape}", expected=f"({self.num_variables},)"
            )
        return x
