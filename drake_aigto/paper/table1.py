"""The paper's Table I, simulations of its plans on a rigid wall, and plans that hold there."""

from __future__ import annotations

import dataclasses
import logging
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from drake_aigto import planning
from drake_aigto.contact import contact_delay
from drake_aigto.jobs import open_jobs
from drake_aigto.paper.planner import (
    AlgorithmName,
    LiteralOptions,
    LiteralTask,
    gradient_from_random,
    gradient_from_zero,
    make_literal_task,
    plan_literal,
)
from drake_aigto.paper.rigid_optimum import RigidOptimum, rigid_optimum
from drake_aigto.progress import Count
from drake_aigto.simulation import Replay
from drake_aigto.world import Scenario, World

_LOG = logging.getLogger(__name__)

ROWS = (1, 2, 3, 4)
# Through Drake.
GRADIENT_SOLVERS: tuple[planning.LocalSolverName, ...] = ("snopt", "ipopt")
# Whether φ ≥ 0 is a constraint → the solver with random guesses: with φ free SNOPT ends far lower
# than IPOPT, with φ ≥ 0 it does not and takes five times as long.
GUESS_SOLVERS: dict[bool, planning.LocalSolverName] = {False: "snopt", True: "ipopt"}
ALGORITHMS: dict[str, AlgorithmName] = {
    "AIGTO, Algorithm 1": "full gradient",
    "AIGTO, annealing": "annealing",
}
RIGID_METHOD = "AIGTO, rigid"


class PaperCosts(NamedTuple):
    """A row of Table I as printed."""

    gradient: float
    aigto: float


PAPER_COSTS = {
    1: PaperCosts(1.19e-2, 3.65e-5),
    2: PaperCosts(1.13e-2, 8.7e-5),
    3: PaperCosts(7.1e-2, 5.42e-5),
    4: PaperCosts(1.13e-2, 3.67e-7),
}


@dataclass(frozen=True)
class Entry:
    """A line of the table: one run, and simulations of its control.

    Attributes:
        label: its name.
        candidate: the run.
        drake: its control on Drake's plant, if requested.
        holds: whether that and the candidate's own replay confirm it.
    """

    label: str
    candidate: planning.Candidate
    drake: Replay | None
    holds: bool

    @property
    def replays(self) -> planning.Replays:
        """Both simulations of its control."""
        return planning.Replays(self.candidate.replay, self.drake)


@dataclass(frozen=True)
class TableMethod:
    """Results of one method on one row of the table.

    Attributes:
        name: of the method.
        costs: J of every run that met the transcription's rows, sorted.
        num_runs: the number of runs.
        entries: the runs that are shown: the best, after the median where there are guesses.
        seconds: all runs together, replays apart.
    """

    name: str
    costs: tuple[float, ...]
    num_runs: int
    entries: tuple[Entry, ...]
    seconds: float

    @property
    def best(self) -> Entry:
        """The run of least cost that met the rows; if none did, that of least defect."""
        return self.entries[-1]


@dataclass(frozen=True)
class Cell:
    """One row of the table, literally transcribed, under one choice of bounds.

    Attributes:
        row: 1 … 4.
        nonpenetration: whether φ(q_k) ≥ 0 was a constraint, for all methods.
        methods: in the order that they are shown.
    """

    row: int
    nonpenetration: bool
    methods: tuple[TableMethod, ...]


@dataclass(frozen=True)
class RigidCell:
    """One row of the table with the rigid transcription: plans hold on a rigid wall.

    Attributes:
        row: 1 … 4.
        restitution: of the wall.
        optimum: the exact one, which the planner does not know.
        contact_delay: of Drake's compliant wall, π √(m / k) [s].
        methods: in the order that they are shown.
    """

    row: int
    restitution: float
    optimum: RigidOptimum
    contact_delay: float
    methods: tuple[TableMethod, ...]


@dataclass(frozen=True)
class Table1:
    """The table, as far as it was run, and its settings.

    Attributes:
        literal: with the paper's transcription, φ free first.
        rigid: with the rigid one.
        rows: the selected ones.
        num_guesses: random guesses of the gradient solvers.
        seed: of the guesses.
        confirm: whether the plans are also replayed on Drake's plant.
    """

    literal: tuple[Cell, ...]
    rigid: tuple[RigidCell, ...]
    rows: tuple[int, ...] = ROWS
    num_guesses: int = 10
    seed: int = 0
    confirm: bool = True

    @property
    def num_missing(self) -> int:
        """The number of cells missing after an interruption."""
        return 3 * len(self.rows) - len(self.literal) - len(self.rigid)


def run_cell(
    row: int, nonpenetration: bool, num_guesses: int = 10, seed: int = 0, confirm: bool = True
) -> Cell:
    """Runs every method on one row, literally transcribed, with or without φ(q_k) ≥ 0.

    The rest is as in `run_table1`; the same seed gives the same plans.
    """
    scenario = Scenario.named(f"table1/{row}")
    world = World.from_scenario(scenario)
    options = LiteralOptions(nonpenetration=nonpenetration, confirm=confirm)
    generator = np.random.default_rng([seed, row])
    methods = list(_gradient_methods(world, scenario, options, num_guesses, generator))
    for name, algorithm in ALGORITHMS.items():
        chosen = dataclasses.replace(options, algorithm=algorithm)
        methods.append(_plan_method(name, plan_literal(scenario, chosen, world)))
    return Cell(row, nonpenetration, tuple(methods))


