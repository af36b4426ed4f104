"""Costs as flat tables of terms, and their means over boxes in closed form."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Floats, Ints
from drake_aigto.box.kernels import NO_SYSTEM, System, add_means
from drake_aigto.box.lanes import Lanes, make_lanes
from drake_aigto.box.tapes import Order
from drake_aigto.errors import OptionsError, UnsupportedTermError
from drake_aigto.linear import Pattern, Storage, as_order, choose_storage, narrow_band, spread
from drake_aigto.terms import Factor, FunctionKind, Term, TermBlock, copy_weights, stack_terms


@dataclass(frozen=True)
class NewtonSystem:
    """Value, gradient and Hessian at one box, in elimination order.

    With n variables and u unknowns a variable (2, or 1 for centers only):

    Attributes:
        value: f̄.
        gradient: (u n,) with unknowns (c_i, z_i) next to each other, or c_i alone.
        band: (u (bandwidth + 1), u n) Hessian in LAPACK's lower band storage, in Fortran's order;
            or its entries (1, E), where there is a pattern.
        pattern: Of the Hessian, if it is no band.
    """

    value: float
    gradient: Floats
    band: Floats
    pattern: Pattern | None = None


class BoxPolynomial:
    """f(x) = Σ_m a_m ∏_i g_mi(x_i) and its mean over the box A(c, w) = {x : |x − c| ≤ w}.

        f̄(c, w) = Σ_m a_m ∏_i μ(g_mi; c_i, w_i),      I(c, w) = S(w) f̄(c, w),      S(w) = ∏ 2w_i

    (AIGTO Sec. II-B). Derivatives are in c and z = log w, so that ∂f̄/∂z_i = w_i ∂f̄/∂w_i is
    finite, and zero, at w_i = 0.

    Args:
        num_variables: Dimension n of x.
        blocks: The terms, grouped by the polynomial that copies share.
        order: Elimination order of the variables (a permutation of 0 … n−1) for banded Newton
            systems; variables that appear together should be near each other. Default: reverse
            Cuthill-McKee on the coupling graph. Where that leaves a wide band, and another order
            little fill, the other is taken, and Newton systems are sparse.

    Attributes:
        order: The elimination order (n,), read-only.
        position: Place of each variable in it (n,).
        copy_weights: Weight of each copy, block after block.
        bandwidth: Largest distance of two variables that appear in one term, in that order or, if
            systems are sparse, in the best one for bands.
        storage: How Newton systems over boxes, of 2n unknowns, are stored, and why.

    Raises:
        OptionsError: The order is no permutation of the variables.
    """

    def __init__(
        self, num_variables: int, blocks: tuple[TermBlock, ...], order: ArrayLike | None = None
    ) -> None:
        """Stacks the blocks and finds the Hessian's bandwidth under the elimination order."""
        self.num_variables = num_variables
        self.blocks = tuple(blocks)
        self._terms = stack_terms(self.blocks)
        self._lanes: dict[Order, Lanes] = {}
        self.copy_weights = copy_weights(self.blocks)
        self._patterns: dict[Order, Pattern] = {}
        edges = self.couplings().T
        if order is not None:
            places = np.argsort(as_order(order, num_variables))
        else:
            places = narrow_band(num_variables, edges) if edges.size else np.arange(num_variables)
        self.storage = choose_storage(num_variables, edges, [places], group_size=2)
        self.position = self.storage.places
        self.order = as_order(np.argsort(self.position), num_variables)
        self.bandwidth = (self.storage.bandwidth + 1) // 2 - 1

    def couplings(self) -> Ints:
        """Returns pairs of variables that a term reads, each with itself among them: (P, 2)."""
        return self._terms.couplings()[1]

    @property
    def num_terms(self) -> int:
        """Number of monomials, all copies counted."""
        return sum(len(block.terms) * block.variables.shape[0] for block in self.blocks)

    @property
    def weights(self) -> dict[str, float]:
        """Weight of each named block."""
        return {block.name: block.weight for block in self.blocks}

    def with_weights(self, weights: Mapping[str, float]) -> BoxPolynomial:
        """Returns the same table with the named blocks' weights replaced; nothing is parsed again.

        Raises:
            OptionsError: A name is not that of a block, or a weight is not finite.
        """
        unknown = sorted(set(weights) - set(self.weights))
        if unknown:
            raise OptionsError(
                "weights",
                got=f"no cost named {unknown}",
                expected=f"names among {sorted(self.weights)}",
            )
        other = copy.copy(self)
        other.blocks = tuple(
            b.with_weight(weights[b.name]) if b.name in weights else b for b in self.blocks
        )
        other.copy_weights = copy_weights(other.blocks)
        return other

    def with_coefficients(self, coefficients: Floats) -> BoxPolynomial:
        """Returns the same functions with other coefficients; nothing is parsed again.

        Args:
            coefficients: Of each term's, one sum after the other; blocks of equal terms are one
                sum, whose place is that of the first of them.

        Raises:
            UnsupportedTermError: One is not finite.
        """
        other = copy.copy(self)
        other._terms = self._terms.with_coefficients(coefficients)
        new = other._terms.coefficients
        other._lanes = {k: lanes._replace(coefficients=new) for k, lanes in self._lanes.items()}
        places = self._terms.first_terms(len(block.variables) for block in self.blocks)
        other.blocks = tuple(
            block.with_coefficients(coefficients[place : place + len(block.terms)].tolist())
            for block, place in zip(self.blocks, places, strict=True)
        )
        return other

    def mean(self, center: ArrayLike, half_width: ArrayLike) -> float:
        """Returns f̄(c, w); f(c) at w = 0."""
        return self._add_means(center, half_width, self.copy_weights, Order.MEAN, NO_SYSTEM)[0]

    def __call__(self, x: ArrayLike) -> float:
        """Returns f(x)."""
        return self.mean(x, np.zeros(self.num_variables))

    def gradient(self, center: ArrayLike, half_width: ArrayLike) -> tuple[float, Floats, Floats]:
        """Returns f̄, ∂f̄/∂c (n,) and ∂f̄/∂z (n,), z = log w."""
        places = 2 * np.arange(self.num_variables)
        system = self._make_system(places, Order.GRADIENT, (places.size, 0), None)
        value, _ = self._add_means(center, half_width, self.copy_weights, Order.GRADIENT, system)
        return value, system.gradient[0::2].copy(), system.gradient[1::2].copy()

    def _make_system(
        self, places: Ints, order: Order, shape: tuple[int, int], pattern: Pattern | None
    ) -> System:
        """Returns a system of zeros; the variables' first unknowns have these places."""
        size = order.num_unknowns * self.num_variables
        no_places = np.full(self.copy_weights.size, -1)
        multipliers = np.ones_like(self.copy_weights)
        return System(
            multipliers, places, no_places, np.zeros(size), np.zeros(shape), pattern, None
        )

    def _add_means(
        self,
        center: ArrayLike,
        half_width: ArrayLike,
        weights: Floats,
        order: Order,
        system: System,
    ) -> tuple[float, Floats]:
        """Returns the weighted mean and its parts by copy; derivatives are added to the system."""
        c, w = self._box(center, half_width)
        means = np.empty(weights.size)
        return add_means(self.lanes(order), weights, c, w, means, system), means

    def hessian_shape(self, order: Order) -> tuple[int, int]:
        """Returns the shape of what Hessians are added to: a band (u n, diagonals), or (E, 1)."""
        pattern, stride = self.pattern(order), order.num_unknowns
        if pattern is not None:
            return pattern.rows.size, 1
        return stride * self.num_variables, stride * (self.bandwidth + 1)

    def pattern(self, order: Order) -> Pattern | None:
        """Returns the pattern of Hessians, made at first use; None: they are bands."""
        if self.storage.pattern is None:
            return None
        if order not in self._patterns:
            self._patterns[order] = spread(self.storage.pattern, order.num_unknowns)
        return self._patterns[order]

    def lanes(self, order: Order) -> Lanes:
        """Returns the kernels' tables for derivatives of an order, made at first use."""
        if order not in self._lanes:
            self._lanes[order] = make_lanes(self._terms, order)
        return self._lanes[order]

    def newton_system(
        self, center: ArrayLike, half_width: ArrayLike, centers_only: bool = False
    ) -> NewtonSystem:
        """Returns f̄ with gradient and Hessian in (c, z), or in c alone.

        `to_variables` undoes the ordering.
        """
        order = Order.CENTERS if centers_only else Order.BOXES
        places, pattern = order.num_unknowns * self.position, self.pattern(order)
        system = self._make_system(places, order, self.hessian_shape(order), pattern)
        value, _ = self._add_means(center, half_width, self.copy_weights, order, system)
        return NewtonSystem(value, system.gradient, system.band.T, pattern)

    def to_variables(self, ordered: Floats) -> Iterator[Floats]:
        """Splits a vector in elimination order into its parts, c and then z, in variable order."""
        stride = ordered.size // self.num_variables
        return (ordered[part::stride][self.position] for part in range(stride))

    def _box(self, center: ArrayLike, half_width: ArrayLike) -> tuple[Floats, Floats]:
        # Copied, as Numba would compile once more for arrays that are read-only or strided.
        c = np.array(center, dtype=float, order="C")
        w = np.array(half_width, dtype=float, order="C")
        shape = (self.num_variables,)
        if c.shape != shape or w.shape not in (shape, ()):
            raise ValueError(
                f"center has shape {c.shape} and half_width {w.shape}; expected {shape} for each"
            )
        if w.shape != shape:
            w = np.full(shape, w)
        if w.min(initial=0.0) < 0.0:
            raise ValueError(f"half_width is {w.min():g} at its least; it can't be negative")
        return c, w


