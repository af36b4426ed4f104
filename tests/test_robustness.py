"""The study of robustness: what is asked, what comes out, and the file that it is kept in.

What is shown of a study of robustness: the table, the page, and the figure. Perturbations of the
true world: what they change, by how much, and what is refused.
"""

from __future__ import annotations

import dataclasses
import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from replay_worlds import make_scenario, make_task, shipped, shipped_world
from scenario_studies import QUESTION, make_result

from benchmarks.robustness import study as robustness
from benchmarks.robustness.page import ROBUSTNESS, format_robustness, plot_robustness
from benchmarks.robustness.question import (
    QUANTITIES,
    RANDOM,
    Perturbation,
    RobustnessQuestion,
    perturb_at_random,
    perturb_one_at_a_time,
)
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
from benchmarks.study.page import write_results_page
from drake_aigto import PlanningError, Scenario
from drake_aigto.errors import ModelError, OptionsError, ScenarioError
from drake_aigto.paper import rigid_optimum
from drake_aigto.plain import from_plain, to_plain
from drake_aigto.planning import Feedback
from drake_aigto.simulation import EVENT_DRIVEN, replay_event_driven, replay_with

SMALL = RobustnessQuestion(rows=(1,), restitutions=(0.8,), samples=1, confirm=False)


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


@pytest.mark.parametrize("percent", [51.0, 100.0])
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


@cache
def run_small() -> TaskResult:
    return run_task(SMALL.tasks()[0], SMALL)


@pytest.mark.slow
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
        feedback = replay_with(EVENT_DRIVEN, *truth, controller)
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


def test_the_table_has_every_kind_of_every_plan_in_a_hundred_columns() -> None:
    study = RobustnessStudy(QUESTION, (make_result("table1/1, e = 1"),))
    text = format_robustness(study)
    lines = text.splitlines()
    assert max(map(len, lines)) <= 100
    for kind in (*QUANTITIES, RANDOM):
        assert sum(line.startswith(f"    {kind} ± 1 %") for line in lines) == 2
    random = next(line for line in lines if line.startswith("    random"))
    assert random.split()[4:] == [
        *("6.5e-03", "7.0e-03", "1.0", "mm", "2/2"),
        *("6.5e-03", "7.0e-03", "1.0", "mm", "2/2"),
        *("7.0e-03", "6.5e-03"),
    ]
    assert "ours: 1.00e-03, 1.0 mm off the goal, bounce at 0.500 s ---" in text
    assert "gradient: 2.00e-03, 0 m off the goal, no bounce ---" in text
    velocity = next(line for line in lines if line.startswith("    velocity"))
    assert velocity.split().count("0/1") == 2
    summary = next(line for line in lines if line.startswith("  ours, LQR  "))
    assert summary.split()[2:] == [
        *("1", "5.5e-03", "6.0e-03", "1.0", "mm", "1.0", "mm", "2", "of", "2")
    ]


def test_without_drake_or_random_perturbations_there_is_a_table_too() -> None:
    result = make_result("table1/1, e = 1", kinds=QUANTITIES)
    text = format_robustness(RobustnessStudy(QUESTION, (result,)))
    assert "    mass ± 1 %" in text and "    random" not in text
    plans = tuple(
        dataclasses.replace(plan, outcomes={k: v for k, v in plan.outcomes.items() if k != DRAKE})
        for plan in result.plans
    )
    text = format_robustness(RobustnessStudy(QUESTION, (dataclasses.replace(result, plans=plans),)))
    assert re.search(r"start ± 1 % .* 1/1 +- +1\.0e-03", text)


def test_the_page_has_the_command_the_summary_and_the_figure(tmp_path: Path) -> None:
    file, page = tmp_path / "percent.json", tmp_path / "results.md"
    question = dataclasses.replace(QUESTION, confirm=False)
    failed = PlanResult(OURS, error="nothing was found.")
    done = make_result("table1/2, e = 1")
    results = done, dataclasses.replace(done, name="table1/1, e = 1", plans=(failed,))
    RobustnessStudy(question, results).save(file)
    write_results_page([file], page, {QUESTION.kind: ROBUSTNESS})
    text = page.read_text(encoding="utf-8")
    command = "robustness --rows 1 2 --restitutions 1 --percent 1 --samples 2 --seed 0"
    assert f"    python -m benchmarks {command} --no-confirm\n" in text
    assert "| gradient, LQR | 1 | 4.5e-03 | 5.0e-03 | 1.0 mm | 1.0 mm | 2 of 2 |" in text
    assert "- table1/1, e = 1, ours: nothing was found." in text
    assert "Not all of these tasks" not in text
    (picture,) = re.findall(r"!\[[^]]+\]\((\S+)\)", text)
    assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
    RobustnessStudy(question, results[:1]).save(file)
    write_results_page([file], page, {QUESTION.kind: ROBUSTNESS})
    assert "Not all of these tasks are done." in page.read_text(encoding="utf-8")


