"""AIGO on chains of stages with contact, and multistarts of IPOPT and SNOPT beside it.

    python -m benchmarks.staged_programs [--only push_bot/0.6] [--random 50] [--start-seed 17]
        [--seeds 3] [--workers 1] [--minutes 60]

Every peer has as many seconds of the processor as ours took, one start at least. IPOPT runs through
CasADi on the same rows, with exact Hessians and complementarities λ s ≤ ε that are relaxed and
tightened; the push-bot's starts are roll-outs of random smooth controls, all others random points
of the box, as SNOPT's, which runs through Drake. Best known is the least of all answers, those of
ours from other seeds among them. Feasible: violated by no more than 1e-6.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from pydrake.solvers import SnoptSolver

from benchmarks.collections.staged_programs import StagedProblem, staged_problems
from benchmarks.local_peers import COLD, WARM, casadi, prepare, sum_blocks
from benchmarks.peers import time_solve
from benchmarks.script import machine, read_flags, run_all, run_as, within
from drake_aigto.arrays import Floats
from drake_aigto.solver import AigoOptions, AigoProgram, AigoSolver, StagedProgram, read_program
from drake_aigto.terms import Factor, FunctionKind

FEASIBLE = 1e-6
GLOBAL = 1e-2
_LADDER = (1e-2, 1e-4, 1e-7)  # ε, relative to what IPOPT's λ s varies by
_FARTHEST = 10.0  # a variable without bounds starts within this


@dataclass(frozen=True)
class Run:
    """What came of one program.

    Attributes:
        problem: its name.
        costs: of ours, IPOPT and SNOPT; inf where no answer was feasible.
        seconds: of ours.
        others: of ours from other seeds.
    """

    problem: str
    costs: tuple[float, float, float]
    seconds: float
    others: tuple[float, ...]

    @property
    def known(self) -> float:
        """The least of all answers."""
        return min(*self.costs, *self.others)

    def is_best(self, cost: float) -> bool:
        """Whether a cost is within 1 % of the best known."""
        return bool(np.isfinite(cost) and cost - self.known <= GLOBAL * abs(self.known))


def main() -> None:
    """Runs all programs and prints a line of each, and shares."""
    arguments = read_flags(
        __doc__,
        only=("", "programs whose name has this in it"),
        random=(50, "random starts of the push-bot"),
        start_seed=(17, "of these"),
        seeds=(3, "of ours, for the best known"),
    )
    print(machine())
    problems = staged_problems(arguments.random, arguments.start_seed)
    names = [each.name for each in problems if arguments.only in each.name]
    work = partial(run, starts=(arguments.random, arguments.start_seed), num_seeds=arguments.seeds)
    runs = run_all(work, names, arguments)
    for family in sorted({each.problem.rpartition("/")[0] for each in runs}):
        summarise(family, [each for each in runs if each.problem.startswith(f"{family}/")])


def summarise(family: str, runs: list[Run]) -> None:
    """Prints shares within 1 % of the best known, and seconds."""
    seconds = [each.seconds for each in runs]
    print(
        f"{family}: {len(runs)} programs, ours {np.median(seconds):.2f} s at the median, "
        f"{max(seconds):.2f} s at most"
    )
    for i, name in enumerate(("ours", "IPOPT", "SNOPT")):
        best = sum(each.is_best(each.costs[i]) for each in runs)
        feasible = sum(bool(np.isfinite(each.costs[i])) for each in runs)
        print(f"  {name:6} within 1 % of the best known {best}, feasible {feasible}")


def run(name: str, *, starts: tuple[int, int], num_seeds: int) -> Run:
    """Runs ours, the peers, and ours from other seeds."""
    warm_up()
    (problem,) = (each for each in staged_problems(*starts) if each.name == name)
    program = read_program(problem.prog())
    cost, seconds = run_ours(problem, 0)
    others = tuple(run_ours(problem, seed)[0] for seed in range(1, num_seeds + 1))
    costs = cost, run_ipopt(problem, program, seconds), run_snopt(program, seconds)
    found = Run(name, costs, seconds, others)
    marks = "".join("*" if found.is_best(each) else "-" for each in costs)
    told = " ".join(f"{each:10.5g}" for each in (*costs, found.known))
    print(f"{name:18}{marks} {told} {seconds:6.2f} s", flush=True)
    return found


def warm_up() -> None:
    """Has Numba compile before anything is timed in this process."""
    problem = next(iter(staged_problems(0)))
    AigoSolver(AigoOptions(rounds=2)).Solve(problem.prog())


def run_ours(problem: StagedProblem, seed: int) -> tuple[float, float]:
    """Returns our cost, and seconds."""
    result, seconds = time_solve(problem.prog(), AigoOptions(seed=seed))
    return (result.get_optimal_cost() if result.is_success() else np.inf), seconds


def run_snopt(program: AigoProgram, seconds: float) -> float:
    """Returns the best feasible cost of starts that end in time, of one at least."""
    rng, best = np.random.default_rng(0), np.inf
    for _ in within(seconds):
        found = SnoptSolver().Solve(program.source, random_point(program, rng), None)
        best = min(best, cost_of(program, found.get_x_val()))
    return best


def cost_of(program: AigoProgram, x: Floats) -> float:
    """Returns a point's cost; inf if it is not feasible."""
    if not np.all(np.isfinite(x)) or program.violation(x) > FEASIBLE:
        return np.inf
    return program.cost(x)


