"""Plans as the variables of programs that other authors pose."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydrake.solvers import MathematicalProgram

from benchmarks.collections.peer_programs import payload, push_circle
from benchmarks.friction_worlds import ask_payload, list_circle, list_payload
from drake_aigto import World
from drake_aigto.arrays import Floats
from drake_aigto.planning import MechanismOptions
from drake_aigto.planning.mechanism_problem import MechanismProblem

_STEPS = 199


def test_boxes_that_know_no_friction_close_near_a_plan_that_slides_to_its_goal() -> None:
    """As walls are closed, they end at 7.2 and more."""
    scenario = ask_payload(11)
    problem = MechanismProblem(World.from_scenario(scenario), scenario, MechanismOptions())
    closed = (problem.close(problem.run_aigo(rung)) for rung in problem.options.ladder)
    best = min(closed, key=problem.rank)
    assert best.violation == 0
    assert best.cost < 0.5


def plan_of(times: Any, q: Any, v: Any, controls: Any) -> Any:
    """Returns what is read of a plan."""
    motion = SimpleNamespace(times=times, positions=q, velocities=v, controls=controls)
    scenario = SimpleNamespace(time_step=times[1])
    return SimpleNamespace(best=SimpleNamespace(trajectory=motion), scenario=scenario)


def worst_row(rows: Sequence[Any], prog: MathematicalProgram, x: Floats) -> float:
    """Returns by how much the worst of rows is violated, 0 if none is."""
    worst = 0.0
    for row in rows:
        value = prog.EvalBinding(row, x)
        low, high = row.evaluator().lower_bound(), row.evaluator().upper_bound()
        worst = max(worst, float(np.max(low - value)), float(np.max(value - high)))
    return worst


def test_a_cart_that_carries_its_payload_along_is_listed_as_the_authors_rows_have_it() -> None:
    dt, pull = 0.02, 0.3
    steps = np.arange(_STEPS + 2)
    v = pull * dt * steps
    x = 3.0 + dt * np.cumsum(v)  # Euler's semi-implicit steps, that rows are of.
    nothing = np.zeros_like(x)
    plan = plan_of(
        dt * steps,
        np.column_stack([x, 0.5 + nothing]),
        np.column_stack([v, nothing]),
        np.full((_STEPS + 1, 1), 3 * pull),
    )
    prog = payload(np.array([3.5, 3.0, 0.0, 0.0]), np.zeros(4))
    assert worst_row(prog.GetAllConstraints(), prog, list_payload(plan)) == pytest.approx(
        0.0, abs=1e-12
    )


def test_a_disc_that_is_pushed_along_a_line_is_listed_as_the_authors_rows_have_it() -> None:
    dt, pace, grip = 0.05, 0.3, 0.981
    times, begin = dt * np.arange(121), np.full(2, -1.5 / np.sqrt(2))
    toward = np.array([0.6, 0.8])
    way = (pace * times)[:, np.newaxis] * toward
    plan = plan_of(
        times, np.hstack([begin + way, begin + way + 0.3 * toward]), np.zeros((121, 4)), way[1:]
    )
    with np.errstate(invalid="ignore"):
        prog = push_circle()
    # The authors' disc starts elsewhere, which is the one row that is not met.
    rows = [row for row in prog.GetAllConstraints() if row.variables()[0].get_name() != "q(0,0)"]
    assert worst_row(rows, prog, list_circle(plan)) == pytest.approx(0.0, abs=1e-12)
    pushes = list_circle(plan)[-240:-120]
    assert pushes == pytest.approx(grip * pace * np.ones(120))
