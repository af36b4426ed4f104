"""AIGO's own benchmark: sums over a chain of variables, whose exact optimum is known.

Labbe & Del Prete, "Analytical Integral Global Optimization", L4DC 2025 (PMLR 283:711-722):

    f(x) = Σ_{i=1..n} ∏_{j=1..6} (x_i − a_ij) + Σ_{i<n} b_i x_i x_{i+1},    |x_i| ≤ 2.2

a_ij is uniform on an interval of width 2/3, centred at −2 + (j − 1)·4/5. The paper does not say how
b is distributed: here b_i ~ U(−1, 1).

Neighbours only are coupled, so dynamic programming finds the optimum over any grid exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.solvers import MathematicalProgram
from scipy.linalg import solveh_banded

from benchmarks.collections.known_optimum import GlobalProblem, Part
from drake_aigto.arrays import Floats
from drake_aigto.errors import OptionsError
from drake_aigto.kernels import kernel

REACH = 2.2
NUM_ROOTS = 6
GRID_POINTS = 1601

_NEWTON_STEPS = 50
_RESOLUTION = 1e-13  # of x: a Newton step that is no longer has converged


@dataclass(frozen=True, eq=False)
class ChainProblem:
    """One function of the family.

    Attributes:
        roots: a, shape (n, 6), read-only.
        coupling: b, shape (n − 1,), read-only.
    """

    roots: Floats
    coupling: Floats

    def __post_init__(self) -> None:
        """Lock the arrays."""
        for name in ("roots", "coupling"):
            array = np.array(getattr(self, name), dtype=float)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def num_variables(self) -> int:
        """The number n of variables."""
        return len(self.roots)

    def evaluate(self, x: Any) -> Any:
        """Return f at numbers of shape (…, n)."""
        x = np.asarray(x)
        own = np.prod(x[..., None] - self.roots, axis=-1)
        return np.sum(own, axis=-1) + np.sum(self.coupling * x[..., :-1] * x[..., 1:], axis=-1)

    def gradient(self, x: Any) -> Floats:
        """Return ∇f at x (n,)."""
        x = np.asarray(x, dtype=float)
        slope = _derivatives(self.roots, x)[0]
        slope[:-1] += self.coupling * x[1:]
        slope[1:] += self.coupling * x[:-1]
        return slope

    def problem(self, name: str = "") -> GlobalProblem:
        """Return it as a test function, with its exact minimum; default name: "chain n=…"."""
        return self._problem(name or f"chain n={self.num_variables}", exact_chain_minimum(self))

    def prog(self) -> MathematicalProgram:
        """Return the program: an ExpressionCost for every variable, and the box."""
        return self._problem("", np.zeros(self.num_variables)).prog()

    def _problem(self, name: str, x: Floats) -> GlobalProblem:
        n = self.num_variables
        pairs = np.arange(n - 1)[:, None] + [0, 1]
        parts = (
            Part(_link, pairs, np.column_stack((self.coupling, self.roots[:-1]))),
            Part(_well, [n - 1], self.roots[-1:]),
        )
        minimum = float(self.evaluate(x))
        return GlobalProblem(name, (-REACH, REACH), minimum, x, parts, "Labbe & Del Prete (2025)")


def chain_problem(n: int, seed: int) -> ChainProblem:
    """Return a random function of n variables of the family; the same seed, the same function.

    Raises:
        OptionsError: n is less than 2, which is no chain.
    """
    if n < 2:
        raise OptionsError("n", got=n, expected="2 variables or more")
    rng = np.random.default_rng([n, seed])
    centers = -2.0 + 0.8 * np.arange(NUM_ROOTS)
    roots = centers + rng.uniform(-1.0 / 3.0, 1.0 / 3.0, (n, NUM_ROOTS))
    return ChainProblem(roots, rng.uniform(-1.0, 1.0, n - 1))


def _well(x: Any, *roots: Any) -> Any:
    value = x - roots[0]
    for root in roots[1:]:
        value = value * (x - root)
    return value


def _link(x: Any, after: Any, coupling: Any, *roots: Any) -> Any:
    return _well(x, *roots) + coupling * x * after


def exact_chain_minimum(problem: ChainProblem, grid_points: int = GRID_POINTS) -> Floats:
    """Return the global minimizer over the box, shape (n,).

    Dynamic programming over a grid in every variable finds the grid's best point exactly; Newton's
    method takes it down its basin. That is the global minimizer unless another basin is deeper by
    less than what the grid hides, at most Σ_i f″_i (spacing)²/8 in f; compare two grids to see.
    """
    grid = np.linspace(-REACH, REACH, grid_points)
    own = np.ones((problem.num_variables, grid_points))
    for root in problem.roots.T:
        own *= grid - root[:, None]
    return _polish(problem, grid[_best_path(own, problem.coupling, grid)])


@kernel
def _best_path(own: Floats, coupling: Floats, grid: Floats) -> NDArray[np.int64]:
    """Indices that minimise Σ own[i, k_i] + Σ coupling[i] grid[k_i] grid[k_{i+1}].

    With C(u) the least cost up to x_i = u, the next one's is min_u C(u) + b v u: over the lower
    convex hull of (u, C(u)) that is where the hull's slope passes −b v. So a step costs O(grid).
    """
    n, num = own.shape
    choices = np.empty((n - 1, num), np.int32)
    hull = np.empty(num, np.int64)
    cost = own[0].copy()
    for i in range(n - 1):
        size = 0
        for k in range(num):
            while size > 1 and _is_above(grid, cost, hull[size - 2], hull[size - 1], k):
                size -= 1
            hull[size] = k
            size += 1
        following = own[i + 1].copy()
        place = 0
        for step in range(num):  # in the order in which −b v rises, so that `place` only rises
            k = step if coupling[i] < 0.0 else num - 1 - step
            slope = coupling[i] * grid[k]
            while (
                place + 1 < size
                and cost[hull[place + 1]] + slope * grid[hull[place + 1]]
                <= cost[hull[place]] + slope * grid[hull[place]]
            ):
                place += 1
            choices[i, k] = hull[place]
            following[k] += cost[hull[place]] + slope * grid[hull[place]]
        cost = following
    path = np.empty(n, np.int64)
    path[n - 1] = np.argmin(cost)
    for i in range(n - 2, -1, -1):
        path[i] = choices[i, path[i + 1]]
    return path


@kernel
def _is_above(grid: Floats, cost: Floats, left: int, middle: int, right: int) -> bool:
    """Whether the middle point is on or above the chord between the two others."""
    rise = (cost[middle] - cost[left]) * (grid[right] - grid[left])
    return rise >= (cost[right] - cost[left]) * (grid[middle] - grid[left])


def _polish(problem: ChainProblem, x: Floats) -> Floats:
    """Newton's method in the box; variables at a bound that the slope pushes outward are held."""
    for _ in range(_NEWTON_STEPS):
        gradient = problem.gradient(x)
        free = np.abs(np.clip(x - gradient, -REACH, REACH) - x) > 0
        curvature = np.where(free, _derivatives(problem.roots, x)[1], 1.0)
        beside = np.where(free[:-1] & free[1:], problem.coupling, 0.0)
        banded = np.array([np.append(0.0, beside), curvature])
        longer = np.clip(x - solveh_banded(banded, np.where(free, gradient, 0.0)), -REACH, REACH)
        step, x = float(np.max(np.abs(longer - x))), longer
        if step <= _RESOLUTION:
            break
    return x


def _derivatives(roots: Floats, x: Floats) -> tuple[Floats, Floats]:
    """First and second derivative of ∏_j (x_i − a_ij) by x_i, each shape (n,)."""
    value, slope, curvature = np.ones_like(x), np.zeros_like(x), np.zeros_like(x)
    for root in roots.T:
        factor = x - root
        curvature = curvature * factor + 2.0 * slope
        slope = slope * factor + value
        value = value * factor
    return slope, curvature
