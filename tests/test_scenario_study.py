"""A study of scenarios: its verdicts, and that nothing that was done is lost or done again.

Files of results are of one kind and of one question, and nobody's are written over.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenario_studies import TOYS, Inline, coast_or_turn

from benchmarks.baselines import registry
from benchmarks.study import scenario_question
from benchmarks.study.scenario_question import Job, MethodRun, ScenarioQuestion, round_to, run_job
from benchmarks.study.scenario_study import DIED, ScenarioStudy, calc_good_enough
from drake_aigto.errors import ResultsFileError, StudyError

QUICK = ScenarioQuestion(count=4, methods=("coast", "crash"), seconds_per_unit=0.5, num_steps=20)
PLANNED = dataclasses.replace(
    QUICK, count=2, methods=("aigto", "coast"), seconds_per_unit=None, budgets=(1.0, 100.0)
)


@pytest.fixture(autouse=True)
def toys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "BASELINES", TOYS)
    monkeypatch.setattr(ScenarioQuestion, "scenario", coast_or_turn)
    scenario_question._warm_up.cache_clear()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "study.json"


def test_a_method_succeeds_where_its_replay_costs_no_more_than_the_optimum() -> None:
    study = ScenarioStudy(QUICK).run(executor=Inline())
    assert study.is_complete
    easy, hard, *_ = study.results
    assert easy.optimum == pytest.approx(0.0, abs=1e-12)
    assert easy.good_enough == calc_good_enough(easy.optimum) == pytest.approx(1e-7)
    assert easy.runs["coast"].evaluations == 2
    assert study.succeeds(easy, "coast", 1.0)
    # Coasting ends 0.7 m off the goal.
    assert study.cost(hard, "coast", 100.0) == pytest.approx(0.49)
    assert 0.0 < hard.optimum < 0.49
    assert not study.succeeds(hard, "coast", 100.0)


def test_a_method_that_fails_is_kept_with_its_error() -> None:
    study = ScenarioStudy(QUICK).run(executor=Inline())
    for result in study.results:
        assert result.runs["crash"].error == "ZeroDivisionError: no way\nat all"
        assert result.runs["crash"].cost == math.inf
        assert not study.succeeds(result, "crash", 100.0)


def test_the_planner_goes_first_and_its_time_is_the_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    jobs: list[Job] = []

    def run(job: Job) -> MethodRun:
        jobs.append(job)
        return run_job(job)

    monkeypatch.setattr(scenario_question, "run_job", run)
    study = ScenarioStudy(PLANNED).run(executor=Inline())
    first = [next(job.method for job in jobs if job.number == number) for number in (0, 1)]
    assert first == ["aigto", "aigto"]
    for job in jobs:
        if job.method == "coast":
            unit = study.results[job.number].runs["aigto"].seconds
            assert job.seconds == 100.0 * unit
            assert job.good_enough == study.results[job.number].good_enough
    for result in study.results:
        assert study.succeeds(result, "aigto", 1.0)
        assert study.unit(result) == result.runs["aigto"].seconds > 0.0


@given(
    st.lists(st.tuples(st.floats(1e-3, 1e3) | st.floats(1.0, 1.01), st.floats(1e-6, 1e6))),
    st.lists(st.floats(1e-3, 1e3) | st.floats(1.0, 1.01), min_size=1, unique=True).map(sorted),
)
def test_thinning_loses_no_budgets_cost(
    offers: list[tuple[float, float]], ends: list[float]
) -> None:
    best: list[tuple[float, float]] = []
    for at, cost in sorted(offers):
        if not best or cost < best[-1][1]:
            best.append((at, cost))
    whole = MethodRun(tuple(best), 1e3)
    thinned = whole.thinned(ends)
    assert len(thinned.improvements) <= len(ends) + 1
    for end in (*ends, math.inf):
        # Costs have seven digits; times four, rounded down.
        assert thinned.cost_within(end) <= whole.cost_within(end) * (1 + 1e-6)
        assert thinned.cost_within(end) >= whole.cost_within(end * 1.001) * (1 - 1e-6)


def test_going_on_adds_scenarios_and_methods(path: Path) -> None:
    fewer = dataclasses.replace(QUICK, count=2, methods=("coast",))
    small = ScenarioStudy(fewer).run(path, executor=Inline())
    executor = Inline()
    large = ScenarioStudy(QUICK).run(path, resume=True, executor=executor)
    assert executor.num_jobs == 8 - 2
    assert large.is_complete
    assert large.results[1].runs["coast"] == small.results[1].runs["coast"]
    again = ScenarioStudy(QUICK).run(path, resume=True, executor=executor)
    assert executor.num_jobs == 8 - 2 and again == large


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"seed": 7, "budgets": (1.0,)}, ["seed 0", "seed 7", "budgets [1.0, 10.0, 100.0]"]),
        ({"count": 3}, ["count 4", "count 3"]),
        ({"methods": ("crash",)}, ["methods ['coast', 'crash']", "methods ['crash']"]),
    ],
)
def test_another_studys_file_is_refused_with_what_differs(
    path: Path, changes: dict[str, Any], told: list[str]
) -> None:
    ScenarioStudy(QUICK).run(path, executor=Inline())
    before = path.read_bytes()
    with pytest.raises(ResultsFileError) as error:
        other = ScenarioStudy(dataclasses.replace(QUICK, **changes))
        other.run(path, resume=True, executor=Inline())
    for text in ("study.json is of another study: got ", *told):
        assert text in str(error.value)
    assert "velocity" not in str(error.value)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"goal": 0.5', '"goal": 0.6', "got other numbers for scenario 1 than are drawn now"),
        ('"optimum"', '"ideal"', "is damaged: got results.0..optimum: got nothing"),
    ],
)
def test_a_damaged_file_is_refused(path: Path, old: str, new: str, message: str) -> None:
    ScenarioStudy(QUICK).run(path, executor=Inline())
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ResultsFileError, match=message):
        ScenarioStudy.load(path)


def test_ctrl_c_keeps_what_was_done(path: Path) -> None:
    lines: list[str] = []

    def interrupt(line: str) -> None:
        lines.append(line)
        if len(lines) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ScenarioStudy(QUICK).run(path, executor=Inline(), progress=interrupt)
    assert lines[-1] == "3 of 8 runs; optimal: coast 1/2, crash 0/1"
    kept = ScenarioStudy.load(path)
    assert sum(len(result.runs) for result in kept.results) == 3
    assert not kept.is_complete
    executor = Inline()
    assert ScenarioStudy(QUICK).run(path, resume=True, executor=executor).is_complete
    assert executor.num_jobs == 5


class Broken(Inline):
    """A pool that one dead worker takes down, as ProcessPoolExecutor is."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        if self.num_jobs < 8:
            return super().submit(self.die if self.num_jobs > 3 else fn, *args, **kwargs)
        raise BrokenExecutor("a child process terminated abruptly")

    def die(self, *call: object) -> MethodRun:
        raise BrokenExecutor("terminated")


