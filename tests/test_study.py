"""Table I as a study: rigid plans near the exact optimum, failures shown, and Ctrl-C."""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refuse_work
from scenario_studies import TOYS, Inline

from benchmarks.baselines import registry
from benchmarks.script import read_flags, run_all, run_as, run_jobs
from benchmarks.study.scenario_question import RANGES, ScenarioQuestion
from drake_aigto import jobs, plan, plan_many
from drake_aigto.cli import BAD_INPUT, FINE, INTERRUPTED, NOTHING_HOLDS, main
from drake_aigto.errors import AigtoError, MissingExtraError, OptionsError, StudyError
from drake_aigto.jobs import Answer, ProcessDiedError, load_answers, open_jobs
from drake_aigto.paper import Cell, RigidCell, RigidOptimum, run_rigid_cell, run_table1
from drake_aigto.planning import BALL_LADDER, Plan, Planner, PlanningError, PlanOptions, Replays
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


QUESTIONS = {
    name: dataclasses.replace(Scenario.named(name), time_step=0.02)
    for name in ("table1/1", "table1/2", "table1/3")
}
FAST = PlanOptions(confirm=False, threads=1)


@pytest.fixture(autouse=True)
def run_inline(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drake_aigto.jobs.many.open_workers", Inline)


def dies_of(name: str) -> Callable[..., Answer]:
    """Returns what plans, but for one question, whose process it kills."""

    def answer(asked: str, *arguments: Any) -> Answer:
        if asked == name:
            raise BrokenExecutor
        return WORK(asked, *arguments)

    return answer


WORK = resolve_name("drake_aigto.jobs.many:answer_question")


def test_answers_are_the_plans_of_each_question_alone() -> None:
    told: list[str] = []
    answers = {each.name: each for each in plan_many(QUESTIONS, FAST, progress=told.append)}
    assert answers.keys() == QUESTIONS.keys()
    for name, scenario in QUESTIONS.items():
        answer, alone = answers[name], plan(scenario, FAST)
        assert answer.holds and answer.plan is not None and answer.seconds > 0
        assert answer.plan.candidates == alone.candidates
    assert told == [f"{k} of 3 questions; {k} plans hold" for k in (1, 2, 3)]
    (first,) = plan_many([QUESTIONS["table1/1"]], FAST)
    assert first.name == "0" and first.scenario == QUESTIONS["table1/1"]


def test_by_default_each_plan_takes_one_thread() -> None:
    (answer,) = plan_many([QUESTIONS["table1/2"]])
    assert answer.plan is not None
    assert answer.plan.options == PlanOptions(threads=1, ladder=BALL_LADDER)


def test_what_is_kept_is_gone_on_from(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "plans"
    two = {name: QUESTIONS[name] for name in ("table1/1", "table1/2")}
    done = list(plan_many(two, FAST, folder=folder))
    assert load_answers(folder) == done
    lines = (folder / "answers.jsonl").read_text(encoding="utf-8")
    (folder / "answers.jsonl").write_text(f'{lines}{{"name": "cut sh', encoding="utf-8")

    monkeypatch.setattr("drake_aigto.jobs.many.answer_question", dies_of("table1/3"))
    *again, died = plan_many(QUESTIONS, FAST, folder=folder, resume=True)
    assert again == done
    assert died.died and not died.holds and "two processes that died of it" in str(died.error)
    assert load_answers(folder) == [*done, died]

    monkeypatch.setattr("drake_aigto.jobs.many.answer_question", WORK)
    *_, last = plan_many(QUESTIONS, FAST, folder=folder, resume=True)
    assert last.name == "table1/3" and last.holds
    monkeypatch.setattr("drake_aigto.jobs.many.answer_question", refuse_work)
    assert list(plan_many(QUESTIONS, FAST, folder=folder, resume=True)) == [*done, last]


def test_a_question_that_fails_takes_no_other_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    best = plan(QUESTIONS["table1/1"], FAST)
    well = Planner.plan

    def fail(planner: Planner) -> Plan:
        if planner.scenario == QUESTIONS["table1/1"]:
            error = PlanningError("no plan passed simulation")
            error.plan = best
            raise error
        if planner.scenario == QUESTIONS["table1/2"]:
            raise ZeroDivisionError("a fault")
        return well(planner)

    monkeypatch.setattr(Planner, "plan", fail)
    answers = list(plan_many(QUESTIONS, FAST, folder=tmp_path))
    assert [each.error for each in answers] == [
        "no plan passed simulation.",
        "ZeroDivisionError: a fault",
        None,
    ]
    assert [each.plan == best for each in answers] == [True, False, False]
    assert load_answers(tmp_path) == answers


@pytest.mark.parametrize(
    ("scenarios", "options", "message"),
    [
        ([], {}, r"^scenarios: got none, expected one or more"),
        ({"../x": QUESTIONS["table1/1"]}, {}, r"^the name of a question: got '\.\./x', expected"),
        (
            {"wrong": Scenario(initial_position=-1.0, initial_velocity=0.0, goal_position=1.0)},
            {},
            r"^wrong: initial_position is inside or behind",
        ),
        (
            {"swing": Scenario.named("cart_pole/soft_06")},
            {"options": PlanOptions(aigo_steps=9)},
            r"^swing: aigo_steps: got 9 for a mechanism",
        ),
        (QUESTIONS, {"folder": "/no/such/folder"}, r"^/no/such/folder can't be written: got no f"),
    ],
)
def test_bad_questions_are_refused_before_any_work(
    scenarios: Any, options: Any, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drake_aigto.jobs.many.open_jobs", refuse_work)
    with pytest.raises(AigtoError, match=message):
        plan_many(scenarios, **options)


def test_other_answers_are_never_written_over(tmp_path: Path) -> None:
    one = {"a": QUESTIONS["table1/1"]}
    list(plan_many(one, FAST, folder=tmp_path))
    for changed, resume, message in (
        ({}, False, r"got one that has answers\. Go on from them \(--resume\)"),
        ({"options": None}, True, r"has other answers: got options \{.*expected options None"),
        ({"scenarios": {"a": QUESTIONS["table1/2"]}}, True, "answer to another question of the na"),
    ):
        asked: dict[str, Any] = {"scenarios": one, "options": FAST, **changed}
        with pytest.raises(AigtoError, match=message):
            plan_many(**asked, folder=tmp_path, resume=resume)
    (tmp_path / "answers.jsonl").write_text("{}\n")
    with pytest.raises(AigtoError, match=r"answers\.jsonl can't be read, or is damaged"):
        load_answers(tmp_path)


def test_the_command_prints_each_answer_and_keeps_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    task = tmp_path / "mine.yaml"
    QUESTIONS["table1/3"].save(task)
    folder = tmp_path / "plans"
    command = ["plan-many", "table1/2", str(task), "--into", str(folder), "--quiet"]
    assert main(command) == FINE
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [row[:3] for row in rows] == [["table1/2", "holds", "cost"], ["mine", "holds", "cost"]]
    monkeypatch.setattr("drake_aigto.jobs.many.answer_question", dies_of("table1/1"))
    assert main(["plan-many", "table1/1", *command[1:], "--resume"]) == NOTHING_HOLDS
    *_, last = capsys.readouterr().out.splitlines()
    assert last.startswith("table1/1  failed  table1/1: got two processes that died of it")
    assert main(["replay", str(folder / "mine.json"), "--no-confirm"]) == FINE


@pytest.mark.slow
def test_ctrl_c_ends_the_work_and_what_is_done_is_kept(tmp_path: Path) -> None:
    folder = tmp_path / "plans"
    names = [*(f"table1/{row}" for row in (1, 2, 3, 4)), "acrobot/swing_up"]
    arguments = ["plan-many", *names, "--workers", "1", "--into", str(folder)]
    with subprocess.Popen(
        [sys.executable, "-m", "drake_aigto", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout and process.stdout.readline().startswith("table1/1 ")
        process.send_signal(signal.SIGINT)
        _, told = process.communicate()
    assert process.returncode == INTERRUPTED
    assert told.endswith(f"--resume goes on from {folder}\ndrake-aigto: interrupted\n")
    done = load_answers(folder)
    assert done and all(answer.holds for answer in done)
    head = json.loads((folder / "answers.jsonl").read_text(encoding="utf-8").splitlines()[0])
    assert head["options"] is None


class Blaming(Inline):
    """Loses the first two jobs together, as Dask does with what is at a worker that dies."""

    def __init__(self) -> None:
        super().__init__()
        self.futures: list[Future[Any]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        if len(self.futures) < 2:
            future: Future[Any] = Future()
        else:  # Now each must be alone.
            assert all(future.done() for future in self.futures)
            future = super().submit(fn, *args, **kwargs)
        self.futures.append(future)
        if len(self.futures) == 2:
            for each in self.futures:
                each.set_exception(BrokenExecutor("killed"))
        return future


def die() -> None:
    raise BrokenExecutor("killed")


def test_a_job_that_was_blamed_with_another_runs_again_alone() -> None:
    with open_jobs(Blaming()) as jobs:
        jobs.start("innocent", math.sqrt, 4.0)
        jobs.start("killer", die)
        ended = dict(jobs.ended())
    assert ended["innocent"].result() == 2.0
    with pytest.raises(ProcessDiedError, match=r"^killer: got two processes that died of it"):
        ended["killer"].result()


def test_jobs_may_be_started_as_others_end() -> None:
    with open_jobs(Inline()) as jobs:
        jobs.start(4.0, math.sqrt, 4.0)
        values = []
        for name, future in jobs.ended():
            values.append(future.result())
            if name > 1.1:
                jobs.start(future.result(), math.sqrt, future.result())
    assert values == [4.0**0.5**k for k in range(1, len(values) + 1)]
    assert values[-1] <= 1.1**0.5


def test_when_time_is_up_waiting_ends_and_what_has_not_begun_never_does() -> None:
    started, future = time.monotonic(), Future[Any]()

    class Never(Inline):
        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            return future

        def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
            future.cancel()

    with pytest.raises(TimeoutError), open_jobs(Never()) as jobs:
        jobs.start("long", math.sqrt, 4.0)
        next(jobs.ended(0.05))
    assert time.monotonic() - started < 10.0
    assert future.cancelled()


def test_a_worker_of_another_version_is_refused_by_name() -> None:
    class Elsewhere(Inline):
        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            _, *others = args
            return super().submit(fn, "0.0.9", *others, **kwargs)

    with open_jobs(Elsewhere()) as jobs:
        jobs.start("job", math.sqrt, 4.0)
        ((_, future),) = jobs.ended()
    told = r"^worker on .+: got drake_aigto \d.+, expected 0\.0\.9, as where the study was started"
    with pytest.raises(StudyError, match=told):
        future.result()
