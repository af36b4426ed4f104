"""The paper's Table I, what its plans do on a rigid wall, and plans that hold there."""

from __future__ import annotations

import dataclasses
import logging
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, as_completed
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from drake_aigto.baselines import gradient_from_random, gradient_from_zero
from drake_aigto.count import Count
from drake_aigto.planning import (
    Candidate,
    LiteralProblem,
    Plan,
    Planner,
    PlanningError,
    PlanOptions,
    Replays,
)
from drake_aigto.planning.options import AlgorithmName, LocalSolverName
from drake_aigto.simulation import Replay
from drake_aigto.simulation.material import contact_delay
from drake_aigto.study.rigid_optimum import RigidOptimum, rigid_optimum
from drake_aigto.study.workers import Workers
from drake_aigto.transcription import LiteralTranscription
from drake_aigto.world import Scenario

_LOG = logging.getLogger(__name__)

ROWS = (1, 2, 3, 4)
# Through Drake.
GRADIENT_SOLVERS: tuple[LocalSolverName, ...] = ("snopt", "ipopt")
# Whether φ ≥ 0 is asked for → who gets the random guesses: with φ free SNOPT ends far lower than
# IPOPT, with φ ≥ 0 it does not and takes five times as long.
GUESS_SOLVERS: dict[bool, LocalSolverName] = {False: "snopt", True: "ipopt"}
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
        label: what it is.
        candidate: the run.
        drake: its control on Drake's plant, if that was asked for.
        holds: whether that and the candidate's own replay confirm it.
    """

    label: str
    candidate: Candidate
    drake: Replay | None
    holds: bool

    @property
    def replays(self) -> Replays:
        """Both simulations of its control."""
        return Replays(self.candidate.replay, self.drake)


@dataclass(frozen=True)
class Method:
    """What one method came to on one row of the table.

    Attributes:
        name: of the method.
        costs: J of every run that met the transcription's rows, sorted.
        num_runs: how many runs there were.
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
        nonpenetration: whether φ(q_k) ≥ 0 was asked for, of all methods alike.
        methods: in the order that they are shown.
    """

    row: int
    nonpenetration: bool
    methods: tuple[Method, ...]


@dataclass(frozen=True)
class RigidCell:
    """One row of the table with the rigid transcription: what is planned holds on a rigid wall.

    Attributes:
        row: 1 … 4.
        restitution: of the wall.
        optimum: the exact one, which the planner does not know.
        contact_delay: by how much Drake's compliant wall is late, π √(m / k) [s].
        methods: in the order that they are shown.
    """

    row: int
    restitution: float
    optimum: RigidOptimum
    contact_delay: float
    methods: tuple[Method, ...]


@dataclass(frozen=True)
class Table1:
    """The table, as far as it was run.

    Attributes:
        literal: with the paper's transcription, φ free first.
        rigid: with the rigid one.
    """

    literal: tuple[Cell, ...]
    rigid: tuple[RigidCell, ...]


def run_cell(
    row: int, nonpenetration: bool, num_guesses: int = 10, seed: int = 0, confirm: bool = True
) -> Cell:
    """Runs every method on one row, literally transcribed.

    Args:
        row: 1 … 4.
        nonpenetration: whether φ(q_k) ≥ 0 is asked for.
        num_guesses: random guesses of the gradient solvers.
        seed: of the guesses; the same seed gives the same plans.
        confirm: whether the plans are also replayed on Drake's plant.
    """
    scenario = Scenario.named(f"table1/{row}")
    options = PlanOptions(transcription="literal", nonpenetration=nonpenetration, confirm=confirm)
    planner = Planner(scenario, options)
    methods = list(_gradient_methods(planner, num_guesses, np.random.default_rng([seed, row])))
    for name, algorithm in ALGORITHMS.items():
        chosen = dataclasses.replace(options, algorithm=algorithm)
        methods.append(_aigto_method(name, Planner(scenario, chosen, planner.world)))
    return Cell(row, nonpenetration, tuple(methods))


def run_rigid_cell(row: int, confirm: bool = True) -> RigidCell:
    """Plans for one row with the rigid transcription.

    Args:
        row: 1 … 4.
        confirm: whether the plan is also replayed on Drake's plant.
    """
    scenario = Scenario.named(f"table1/{row}")
    planner = Planner(scenario, PlanOptions(transcription="rigid", confirm=confirm))
    plan = _plan(planner)
    entry = Entry(RIGID_METHOD, plan.best, plan.replay.drake, plan.holds)
    method = Method(
        RIGID_METHOD,
        tuple(sorted(run.cost for run in plan.candidates if run.is_feasible)),
        len(plan.candidates),
        (entry,),
        _seconds(plan),
    )
    return RigidCell(
        row,
        scenario.restitution,
        rigid_optimum(planner.world, scenario),
        contact_delay(planner.world),
        (method,),
    )


def run_table1(
    rows: Sequence[int] = ROWS,
    num_guesses: int = 10,
    seed: int = 0,
    confirm: bool = True,
    executor: Executor | None = None,
    progress: Callable[[str], None] | None = None,
) -> Table1:
    """Runs the table: with φ free as the paper must have had it, with φ ≥ 0, and on a rigid wall.

    Args:
        rows: which.
        num_guesses: random guesses of the gradient solvers.
        seed: of the guesses.
        confirm: whether the plans are also replayed on Drake's plant.
        executor: where cells run; processes of one thread, one a core, if None.
        progress: called with a line of text after each cell.

    Returns:
        The table. Ctrl-C leaves those cells that were done.
    """
    if executor is None:
        with Workers() as pool:
            table = run_table1(rows, num_guesses, seed, confirm, pool, progress)
            pool.kill()  # After Ctrl-C, cells that nobody waits for are still worked on.
            return table
    literal = [
        executor.submit(run_cell, row, nonpenetration, num_guesses, seed, confirm)
        for nonpenetration in (False, True)
        for row in rows
    ]
    rigid = [executor.submit(run_rigid_cell, row, confirm) for row in rows]
    jobs: list[Future[Any]] = [*literal, *rigid]
    done = set()
    try:
        for job in as_completed(jobs):
            cell = job.result()
            took = "; ".join(f"{each.name} {each.seconds:.1f} s" for each in cell.methods)
            _LOG.info("row %d: %s", cell.row, took)
            done.add(job)
            if progress:
                progress(Count(len(done), len(jobs), "cells of Table I done"))
    except KeyboardInterrupt:
        for job in jobs:
            job.cancel()
        if not done:
            raise
    return Table1(
        tuple(job.result() for job in literal if job in done),
        tuple(job.result() for job in rigid if job in done),
    )


def _gradient_methods(
    planner: Planner, num_guesses: int, generator: np.random.Generator
) -> Iterator[Method]:
    for solver in GRADIENT_SOLVERS:
        runs, seconds = _run_gradient(planner, solver, gradient_from_zero, 1)
        yield _summarize(f"{solver.upper()}, from zero", planner, runs, seconds)
    solver = GUESS_SOLVERS[planner.options.nonpenetration]
    guess = partial(gradient_from_random, generator=generator)
    runs, seconds = _run_gradient(planner, solver, guess, num_guesses)
    yield _summarize(solver.upper(), planner, runs, seconds, median=True)


def _run_gradient(
    planner: Planner,
    solver: LocalSolverName,
    run: Callable[[LiteralProblem], Candidate],
    count: int,
) -> tuple[list[Candidate], float]:
    """Returns so many runs of a gradient solver, and their seconds."""
    options = dataclasses.replace(planner.options, local_solver=solver)
    transcription = LiteralTranscription(planner.world, planner.scenario, options.nonpenetration)
    problem = LiteralProblem(transcription, options)
    start = time.perf_counter()
    runs = [run(problem) for _ in range(count)]
    return runs, time.perf_counter() - start


def _aigto_method(name: str, planner: Planner) -> Method:
    plan = planner.plan()
    return _summarize(name, planner, list(plan.candidates), _seconds(plan))


def _plan(planner: Planner) -> Plan:
    """Returns the plan, also one that does not hold: the table shows that it fails."""
    try:
        return planner.plan()
    except PlanningError as error:
        if error.plan is None:
            raise
        return error.plan


def _seconds(plan: Plan) -> float:
    """Returns what the plan took, replays apart."""
    return sum(plan.stats.seconds[part] for part in ("build", "aigo", "polish"))


def _summarize(
    name: str, planner: Planner, runs: list[Candidate], seconds: float, median: bool = False
) -> Method:
    """Returns a method's summary, with those runs replayed that are shown."""
    feasible = sorted((run for run in runs if run.is_feasible), key=lambda run: run.cost)
    ranked = feasible or sorted(runs, key=lambda run: run.max_defect)
    shown = [(name, ranked[0])]
    if median:
        shown = [
            (f"{name}: median of {len(runs)}", ranked[len(ranked) // 2]),
            (f"{name}: best of {len(runs)}", ranked[0]),
        ]
    entries = tuple(_entry(label, planner, run) for label, run in shown)
    return Method(name, tuple(run.cost for run in feasible), len(runs), entries, seconds)


def _entry(label: str, planner: Planner, run: Candidate) -> Entry:
    replays = planner.simulate(run.trajectory)
    return Entry(label, run, replays.drake, run.holds(replays))