def test_the_figure_has_a_dot_for_every_random_perturbation() -> None:
    names = ["table1/1, e = 1", "table1/2, e = 1"]
    study = RobustnessStudy(QUESTION, tuple(map(make_result, names)))
    axes = Figure().add_subplot()
    plot_robustness(axes, study)
    drawn = [
        np.column_stack(line.get_data()) for line in axes.lines if str(line.get_marker()) in "ox"
    ]
    dots = [line for line in drawn if len(line)]  # The others are the legend's.
    assert len(dots) == 2 * 2 * 2  # Tasks, plans, ways to carry them out.
    assert all(line[:, 1] == pytest.approx([6e-3, 7e-3]) for line in dots)
    assert len({line[0, 0] for line in dots}) == len(dots)
    assert [label.get_text() for label in axes.get_xticklabels()] == names
    assert axes.get_yscale() == "log"
    legend = axes.get_legend()
    assert legend is not None and len(legend.get_texts()) == 5


def test_lengths_are_parts_of_the_first_clearance() -> None:
    world = shipped("room")
    scenario = make_task("room", [0.3, 0.9], [1.0, -2.0], restitution=0.5)
    (nearest,) = np.flatnonzero(world.calc_signed_distance(scenario.initial_position) < 0.15)
    near = world.calc_signed_distance(scenario.initial_position)[nearest]
    for name, sign in (("start", 1), ("wall", -1)):
        perturbation = Perturbation(name, **{name: 0.1})
        true_world, true_scenario = perturbation.apply(world, scenario)
        distances = true_world.calc_signed_distance(true_scenario.initial_position)
        assert distances[nearest] == pytest.approx(near * (1 + sign * 0.1), abs=1e-12)
        assert sum(distances) == pytest.approx(2.0 if name == "start" else 2.0 - 0.1 * near)


def test_other_quantities_are_parts_of_themselves() -> None:
    perturbation = Perturbation(RANDOM, velocity=0.1, mass=-0.2, restitution=0.05)
    world, scenario = perturbation.apply(shipped_world(2.0), make_scenario(mass=2, restitution=0.8))
    assert scenario.initial_velocity == pytest.approx([-2.2])
    assert scenario.mass == world.mass == pytest.approx(1.6)
    assert world.constant_inertia.mass_matrix == pytest.approx(np.array([[1.6]]))
    assert scenario.restitution == pytest.approx(0.84)
    assert scenario.initial_position == make_scenario().initial_position


def test_no_wall_returns_more_than_it_gets() -> None:
    kinds = {e: perturb_one_at_a_time(0.01, make_scenario(restitution=e)) for e in (1.0, 0.5, 0.0)}
    assert [len(found) for found in kinds.values()] == [9, 10, 8]
    assert [each.restitution for each in kinds[1.0] if each.kind == "restitution"] == [-0.01]
    more = Perturbation(RANDOM, restitution=0.01)
    assert more.apply(shipped_world(), make_scenario(restitution=1.0))[1].restitution == 1.0


def test_random_perturbations_come_from_the_seed_alone() -> None:
    few, many, other = (
        perturb_at_random(0.01, n, seed) for n, seed in ((3, 1), (100, 1), (100, 2))
    )
    assert many[:3] == few and many != other
    parts = np.array([[getattr(each, name) for name in QUANTITIES] for each in many])
    assert np.all(np.abs(parts) <= 0.01)
    assert np.all(np.max(parts, axis=0) > 0.009) and np.all(np.min(parts, axis=0) < -0.009)
    assert np.max(np.abs(np.corrcoef(parts.T) - np.eye(5))) < 0.4


def test_a_restitution_that_is_the_models_own_is_refused() -> None:
    world = shipped_world()
    contacts = tuple(dataclasses.replace(each, restitution=0.5) for each in world.contacts)
    own = dataclasses.replace(world, contacts=contacts)
    with pytest.raises(ModelError, match=r"got 0\.5, the model's own, expected the scenario's"):
        Perturbation("restitution", restitution=0.01).apply(own, make_scenario())


def test_a_start_in_the_wall_is_refused() -> None:
    with pytest.raises(ScenarioError, match="initial_position is inside"):
        Perturbation(RANDOM, start=-0.5, wall=0.6).apply(shipped_world(), make_scenario())
