"""A whole plan against one cold solve of the local solvers that people would start instead.

    python -m benchmarks.planner_speed [--scenarios 20] [--repeats 5] [--guesses 5] [--drake 2]

On Table I's rows and on random scenarios at N = 200, one thread each, in turns: the planner with
``confirm=False`` (polish, and the replays that rank its candidates), which has planned once for
other ends, all three changed, and now plans again for these, without boxes, as contact sequences
grow out of the uncontrolled motion's; the same with them (``exhaustive``); IPOPT with CasADi's
exact Hessian, from zero and from random guesses; Drake's IPOPT and SNOPT from zero. These solve the
paper's literal transcription, contact rows multiplied out, δ = 1e-3 and q ≥ 0, built before; in
Drake each kind of row is one constraint that all stages share, the fastest form there. Their
options are their own defaults.

Costs are what each method promises, and what a rigid wall makes of its control. Ratios are taken
scenario by scenario, of medians over the turns; the figures are the medians over the scenarios.
Writes planner_speed.csv; exits with 1 if a figure is missed, or CasADi is not installed.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import dataclasses
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks.local_peers import Solver, casadi, casadi_ipopt, drake_solver
from benchmarks.script import Spread, clock, is_met, read_flags, write_csv
from benchmarks.study import ScenarioQuestion
from drake_aigto.arrays import Floats
from drake_aigto.local import compile_nlp
from drake_aigto.paper import ROWS, LiteralTranscription, random_guess
from drake_aigto.planning import Planner, PlanOptions
from drake_aigto.simulation import replay_event_driven
from drake_aigto.world import Scenario, World

ENDS = ("initial_position", "initial_velocity", "goal_position")
_MOVED = 1.1  # The first plan's ends, in parts of those that are measured.
PLAN, BOXED = "plan", "plan with boxes"
CASADI, CASADI_RANDOM = "CasADi + IPOPT from zero", "CasADi + IPOPT from random"
DRAKE_IPOPT, DRAKE_SNOPT = "Drake's IPOPT from zero", "Drake's SNOPT from zero"
METHODS = (PLAN, BOXED, CASADI, CASADI_RANDOM, DRAKE_IPOPT, DRAKE_SNOPT)
# Of a plan's time, at the most, and its time [s].
AGAINST_CASADI, MOST_SECONDS, AGAINST_DRAKE = 0.35, 5e-3, 0.3
# Of the costs with boxes and without them, on a rigid wall, and absolute [1].
_SAME, _NOTHING = 1.0001, 1e-9


class Answer(NamedTuple):
    """What a method found."""

    cost: float  # that it promises
    times: npt.ArrayLike
    controls: npt.ArrayLike


@dataclass(frozen=True)
class Run:
    """One turn of one method: a line of the CSV file."""

    scenario: str
    method: str
    turn: int
    wall_seconds: float
    cpu_seconds: float
    cost: float
    replayed_cost: float


def main() -> int:
    """Measures, prints, writes and judges."""
    arguments = read_flags(
        __doc__,
        workers=None,
        scenarios=(20, "random ones, besides Table I"),
        repeats=(5, "turns of the planner and of CasADi"),
        guesses=(5, "random guesses, in as many turns"),
        drake=(2, "turns of Drake's solvers"),
        seed=(0, ""),
        clock=("wall", "of the ratios", {"choices": ("wall", "cpu")}),
        out=(Path(), "folder of the CSV"),
    )
    scenarios = {f"table1/{row}": Scenario.named(f"table1/{row}") for row in ROWS}
    question = ScenarioQuestion(count=arguments.scenarios, seed=arguments.seed)
    scenarios |= {f"random {i}": each for i, each in enumerate(question.scenarios())}
    _warm_up(scenarios["table1/1"])
    runs: list[Run] = []
    for name, scenario in scenarios.items():
        found = list(run_scenario(name, scenario, arguments))
        runs += found
        tell(name, found)
        write_csv(arguments.out / "planner_speed.csv", runs, "one thread, in turns")
    return 0 if judge(runs, arguments.clock) else 1


def _warm_up(scenario: Scenario) -> None:
    """Loads compiled code and libraries."""
    world = World.from_scenario(scenario)
    Planner(scenario, PlanOptions(confirm=False), world).plan()
    literal = LiteralTranscription(world, scenario)
    for name in ("ipopt", "snopt"):
        drake_solver(literal, name)(np.zeros(literal.prog().num_vars()))


def _make_planner(scenario: Scenario, options: PlanOptions, world: World) -> Planner:
    """Returns a planner that has planned once, for other ends."""
    others = {name: _MOVED * getattr(scenario, name) for name in ENDS}
    planner = Planner(dataclasses.replace(scenario, **others), options, world)
    planner.plan()
    return planner


def run_scenario(name: str, scenario: Scenario, arguments: argparse.Namespace) -> Iterator[Run]:
    """Yields all turns on one scenario."""
    world = World.from_scenario(scenario)
    literal = LiteralTranscription(world, scenario)
    options = PlanOptions(confirm=False, threads=1)
    kinds = {PLAN: options, BOXED: dataclasses.replace(options, exhaustive=True)}
    planners = {
        kind: [_make_planner(scenario, each, world) for _ in range(arguments.repeats)]
        for kind, each in kinds.items()
    }
    ends = {name: getattr(scenario, name) for name in ENDS}
    zero, generator = np.zeros(literal.prog().num_vars()), np.random.default_rng(arguments.seed)

    def plan(kind: str) -> Answer:
        found = planners[kind].pop().plan(**ends)
        return Answer(found.cost, found.trajectory.times, found.trajectory.controls)

    def solve(solver: Solver, guess: Floats) -> Answer:
        x = solver(guess)
        return Answer(literal.scenario_cost(x), literal.GetSampleTimes(), literal.split(x)[2])

    works: dict[str, tuple[int, Callable[[], Answer]]] = {
        kind: (arguments.repeats, partial(plan, kind)) for kind in kinds
    }
    if casadi is not None:
        exact = casadi_ipopt(compile_nlp(literal.prog()))
        works[CASADI] = arguments.repeats, partial(solve, exact, zero)
        works[CASADI_RANDOM] = (
            arguments.guesses,
            lambda: solve(exact, random_guess(literal, generator)),
        )
    for method, solver in ((DRAKE_IPOPT, "ipopt"), (DRAKE_SNOPT, "snopt")):
        works[method] = arguments.drake, partial(solve, drake_solver(literal, solver), zero)
    for turn in range(max(turns for turns, _ in works.values())):
        for method, (turns, work) in works.items():
            if turn < turns:
                answer, seconds = clock(work)
                replay = replay_event_driven(world, scenario, answer.times, answer.controls)
                yield Run(name, method, turn, *seconds, answer.cost, replay.cost)


def tell(name: str, runs: Sequence[Run]) -> None:
    """Prints one line for each method."""
    for method in METHODS:
        found = [run for run in runs if run.method == method]
        if not found:
            continue
        seconds = Spread.of(run.wall_seconds for run in found)
        cost, replayed = (
            float(np.median([getattr(run, field) for run in found]))
            for field in ("cost", "replayed_cost")
        )
        print(
            f"{name:12}{method:28}{seconds.show(1e-3, 1):>26} ms   cost {cost:.3e}, "
            f"on a rigid wall {replayed:.3e}",
            flush=True,
        )


def judge(runs: Sequence[Run], by: str) -> bool:
    """Prints the ratios, and returns whether the figures are reached."""
    print("\nMedians over the scenarios")
    medians = {}
    for method in dict.fromkeys(run.method for run in runs):
        medians[method], cost = (
            float(np.median([getattr(run, field) for run in runs if run.method == method]))
            for field in (f"{by}_seconds", "replayed_cost")
        )
        print(f"  {method:28}{1e3 * medians[method]:7.1f} ms, on a rigid wall {cost:.1e}")
    for kind in (PLAN, BOXED):
        print(f"A {kind}'s time, as a multiple of" if kind == PLAN else "With boxes, likewise")
        for method in METHODS[2:]:
            if spread := compare(runs, kind, method, by):
                print(f"  {method:28}{spread.show()}")
    costs = {
        kind: np.array([run.replayed_cost for run in runs if (run.method, run.turn) == (kind, 0)])
        for kind in (PLAN, BOXED)
    }
    same = costs[PLAN] <= _SAME * costs[BOXED] + _NOTHING
    print(f"without boxes at the same cost: {np.sum(same)} of {len(same)}")
    met = is_met("a plan [s]", medians[PLAN], MOST_SECONDS)
    for what, kind, method, most in (
        ("a plan / Drake's IPOPT", PLAN, DRAKE_IPOPT, AGAINST_DRAKE),
        ("a plan / CasADi + IPOPT", PLAN, CASADI, AGAINST_CASADI),
    ):
        spread = compare(runs, kind, method, by)
        if spread is None:
            print(f"MISSED {what}: it was not run (--drake 0, or without the extra `bench`)")
        met &= spread is not None and is_met(what, spread.median, most)
    return met


def compare(runs: Sequence[Run], kind: str, method: str, by: str) -> Spread | None:
    """Returns a plan's time over a method's, over the scenarios; None if it never ran."""
    ratios = []
    for scenario in dict.fromkeys(run.scenario for run in runs):
        ours, theirs = (
            [
                getattr(run, f"{by}_seconds")
                for run in runs
                if (run.scenario, run.method) == (scenario, each)
            ]
            for each in (kind, method)
        )
        if theirs:
            ratios.append(float(np.median(ours) / np.median(theirs)))
    return Spread.of(ratios) if ratios else None


if __name__ == "__main__":
    sys.exit(main())
