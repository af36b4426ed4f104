"""Lower bounds: how near they come, how long they take, and whether any is above what is known.

    python -m benchmarks.certificates [--chains 50 170 1000 10000] [--univariate 1000]
        [--programs 10000] [--scenarios 500] [--worlds 100] [--workers 1] [--keep FILE]

Chains, polynomials and test functions are solved with `AigoOptions(certify=True)`, and their bounds
held against exact optima; those of random programs, after a random number of cells, against the
best of 10,000 random points. Bounds of plans are held against exact optima over all
controls; of corridors with e < 1, against the best of listed sequences of bounces. A bound is wrong
if it is above that by more than what is given as rounding.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pydrake.symbolic as sym
from pydrake.solvers import ExpressionCost, MathematicalProgram

from benchmarks.collections.chain import chain_problem, exact_chain_minimum
from benchmarks.collections.constrained_programs import constrained_problems
from benchmarks.collections.global_functions import global_problems, random_univariate
from benchmarks.collections.known_optimum import ConstrainedProblem, GlobalProblem
from benchmarks.optima import ContactOptimum
from benchmarks.script import machine, read_flags, run_as, run_jobs
from benchmarks.worlds import WORLDS
from drake_aigto.arrays import Floats
from drake_aigto.certify import bound_plans, certify
from drake_aigto.paper import RigidOptimum, rigid_optimum
from drake_aigto.solver import AigoDetails, AigoOptions, AigoSolver, AigoStatus
from drake_aigto.world import Scenario, World

DEGREES = (4, 6, 8, 10, 12)
RESTITUTIONS = (1.0, 0.9, 0.8, 0.5, 0.2, 0.0)
LOSSY = (0.8, 0.5)
FEW = 4  # variables of the test functions
PERMITTED = 10.0  # seconds of one of them
SAMPLES = 10_000
PART = 1000  # random programs at a time
# Known optima are themselves rounded by this part of their size, or of 1.
ROUNDING = 1e-9

SOLVER = AigoSolver(AigoOptions(certify=True))

# A line to print, and how many bounds are wrong.
Found = tuple[str, int]


def main() -> None:
    arguments = read_flags(
        __doc__,
        chains=((50, 170, 1000, 10000), ""),
        univariate=(1000, "polynomials"),
        programs=(10000, "random programs"),
        scenarios=(500, "of one wall"),
        worlds=(100, "scenarios of other worlds"),
        lossy=(25, "corridors of each restitution below 1"),
    )
    print(machine(), flush=True)
    worlds = ("corridor", "room", "floor", "two_masses")
    parts = range(0, arguments.programs, PART)
    jobs: list[tuple[Any, ...]] = [
        *(("chain", n) for n in arguments.chains),
        ("univariate", arguments.univariate),
        ("few_variables",),
        ("constrained",),
        ("one_wall", arguments.scenarios),
        *(("world", name, arguments.worlds) for name in worlds),
        *(("world", "corridor", arguments.lossy, e) for e in LOSSY),
        *(("random_programs", min(PART, arguments.programs - first), first) for first in parts),
    ]
    wrong = 0
    for _, future in run_jobs(run, jobs, arguments):
        line, above = future.result()
        print(line, flush=True)
        wrong += above
    print(f"bounds that were wrong, in all: {wrong}")


def run(job: tuple[Any, ...]) -> Found:
    """Measures one thing: the name of a function here, and what it is called with."""
    warm_up()
    name, *arguments = job
    found: Found = globals()[name](*arguments)
    return found


@cache
def warm_up() -> None:
    """Has machine code compiled or loaded."""
    constrained = next(each for each in constrained_problems() if each.num_variables == 2)
    for prog in (chain_problem(10, 0).prog(), random_univariate(4, 0).prog(), constrained.prog()):
        SOLVER.Solve(prog)


def chain(n: int) -> Found:
    """Solves one of AIGO's family at one size."""
    problem = chain_problem(n, 100)
    prog, least = problem.prog(), problem.evaluate(exact_chain_minimum(problem))
    start = time.process_time()
    result = SOLVER.Solve(prog)
    seconds = time.process_time() - start
    details: AigoDetails = result.get_solver_details()
    above = (result.get_optimal_cost() - least) / abs(least)
    line = (
        f"chain n = {n:5}  {seconds:6.2f} s  {details.status.name:7} gap {details.gap:.1e}  "
        f"answer {above:.1e} above the optimum  boxes {details.boxes}"
    )
    return line, is_wrong(details.lower_bound, least)