def random_point(program: AigoProgram, rng: np.random.Generator) -> Floats:
    """Returns x (n,) of the box."""
    parsed = program.parsed
    return rng.uniform(np.maximum(parsed.lower, -_FARTHEST), np.minimum(parsed.upper, _FARTHEST))


def run_ipopt(problem: StagedProblem, program: AigoProgram, seconds: float) -> float:
    """Returns the best feasible cost of starts that end in time, of one at least."""
    peer, rng = Ipopt(StagedProgram(program, FEASIBLE)), np.random.default_rng(0)
    start: Callable[[np.random.Generator], Floats] = partial(random_point, program)
    if problem.roll_out is not None:
        start = problem.roll_out
    best = np.inf
    for _ in within(seconds):
        best = min(best, cost_of(program, peer.solve(start(rng))))
    return best


class Ipopt:
    """CasADi and IPOPT on a program's rows, complementarities as λ s ≤ ε."""

    def __init__(self, staged: StagedProgram) -> None:
        """Writes the program in CasADi's symbols, over y = (x, slacks)."""
        prepare()
        self._staged, nlp = staged, staged.nlp
        y = casadi.SX.sym("y", nlp.num_variables)
        sums = sum_blocks(nlp.blocks, lambda factor, i: _factor(factor, y[i]))
        costs, rows = sums[: nlp.num_costs], sums[nlp.num_costs :]
        problem = {"x": y, "f": sum(costs, casadi.SX(0.0)), "g": casadi.vertcat(*rows)}
        self._solvers = [
            casadi.nlpsol("peer", "ipopt", problem, options) for options in (COLD, WARM)
        ]

    def solve(self, x: Floats, ladder: Sequence[float] = _LADDER) -> Floats:
        """Returns where IPOPT ends from x (n,), relaxed and tightened.

        Args:
            x: where it starts.
            ladder: ε, one after the other.
        """
        program = self._staged.program
        y = program.with_slacks(x)
        multipliers: dict[str, Any] = {}
        for number, relaxation in enumerate(ladder):
            y, multipliers = self._solve(min(number, 1), y, relaxation, multipliers)
        return program.answer(y)

    def polish(self, x: Floats) -> Floats:
        """Returns where IPOPT ends from x (n,) on the smallest ε alone."""
        program = self._staged.program
        return program.answer(self._solve(1, program.with_slacks(x), _LADDER[-1], {})[0])

    def _solve(
        self, number: int, y: Floats, relaxation: float, multipliers: dict[str, Any]
    ) -> tuple[Floats, dict[str, Any]]:
        """Returns the optimum for one ε, and its multipliers."""
        nlp = self._staged.nlp
        lower, upper = np.zeros(nlp.num_rows), np.zeros(nlp.num_rows)
        lower[self._staged.relaxed] = -np.inf
        upper[self._staged.relaxed] = relaxation
        bounds = {"lbx": nlp.lower, "ubx": nlp.upper, "lbg": lower, "ubg": upper}
        found = self._solvers[number](x0=y, **bounds, **multipliers)
        return np.array(found["x"]).ravel(), {"lam_x0": found["lam_x"], "lam_g0": found["lam_g"]}


def _factor(factor: Factor, at: Any) -> Any:
    """Returns a factor in CasADi's symbols."""
    inner = factor.scale * at + factor.offset
    if factor.kind == FunctionKind.POWER:
        return inner**factor.exponent
    waves = {FunctionKind.COSINE: casadi.cos, FunctionKind.SINE: casadi.sin}
    return at**factor.exponent * waves[factor.kind](inner)


if __name__ == "__main__":
    run_as("benchmarks.staged_programs")
