"""AIGO on functions with loops, beside an annealing that was written for them.

    python -m benchmarks.loops [--families wells roots ripples springs] [--size 15] [--count 3]
        [--first-seed 100] [--seconds 10] [--workers 1]

Functions are of variables that are coupled in loops: grids and braced rings of springs.

    f(x) = Σ_i single(x_i; a_i) + Σ_(i,j) pair(x_i, x_j; b_ij)

over nodes i of one or two coordinates each, all within ±reach. Their minima are not known: dynamic
programming takes too long for these loops. Gap: (f − best) / |best|, of the best that both know.

The annealing moves one node at a time and adds up only what that node appears in (Numba). Steps
follow the acceptance, a tenth of the moves draw anew, and it cools by powers from moves' usual
change of f to a hundredth. It runs three times in the given seconds, and L-BFGS-B ends each run.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numba import njit
from numba.core.errors import NumbaExperimentalFeatureWarning
from pydrake.solvers import ExpressionCost, MathematicalProgram
from scipy.optimize import minimize
from scipy.sparse import coo_array

from benchmarks.collections.chain import NUM_ROOTS, REACH
from benchmarks.peers import time_solve
from benchmarks.script import machine, read_flags, run_all, run_as
from drake_aigto.arrays import Floats, Ints
from drake_aigto.box import BoxPolynomial
from drake_aigto.kernels import kernel
from drake_aigto.solver import AigoOptions, AigoSolver
from drake_aigto.terms import parse_costs


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
    """One function."""

    name: str  # which
    single: Callable[..., Any]  # of the coordinates of a node, and its numbers
    pair: Callable[..., Any]  # of those of two nodes, and their edge's numbers
    nodes: Floats  # numbers a of each node, shape (N, p)
    edges: Ints  # pairs of nodes, shape (E, 2)
    links: Floats  # numbers b of each edge, shape (E, q)
    dimension: int  # coordinates of a node
    reach: float  # bounds of all coordinates

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


FAMILIES = ("wells", "roots", "ripples", "springs")
RUNS = 3
CLOSE = 0.01  # of the annealing's value
_TRIAL_SWEEPS = 50
# Functions are arguments of the annealing.
warnings.filterwarnings("ignore", category=NumbaExperimentalFeatureWarning)


@dataclass(frozen=True)
class Run:
    """One function, solved both ways.

    Attributes:
        problem: its name.
        ours, annealed, best: values; the last is the least that is known.
        seconds: of the processor, ours.
    """

    problem: str
    ours: float
    annealed: float
    best: float
    seconds: float

    def gap(self, value: float) -> float:
        """Returns how far a value is above the best, relative to it."""
        return (value - self.best) / abs(self.best)


def main() -> None:
    """Runs all families, and prints each function and a summary."""
    arguments = read_flags(
        __doc__,
        families=(FAMILIES, "", {"choices": FAMILIES}),
        size=(15, ""),
        count=(3, "functions of each family"),
        first_seed=(100, ""),
        seconds=(10.0, "of the annealing"),
    )
    print(machine())
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.count)
    jobs = [(family, arguments.size, seed) for family in arguments.families for seed in seeds]
    work = partial(run, seconds=arguments.seconds)
    runs = run_all(work, jobs, arguments)
    for each in runs:
        print(
            f"{each.problem:28} best {each.best:12.5f}  ours {each.gap(each.ours):7.3%} in "
            f"{each.seconds:5.2f} s  annealing {each.gap(each.annealed):7.3%}"
        )
    for family in arguments.families:
        summarise(family, [each for each in runs if each.problem.startswith(family)])


def summarise(family: str, runs: list[Run]) -> None:
    """Prints mean and worst gaps of a family, and in how many ours is close to the annealing."""
    gaps = [(each.gap(each.ours), each.gap(each.annealed)) for each in runs]
    (ours, theirs), (worst, their_worst) = np.mean(gaps, axis=0), np.max(gaps, axis=0)
    close = sum(each.ours <= each.annealed + CLOSE * abs(each.annealed) for each in runs)
    slowest = max(each.seconds for each in runs)
    print(
        f"{family:8} ours {ours:.3%} (worst {worst:.3%}), annealing {theirs:.3%} (worst "
        f"{their_worst:.3%}); within 1 % of it {close} of {len(runs)}, slowest {slowest:.2f} s"
    )


def run(job: tuple[str, int, int], *, seconds: float) -> Run:
    """Solves one function both ways; all is compiled before it is timed."""
    family, size, seed = job
    AigoSolver().Solve(loop_problem(family, 3, 0).prog())
    anneal(loop_problem(family, 3, 0), 0.0, 0)
    problem = loop_problem(family, size, seed)
    result, took = time_solve(problem.prog(), AigoOptions())
    ours, annealed = result.get_optimal_cost(), anneal(problem, seconds, seed)
    return Run(problem.name, ours, annealed, min(ours, annealed), took)


def anneal(problem: LoopProblem, seconds: float, seed: int) -> float:
    """Returns the least value of three annealings that take so many seconds in all."""
    prog = problem.prog()
    f = BoxPolynomial(prog.num_vars(), parse_costs(prog))
    starts, numbers, others = _neighbors(problem)
    tables = problem.nodes, starts, numbers, others, problem.links

    def sweep(x: Floats, seed: int, count: int, hot: float, cold: float) -> float:
        change: float = _anneal(
            problem.single, problem.pair, x, *tables, problem.reach, count, hot, cold, seed
        )
        return change

    rng = np.random.default_rng(seed)
    best = np.inf
    for number in range(RUNS):
        x = rng.uniform(-problem.reach, problem.reach, (len(problem.nodes), problem.dimension))
        hot = sweep(x, number, 1, 1e3, 1e3)
        begin = time.process_time()
        sweep(x, number, _TRIAL_SWEEPS, hot, hot)
        each = (time.process_time() - begin) / _TRIAL_SWEEPS
        sweep(x, number, int(seconds / RUNS / each), hot, hot / 100)
        best = min(best, _descend(f, x.ravel(), problem.reach))
    return best


def _descend(f: BoxPolynomial, x: Floats, reach: float) -> float:
    def value_and_slope(x: Floats) -> tuple[float, Floats]:
        value, slope, _ = f.gradient(x, np.zeros(x.size))
        return value, slope

    bounds = [(-reach, reach)] * x.size
    found = minimize(value_and_slope, x, jac=True, method="L-BFGS-B", bounds=bounds)
    return float(found.fun)


def _neighbors(problem: LoopProblem) -> tuple[Ints, Ints, Ints]:
    """Returns for each node its first place; and there edges and neighbors, −1 − j if j is first.

    The neighbor's sign says which end of the edge it is, as pairs need not be symmetric.
    """
    count = len(problem.nodes)
    i, j = problem.edges.T
    edge = np.arange(len(i)) + 1
    rows, columns = np.concatenate([i, j]), np.concatenate([j, i])
    table = coo_array((np.concatenate([edge, -edge]), (rows, columns)), (count, count)).tocsr()
    others = np.where(table.data > 0, table.indices, -1 - table.indices)
    return table.indptr.astype(np.int64), np.abs(table.data) - 1, others.astype(np.int64)


@kernel
def _local(
    single: Callable[..., float],
    pair: Callable[..., float],
    x: Floats,
    y: Floats,
    i: int,
    nodes: Floats,
    starts: Ints,
    numbers: Ints,
    others: Ints,
    links: Floats,
) -> float:
    """Returns all that node i appears in, if it is at y."""
    total = single(y, nodes[i])
    for k in range(starts[i], starts[i + 1]):
        j = others[k]
        if j >= 0:
            total += pair(y, x[j], links[numbers[k]])
        else:
            total += pair(x[-1 - j], y, links[numbers[k]])
    return total


@kernel
def _anneal(
    single: Callable[..., float],
    pair: Callable[..., float],
    x: Floats,
    nodes: Floats,
    starts: Ints,
    numbers: Ints,
    others: Ints,
    links: Floats,
    reach: float,
    count: int,
    hot: float,
    cold: float,
    seed: int,
) -> float:
    """Sweeps over all nodes so many times; returns how much a new draw changes f on average."""
    np.random.seed(seed)
    y = np.empty(x.shape[1])
    step, changes = reach, 0.0
    draws = 1
    for sweep in range(count):
        temperature = hot * (cold / hot) ** (sweep / count)
        accepted = 0
        for i in range(x.shape[0]):
            is_new = np.random.random() < 0.1
            is_out = False
            for k in range(y.size):
                y[k] = (
                    np.random.uniform(-reach, reach)
                    if is_new
                    else (x[i, k] + step * np.random.normal())
                )
                is_out |= abs(y[k]) > reach
            if is_out:
                continue
            tables = nodes, starts, numbers, others, links
            change = _local(single, pair, x, y, i, *tables) - _local(
                single, pair, x, x[i], i, *tables
            )
            if is_new:
                changes += abs(change)
                draws += 1
            if change < 0.0 or np.random.random() < np.exp(-change / temperature):
                x[i] = y
                accepted += 0 if is_new else 1
        step = min(reach, step * (1.05 if accepted > 0.4 * x.shape[0] else 0.95))
    return changes / draws


if __name__ == "__main__":
    run_as("benchmarks.loops")