def is_wrong(bound: float, least: float) -> int:
    return int(bound > least + ROUNDING * max(1.0, abs(least)))


def univariate(count: int) -> Found:
    """Counts how many polynomials of one variable are proven, and times the bound."""
    proven, wrong, seconds = 0, 0, []
    for number in range(count):
        problem = random_univariate(DEGREES[number % len(DEGREES)], number)
        prog = problem.prog()
        result = SOLVER.Solve(prog)
        details = result.get_solver_details()
        proven += details.status == AigoStatus.PROVEN
        wrong += is_wrong(details.lower_bound, problem.minimum)
        start = time.process_time()
        certify(prog, result.GetSolution())
        seconds.append(time.process_time() - start)
    line = (
        f"polynomials of one variable: {proven} of {count} proven; the bound takes "
        f"{1e3 * np.median(seconds):.2f} ms, at most {1e3 * max(seconds, default=0.0):.2f} ms"
    )
    return line, wrong


def few_variables() -> Found:
    few = [problem for problem in global_problems() if problem.num_variables <= FEW]
    return _solve_all(f"test functions of up to {FEW} variables", few)


def constrained() -> Found:
    few = [problem for problem in constrained_problems() if problem.num_variables <= 3]
    return _solve_all("constrained programs of up to 3 variables", few)


def _solve_all(name: str, problems: Sequence[GlobalProblem | ConstrainedProblem]) -> Found:
    """Counts how many problems are proven in time."""
    proven, wrong, seconds, left = 0, 0, [], []
    for problem in problems:
        start = time.process_time()
        details = SOLVER.Solve(problem.prog()).get_solver_details()
        seconds.append(time.process_time() - start)
        if details.status == AigoStatus.PROVEN and seconds[-1] <= PERMITTED:
            proven += 1
        else:
            left.append(f"{problem.name} {details.gap:.0e}")
        wrong += is_wrong(details.lower_bound, problem.minimum)
    line = (
        f"{name}: {proven} of {len(seconds)} proven in {PERMITTED:g} s; median "
        f"{1e3 * np.median(seconds):.0f} ms, at most {max(seconds):.2f} s; gaps left: "
        f"{', '.join(left) or 'none'}"
    )
    return line, wrong


def random_programs(count: int, seed: int) -> Found:
    """Counts in how many random programs a bound is above the best value of random points."""
    generator = np.random.default_rng(seed)
    wrong = 0
    for _ in range(count):
        draw = RandomProgram.draw(generator)
        bound = certify(draw.prog(), cells=int(generator.integers(1, 300))).lower_bound
        wrong += bound > draw.best_value(generator)
    line = f"random programs, from {seed} on: {wrong} of {count} bounds above the best known value"
    return line, wrong