class _CoefficientTerm(NamedTuple):
    """factor · ∏ p_j^powers_j, a part of a coefficient."""

    coefficient: int
    factor: float
    powers: tuple[int, ...]


class ParametricPolynomial:
    """f(x; p) = Σ_m a_m(p) ∏_i g_mi(x_i), whose coefficients a_m are polynomials of P numbers p.

    Boxes are not over parameters: `at` folds their powers into coefficients. What depends on the
    structure of f alone (tables, tapes, the storage of Newton systems) is made once.

    Args:
        num_variables: Dimension n of x.
        num_parameters: P.
        blocks: Terms over x, the variables 0 … n − 1, and over p, n … n + P − 1. Of parameters they
            read powers only, and all copies of a sum read the same ones.
        order: Elimination order of x, see `BoxPolynomial`.

    Raises:
        UnsupportedTermError: A function of a parameter that is no power.
    """

    def __init__(
        self,
        num_variables: int,
        num_parameters: int,
        blocks: Iterable[TermBlock],
        order: ArrayLike | None = None,
    ) -> None:
        """Takes coefficients apart."""
        summands: list[_CoefficientTerm] = []
        known: dict[tuple[object, ...], tuple[Term, ...]] = {}
        structure: list[TermBlock] = []
        for block in blocks:
            is_parameter = block.variables[0] >= num_variables
            places = np.where(is_parameter, block.variables[0] - num_variables, -1).tolist()
            key = block.terms, tuple(places)
            if key not in known:
                known[key] = _take_apart(block, places, num_parameters, summands)
            variables = block.variables[:, ~is_parameter]
            structure.append(TermBlock(block.name, known[key], variables, block.weight))
        self._structure = BoxPolynomial(num_variables, tuple(structure), order)
        for each in (Order.MEAN, Order.BOXES):  # Now, for all values.
            self._structure.lanes(each)
        self._targets = np.array([each.coefficient for each in summands], dtype=np.int64)
        self._factors = np.array([each.factor for each in summands])
        powers = [each.powers for each in summands]
        self._powers = np.array(powers, dtype=np.int64).reshape(-1, num_parameters)

    @property
    def storage(self) -> Storage:
        """Storage of Newton systems, see `BoxPolynomial`."""
        return self._structure.storage

    def at(self, parameters: ArrayLike) -> BoxPolynomial:
        """Returns f(·; p) at p of shape (P,)."""
        p = np.asarray(parameters, dtype=float)
        parts = self._factors * np.prod(p**self._powers, axis=1)
        return self._structure.with_coefficients(np.bincount(self._targets, parts).astype(float))


