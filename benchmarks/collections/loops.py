"""Functions whose variables are coupled in loops: grids and braced rings of springs.

    f(x) = Σ_i single(x_i; a_i) + Σ_(i,j) pair(x_i, x_j; b_ij)

over nodes i of one or two coordinates each, all within ±reach. Their minima are not known: dynamic
programming takes too long for these loops.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from pydrake.solvers import ExpressionCost, MathematicalProgram

from benchmarks.collections.chain import NUM_ROOTS, REACH
from drake_aigto.arrays import Floats, Ints


@njit
def wells(x: Any, a: Any) -> Any:
    """Two wells, one deeper."""
    return x[0] ** 4 - 2.0 * x[0] ** 2 + a[0] * x[0]


@njit
def roots(x: Any, a: Any) -> Any:
    """A polynomial of degree 6 with these roots, as in AIGO's own benchmark."""
    y = x[0]
    return (y - a[0]) * (y - a[1]) * (y - a[2]) * (y - a[3]) * (y - a[4]) * (y - a[5])


@njit
def ripples(x: Any, a: Any) -> Any:
    """A shallow bowl with ripples."""
    return 0.2 * x[0] ** 2 + np.cos(4.0 * x[0] + a[0])


@njit
def field(x: Any, a: Any) -> Any:
    """A rippled field in the plane, which a node is drawn through."""
    return 0.05 * (x[0] ** 2 + x[1] ** 2) + a[0] * np.cos(2.0 * x[0]) + a[1] * np.cos(2.0 * x[1])


@njit
def product(x: Any, y: Any, b: Any) -> Any:
    """Either sign: neighbors want to be alike, or opposite."""
    return b[0] * x[0] * y[0]


@njit
def wave(x: Any, y: Any, b: Any) -> Any:
    """A preferred difference, up to a period."""
    return np.cos(2.0 * (x[0] - y[0]) + b[0])


@njit
def spring(x: Any, y: Any, b: Any) -> Any:
    """A spring of rest length b₀ between two points of the plane."""
    return 0.1 * ((x[0] - y[0]) ** 2 + (x[1] - y[1]) ** 2 - b[0] ** 2) ** 2


@dataclass(frozen=True, eq=False)
class LoopProblem:
    """One function.

    Attributes:
        name: which.
        single: of the coordinates of a node, and its numbers.
        pair: of those of two nodes, and their edge's numbers.
        nodes: numbers a of each node, shape (N, p).
        edges: pairs of nodes, shape (E, 2).
        links: numbers b of each edge, shape (E, q).
        dimension: coordinates of a node.
        reach: bounds of all coordinates.
    """

    name: str
    single: Callable[..., Any]
    pair: Callable[..., Any]
    nodes: Floats
    edges: Ints
    links: Floats
    dimension: int
    reach: float

    def prog(self) -> MathematicalProgram:
        """Returns the program, a cost for each node and each edge."""
        prog = MathematicalProgram()
        x = prog.NewContinuousVariables(len(self.nodes), self.dimension, "x")
        single, pair = self.single.py_func, self.pair.py_func  # type: ignore[attr-defined]
        formulas = [single(x_i, a) for x_i, a in zip(x, self.nodes, strict=True)]
        for (i, j), b in zip(self.edges, self.links, strict=True):
            formulas.append(pair(x[i], x[j], b))
        for formula in formulas:
            cost = ExpressionCost(formula)
            prog.AddCost(cost, vars=cost.vars())
        prog.AddBoundingBoxConstraint(-self.reach, self.reach, x.ravel())
        return prog


def loop_problem(family: str, size: int, seed: int) -> LoopProblem:
    """Returns a random function of a family.

    Args:
        family: "wells", "roots" or "ripples" on a grid; "springs" around a ring.
        size: nodes along a side of the grid; a quarter of the ring's.
        seed: of all numbers.
    """
    rng = np.random.default_rng([size, seed, *family.encode()])
    if family == "springs":
        count = 4 * size
        ring = np.arange(count)
        # Each second one is braced, so that the ring can't just fold.
        edges = np.vstack([np.column_stack([ring, (ring + k) % count]) for k in (1, 2)])
        nodes, links = rng.uniform(-1.0, 1.0, (count, 2)), rng.uniform(0.5, 2.0, (2 * count, 1))
        return LoopProblem(_name(family, size, seed), field, spring, nodes, edges, links, 2, 4.0)
    place = np.arange(size**2).reshape(size, size)
    across = np.column_stack([place[:, :-1].ravel(), place[:, 1:].ravel()])
    down = np.column_stack([place[:-1].ravel(), place[1:].ravel()])
    edges = np.vstack([across, down])
    single, pair = {"wells": (wells, product), "roots": (roots, product)}.get(
        family, (ripples, wave)
    )
    if family == "roots":
        nodes = -2.0 + 0.8 * np.arange(NUM_ROOTS) + rng.uniform(-1, 1, (size**2, NUM_ROOTS)) / 3.0
    else:
        nodes = rng.uniform(-1.0, 1.0, (size**2, 1)) * (np.pi if family == "ripples" else 1.0)
    links = rng.normal(size=(len(edges), 1))
    if family == "ripples":
        links = rng.uniform(-np.pi, np.pi, (len(edges), 1))
    reach = 3.0 if family == "ripples" else REACH
    return LoopProblem(_name(family, size, seed), single, pair, nodes, edges, links, 1, reach)


def _name(family: str, size: int, seed: int) -> str:
    return f"{family} size={size} seed={seed}"
