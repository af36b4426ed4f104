"""Table I as a study: rigid plans near the exact optimum, failures shown, and Ctrl-C."""

from __future__ import annotations

import dataclasses
import json

import pytest
from scenario_studies import Inline

from drake_aigto.paper import ROWS, Cell, RigidCell, RigidOptimum, run_rigid_cell, run_table1
from drake_aigto.plain import to_plain
from drake_aigto.planning import Plan, Planner, PlanningError, PlanOptions, Replays
from drake_aigto.world import Scenario

NOTHING = RigidOptimum(0.0, (), (), 0.0)


@pytest.mark.parametrize("row", ROWS)
def test_a_rigid_plan_is_the_exact_optimum_in_both_simulations(row: int) -> None:
    cell = run_rigid_cell(row)
    optimum, best = cell.optimum.cost, cell.methods[0].best
    rigid, drake = best.replays
    assert best.holds
    assert best.candidate.is_feasible
    assert rigid.cost >= optimum * (1 - 1e-9)
    assert rigid.cost <= max(1.01 * optimum, 1e-6)
    assert abs(drake.cost - optimum) <= max(0.02 * optimum, 1e-5)
    assert rigid.bounce_times == pytest.approx(cell.optimum.bounce_times, abs=2e-3)
    assert cell.contact_delay == pytest.approx(9.93e-5, rel=1e-2)  # π √(1 kg / 1e9 N/m)


def test_a_rigid_cell_is_plain_json() -> None:
    cell = run_rigid_cell(4, confirm=False)
    data = json.loads(json.dumps(to_plain(cell)))
    assert (data["row"], data["restitution"]) == (4, 1.0)
    assert data["optimum"]["bounce_times"] == list(cell.optimum.bounce_times)
    (method,) = data["methods"]
    assert method["name"] == "AIGTO, rigid"
    assert method["entries"][0]["candidate"]["cost"] == cell.methods[0].best.candidate.cost
    assert method["entries"][0]["drake"] is None


def test_a_rigid_plan_that_fails_is_shown_as_failing(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = dataclasses.replace(Scenario.named("table1/4"), time_step=0.05)
    found = Planner(scenario, PlanOptions(confirm=False)).plan()
    rigid = found.replay.event_driven
    missed = Replays(rigid, dataclasses.replace(rigid, simulator="drake", cost=1.0))
    error = PlanningError("nothing holds")

    def fail(planner: Planner) -> Plan:
        raise error

    monkeypatch.setattr(Planner, "plan", fail)
    with pytest.raises(PlanningError):
        run_rigid_cell(4)
    error.plan = dataclasses.replace(found, replay=missed)
    best = run_rigid_cell(4).methods[0].best
    assert not best.holds
    assert best.candidate == found.best
    assert best.replays == missed


@pytest.fixture
def quick_cells(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Makes cells empty; those in the returned list are interrupted instead."""
    interrupted: list[object] = []

    def make(key: object, cell: Cell | RigidCell) -> Cell | RigidCell:
        if key in interrupted:
            raise KeyboardInterrupt
        return cell

    def run_cell(row: int, nonpenetration: bool, *arguments: object) -> object:
        return make((row, nonpenetration), Cell(row, nonpenetration, ()))

    def run_rigid(row: int, confirm: bool) -> object:
        return make((row, "rigid"), RigidCell(row, 1.0, NOTHING, 1e-4, ()))

    monkeypatch.setattr("drake_aigto.paper.table1.run_cell", run_cell)
    monkeypatch.setattr("drake_aigto.paper.table1.run_rigid_cell", run_rigid)
    return interrupted


def test_the_table_is_in_the_order_of_bounds_and_rows(quick_cells: list[object]) -> None:
    lines: list[str] = []
    table = run_table1((2, 1), executor=Inline(), progress=lines.append)
    order = [(cell.nonpenetration, cell.row) for cell in table.literal]
    assert order == [(False, 2), (False, 1), (True, 2), (True, 1)]
    assert [cell.row for cell in table.rigid] == [2, 1]
    assert lines == [f"{k} of 6 cells of Table I done" for k in range(1, 7)]


def test_an_interrupt_leaves_what_was_done(quick_cells: list[object]) -> None:
    quick_cells.append((2, True))
    lines: list[str] = []
    table = run_table1((1, 2), executor=Inline(), progress=lines.append)
    done = [(cell.row, cell.nonpenetration) for cell in table.literal]
    assert done == [(1, False), (2, False), (1, True)]
    assert not table.rigid
    assert len(lines) == 3


def test_an_interrupt_before_anything_was_done_goes_on(quick_cells: list[object]) -> None:
    quick_cells.append((1, False))
    with pytest.raises(KeyboardInterrupt):
        run_table1((1,), executor=Inline())
