"""Programs for local solvers: `PolynomialNlp`, its builder, and results of a solve."""

from __future__ import annotations

import copy
import enum
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Floats, Ints, locked
from drake_aigto.box import NO_SYSTEM, Lanes, Order, add_means, make_lanes
from drake_aigto.errors import OptionsError, UnsupportedTermError
from drake_aigto.linear import Storage, as_order
from drake_aigto.local.kkt import KktStructure
from drake_aigto.terms import Factor, FunctionKind, Term, TermBlock, copy_weights, stack_terms

# A coefficient, and the variables that it is multiplied by; one that is there twice is squared.
Monomial = tuple[float, tuple[int, ...]]
Summand = Monomial | Term


def check_bounds(lower: Floats, upper: Floats, name: Callable[[int], str]) -> None:
    """Refuses bounds (n,) that contradict each other; messages call a variable by its name."""
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
        """Places of its unknowns in KKT matrices, found once."""
        return KktStructure(
            self.terms, self.copy_weights, self.num_costs, self.lower != self.upper, self.order
        )

    @cached_property
    def _lanes(self) -> Lanes:
        return make_lanes(self.terms, Order.MEAN)

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
        # Copied, for Numba would compile once more for arrays that are read-only.
        x, weights = np.array(x, dtype=float, order="C"), self.copy_weights.copy()
        if x.shape != (self.num_variables,):
            raise OptionsError(
                "the point", got=f"shape {x.shape}", expected=f"({self.num_variables},)"
            )
        values = np.empty(weights.size)
        lanes = self._lanes._replace(are_magnitudes=are_magnitudes)
        add_means(lanes, weights, x, np.zeros(x.size), values, NO_SYSTEM)
        return values[: self.num_costs], values[self.num_costs :]


class NlpBuilder:
    """Collects variables with bounds, costs and rows that are sums of monomials or other terms.

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

    def add_cost(self, name: str, terms: Iterable[Summand], copies: ArrayLike) -> None:
        """Adds a cost over local variables 0 … L−1, once for each row of `copies` (K, L)."""
        self._costs.append(TermBlock(name, _terms(terms), copies))

    def add_row(self, name: str, terms: Iterable[Summand], copies: ArrayLike) -> None:
        """Adds rows sum = 0 over local variables 0 … L−1, one for each row of `copies` (K, L)."""
        self._rows.append(TermBlock(name, _terms(terms), copies))

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


def _terms(summands: Iterable[Summand]) -> tuple[Term, ...]:
    """Returns the summands that are not zero."""
    terms = (
        each if isinstance(each, Term) else Term(float(each[0]), _factors(each[1]))
        for each in summands
    )
    return tuple(term for term in terms if term.coefficient)


@cache
def _factors(variables: tuple[int, ...]) -> tuple[Factor, ...]:
    powers = {variable: variables.count(variable) for variable in variables}
    return tuple(Factor(i, FunctionKind.POWER, power) for i, power in powers.items())


class LocalStatus(enum.Enum):
    """Why a local solve ended, and how to go on.

    A point counts as within the tolerances too where only rounding of f or of the rows, relative to
    the terms that they are sums of, keeps it from them.
    """

    CONVERGED = "a stationary point within the tolerances"
    INFEASIBLE = "the rows can't be met near here: start elsewhere, or look for a contradiction"
    ITERATION_LIMIT = "the iterations ran out: allow more, or start closer"
    STALLED = "no step improves any more: loosen the tolerances, or scale the problem better"
    UNBOUNDED = "the unknowns grow without limit: bound the variables, or check the cost's sign"
    NOT_FINITE = "the start has no finite value: start where every term has one"


class LocalIterate(NamedTuple):
    """An iterate, and the step that led to it.

    Attributes:
        cost: f.
        residual: Largest scaled residual of a row.
        optimality: Scaled optimality error, see `LocalResult`.
        barrier: μ.
        shift: Of the Hessian's diagonal; 0 where it was convex enough.
        step: Length of the step, in (0, 1]; 0 at the start and after a restoration.
    """

    cost: float
    residual: float
    optimality: float
    barrier: float
    shift: float
    step: float


@dataclass(frozen=True, eq=False)
class LocalResult:
    """Result of a local solve.

    Attributes:
        x: The point (n,), within its bounds; read-only.
        cost: f(x).
        status: Why it ended.
        iterations: Newton steps, those of the feasibility restoration included.
        residual: max |c_i(x)|.
        optimality: max-norm of the scaled optimality conditions that ended the solve: stationarity
            and complementarity (Wächter & Biegler 2006, eq. (5), without the rows).
        multipliers: λ of the rows (m,), with ∇f + Aᵀλ − z_lower + z_upper = 0; read-only.
        lower_multipliers: z_lower ≥ 0 of the lower bounds (n,), 0 where there is none, and where
            equal bounds hold a variable; read-only.
        upper_multipliers: z_upper ≥ 0 of the upper bounds (n,); read-only.
        storage: Order, storage and factorization of KKT matrices, and why.
        history: Every iterate, the start first.
    """

    x: Floats
    cost: float
    status: LocalStatus
    iterations: int
    residual: float
    optimality: float
    multipliers: Floats
    lower_multipliers: Floats
    upper_multipliers: Floats
    storage: Storage = field(repr=False)
    history: tuple[LocalIterate, ...] = ()

    def __post_init__(self) -> None:
        """Locks the arrays."""
        for array in (self.x, self.multipliers, self.lower_multipliers, self.upper_multipliers):
            array.setflags(write=False)

    @property
    def is_success(self) -> bool:
        """Whether the solve converged."""
        return self.status is LocalStatus.CONVERGED
