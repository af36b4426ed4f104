"""What simulations veto, doing nothing, and Ctrl-C: nothing of it in silence."""

from __future__ import annotations

import dataclasses
import html
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from marks import slow
from replay_worlds import (
    COARSE,
    UNCONFIRMED,
    bounce_plan,
    make_diagram,
    make_wedge,
    shipped_world,
    table1,
)

from drake_aigto import Scenario, World, plan
from drake_aigto.cli import INTERRUPTED, main
from drake_aigto.paper import LITERAL_LADDER, LiteralOptions, plan_literal, rigid_optimum
from drake_aigto.planning import BallTask, Plan, Planner, PlanningError, PlanOptions, ProgramTask
from drake_aigto.show import Page, add_verdict, cost_text, format_plan
from drake_aigto.simulation import Replay, replay_event_driven

MODELS = "package://drake_aigto_models"


def test_a_contact_that_only_the_simulation_has_is_told() -> None:
    found = bounce_plan()
    assert found.best.unplanned == ()
    assert "unplanned" not in format_plan(found)
    silent = dataclasses.replace(found.best, contacts=())
    hidden = dataclasses.replace(found, candidates=(silent, *found.candidates[1:]))
    (time,) = found.replay.event_driven.bounce_times
    assert silent.unplanned == ((time, 0),)
    assert f"on a rigid wall it also touches wall at {time:.3f} s" in format_plan(hidden)


@pytest.mark.parametrize(
    ("weights", "words"),
    [
        ({"control_weight": 1e5}, "hardly better than doing nothing"),
        ({}, ""),
        ({"initial_velocity": [0.0], "goal_position": [1.0]}, ""),  # Nothing is to be done.
    ],
)
def test_a_plan_that_hardly_does_anything_says_so_first(
    weights: dict[str, Any], words: str
) -> None:
    found = plan(table1(1, **weights, **COARSE), UNCONFIRMED)
    verdict = format_plan(found).splitlines()[0]
    assert found.idleness == words
    assert verdict.split("     ")[1].strip(" ,").startswith(words or "holds")
    page = Page("")
    add_verdict(page, found, found.find_world())
    if words:
        assert "of which its control" in format_plan(found) and words in page.to_html().lower()
    assert ("doing nothing" in repr(found)) == bool(words)


def test_what_speaks_against_moving_is_said_where_a_plan_does_nothing() -> None:
    found = plan(table1(1, control_weight=1e5, **COARSE), UNCONFIRMED)
    idle = dataclasses.replace(
        found, candidates=tuple(sorted(found.candidates, key=lambda each: not each.is_idle))
    )
    text = format_plan(idle)
    assert idle.idleness == "does nothing" and text.startswith("verdict     does nothing,")
    moving = min(each.cost for each in found.candidates if not each.is_idle)
    assert f"that move costs {cost_text(moving, 3)}" in text


def test_a_literal_plan_that_keeps_its_promise_is_no_success_where_doing_nothing_costs_less() -> (
    None
):
    # It is at the goal already, from which ε/(φ + δ) pushes it.
    still = {"initial_position": [0.5], "initial_velocity": [0.0], "goal_position": [0.5]}
    scenario = table1(1, **still, goal_weight=1e-4, **COARSE)
    found = plan_literal(scenario, LiteralOptions(ladder=LITERAL_LADDER[:1], confirm=False))
    assert found.keeps_promise
    assert not found.holds
    assert found.idle is not None
    assert found.idle.cost == 0.0
    assert "fails: on a rigid wall doing nothing costs less" in format_plan(found)
    assert "doing nothing is better: it costs 0" in format_plan(found)


def test_a_literal_plan_that_beats_doing_nothing_tells_what_that_costs() -> None:
    options = LiteralOptions(ladder=LITERAL_LADDER[:1], confirm=False)
    found = plan_literal(table1(1, **COARSE), options)
    assert not found.best.is_idle
    assert found.holds == found.keeps_promise
    assert "no control  it costs 0.07290" in format_plan(found)


def contradict(number: int) -> Any:
    """Returns Drake's replay of a plan, but for the first so many, which miss by a metre."""
    calls = []

    def replay(world: World, scenario: Scenario, *control: Any) -> Replay:
        calls.append(control)
        found = replay_event_driven(world, scenario, *control)
        miss = 1.0 if len(calls) <= number else 0.0
        return dataclasses.replace(
            found, simulator="drake", cost=found.cost + miss, goal_error=found.goal_error + miss
        )

    return replay


