"""The study of robustness: what is asked, what comes out, and the file that it is kept in."""

from __future__ import annotations

import dataclasses
import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from replay_worlds import shipped_world
from robustness_studies import QUESTION, make_result
from scenario_studies import Inline

from benchmarks.robustness import study as robustness
from benchmarks.robustness.page import format_robustness
from benchmarks.robustness.question import RobustnessQuestion
from benchmarks.robustness.study import (
    DRAKE,
    FEEDBACK,
    GRADIENT,
    OPEN_LOOP,
    OURS,
    PlanResult,
    RobustnessStudy,
    TaskResult,
    plan_without_contact,
    round_as_filed,
    run_task,
)
from drake_aigto import OptionsError, PlanningError, Scenario
from drake_aigto.control import Feedback, track_event_driven
from drake_aigto.paper import rigid_optimum
from drake_aigto.plain import from_plain, to_plain
from drake_aigto.simulation import replay_event_driven

SMALL = RobustnessQuestion(rows=(1,), restitutions=(0.8,), samples=1, confirm=False)


# What is asked.


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"percent": 0.0}, "percent: got 0.0, expected a number above 0"),
        ({"percent": -1.0}, "percent: got -1.0, expected a number above 0"),
        ({"percent": np.nan}, "percent: got nan, expected a number above 0"),
        ({"rows": (1, 5)}, "rows: got 5, expected some of 1, 2, 3, 4"),
        ({"restitutions": (1.1,)}, "restitutions: got 1.1, expected numbers from 0 to 1"),
        ({"samples": -1}, "samples: got -1, expected a whole number, 0 or more"),
        ({"scenarios": -1}, "scenarios: got -1, expected a whole number, 0 or more"),
        ({"seed": -1}, "seed: got -1, expected a whole number, 0 or more"),
        ({"rows": ()}, "rows: got none, expected some, or random scenarios"),
    ],
)
def test_a_bad_question_is_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionsError, match=re.escape(message)):
        RobustnessQuestion(**fields)


@pytest.mark.parametrize("percent", [51.0, 99.0, 100.0, 1000.0])
def test_perturbations_that_reach_the_wall_are_refused(percent: float) -> None:
    question = RobustnessQuestion(rows=(3, 4), percent=percent)
    message = rf"percent, for table1/3, e = 1: got {percent:g}, by which .* Perturb by less"
    with pytest.raises(OptionsError, match=message):
        question.check()


def test_tasks_are_rows_and_random_scenarios() -> None:
    question = RobustnessQuestion(rows=(2, 4), restitutions=(1.0, 0.5), scenarios=3, seed=7)
    tasks = question.tasks()
    assert [task.name for task in tasks[:4]] == [
        *("table1/2, e = 1", "table1/2, e = 0.5"),
        *("table1/4, e = 1", "table1/4, e = 0.5"),
    ]
    assert len({task.name for task in tasks}) == len(tasks) == 7
    assert tasks[1].scenario.initial_velocity == [-1.2] and tasks[1].scenario.restitution == 0.5
    assert tasks[4:] == dataclasses.replace(question, rows=()).tasks()
    question.check()


# What comes out.


@cache
def run_small() -> TaskResult:
    return run_task(SMALL.tasks()[0], SMALL)


def test_outcomes_are_replays_of_the_perturbed_truth() -> None:
    result = run_small()
    world, scenario = shipped_world(), result.scenario
    gradient = next(plan for plan in result.plans if plan.method == GRADIENT)
    plan = plan_without_contact(world, scenario)
    controller = Feedback(world, scenario, plan)
    perturbations = SMALL.perturbations(scenario)
    assert result.kinds == tuple(perturbation.kind for perturbation in perturbations)
    for i in (0, 5, 7, len(perturbations) - 1):
        truth = perturbations[i].apply(world, scenario)
        open_loop = replay_event_driven(*truth, plan.times, plan.controls)
        feedback = track_event_driven(*truth, controller).replay
        for way, replay in ((OPEN_LOOP, open_loop), (FEEDBACK, feedback)):
            assert gradient.outcomes[way][i].cost == round_as_filed(replay.cost)
            assert gradient.outcomes[way][i].goal_error == round_as_filed(replay.goal_error)
        assert result.optima[i] == round_as_filed(rigid_optimum(*truth).cost)


def test_no_outcome_beats_what_is_possible_and_feedback_comes_near() -> None:
    result = run_small()
    ours, gradient = result.plans
    assert (ours.method, gradient.method) == (OURS, GRADIENT)
    assert len(ours.bounce_times) == 1 and not gradient.bounce_times
    for plan in result.plans:
        assert plan.cost >= result.optimum * (1 - 1e-9)
        assert DRAKE not in plan.outcomes
        for outcomes in plan.outcomes.values():
            for outcome, optimum in zip(outcomes, result.optima, strict=True):
                assert outcome.cost >= optimum * (1 - 1e-9)
                assert outcome.keeps_contacts
    feedback, open_loop = (
        sum(outcome.cost for outcome in ours.outcomes[way]) for way in (FEEDBACK, OPEN_LOOP)
    )
    assert feedback < 0.5 * open_loop
    assert max(outcome.cost for outcome in ours.outcomes[OPEN_LOOP]) < gradient.cost


def test_the_gradient_solvers_plan_is_the_best_flight() -> None:
    scenario = Scenario.named("table1/1")
    plan = plan_without_contact(shipped_world(), scenario)
    replay = replay_event_driven(shipped_world(), scenario, plan.times, plan.controls)
    assert not replay.bounce_times
    best = rigid_optimum(shipped_world(), scenario).flight_cost
    assert replay.cost == pytest.approx(best, rel=1e-3) and replay.cost > best


def test_a_plan_that_is_not_found_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise PlanningError("nothing was found", got="4 candidates")

    monkeypatch.setattr(robustness, "_plan", fail)
    result = run_task(SMALL.tasks()[0], SMALL)
    assert result.plans[0] == PlanResult(OURS, error="nothing was found: got 4 candidates.")
    assert from_plain(TaskResult, json.loads(json.dumps(to_plain(result)))).plans[0].error
    text = format_robustness(RobustnessStudy(SMALL, (result,)))
    assert "ours: nothing was found: got 4 candidates." in text


# Files.


def test_a_study_reads_back_as_it_was_written(tmp_path: Path) -> None:
    results = make_result("table1/1, e = 1"), make_result("table1/2, e = 1")
    study = RobustnessStudy(QUESTION, results)
    path = tmp_path / "results.json"
    study.save(path)
    assert RobustnessStudy.load(path) == study
    assert json.loads(path.read_text())["kind"] == "robustness"


def test_a_study_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robustness, "run_task", lambda task, _: make_result(task.name))
    path, executor, lines = tmp_path / "results.json", Inline(), list[str]()
    RobustnessStudy(QUESTION, (make_result("table1/2, e = 1"),)).save(path)
    study = RobustnessStudy(QUESTION)
    study = study.run(path, resume=True, executor=executor, progress=lines.append)
    assert executor.num_jobs == 1 and lines == ["2 of 2 tasks done"]
    assert [result.name for result in study.results] == ["table1/1, e = 1", "table1/2, e = 1"]