@dataclass(frozen=True)
class RandomProgram:
    """A chain of up to six variables of quartics, waves and products, perhaps with a row.

    Attributes:
        own: of x_i⁴ … x_i, and of its wave (n, 5).
        links: of x_i x_(i+1) (n − 1,).
        row: (a, b) of x_0 x_1 + a x_0² ≤ b, or None.
        lower: bounds of x (n,).
        upper: shape (n,).
    """

    own: Floats
    links: Floats
    row: tuple[float, float] | None
    lower: Floats
    upper: Floats

    @classmethod
    def draw(cls, generator: np.random.Generator) -> RandomProgram:
        """Returns one; a third of those of several variables have a row."""
        n = int(generator.integers(1, 7))
        lower = generator.uniform(-2.0, 0.0, n)
        has_row = n > 1 and generator.random() < 1 / 3
        return cls(
            generator.normal(size=(n, 5)),
            generator.normal(size=n - 1),
            (generator.normal(), generator.normal()) if has_row else None,
            lower,
            lower + generator.uniform(0.1, 3.0, n),
        )

    def cost(self, x: Any, waves: Sequence[Any]) -> Any:
        """Returns f of numbers, arrays or Expressions, and of their waves."""
        total = 0.0
        for i, (own, (a, b, c, d, e)) in enumerate(zip(x, self.own.tolist(), strict=True)):
            total = total + a * own**4 + b * own**3 + c * own**2 + d * own + e * waves[i % 3](own)
        for i, link in enumerate(self.links.tolist()):
            total = total + link * x[i] * x[i + 1]
        return total

    def prog(self) -> MathematicalProgram:
        """Returns it for Drake."""
        prog = MathematicalProgram()
        x = prog.NewContinuousVariables(self.lower.size, "x")
        prog.AddBoundingBoxConstraint(self.lower, self.upper, x)
        cost = ExpressionCost(self.cost(x, (sym.sin, sym.cos, sym.exp)))
        prog.AddCost(cost, vars=cost.vars())
        if self.row:
            prog.AddConstraint(x[0] * x[1] + self.row[0] * x[0] ** 2 <= self.row[1])
        return prog

    def best_value(self, generator: np.random.Generator) -> float:
        """Returns the least cost of feasible points among many random ones."""
        points = generator.uniform(self.lower, self.upper, (SAMPLES, self.lower.size)).T
        values = self.cost(points, (np.sin, np.cos, np.exp))
        if self.row:
            values = values[points[0] * points[1] + self.row[0] * points[0] ** 2 <= self.row[1]]
        return float(np.min(values, initial=np.inf))


def one_wall(count: int) -> Found:
    return _bound_all("one wall, every e", draw_one_wall(count), 1e-3, rigid_optimum)


def draw_one_wall(count: int) -> Iterator[Scenario]:
    generator = np.random.default_rng(0)
    for number in range(count):
        yield Scenario(
            initial_position=generator.uniform(0.2, 1.5),
            initial_velocity=generator.uniform(-3.0, 0.5),
            goal_position=generator.uniform(0.2, 1.5),
            restitution=RESTITUTIONS[number % len(RESTITUTIONS)],
        )


def world(name: str, count: int, restitution: float | None = None) -> Found:
    """Measures how near bounds are in a world, perhaps with another restitution."""
    study, scenarios = WORLDS[name], WORLDS[name].draw(count, 2026)
    if restitution is not None:
        name = f"{name}, e = {restitution:g}"
        scenarios = (dataclasses.replace(each, restitution=restitution) for each in scenarios)
    return _bound_all(name, scenarios, 1e-2, study.optimum)


def _bound_all(
    name: str,
    scenarios: Iterator[Scenario],
    enough: float,
    optimum: Callable[[World, Scenario], RigidOptimum | ContactOptimum],
) -> Found:
    """Measures how near bounds of plans are to the exact optima."""
    near, wrong, seconds = 0, 0, []
    for scenario in scenarios:
        place = World.from_scenario(scenario)
        least = optimum(place, scenario).cost
        start = time.process_time()
        bound = bound_plans(place, scenario, least)
        seconds.append(time.process_time() - start)
        # Not `PlanBound.gap`: that is of the task's scale where the bound is 0.
        near += least - (bound.lower_bound or 0.0) <= enough * least + ROUNDING * bound.scale
        # What is above the optimum is cut to the cost that is given: ask again with a dearer plan.
        dear = bound_plans(place, scenario, 1.1 * least + 1e-3 * bound.scale)
        low = dear.lower_bound or 0.0
        wrong += low > least + ROUNDING * max(least, bound.scale)
    line = (
        f"{name}: {near} of {len(seconds)} within {enough:g}; median "
        f"{1e3 * np.median(seconds):.1f} ms, at most {1e3 * max(seconds, default=0.0):.1f} ms"
    )
    return line, wrong


if __name__ == "__main__":
    run_as("benchmarks.certificates")
