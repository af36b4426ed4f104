"""Newton systems whose band is wide: a variable that all share, and a square grid.

    python -m benchmarks.wide_bands [--most 20000]

Boxes shrink over a few temperatures (`aigo.Annealing`), and the local solver solves a program: the
least time by trapezoids that share one free time step, and the control of −Δq + q³ = u on a grid.
Each in a process of its own, one thread, as the package chooses and, where a factorization is
predicted to take no more than some seconds, without sparse factors: CPU seconds an iteration, the
largest memory that the process had, less what it had before, and where it ends. Last, `AigoSolver`
on a MathematicalProgram of 10,000 variables that share one. Writes wide_bands.csv; exits with 1
unless both storages end in the same optimum, and time per variable and iteration grows by less than
a factor 3 from 1,000 variables to the most, where all share one. On grids L itself grows faster.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import dataclasses
import json
import resource
import subprocess
import sys
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from pydrake.solvers import ExpressionConstraint, ExpressionCost, MathematicalProgram, QuadraticCost
from pydrake.symbolic import Variable

from benchmarks.growth import RESIDENT_UNIT
from benchmarks.measure import clock, is_met, write_csv
from drake_aigto import AigoOptions, AigoSolver
from drake_aigto.aigo import Annealing, Box, minimize
from drake_aigto.box import BoxPolynomial
from drake_aigto.linear import Storage
from drake_aigto.local import InteriorPoint, PolynomialNlp, compile_nlp
from drake_aigto.terms import Factor, FunctionKind, Term, TermBlock

SIZES = (100, 400, 1000, 4000, 10_000, 20_000)
MOST_BAND_WORK = 2e10  # size · b², of a factorization without sparse factors: some three seconds
LARGEST_GROWTH = 3.0
SAME = 1e-6  # relative, of two optima
ARROW, GRID = "arrow", "grid"
BOXES, LOCAL, SOLVER = "boxes", "local solver", "AigoSolver"
SHORT = Annealing(initial_temperature=1e-2, final_temperature=2e-3, max_newton_steps=10)


@dataclass(frozen=True)
class Run:
    """One process: a line of the CSV file."""

    family: str
    method: str
    variables: int
    may_be_sparse: bool
    factorization: str
    unknowns: int
    bandwidth: int
    fill: int | None
    iterations: int
    seconds: float  # CPU, of all iterations
    memory: float  # [bytes]
    optimum: float

    @property
    def seconds_each(self) -> float:
        """Of one iteration."""
        return self.seconds / max(1, self.iterations)

    @property
    def band_work(self) -> float:
        """Multiplications that a factorization of the band takes."""
        return float(self.unknowns) * float(self.bandwidth) ** 2


def main() -> int:
    """Starts a process for each line, prints, writes and judges."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--most", type=int, default=SIZES[-1], help="variables")
    parser.add_argument("--out", type=Path, default=Path(), help="folder of the CSV")
    parser.add_argument("--run", nargs=4, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.run:
        family, method, variables, may_be_sparse = arguments.run
        run = measure(family, method, int(variables), may_be_sparse == "True")
        print(json.dumps(dataclasses.asdict(run)))
        return 0
    found: list[Run] = []
    for family in (ARROW, GRID):
        for method in (BOXES, LOCAL):
            for variables in (each for each in SIZES if each <= arguments.most):
                found += compare(family, method, variables)
    found.append(start(ARROW, SOLVER, min(10_000, arguments.most), True))
    tell(found[-1], None)
    write_csv(arguments.out / "wide_bands.csv", found, "one thread")
    return 0 if judge(found) else 1


def compare(family: str, method: str, variables: int) -> list[Run]:
    """Returns a run as the package chooses and, where that would not take long, one of bands."""
    chosen = start(family, method, variables, True)
    other = None
    if "sparse" in chosen.factorization and chosen.band_work <= MOST_BAND_WORK:
        other = start(family, method, variables, False)
    tell(chosen, other)
    return [chosen] if other is None else [chosen, other]


def start(family: str, method: str, variables: int, may_be_sparse: bool) -> Run:
    """Returns what a process of its own measures."""
    command = [
        sys.executable,
        "-m",
        "benchmarks.wide_bands",
        "--run",
        family,
        method,
        str(variables),
    ]
    process = subprocess.run(
        [*command, str(may_be_sparse)], check=True, stdout=subprocess.PIPE, text=True
    )
    return Run(**json.loads(process.stdout))


def measure(family: str, method: str, variables: int, may_be_sparse: bool) -> Run:
    """Solves smaller problems, which loads compiled code, and then the one asked for."""
    solve = {BOXES: shrink, LOCAL: polish, SOLVER: search}[method]
    # No call of SuperLU seems to pay then.
    bands = patch("drake_aigto.linear.storage._SPARSE_CALL", np.inf)
    with nullcontext() if may_be_sparse else bands:
        for small in (100, 400 if may_be_sparse else 100):
            solve(family, small)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        storage, iterations, seconds, optimum = solve(family, variables)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    return Run(
        *(family, method, variables, may_be_sparse),
        *(storage.factorization.value, storage.size, storage.bandwidth, storage.fill),
        *(iterations, seconds, float(memory * RESIDENT_UNIT), optimum),
    )


def shrink(family: str, variables: int) -> tuple[Storage, int, float, float]:
    """Returns storage, Newton steps, seconds and the mean of boxes at some temperature."""
    f = chain_of_wells(variables) if family == ARROW else grid_of_wells(side(variables))
    box = Box(np.full(f.num_variables, 0.1), np.full(f.num_variables, 2.0))
    result, seconds = clock(lambda: minimize(f, box, SHORT))
    return result.storage, result.num_inner_steps, seconds.cpu, result.history[-1].mean


def polish(family: str, variables: int) -> tuple[Storage, int, float, float]:
    """Returns storage, iterations, seconds and the optimum of the local solver."""
    nlp = shortest_time(variables // 3) if family == ARROW else control_of_field(variables)
    start = np.clip(np.full(nlp.num_variables, 0.02), nlp.lower, nlp.upper)
    result, seconds = clock(lambda: InteriorPoint().solve(nlp, start))
    assert result.is_success, result.status
    return result.storage, result.iterations, seconds.cpu, result.cost


def search(_: str, variables: int) -> tuple[Storage, int, float, float]:
    """Returns storage, iterations, seconds and the optimum of a few rounds of `AigoSolver`."""
    program = wells_with_shared_variable(variables)
    result, seconds = clock(lambda: AigoSolver(AigoOptions(rounds=5)).Solve(program))
    assert result.is_success()
    details = result.get_solver_details()
    return details.box_storage, details.iterations, seconds.cpu, result.get_optimal_cost()


def side(variables: int) -> int:
    """Returns that of the largest square of no more variables."""
    return int(np.sqrt(variables))


def monomial(coefficient: float, *powers: tuple[int, int]) -> Term:
    """Returns the term of (variable, exponent)."""
    return Term(coefficient, tuple(Factor(i, FunctionKind.POWER, p) for i, p in powers))


def wells(variables: int) -> tuple[TermBlock, ...]:
    """Returns Σ (x² − 1)², a tilt for each tenth x, at random."""
    well = (monomial(1.0, (0, 4)), monomial(-2.0, (0, 2)), monomial(1.0))
    tilts = np.random.default_rng(0).normal(size=10)
    tilted = [
        TermBlock(
            f"tilt {k}",
            (monomial(float(tilt), (0, 1)),),
            np.arange(k, variables, 10)[:, np.newaxis],
        )
        for k, tilt in enumerate(tilts)
    ]
    return TermBlock("wells", well, np.arange(variables)[:, np.newaxis]), *tilted


def chain_of_wells(variables: int) -> BoxPolynomial:
    """Returns wells, each coupled to the next one and to the first."""
    i = np.arange(1, variables - 1)
    link = monomial(0.3, (0, 1), (1, 1)), monomial(0.1, (0, 1), (1, 1), (2, 1))
    links = TermBlock("links", link, np.column_stack([i, i + 1, np.zeros_like(i)]))
    return BoxPolynomial(variables, (links, *wells(variables)))


def grid_of_wells(side: int) -> BoxPolynomial:
    """Returns wells, each coupled to its neighbours."""
    i = np.arange(side * side).reshape(side, side)
    pairs = (i[:, :-1], i[:, 1:]), (i[:-1], i[1:])
    edges = np.vstack([np.column_stack([a.ravel(), b.ravel()]) for a, b in pairs])
    links = TermBlock("links", (monomial(0.4, (0, 1), (1, 1)),), edges)
    return BoxPolynomial(side * side, (links, *wells(side * side)))


def stages(expressions: list[Any], local: list[Variable], places: Any) -> Any:
    """Yields a shared row evaluator's variables, in its order, at each of some places."""
    row = ExpressionConstraint(expressions, np.zeros(len(expressions)), np.zeros(len(expressions)))
    for variables in places:
        of_id = {each.get_id(): x for each, x in zip(local, variables, strict=True)}
        yield row, [of_id[each.get_id()] for each in row.vars()]


def shortest_time(steps: int) -> PolynomialNlp:
    """Returns the least time from rest at 0 to rest at 1 with |u| ≤ 1, of steps h that are free."""
    prog = MathematicalProgram()
    q, v = prog.NewContinuousVariables(steps + 1, "q"), prog.NewContinuousVariables(steps + 1, "v")
    u, h = prog.NewContinuousVariables(steps, "u"), prog.NewContinuousVariables(1, "h")
    for point, position in ((0, 0.0), (steps, 1.0)):
        prog.AddBoundingBoxConstraint(position, position, q[point])
        prog.AddBoundingBoxConstraint(0.0, 0.0, v[point])
    prog.AddBoundingBoxConstraint(-1.0, 1.0, u)
    prog.AddBoundingBoxConstraint(1e-6, 10.0, h)
    prog.AddLinearCost([float(steps)], 0.0, h)
    a = [Variable(name) for name in ("q0", "q1", "v0", "v1", "u", "h")]
    rows = [a[1] - a[0] - a[5] * (a[2] + a[3]) * 0.5, a[3] - a[2] - a[5] * a[4]]
    places = ([*q[k : k + 2], *v[k : k + 2], u[k], h[0]] for k in range(steps))
    for row, variables in stages(rows, a, places):
        prog.AddConstraint(row, vars=variables)
    return compile_nlp(prog)


def control_of_field(variables: int) -> PolynomialNlp:
    """Returns Σ (q − 1)² + 0.01 u² s.t. −Δq + q³ = u on a square, q = 0 on its edge."""
    n = side(variables // 2)
    prog = MathematicalProgram()
    q, u = prog.NewContinuousVariables(n + 2, n + 2, "q"), prog.NewContinuousVariables(n, n, "u")
    is_edge = np.ones((n + 2, n + 2), dtype=bool)
    is_edge[1:-1, 1:-1] = False
    prog.AddBoundingBoxConstraint(0.0, 0.0, q[is_edge])
    miss, effort = QuadraticCost([[2.0]], [-2.0], 1.0), QuadraticCost([[0.02]], [0.0], 0.0)
    for cost, variables_of in ((miss, q[1:-1, 1:-1]), (effort, u)):
        for each in variables_of.ravel():
            prog.AddCost(cost, vars=[each])
    a = [Variable(name) for name in ("q", "left", "right", "below", "above", "u")]
    row = 4 * a[0] - sum(a[1:5]) + a[0] ** 3 / n**2 - a[5] / n
    places = (
        [q[i, j], q[i - 1, j], q[i + 1, j], q[i, j - 1], q[i, j + 1], u[i - 1, j - 1]]
        for i in range(1, n + 1)
        for j in range(1, n + 1)
    )
    for shared, read in stages([row], a, places):
        prog.AddConstraint(shared, vars=read)
    return compile_nlp(prog)


def wells_with_shared_variable(variables: int) -> MathematicalProgram:
    """Returns Σ (x_k² − s)² + 0.2 (x_k − x_{k−1})² + 0.2 x_k s, s shared by all."""
    prog = MathematicalProgram()
    x, s = prog.NewContinuousVariables(variables, "x"), prog.NewContinuousVariables(1, "s")
    prog.AddBoundingBoxConstraint(-2.0, 2.0, x)
    prog.AddBoundingBoxConstraint(0.5, 2.0, s)
    a = [Variable(name) for name in ("before", "x", "s")]
    stage = ExpressionCost((a[1] ** 2 - a[2]) ** 2 + 0.2 * (a[1] - a[0]) ** 2 + 0.2 * a[1] * a[2])
    for k in range(1, variables):
        of_id = {a[0].get_id(): x[k - 1], a[1].get_id(): x[k], a[2].get_id(): s[0]}
        prog.AddCost(stage, vars=[of_id[each.get_id()] for each in stage.vars()])
    return prog


def tell(chosen: Run, other: Run | None) -> None:
    """Prints a run, and how many times as long the other one takes."""
    fill = "" if chosen.fill is None else f", L of {chosen.fill:,}"
    line = (
        f"{chosen.family:5} {chosen.method:12} n = {chosen.variables:6}  {chosen.factorization:22} "
        f"{chosen.unknowns:6} unknowns, b = {chosen.bandwidth:5}{fill}: "
        f"{1e3 * chosen.seconds_each:8.2f} ms an iteration, {chosen.iterations} iterations, "
        f"{chosen.memory / 2**20:.0f} MiB"
    )
    if other is not None:
        line += (
            f"; {other.factorization}: {other.seconds_each / chosen.seconds_each:.1f} × as long, "
            f"{other.memory / 2**20:.0f} MiB"
        )
    print(line, flush=True)


def judge(found: list[Run]) -> bool:
    """Returns whether optima agree, and the arrow's work grows in proportion."""
    runs = {(r.family, r.method, r.variables, r.may_be_sparse): r for r in found}
    met = True
    for key, run in runs.items():
        chosen = runs[(*key[:3], True)]
        off = abs(run.optimum - chosen.optimum) / max(1.0, abs(chosen.optimum))
        if not run.may_be_sparse:
            met &= is_met(f"difference of optima, {' '.join(map(str, key[:3]))}", off, SAME)
    for method in (BOXES, LOCAL):
        first, *_, last = (
            r
            for r in found
            if (r.family, r.method, r.may_be_sparse) == (ARROW, method, True)
            and r.variables >= 1000
        )
        growth = (last.seconds_each / last.variables) / (first.seconds_each / first.variables)
        name = (
            f"time per variable and iteration, {method}, n = {last.variables} / {first.variables}"
        )
        met &= is_met(name, growth, LARGEST_GROWTH)
    return met


if __name__ == "__main__":
    sys.exit(main())
