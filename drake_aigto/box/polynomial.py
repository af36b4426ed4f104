"""`BoxPolynomial`: a cost as a flat table of terms, and its mean over boxes in closed form."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from drake_aigto.box.functions import FunctionKind
from drake_aigto.box.kernels import block_mean, block_newton

_NO_GRADIENT = np.empty(0)


@dataclass(frozen=True)
class Factor:
    """One-variable function g(scale·x + offset) of the local variable `variable` of a block."""

    variable: int
    kind: FunctionKind
    exponent: int = 1
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Term:
    """coefficient · ∏ factors, no two of which read the same variable."""

    coefficient: float
    factors: tuple[Factor, ...]


class TermBlock:
    """K copies of one sum of terms, each over its own L variables: what N stages share is stored once.

    Attributes:
        name: Description of the cost that it came from.
        terms: The sum's terms over local variables 0 … L−1.
        variables: (K, L) index of each copy's variables in the whole problem.
        weight: Common factor of all copies.
    """

    def __init__(
        self, name: str, terms: tuple[Term, ...], variables: ArrayLike, weight: float = 1.0
    ) -> None:
        """Flatten the terms into the arrays that the kernels walk."""
        self.name = name
        self.terms = terms
        self.weight = float(weight)
        self.variables = np.ascontiguousarray(np.atleast_2d(np.asarray(variables, dtype=np.int64)))
        self.variables.setflags(write=False)
        factors = list(dict.fromkeys(factor for term in terms for factor in term.factors))
        index = {factor: f for f, factor in enumerate(factors)}
        self._arrays = (
            self.variables,
            np.array([f.variable for f in factors], dtype=np.int64),
            np.array([int(f.kind) for f in factors], dtype=np.int64),
            np.array([f.exponent for f in factors], dtype=np.int64),
            np.array([f.scale for f in factors], dtype=float),
            np.array([f.offset for f in factors], dtype=float),
            np.array([t.coefficient for t in terms], dtype=float),
            np.cumsum([0] + [len(t.factors) for t in terms], dtype=np.int64),
            np.array([index[f] for t in terms for f in t.factors], dtype=np.int64),
        )

    def with_weight(self, weight: float) -> TermBlock:
        """The same block under another weight; the term table is shared."""
        block = object.__new__(TermBlock)
        block.__dict__.update(self.__dict__)
        block.weight = float(weight)
        return block

    @property
    def kernel_arguments(self) -> tuple[object, ...]:
        """The leading arguments of the functions in `kernels`."""
        return (self.weight, *self._arrays)

    def couplings(self) -> NDArray[np.int64]:
        """Pairs of local variables that appear together in a term, shape (P, 2)."""
        pairs = {
            (a.variable, b.variable) for t in self.terms for a in t.factors for b in t.factors
        }
        return np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)


@dataclass(frozen=True)
class NewtonSystem:
    """Value, gradient and Hessian at one box, in elimination order.

    Attributes:
        value: f̄.
        gradient: (n,) with unknowns (c_i, z_i) next to each other, or c_i alone.
        band: (bandwidth + 1, n) Hessian in LAPACK's lower band storage.
    """

    value: float
    gradient: NDArray[np.float64]
    band: NDArray[np.float64]


class BoxPolynomial:
    """f(x) = Σ_m a_m ∏_i g_mi(x_i) and its mean over the box A(c, w) = {x : |x − c| ≤ w}.

        f̄(c, w) = Σ_m a_m ∏_i μ(g_mi; c_i, w_i),      I(c, w) = S(w) f̄(c, w),      S(w) = ∏ 2w_i

    (AIGTO Sec. II-B). Derivatives are in c and z = log w, so that ∂f̄/∂z_i = w_i ∂f̄/∂w_i stays finite at w_i = 0.

    Args:
        num_variables: Dimension n of x.
        blocks: The terms, grouped by the polynomial that copies share.
        order: Elimination order of the variables (a permutation of 0 … n−1) for the banded Newton system; variables that
            appear together should be near each other. Default: reverse Cuthill-McKee on the coupling graph.
    """

    def __init__(
        self,
        num_variables: int,
        blocks: tuple[TermBlock, ...],
        order: ArrayLike | None = None,
    ) -> None:
        """Store the blocks and find the Hessian's bandwidth under the elimination order."""
        self.num_variables = num_variables
        self.blocks = tuple(blocks)
        rows, columns = self._coupled_pairs()
        if order is None:
            graph = coo_array((np.ones(rows.size), (rows, columns)), shape=(num_variables,) * 2)
            order = reverse_cuthill_mckee(graph.tocsr(), symmetric_mode=True)
        self.order = np.asarray(order, dtype=np.int64)
        self._position = np.argsort(self.order)
        self._reach = int(np.max(np.abs(self._position[rows] - self._position[columns]), initial=0))

    def _coupled_pairs(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        pairs = [block.variables[:, block.couplings()].reshape(-1, 2) for block in self.blocks]
        stacked = np.concatenate([np.empty((0, 2), dtype=np.int64), *pairs])
        return stacked[:, 0], stacked[:, 1]

    @property
    def num_terms(self) -> int:
        """Number of monomials, all copies counted."""
        return sum(len(block.terms) * block.variables.shape[0] for block in self.blocks)

    @property
    def weights(self) -> dict[str, float]:
        """Weight of each named block."""
        return {block.name: block.weight for block in self.blocks}

    def with_weights(self, weights: Mapping[str, float]) -> BoxPolynomial:
        """The same table with the named blocks' weights replaced; nothing is parsed again.

        Raises:
            KeyError: A name is not that of a block.
        """
        unknown = set(weights) - {block.name for block in self.blocks}
        if unknown:
            raise KeyError(f"no block named {sorted(unknown)}; have {sorted(self.weights)}")
        other = object.__new__(BoxPolynomial)
        other.__dict__.update(self.__dict__)
        other.blocks = tuple(b.with_weight(weights.get(b.name, b.weight)) for b in self.blocks)
        return other

    def mean(self, center: ArrayLike, half_width: ArrayLike) -> float:
        """f̄(c, w); f(c) at w = 0."""
        c, w = self._box(center, half_width)
        return sum(
            block_mean(*block.kernel_arguments, c, w, _NO_GRADIENT, _NO_GRADIENT)
            for block in self.blocks
        )

    def __call__(self, x: ArrayLike) -> float:
        """f(x)."""
        return self.mean(x, np.zeros(self.num_variables))

    def mean_by_block(self, center: ArrayLike, half_width: ArrayLike) -> dict[str, float]:
        """Each block's share of f̄, divided by its weight."""
        c, w = self._box(center, half_width)
        shares: dict[str, float] = {}
        for block in self.blocks:
            arguments = block.with_weight(1.0).kernel_arguments
            share = block_mean(*arguments, c, w, _NO_GRADIENT, _NO_GRADIENT)
            shares[block.name] = shares.get(block.name, 0.0) + share
        return shares

    def gradient(
        self, center: ArrayLike, half_width: ArrayLike
    ) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
        """f̄, ∂f̄/∂c (n,) and ∂f̄/∂z (n,), z = log w."""
        c, w = self._box(center, half_width)
        gradient_c, gradient_z = np.zeros(self.num_variables), np.zeros(self.num_variables)
        value = 0.0
        for block in self.blocks:
            value += block_mean(*block.kernel_arguments, c, w, gradient_c, gradient_z)
        return value, gradient_c, gradient_z

    def newton_system(
        self, center: ArrayLike, half_width: ArrayLike, centers_only: bool = False
    ) -> NewtonSystem:
        """f̄ with gradient and banded Hessian in (c, z), or in c alone; `to_variables` undoes the ordering."""
        c, w = self._box(center, half_width)
        stride = 1 if centers_only else 2
        size = stride * self.num_variables
        gradient = np.zeros(size)
        band = np.zeros((stride * self._reach + stride, size))
        value = 0.0
        for block in self.blocks:
            value += block_newton(
                *block.kernel_arguments, c, w, self._position, stride, gradient, band
            )
        return NewtonSystem(value, gradient, band)

    def to_variables(self, ordered: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
        """Split a vector in elimination order into its parts (c, then z if there), each in variable order."""
        stride = ordered.size // self.num_variables
        return (ordered[part::stride][self._position] for part in range(stride))

    def _box(
        self, center: ArrayLike, half_width: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        shape = (self.num_variables,)
        c = np.ascontiguousarray(center, dtype=float)
        w = np.ascontiguousarray(np.broadcast_to(np.asarray(half_width, dtype=float), shape))
        if c.shape != shape:
            raise ValueError(f"center has shape {c.shape}; this polynomial needs {shape}")
        return c, w
