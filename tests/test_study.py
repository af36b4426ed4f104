"""Table I as a study: rigid plans near the exact optimum, failures shown, and Ctrl-C."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenario_studies import TOYS, Inline

from benchmarks.baselines import registry
from benchmarks.script import read_flags, run_all, run_as, run_jobs
from benchmarks.study.scenario_question import RANGES, ScenarioQuestion
from drake_aigto import jobs
from drake_aigto.cli import BAD_INPUT
from drake_aigto.errors import AigtoError, MissingExtraError, OptionsError
from drake_aigto.paper import Cell, RigidCell, RigidOptimum, run_rigid_cell, run_table1
from drake_aigto.planning import Plan, Planner, PlanningError, PlanOptions, Replays
from drake_aigto.world import Scenario

NOTHING = RigidOptimum(0.0, (), (), 0.0)


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


def parse(*flags: str, **others: Any) -> argparse.Namespace:
    return read_flags("A script. More.", flags, **others)


class Some(Inline):
    """Never ends the job "long", and loses the process of "dies"."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        return Future() if ("long",) in args else super().submit(fn, *args, **kwargs)


@pytest.fixture(autouse=True)
def inline(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "open_workers", Some)


def work(job: str) -> str:
    if job == "dies":
        raise BrokenExecutor
    if job == "raises":
        raise ValueError(job)
    return job


def test_when_time_is_up_what_is_done_was_yielded_and_the_rest_is_no_outcome(
    capsys: pytest.CaptureFixture[str],
) -> None:
    ended = dict(run_jobs(work, ["a", "long"], parse("--minutes", "0.01")))
    assert {number: future.result() for number, future in ended.items()} == {0: "a"}
    assert "TIME IS UP: 1 jobs not done" in capsys.readouterr().out


def test_flags_are_of_the_types_of_their_defaults() -> None:
    flags: dict[str, Any] = {
        "count": (3, ""),
        "only": ("", ""),
        "sizes": ((1, 2), ""),
        "masses": ([1.0], "", {"nargs": "+"}),
        "is_short": (False, ""),
    }
    usual = parse(**flags)
    assert (usual.count, usual.sizes, usual.masses, usual.is_short) == (3, (1, 2), [1.0], False)
    words = ("--count", "5", "--sizes", "7", "--masses", "2", "3", "--is-short", "--workers", "2")
    asked = parse(*words, **flags)
    assert (asked.count, asked.sizes, asked.masses, asked.is_short) == (5, [7], [2.0, 3.0], True)
    assert asked.workers == 2 and asked.minutes == math.inf


def test_what_is_kept_is_gone_on_from_and_only_with_the_same_flags(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    done: list[str] = []

    def note(job: str) -> str:
        done.append(job)
        return work(job)

    keep = ("--keep", str(tmp_path / "jobs"))
    assert run_all(note, ["a", "raises", "dies"], parse(*keep)) == ["a"]
    told = capsys.readouterr().out
    assert "FAILED raises: ValueError('raises')" in told
    assert "FAILED dies: ProcessDiedError('2', 'two processes that died of it'" in told
    with (tmp_path / "jobs").open("ab") as file:
        file.write(b"\x80\x04cut sho")
    assert run_all(note, ["b", "raises", "a"], parse(*keep, "--workers", "2")) == ["b", "a"]
    assert [job for job in done if job != "dies"] == ["a", "raises", "b", "raises"]
    with pytest.raises(OptionsError, match="--keep"):
        run_all(note, ["c"], parse(*keep, seed=(1, "")))


def test_a_script_without_its_scheduler_ends_with_one_clear_error(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    monkeypatch.setattr("drake_aigto.jobs.jobs.find_spec", lambda name: None)
    monkeypatch.setattr("sys.argv", ["random_programs", "--count", "1", "--scheduler", "tcp://a:1"])
    with pytest.raises(SystemExit) as ended:
        run_as("benchmarks.random_programs")
    assert ended.value.code == BAD_INPUT
    told = "benchmarks.random_programs: scheduler tcp://a:1: got no module 'distributed', expected"
    assert capsys.readouterr().err.startswith(told)


@given(st.integers(0, 2**40), st.integers(1, 6), st.integers(1, 6))
def test_a_larger_count_goes_on_where_a_smaller_one_ends(seed: int, few: int, more: int) -> None:
    small, large = (ScenarioQuestion(seed=seed, count=count) for count in (few, few + more))
    assert list(small.scenarios()) == list(large.scenarios())[:few]
    assert small.method_seed(few - 1) == large.method_seed(few - 1)


def test_scenarios_depend_on_the_seed_and_not_on_methods() -> None:
    question = ScenarioQuestion(count=20)
    starts = [scenario.initial_position[0] for scenario in question.scenarios()]
    other = dataclasses.replace(question, methods=("aigto", "snopt"))
    assert starts == [scenario.initial_position[0] for scenario in other.scenarios()]
    reseeded = dataclasses.replace(question, seed=1)
    assert len({*starts, *(each.initial_position[0] for each in reseeded.scenarios())}) == 40


def test_scenarios_fill_their_ranges() -> None:
    scenarios = list(ScenarioQuestion(count=400).scenarios())
    for name, (low, high) in RANGES.items():
        values = [getattr(scenario, name)[0] for scenario in scenarios]
        width = high - low
        # Of 400 draws, none in the first or last 5 % has a chance of 0.95⁴⁰⁰ = 1e-9.
        assert low <= min(values) < low + 0.05 * width
        assert high - 0.05 * width < max(values) <= high


@pytest.mark.parametrize(
    ("changes", "kind", "message"),
    [
        ({"count": 0}, OptionsError, "count: got 0, expected a whole number, 1 or more"),
        ({"count": -3}, OptionsError, "count: got -3"),
        ({"count": 2.5}, OptionsError, "count: got 2.5"),
        ({"seed": -1}, OptionsError, "seed: got -1, expected a whole number, 0 or more"),
        ({"num_steps": 0}, OptionsError, "num_steps: got 0"),
        ({"methods": ()}, OptionsError, "methods: got none"),
        ({"methods": ("coast", "coast")}, OptionsError, "methods: got coast twice"),
        ({"methods": ("cost",)}, OptionsError, "unknown baseline 'cost': expected aigto, the plan"),
        ({"methods": ("cost",)}, OptionsError, "or one of coast, crash, absent"),
        ({"methods": ("cost",)}, OptionsError, "Did you mean 'coast'? unknown baseline"),
        ({"methods": ("aigto", "absent")}, MissingExtraError, "no_such_library"),
        ({"methods": ("coast",)}, OptionsError, "seconds_per_unit: got none, expected seconds, as"),
        ({"seconds_per_unit": 0.0}, OptionsError, "seconds_per_unit: got 0.0, expected a number"),
        ({"budgets": ()}, OptionsError, "budgets: got (), expected numbers above 0"),
        ({"budgets": (0.0, 1.0)}, OptionsError, "budgets: got (0.0, 1.0), expected numbers above"),
        ({"budgets": (10.0, 1.0)}, OptionsError, "budgets: got (10.0, 1.0), expected increasing"),
    ],
)
def test_a_question_without_sense_is_refused(
    changes: dict[str, Any], kind: type[AigtoError], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(registry, "BASELINES", TOYS)
    with pytest.raises(kind) as error:
        ScenarioQuestion(**changes).check()
    assert message in str(error.value)
