"""A study of scenarios: its verdicts, and what its files keep."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenario_studies import TOYS, coast_or_turn

from benchmarks.baselines import registry
from benchmarks.study import scenario_question, scenario_study
from benchmarks.study.scenario_question import Job, MethodRun, ScenarioQuestion, round_to, run_job
from benchmarks.study.scenario_study import ScenarioStudy, answer, calc_good_enough
from drake_aigto.errors import ResultsFileError

QUICK = ScenarioQuestion(count=4, methods=("coast", "crash"), seconds_per_unit=0.5, num_steps=20)
PLANNED = dataclasses.replace(
    QUICK, count=2, methods=("coast", "aigto"), seconds_per_unit=None, budgets=(1.0, 100.0)
)


@pytest.fixture(autouse=True)
def toys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "BASELINES", TOYS)
    monkeypatch.setattr(ScenarioQuestion, "scenario", coast_or_turn)
    scenario_question._warm_up.cache_clear()


def run_study(question: ScenarioQuestion) -> ScenarioStudy:
    return ScenarioStudy(question, tuple(answer((question, i)) for i in range(question.count)))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "study.json"


def test_a_method_succeeds_where_its_replay_costs_no_more_than_the_optimum() -> None:
    study = run_study(QUICK)
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
    study = run_study(QUICK)
    for result in study.results:
        assert result.runs["crash"].error == "ZeroDivisionError: no way\nat all"
        assert result.runs["crash"].cost == math.inf
        assert not study.succeeds(result, "crash", 100.0)


def test_the_planner_goes_first_and_its_time_is_the_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    jobs: list[Job] = []

    def run(job: Job) -> MethodRun:
        jobs.append(job)
        return run_job(job)

    monkeypatch.setattr(scenario_study, "run_job", run)
    study = run_study(PLANNED)
    assert [job.method for job in jobs] == ["aigto", "coast"] * 2
    for result, job in zip(study.results, jobs[1::2], strict=True):
        assert job.seconds == pytest.approx(100.0 * result.runs["aigto"].seconds, rel=1e-3)
        assert job.good_enough == result.good_enough
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


def test_a_study_survives_its_file(path: Path) -> None:
    study = run_study(QUICK)
    study.save(path)
    assert ScenarioStudy.load(path) == study


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"goal": 0.5', '"goal": 0.6', "got other numbers for scenario 1 than are drawn now"),
        ('"optimum"', '"ideal"', "is damaged: got results.0..optimum: got nothing"),
    ],
)
def test_a_damaged_file_is_refused(path: Path, old: str, new: str, message: str) -> None:
    run_study(QUICK).save(path)
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ResultsFileError, match=message):
        ScenarioStudy.load(path)


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