def test_a_pool_that_breaks_loses_nothing_that_was_done(path: Path) -> None:
    with pytest.raises(StudyError, match=r"pool .* broke: got .*abruptly\. .* go on .*\(--resume"):
        ScenarioStudy(QUICK).run(path, executor=Broken())
    kept = ScenarioStudy.load(path)
    assert sum(len(result.runs) for result in kept.results) == 4
    assert ScenarioStudy(QUICK).run(path, resume=True, executor=Inline()).is_complete


def test_a_job_that_kills_its_processes_is_kept_as_that_and_tried_again_by_resume(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run_or_die(job: Job) -> MethodRun:
        if job.number == 2:
            raise BrokenExecutor
        return MethodRun(((0.1, 1e-9),), 0.1, 1)

    monkeypatch.setattr(scenario_question, "run_job", run_or_die)
    question = dataclasses.replace(QUICK, methods=("coast",))
    study = ScenarioStudy(question).run(path, executor=Inline())
    errors = [result.runs["coast"].error for result in study.results]
    assert errors == [None, None, DIED, None]
    # It may have been the machine's fault: tried again, and nothing else is.
    monkeypatch.setattr(scenario_question, "run_job", run_job)
    executor = Inline()
    again = ScenarioStudy(question).run(path, resume=True, executor=executor)
    assert executor.num_jobs == 1
    assert again.results[2].runs["coast"].error is None


@pytest.mark.parametrize(
    ("value", "digits", "nearest", "down"),
    [
        (123.456, 3, 123.0, 123.0),
        (1.23556e-9, 4, 1.236e-9, 1.235e-9),
        (-0.0019996, 4, -0.002, -0.001999),
        (0.0, 3, 0.0, 0.0),
    ],
)
def test_numbers_are_rounded_to_significant_digits(
    value: float, digits: int, nearest: float, down: float
) -> None:
    assert round_to(value, digits) == nearest
    assert round_to(nearest, digits) == nearest
    assert round_to(value, digits, down=True) == down
    assert round_to(down, digits, down=True) == down
