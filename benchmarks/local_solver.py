"""Our local solver against its peers, on the literal transcription of Table I at 200 knots.

    python -m benchmarks.local_solver [--guesses 20] [--drake 2] [--seed 0]

Peers: IPOPT with CasADi's exact Hessian (left out where CasADi is not installed; it is in the extra
`bench`), and IPOPT and SNOPT through Drake, which differentiate but once and by Python's leave.
Starts: zero; random guesses (positions in [0, 1.5] m, velocities in ±2 m/s, controls in ±10 N);
AIGO's box centers; and straight flights over the contacts that AIGO proposes, as `plan` polishes
them. From AIGO's starts IPOPT and ours use their options for warm starts.

Solved means that the solver says so, and that rows and bounds hold to 1e-8. Costs are over what was
solved: they tell how good the local optima are that a solver falls into.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.local_peers import Solver, casadi, casadi_ipopt, drake_solver
from drake_aigto.arrays import Floats
from drake_aigto.local import InteriorPoint, PolynomialNlp, compile_nlp
from drake_aigto.paper import LiteralProblem, LiteralTranscription
from drake_aigto.paper.problem import ballistic_guess
from drake_aigto.world import Scenario, World

HOLDS = 1e-8
MAX_ITERATIONS = 500
IPOPT_OPTIONS = {"tol": 1e-8, "constr_viol_tol": 1e-10, "max_iter": MAX_ITERATIONS}
SNOPT_OPTIONS = {"Major iterations limit": MAX_ITERATIONS, "Major feasibility tolerance": 1e-10}


@dataclass(frozen=True)
class Run:
    """One solve."""

    solved: bool
    cost: float
    iterations: int
    seconds: float


def main() -> None:
    """Prints a line for every solver, kind of start, and choice of bounds."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--guesses", type=int, default=20, help="random starts a row")
    parser.add_argument("--drake", type=int, default=2, help="of these, for Drake's solvers")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    print(f"{'':44}solved     median cost  best cost  iterations  ms/iter  ms/solve")
    for nonpenetration in (False, True):
        runs: dict[tuple[str, str], list[Run]] = {}
        for row in range(1, 5):
            for kind, name, run in run_row(row, nonpenetration, arguments):
                runs.setdefault((kind, name), []).append(run)
        for (kind, name), found in sorted(runs.items()):
            report(f"{'q ≥ 0 ' if nonpenetration else 'q free'}  {kind:16}{name}", found)


def run_row(
    row: int, nonpenetration: bool, arguments: argparse.Namespace
) -> Iterator[tuple[str, str, Run]]:
    """Yields kind of start, solver and run."""
    scenario = Scenario.named(f"table1/{row}")
    transcription = LiteralTranscription(World.from_scenario(scenario), scenario, nonpenetration)
    nlp = compile_nlp(transcription.prog(), transcription.elimination_order())
    solvers = make_solvers(transcription, nlp)
    for kind, starts in make_starts(transcription, arguments.guesses, arguments.seed).items():
        warm = kind.startswith("AIGO")
        for name, solve in solvers.items():
            for start in starts[: arguments.drake] if "Drake" in name else starts:
                begin = time.perf_counter()
                x, is_success, iterations = solve(start, warm)
                seconds = time.perf_counter() - begin
                yield (
                    kind,
                    name,
                    Run(is_success and holds(nlp, x), nlp.evaluate(x)[0], iterations, seconds),
                )


def make_starts(
    transcription: LiteralTranscription, guesses: int, seed: int
) -> dict[str, list[Floats]]:
    """Kind → starts."""
    rng = np.random.default_rng(seed)
    lower, upper = (
        np.repeat(
            values,
            [part.size for part in transcription.split(np.zeros(transcription.prog().num_vars()))],
        )
        for values in ([0.0, -2.0, -10.0], [1.5, 2.0, 10.0])
    )
    problem = LiteralProblem(transcription)
    centers, flights = [], {}
    for rung in problem.options.ladder:
        result = problem.run_aigo(rung)
        centers.append(result.box.center)
        for knots in problem.find_sequences(result, rung):
            flights[knots] = ballistic_guess(transcription, result.box.center, knots)
    return {
        "zero": [np.zeros(lower.size)],
        "random": [rng.uniform(lower, upper) for _ in range(guesses)],
        "AIGO's centers": centers,
        "AIGO's contacts": list(flights.values()),
    }


def make_solvers(transcription: LiteralTranscription, nlp: PolynomialNlp) -> dict[str, Solver]:
    """Name → solver, compiled."""
    cold, warm = InteriorPoint(max_iterations=MAX_ITERATIONS), InteriorPoint.warm()
    cold.solve(nlp, np.zeros(nlp.num_variables))  # Numba compiles.

    def ours(start: Floats, is_near: bool) -> tuple[Floats, bool, int]:
        result = (warm if is_near else cold).solve(nlp, start)
        return result.x, result.is_success, result.iterations

    solvers: dict[str, Solver] = {"ours": ours}
    if casadi is not None:
        solvers["IPOPT, CasADi"] = casadi_ipopt(nlp, IPOPT_OPTIONS)
    for name in ("ipopt", "snopt"):
        solver = drake_solver(transcription, name, IPOPT_OPTIONS, SNOPT_OPTIONS)
        solvers[f"{name.upper()}, Drake"] = solver
    return solvers


def holds(nlp: PolynomialNlp, x: Floats) -> bool:
    """Whether rows and bounds hold."""
    outside = np.maximum(nlp.lower - x, x - nlp.upper)
    return bool(np.max(np.abs(nlp.evaluate(x)[1])) <= HOLDS and np.max(outside) <= HOLDS)


def report(label: str, runs: list[Run]) -> None:
    """Prints one line."""
    costs = [run.cost for run in runs if run.solved]
    iterations, seconds = [run.iterations for run in runs], [run.seconds for run in runs]
    told = ""
    if any(iterations):
        told = f"{np.median(iterations):10.0f} {1e3 * sum(seconds) / sum(iterations):8.2f}"
    print(
        f"{label:44}{len(costs):3}/{len(runs):3} "
        f"{np.median(costs) if costs else np.nan:14.2e} {min(costs, default=np.nan):10.2e} "
        f"{told:19} {1e3 * np.median(seconds):9.1f}",
        flush=True,
    )


if __name__ == "__main__":
    main()
