"""Questions that nobody shipped: drawn by seed, judged beside the best that is known."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import questions
from benchmarks.questions import NEAR, WIDE, Job, Row, draw, format_results, load_known, main
from drake_aigto import Planner, Scenario, World
from drake_aigto.errors import ScenarioError

ROW = Row("cart_pole/soft_06", 0, 80.0, 80.0, 168.0, 79.0, math.inf, False, 60, 3, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cart_pole/soft_06", "corridor/lossy"])
def test_questions_are_the_same_again_others_to_tune_on_and_fit_their_world(name: str) -> None:
    shipped, asked = Scenario.named(name), [draw(name, number, False) for number in range(2)]
    assert len({*asked, *(draw(name, number, True) for number in range(2)), shipped}) == 5
    for number, scenario in enumerate(asked):
        World.from_scenario(scenario).check(scenario)
        assert draw.__wrapped__(name, number, False) == scenario
        factor = scenario.duration / shipped.duration
        assert 0.3 <= factor <= 4.0 and 10 <= scenario.num_steps <= 400


def test_the_best_known_is_stored_until_its_question_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(questions, "PATH", tmp_path / "known.json")
    job = Job(ROW.world, ROW.number, False, 4.0)
    assert questions.find_known(job, load_known()).cost == math.inf
    questions.store([ROW], False, 4.0)
    questions.store([replace(ROW, rival=math.inf, cost=79.5)], False, 0.0)
    assert questions.find_known(job, load_known())[1:] == (79.0, 4.0)
    assert questions.find_known(job._replace(is_tuning=True), load_known()).times == 0.0
    lighter = replace(draw(ROW.world, 0, False), control_weight=2e-3)
    monkeypatch.setattr(questions, "draw", lambda *_: lighter)
    assert questions.find_known(job, load_known())[1:] == (math.inf, 0.0)


def test_rivals_that_had_their_time_are_not_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    job = Job("cart_pole/soft_06", 0, False, 4.0)
    known = questions.find_known(job, {})._replace(cost=1e-3, times=4.0)
    monkeypatch.setattr(questions, "load_known", lambda: {job.name: known})
    monkeypatch.setattr(questions, "ask_rivals", lambda *_: 1e-4)
    row = questions.answer(job)
    assert (row.rival, row.best) == (math.inf, 1e-3) and not row.is_within(WIDE)
    assert questions.answer(job._replace(times=5.0)).best == 1e-4


def test_questions_of_a_motion_that_repeats_move_its_goal_with_its_start() -> None:
    shipped, advance = Scenario.named("hopper/gait").initial_position, [0.4, 0.0, 0.0, 0.0]
    asked = [draw("hopper/gait", number, True) for number in range(4)]
    assert 0 < sum(np.array_equal(each.initial_position, shipped) for each in asked) < 4
    for scenario in asked:
        planner = Planner(scenario)  # Which refuses any other goal.
        way = planner.scenario.goal_position - planner.scenario.initial_position
        np.testing.assert_allclose(way, advance, atol=1e-12)


def test_plans_are_near_the_best_that_anything_has_found() -> None:
    assert ROW.best == 79.0 and not ROW.is_within(NEAR) and ROW.is_within(WIDE)
    assert replace(ROW, known=70.0).best == 70.0
    none = replace(ROW, number=1, cost=math.inf, error="no plan")
    assert not none.is_within(WIDE)
    idle = replace(ROW, number=2, cost=168.0, is_idle=True)
    line = format_results([ROW, none, idle]).splitlines()[1].split()
    assert line == ["cart_pole/soft_06", "3", "0", "33", "inf", "1", "1", "1.00"]
    for cost, rival in ((0.0, np.inf), (1e-28, 0.0)):
        nothing = replace(ROW, cost=cost, rival=rival)
        assert nothing.is_within(NEAR)


def test_a_world_that_is_not_shipped_is_refused() -> None:
    with pytest.raises(ScenarioError, match="unknown scenario 'cart_pole/soft'"):
        main(["cart_pole/soft"])