def _take_apart(
    block: TermBlock, places: list[int], num_parameters: int, summands: list[_CoefficientTerm]
) -> tuple[Term, ...]:
    """Returns the terms of a block over x alone, and adds the parts of their coefficients.

    The coefficient of each new term is its number, counted on from the last summand's. Places are,
    of each local variable, which parameter it is; −1 for those of x.
    """
    local = (np.cumsum(np.array(places) < 0) - 1).tolist()
    numbers: dict[tuple[Factor, ...], int] = {}
    first = 1 + max((each.coefficient for each in summands), default=-1)
    for term in block.terms:
        powers, kept = [0] * num_parameters, []
        for factor in term.factors:
            if places[factor.variable] < 0:
                kept.append(factor._replace(variable=local[factor.variable]))
            elif (factor.kind, factor.scale, factor.offset) == (FunctionKind.POWER, 1.0, 0.0):
                powers[places[factor.variable]] = factor.exponent
            else:
                raise UnsupportedTermError(
                    f"the cost '{block.name}' can't be compiled for any value of its parameters",
                    got=f"the factor {factor} of a parameter",
                    expected="powers of parameters",
                )
        number = numbers.setdefault(tuple(kept), first + len(numbers))
        summands.append(_CoefficientTerm(number, term.coefficient, tuple(powers)))
    return tuple(Term(float(number), factors) for factors, number in numbers.items())