def run_rigid_cell(row: int, confirm: bool = True) -> RigidCell:
    """Plans for one row with the rigid transcription."""
    scenario = Scenario.named(f"table1/{row}")
    planner = planning.Planner(scenario, planning.PlanOptions(confirm=confirm))
    optimum, delay = rigid_optimum(planner.world, scenario), contact_delay(planner.world)
    methods = (_plan_method(RIGID_METHOD, _plan(planner)),)
    return RigidCell(row, scenario.restitution, optimum, delay, methods)


def run_table1(
    rows: Sequence[int] = ROWS,
    num_guesses: int = 10,
    seed: int = 0,
    confirm: bool = True,
    executor: AbstractContextManager[Executor] | None = None,
    progress: Callable[[str], None] | None = None,
) -> Table1:
    """Runs the table: with φ free as the paper must have had it, with φ ≥ 0, and on a rigid wall.

    Ctrl-C leaves those cells that were done.

    Args:
        rows: the selected ones, each shown once.
        num_guesses: random guesses of the gradient solvers.
        seed: of the guesses.
        confirm: whether the plans are also replayed on Drake's plant.
        executor: runs cells, entered here; `open_workers`, with one process per core, if None.
        progress: called with a line of text after each cell.

    Raises:
        StudyError: from `open_workers`; or the processes that ran a cell died.
    """
    calls: dict[str, tuple[Any, ...]] = {
        f"Table I, row {row}, φ {'≥ 0' if bounded else 'free'}": (
            run_cell,
            *(row, bounded, num_guesses, seed, confirm),
        )
        for bounded in (False, True)
        for row in rows
    }
    calls |= {f"Table I, row {row}, rigid": (run_rigid_cell, row, confirm) for row in rows}
    done: dict[str, Any] = {}
    with open_jobs(executor) as jobs:
        for name, call in calls.items():
            jobs.start(name, *call)
        try:
            for name, future in jobs.ended():
                done[name] = cell = future.result()
                took = "; ".join(f"{each.name} {each.seconds:.1f} s" for each in cell.methods)
                _LOG.info("%s: %s", name, took)
                if progress:
                    progress(Count(len(done), len(calls), "cells of Table I done"))
        except KeyboardInterrupt:
            if not done:
                raise
    cells = [done[name] for name in calls if name in done]
    return Table1(
        tuple(cell for cell in cells if isinstance(cell, Cell)),
        tuple(cell for cell in cells if isinstance(cell, RigidCell)),
        *(tuple(dict.fromkeys(rows)), num_guesses, seed, confirm),
    )


def _gradient_methods(
    world: World,
    scenario: Scenario,
    options: LiteralOptions,
    num_guesses: int,
    generator: np.random.Generator,
) -> Iterator[TableMethod]:
    def problem_for(solver: planning.LocalSolverName) -> LiteralTask:
        chosen = dataclasses.replace(options, local_solver=solver)
        return make_literal_task(world, scenario, chosen)

    for solver in GRADIENT_SOLVERS:
        name = f"{solver.upper()}, from zero"
        yield _run_gradient(name, problem_for(solver), gradient_from_zero)
    solver = GUESS_SOLVERS[options.nonpenetration]
    guess = partial(gradient_from_random, generator=generator)
    yield _run_gradient(solver.upper(), problem_for(solver), guess, num_guesses)


def _run_gradient(
    name: str,
    problem: LiteralTask,
    run: Callable[[LiteralTask], planning.Candidate],
    num_guesses: int | None = None,
) -> TableMethod:
    """Returns a run of a gradient solver, or several, with those replayed that are shown."""
    start = time.perf_counter()
    runs = [run(problem) for _ in range(num_guesses or 1)]
    seconds = time.perf_counter() - start
    feasible = sorted((run for run in runs if run.is_feasible), key=lambda run: run.cost)
    ranked = feasible or sorted(runs, key=lambda run: run.max_defect)
    shown = {name: ranked[0]}
    if num_guesses is not None:
        shown = {
            f"{name}: median of {num_guesses}": ranked[len(ranked) // 2],
            f"{name}: best of {num_guesses}": ranked[0],
        }
    entries = tuple(_entry(label, each, problem.confirm(each)) for label, each in shown.items())
    return TableMethod(name, tuple(each.cost for each in feasible), len(runs), entries, seconds)


def _plan_method(name: str, plan: planning.Plan) -> TableMethod:
    """Returns a plan's summary; its time is without replays."""
    costs = sorted(run.cost for run in plan.candidates if run.is_feasible)
    seconds = sum(plan.stats.seconds[part] for part in ("build", "aigo", "polish"))
    entry = _entry(name, plan.best, plan.replay)
    return TableMethod(name, tuple(costs), len(plan.candidates), (entry,), seconds)


def _plan(planner: planning.Planner) -> planning.Plan:
    """Returns the plan, also one that does not hold: the table shows that it fails."""
    try:
        return planner.plan()
    except planning.PlanningError as error:
        if error.plan is None:
            raise
        return error.plan


def _entry(label: str, run: planning.Candidate, replays: planning.Replays) -> Entry:
    return Entry(label, run, replays.drake, run.holds(replays))
