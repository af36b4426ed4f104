"""Functions of a mechanism's configuration as sums of products, from finitely many samples."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.symbolic import Expression, cos, sin

from drake_aigto.arrays import Bools, Floats, Ints

# q of shape (nq,) ↦ numbers of any one shape.
Function = Callable[[Floats], Floats]


# What entries differ by, relative to the largest, if they do not differ but for rounding.
_ROUNDING = 1e-12
_NUM_PROBES = 3  # Where one alone might change nothing by chance.
MAX_SAMPLES = 100_000  # Of one function, some second's worth.


@dataclass(frozen=True)
class TooManySamples(Exception):
    """A function of too many coordinates at once.

    Attributes:
        entry: of its values, counted row by row.
        coordinates: the positions that it depends on.
    """

    entry: int
    coordinates: tuple[int, ...]


def interpolate(
    function: Function, q: NDArray[Any], is_hinge: Sequence[bool], degree: int
) -> NDArray[Any]:
    """Returns a function of q as expressions, exact but for rounding.

    Each of its values has to be a polynomial of the degree in every slider's position, and one in
    the sine and cosine of every hinge's angle: a point on a link has degree 1, as each joint
    between two links moves it once, and M = Σ JᵀmJ has degree 2. Such a function is known from
    degree + 1 positions of each slider, and 2 · degree + 1 angles of each hinge,

        f(q) = Σ_k a_k ∏_i b_{k_i}(q_i),    b ∈ {1, q, q², …} or {1, cos q, sin q, cos 2q, …}.

    Whether it is one, the caller has to check.

    Args:
        function: takes q of shape (nq,), returns numbers of any shape.
        q: the variables, shape (nq,).
        is_hinge: whether each of them is an angle.
        degree: the most in any coordinate.

    Raises:
        TooManySamples: a value depends on too many coordinates at once.
    """
    example = function(np.zeros(len(q)))
    result = np.empty(example.size, dtype=object)
    bases = [_Basis.of(hinge, degree) for hinge in is_hinge]
    depends = _find_dependence(function, len(q))
    for pattern in np.unique(depends, axis=0):
        entries = np.flatnonzero((depends == pattern).all(axis=1))
        coordinates = np.flatnonzero(pattern).tolist()
        if math.prod(bases[i].nodes.size for i in coordinates) > MAX_SAMPLES:
            raise TooManySamples(int(entries[0]), tuple(coordinates))
        grid = _sample(function, len(q), [(i, bases[i].nodes) for i in coordinates], entries)
        for axis, i in enumerate(coordinates):
            grid = np.moveaxis(np.tensordot(bases[i].weights, grid, (1, axis)), 0, axis)
        functions = [bases[i].express(q[i]) for i in coordinates]
        for entry, coefficients in zip(entries, np.moveaxis(grid, -1, 0), strict=True):
            result[entry] = _sum_up(coefficients, functions)
    return result.reshape(example.shape)


@dataclass(frozen=True)
class _Basis:
    """Functions of one coordinate, and the nodes that tell them apart.

    Attributes:
        is_hinge: whether they are waves, or powers.
        nodes: as many as functions (b,).
        weights: W of shape (b, b): coefficients are W times the values at the nodes.
    """

    is_hinge: bool
    nodes: NDArray[Any]
    weights: NDArray[Any]

    @classmethod
    def of(cls, is_hinge: bool, degree: int) -> _Basis:
        """Returns powers or waves up to a degree."""
        if not is_hinge:
            nodes = np.linspace(-1.0, 1.0, degree + 1)
            return cls(is_hinge, nodes, np.linalg.inv(np.vander(nodes, increasing=True)))
        count = 2 * degree + 1
        nodes = np.array([2.0 * np.pi * j / count for j in range(count)])
        waves = [np.full(count, 0.5)]
        for k in range(1, degree + 1):
            waves += [np.cos(k * nodes), np.sin(k * nodes)]
        return cls(is_hinge, nodes, 2.0 / count * np.array(waves))

    def express(self, x: Any) -> list[Expression]:
        """Returns the functions of a variable."""
        count = self.nodes.size
        if not self.is_hinge:
            return [Expression(1.0), *(x**k * Expression(1.0) for k in range(1, count))]
        waves = [[cos(k * x), sin(k * x)] for k in range(1, count // 2 + 1)]
        return [Expression(1.0), *itertools.chain(*waves)]


def _find_dependence(function: Function, num_positions: int) -> Bools:
    """Returns whether each value changes with each coordinate alone, (values, nq)."""
    rng = np.random.default_rng(0)
    found = []
    for _ in range(_NUM_PROBES):
        q, other = rng.uniform(-1.0, 1.0, (2, num_positions))
        here = function(q).ravel()
        moved = [np.where(np.arange(num_positions) == i, other, q) for i in range(num_positions)]
        changes = np.array([function(each).ravel() - here for each in moved])
        found.append(np.abs(changes.T) > _ROUNDING * np.abs(here).max(initial=0.0))
    return np.logical_or.reduce(found)


def _sample(
    function: Function,
    num_positions: int,
    axes: Sequence[tuple[int, Floats]],
    entries: Ints,
) -> Floats:
    """Returns values on the grid of the axes' nodes, other coordinates at 0: (…, entries)."""
    places = [i for i, _ in axes]
    q = np.zeros(num_positions)
    values = []
    for point in itertools.product(*(nodes for _, nodes in axes)):
        q[places] = point
        values.append(function(q).ravel()[entries])
    return np.array(values).reshape(*(nodes.size for _, nodes in axes), entries.size)


def _sum_up(coefficients: Floats, functions: list[list[Expression]]) -> Expression:
    """Returns Σ coefficient · ∏ functions, without rounding."""
    total = Expression(0.0)
    for place in np.argwhere(np.abs(coefficients) > _ROUNDING * np.abs(coefficients).max()):
        product = Expression(float(coefficients[tuple(place)]))
        for choice, options in zip(place, functions, strict=True):
            product *= options[choice]
        total += product
    return total