def test_a_candidate_that_drake_contradicts_is_told_in_the_plan_and_wherever_it_is_shown(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    caplog.set_level(logging.INFO, "drake_aigto")
    monkeypatch.setattr("drake_aigto.planning.program_task.replay_drake", contradict(1))
    found = plan(table1(1, **COARSE))
    # The next candidate is taken.
    assert found.holds and found.cost > bounce_plan().cost
    assert found.candidates[1].cost == bounce_plan().cost
    found.save(tmp_path / "plan.json")
    (veto,) = Plan.load(tmp_path / "plan.json").vetoes
    assert veto.candidate == found.candidates[1]
    assert veto.candidate.cost < found.cost
    assert veto.replay.simulator == "drake"
    assert [veto.replay.cost, veto.replay.goal_error] == pytest.approx([1.0, 1.0], rel=1e-3)
    assert "vetoed by the drake replay: contact at 0.550 s promises cost 2.181e-04" in caplog.text
    page = Page("")
    add_verdict(page, found, shipped_world())
    for told in (format_plan(found), page.to_html()):
        words = " ".join(html.unescape(told).split())
        assert (
            "a candidate with contacts at 0.550 s promises 2.18e-04, but on Drake's plant costs "
            "1.00 and ends 1.00 m off the goal" in words
        )
    assert not bounce_plan().vetoes


def test_a_candidate_that_holds_from_its_exact_start_only_is_told() -> None:
    found, replay = bounce_plan(), bounce_plan().best.replay
    exact = dataclasses.replace(replay, cost=replay.cost / 2)
    off = dataclasses.replace(replay, cost=replay.cost + 1.0)
    frail = dataclasses.replace(
        found.best, cost=found.cost / 2, replay=exact, drake=None, perturbed=(exact, off)
    )
    found = dataclasses.replace(found, candidates=(found.best, frail))
    assert [(veto.candidate, veto.replay) for veto in found.vetoes] == [(frail, off)]
    words = " ".join(format_plan(found).split())
    assert "1.09e-04, but from a start 1e-3 of the scales off, on a rigid wall costs" in words


def test_nothing_that_holds_is_an_error_that_says_what_was_tried(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cost = bounce_plan().cost
    monkeypatch.setattr("drake_aigto.planning.program_task.replay_drake", contradict(99))
    message = (
        r"nothing that was planned holds in simulation: got \d candidates from 5 rungs of AIGO "
        r"\(contact at 0\.550 s for 2\.18e-04, replayed 2\.18e-04, in Drake 1\.00e\+00 and "
        r"1\.0e\+00 m off the goal; .*free flight for 8\.95e-03, .*, expected simulations .* Allow"
    )
    with pytest.raises(PlanningError, match=message) as caught:
        plan(table1(1, **COARSE))
    assert caught.value.plan is not None and not caught.value.plan.holds
    assert caught.value.plan.cost == cost


@pytest.mark.slow
def test_a_hard_goal_that_all_candidates_miss_is_told_with_the_nearest() -> None:
    # A force of 12 N does not push 1 kg 30 m far in 2 s.
    block = Scenario.named("sliding_block/to_rest")
    far = dataclasses.replace(block, goal_position=[30.0, 0.15], time_step=0.2)
    options = PlanOptions(starts=2, renewals=0, confirm=False)
    message = r"all miss 'hard goal', by 0\.\d+ of the task's scales .*\(hard_goal: false\)"
    with pytest.raises(PlanningError, match=message):
        Planner(far, options).plan()


def test_what_speaks_against_a_candidate_is_told_of_each() -> None:
    best = bounce_plan().best
    assert best.describe_verdict() == "contact at 0.550 s for 2.18e-04, replayed 2.18e-04"
    broken = dataclasses.replace(best.replay, violations={"bounds": 1.0})
    dear = dataclasses.replace(best.replay, cost=2.0)
    defects = {**best.defects, "flight": 0.5}
    many = dataclasses.replace(best, contacts=best.contacts * 8, defects=defects)
    assert "0.550 s and 2 more for" in many.describe_verdict()
    assert many.describe_verdict().endswith("largest defect 5.0e-01")
    left = dataclasses.replace(best, replay=broken).describe_verdict()
    assert left.endswith("; there it breaks 'bounds'")
    frail = dataclasses.replace(best, perturbed=(best.replay, dear)).describe_verdict()
    assert frail.endswith(", 2.00e+00 from a start 1e-3 of the scales off")


def test_where_no_polish_succeeds_there_is_still_doing_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(BallTask, "_has_arcs", False)
    monkeypatch.setattr(BallTask, "solve_nlp", lambda self, nlp, guess, *_: guess)
    found = plan(table1(1, **COARSE))
    assert found.best.is_idle
    assert not any(candidate.is_feasible for candidate in found.candidates[1:])
    assert "this is the plan: no other plan that holds costs less" in format_plan(found)


@pytest.mark.slow
def test_a_dead_stop_from_high_speed_is_no_reason_for_a_veto() -> None:
    scenario = table1(1, initial_velocity=-100.0, restitution=0.0)
    found = plan(scenario)
    assert found.holds and not found.vetoes
    assert found.cost == pytest.approx(rigid_optimum(shipped_world(), scenario).cost, rel=1e-3)


def one_coordinate(model: str, start: float, velocity: float, **fields: Any) -> Scenario:
    ends: dict[str, Any] = {"goal_position": 0.7, **fields}
    return Scenario(
        model=f"{MODELS}/{model}.sdf", initial_position=start, initial_velocity=velocity, **ends
    )


@pytest.mark.parametrize(
    "scenario",
    [
        one_coordinate("corridor", 0.5, 20.0),  # 20 bounces.
        *slow(
            one_coordinate("floor", 0.29, -0.07, duration=0.9, goal_position=0.3, restitution=0.3)
        ),
    ],
    ids=["corridor", "floor"],
)
def test_no_plan_is_worse_than_doing_nothing(scenario: Scenario) -> None:
    world = World.from_scenario(scenario)
    nothing = np.zeros((1, world.num_actuators))
    free = replay_event_driven(world, scenario, [0.0, scenario.duration], nothing)
    found = plan(scenario, UNCONFIRMED, world)
    assert found.holds
    assert found.cost <= free.cost * (1 + 1e-9)
    assert found.idle is not None
    assert found.idle.cost == pytest.approx(free.cost, rel=1e-9)


@pytest.mark.parametrize(
    ("world", "fields"),
    [
        (None, {"model": f"{MODELS}/floor.sdf", "initial_position": 0.3, "restitution": 0.5}),
        (None, {"model": f"{MODELS}/floor.sdf", "initial_position": 0.01, "restitution": 0.8}),
        (None, {"model": f"{MODELS}/corridor.sdf", "initial_velocity": 30.0}),
        (World.from_diagram(make_diagram(gravity=9.81, spring=3.0)), {"initial_velocity": -1.0}),
        (make_wedge(1.5), {"initial_position": [0.5, 0.5], "initial_velocity": [-2.0, -2.0]}),
    ],
    ids=["comes to rest", "chatters", "bounces often", "on a spring", "into a corner"],
)
def test_doing_nothing_obeys_the_rows_of_a_plan(world: World | None, fields: Any) -> None:
    ends = {"initial_position": 0.5, "initial_velocity": 0.0, **fields}
    goal = np.full(np.size(ends["initial_position"]), 0.7)
    scenario = Scenario(**ends, goal_position=goal)
    problem = Planner(scenario, UNCONFIRMED, world).task
    assert isinstance(problem, ProgramTask)
    idle = problem.idle_candidate()
    assert idle.is_feasible and idle.is_confirmed and idle.is_idle
    assert not np.any(idle.trajectory.controls)
    assert np.any(idle.trajectory.impulses) == bool(idle.replay.bounce_times)


def test_ctrl_c_gives_the_best_so_far_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(self: BallTask, candidate: Any) -> Any:
        raise KeyboardInterrupt

    whole = bounce_plan()
    assert not whole.is_interrupted
    monkeypatch.setattr(BallTask, "confirm", interrupt)
    out = tmp_path / "plan.json"
    assert main(["plan", "table1/1", "--time-step", "0.02", "--json", str(out)]) == INTERRUPTED
    saved = Plan.load(out)
    assert saved.is_interrupted and saved.replay.drake is None
    assert saved.cost == whole.cost
    assert "interrupted Ctrl-C ended the search" in " ".join(capsys.readouterr().out.split())
    page = Page("")
    add_verdict(page, saved, shipped_world())
    assert "interrupted</th><td>Ctrl-C ended the search" in page.to_html()
    monkeypatch.undo()
    assert main(["replay", str(out)]) == 0
