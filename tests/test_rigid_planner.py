"""Rigid plans: optimal, true in simulation, of whatever plant; what their search leaves out."""

from __future__ import annotations

import dataclasses
import html
import logging
import os
import signal
import threading
import time
from functools import cache
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
    make_scenario,
    make_wedge,
    shipped_world,
    table1,
)

from benchmarks.study import ScenarioQuestion
from drake_aigto import Scenario, World
from drake_aigto.aigo import AigoResult, Iterate, Status
from drake_aigto.cli import INTERRUPTED, main
from drake_aigto.paper import LITERAL_LADDER, LiteralOptions, plan_literal, rigid_optimum
from drake_aigto.planning import (
    BALL_LADDER,
    Arcs,
    BallSearch,
    BallTask,
    Origin,
    PhaseMotion,
    PhaseProblem,
    Plan,
    Planner,
    PlanningError,
    PlanOptions,
    ProgramTask,
    Rung,
    make_ball_task,
    plan,
)
from drake_aigto.show import Page, add_verdict, cost_text, format_plan
from drake_aigto.simulation import Replay, replay_event_driven
from drake_aigto.transcription import RigidTranscription, Touch


@pytest.mark.parametrize("steps", [1, *slow(3), 20])
@pytest.mark.parametrize("name", ["table1/1", *slow("corridor/six_bounces", "room/two_walls")])
def test_which_contacts_a_plan_has_does_not_depend_on_the_time_step(name: str, steps: int) -> None:
    fine, world = fine_plan(name), World.from_scenario(Scenario.named(name))
    scenario = Scenario.named(name)
    coarse = dataclasses.replace(scenario, time_step=scenario.duration / steps)
    found = plan(coarse, UNCONFIRMED, world)
    assert [c.index for c in found.best.contacts] == [c.index for c in fine.best.contacts]
    assert len(found.trajectory.controls) == max(steps, 1 + len(fine.best.contacts))
    # A force that falls steadily to 0 costs a third more if it is held throughout.
    assert fine.cost * (1 - 1e-6) <= found.cost <= 4 / 3 * fine.cost
    told = f"instead of {steps}, which are too few for its phases"
    assert (told in format_plan(found)) == (steps <= len(fine.best.contacts))


def test_a_plan_that_arcs_do_not_lead_to_has_so_many_steps_at_most_and_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("drake_aigto.planning.balls.task.solve_in_arcs", lambda *_: None)
    monkeypatch.setattr("drake_aigto.planning.balls.task._MOST_GENERAL", 80)
    found = plan(table1(1, time_step=1e-3), UNCONFIRMED, shipped_world())
    assert len(found.trajectory.controls) == 80
    assert found.cost == pytest.approx(2.1805e-4, rel=1e-3)
    assert "80 instead of 1000, with which it was not polished" in format_plan(found)


@cache
def fine_plan(name: str) -> Plan:
    return plan(Scenario.named(name), UNCONFIRMED)


@pytest.mark.parametrize(("row", "e"), [(1, 1.0), (2, 0.8), (3, 0.5), (4, 0.5)])
def test_a_plan_is_the_optimum_and_holds(row: int, e: float) -> None:
    scenario = table1(row, restitution=e, time_step=0.01)
    found = Planner(scenario, world=shipped_world()).plan()
    exact = rigid_optimum(shipped_world(), scenario)
    rigid, drake = found.replay.event_driven, found.replay.drake
    assert found.holds and drake is not None
    # Held controls cost 1/(4 K²) more than free ones, with K ≥ 38 steps a phase here.
    assert found.cost == pytest.approx(exact.cost, rel=2e-4, abs=1e-9)
    assert rigid.cost == pytest.approx(found.cost, rel=1e-6, abs=1e-12)
    assert drake.cost == pytest.approx(exact.cost, rel=0.02, abs=1e-5)
    (contact,) = found.best.contacts
    assert contact.time == pytest.approx(exact.bounce_times[0], abs=2e-3)
    assert contact.energy_ratio == pytest.approx(e**2)
    assert rigid.bounce_times == pytest.approx([contact.time], abs=1e-9)
    assert max(found.defects.values()) < 1e-9
    assert found.best.max_penetration < 1e-12
    assert len(found.trajectory.times) == scenario.num_steps + 1


@pytest.mark.slow
def test_random_plans_are_optimal() -> None:
    generator, world = np.random.default_rng(12), shipped_world()
    for e in (1.0, 0.8, 0.5, 0.9, 0.3, 0.0):
        p0, goal = generator.uniform(0.2, 1.5, 2)
        scenario = make_scenario(p0, generator.uniform(-3, 0.5), goal, restitution=e, **COARSE)
        cost = plan(scenario, UNCONFIRMED, world).replay.event_driven.cost
        exact = rigid_optimum(world, scenario).cost
        assert exact * (1 - 1e-9) <= cost <= 1.01 * exact + 1e-7, scenario


def test_a_bounce_that_knots_step_over_is_found_in_the_replay() -> None:
    # At the wall after 2 ms; AIGO's steps are 20 ms, the scenario's too.
    scenario = Scenario(
        initial_position=0.006, initial_velocity=-3.0, goal_position=1.0, restitution=0.5, **COARSE
    )
    found = plan(scenario, UNCONFIRMED, shipped_world())
    exact = rigid_optimum(shipped_world(), scenario)
    assert exact.bounce_times[0] < 0.005
    assert found.cost == pytest.approx(exact.cost, rel=1e-2)


def test_touches_at_the_very_start_or_end_are_left_out() -> None:
    problem = make_ball_task(shipped_world(), table1(1, time_step=0.25), UNCONFIRMED)
    assert problem.fits(()) and problem.fits((Touch.bounce(0.2), Touch(0.6, 0.8)))
    for t in (0.0, 1e-9, 1.0 - 1e-9, 1.0):
        assert not problem.fits((Touch.bounce(t),))


def test_boxes_get_steps_enough_to_tell_a_bounce_from_the_start() -> None:
    world = shipped_world()
    fast = table1(1, initial_position=0.06, initial_velocity=-3.0)
    for scenario, steps in ((table1(1), 50), (fast, 150), (table1(1, time_step=0.05), 50)):
        problem = make_ball_task(world, scenario, PlanOptions())
        assert problem.transcription.num_samples() == steps + 1
    assert make_ball_task(world, table1(1), PlanOptions(aigo_steps=7)).box.center.size == 3 * 8 - 1


@pytest.mark.parametrize("e", [*slow(1.0), 0.5])
@pytest.mark.parametrize(
    ("plant", "joints"),
    [
        *slow(({"gravity": 9.81}, 1)),
        *slow(({"spring": 5.0, "reference": -0.5}, 1)),
        ({"num_joints": 2}, 2),
        *slow(({"num_joints": 2, "spring": 5.0, "reference": 0.3}, 2)),
    ],
    ids=["gravity", "spring", "two joints", "two joints and a spring"],
)
def test_a_bounce_is_planned_on_any_plant_and_holds(plant: Any, joints: int, e: float) -> None:
    world = World.from_diagram(make_diagram(**plant))
    start, speed, goal = (([0.6], [-1.5], [0.5]), ([0.3, 0.5], [0, -1.5], [0.6, 0.3]))[joints - 1]
    scenario = make_scenario(start, speed, goal, restitution=e, time_step=0.01)
    found = plan(scenario, PlanOptions(exhaustive=True), world)
    assert found.holds and max(found.defects.values()) < 1e-9
    assert len(found.best.contacts) == len(found.replay.event_driven.bounce_times) == 1
    flight = next(c for c in found.candidates if not c.contacts)
    assert found.cost < 0.7 * flight.cost
    # Exact for a constant bias; the midpoint rule's error for a spring.
    tolerance = 2e-3 if "spring" in plant else 1e-8
    assert found.replay.event_driven.cost == pytest.approx(found.cost, rel=tolerance)


def test_a_plan_rests_until_it_is_time_to_jump() -> None:
    # Without rebound, on a floor: staying there costs nothing, and hovering does.
    world = World.from_diagram(make_diagram(gravity=9.81))
    scenario = make_scenario(0.3, 0.0, 0.5, duration=2.0, time_step=0.02, restitution=0.0)
    found = plan(scenario, world=world)
    (contact,) = found.best.contacts
    assert found.holds
    assert contact.time < 0.3 and contact.last_time > 1.0
    held = found.trajectory.forces[found.trajectory.forces > 0]
    np.testing.assert_allclose(held[:5], 9.81 * 1.5, rtol=1e-4)
    flights = [c.cost for c in found.candidates if all(k.time == k.last_time for k in c.contacts)]
    assert found.cost < 0.7 * min(flights)


def test_the_polish_is_a_program_for_any_solver() -> None:
    scenario = table1(1, **COARSE)
    costs = [
        plan(scenario, PlanOptions(local_solver=solver, confirm=False), shipped_world()).cost
        for solver in ("ipopt", "snopt")
    ]
    assert costs == pytest.approx([bounce_plan().cost] * 2, rel=1e-5)


def test_a_plan_with_a_contact_that_lasts_reads_back(tmp_path: Path) -> None:
    scenario = table1(1, restitution=0.0, **COARSE)
    phases = PhaseProblem(shipped_world(), scenario, [Touch(0.4, 0.6)])
    arcs = Arcs(phases)
    problem = make_ball_task(shipped_world(), scenario, UNCONFIRMED)
    x = problem.solve_nlp(arcs.nlp, arcs.vector(phases.guess([[0.0], [0.0]])))
    motion = PhaseMotion(phases, arcs.trajectory(x))
    candidate = problem.judge(Origin("by hand"), problem.box.center, motion)
    found = dataclasses.replace(bounce_plan(), candidates=(candidate,))
    found.save(tmp_path / "plan.json")
    assert Plan.load(tmp_path / "plan.json") == found


@cache
def all_candidates() -> Plan:
    return plan(table1(1, **COARSE), dataclasses.replace(UNCONFIRMED, exhaustive=True))


def test_every_candidate_was_read_off_a_box() -> None:
    problem = make_ball_task(shipped_world(), table1(1, **COARSE), UNCONFIRMED)
    read = {
        tuple(touch.lasts for touch in sequence)
        for rung in BALL_LADDER
        for sequence in problem.find_sequences(problem.run_aigo(rung), rung)
    }
    origins = [Origin("annealing", rung) for rung in BALL_LADDER]
    for candidate in (each for each in all_candidates().candidates if not each.is_idle):
        assert candidate.origin in origins
        assert tuple(False for _ in candidate.contacts) in read
    assert {len(c.contacts) for c in all_candidates().candidates} >= {0, 1}


@pytest.mark.parametrize("number", [0, *slow(1, 2)])
def test_boxes_that_are_left_out_would_find_nothing_better(number: int) -> None:
    scenario = ScenarioQuestion(seed=11, num_steps=50).scenario(number)
    before = dataclasses.replace(scenario, initial_velocity=0.0)
    few, all_of_them = (
        Planner(before, dataclasses.replace(UNCONFIRMED, exhaustive=exhaustive)).plan(
            initial_velocity=scenario.initial_velocity
        )
        for exhaustive in (False, True)
    )
    assert few.replay.event_driven.cost == pytest.approx(
        all_of_them.replay.event_driven.cost, rel=1e-4
    )
    assert few.stats.aigo_steps == 0 and None not in all_of_them.stats.box_contacts


def test_boxes_are_run_for_a_first_plan_and_where_nothing_else_leads_to_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    planner = Planner(table1(1, **COARSE), UNCONFIRMED)
    again = planner.plan(initial_velocity=-2.1)
    assert again.best.origin.rung is None and again.stats.aigo_steps == 0
    assert planner.plan().best.origin.rung in BALL_LADDER
    monkeypatch.setattr(BallSearch, "_propose_uncontrolled", lambda self: iter(()))
    found = planner.plan(initial_velocity=-2.1)
    assert found.best.origin.rung in BALL_LADDER and len(found.best.contacts) == 1
    assert None not in found.stats.box_contacts
    assert found.cost == pytest.approx(again.cost, rel=1e-4)


@pytest.mark.parametrize("gravity", [0.0, 9.81])
@pytest.mark.parametrize("goal", [0.7, 1.4])
def test_no_flight_costs_less_than_its_bound(gravity: float, goal: float) -> None:
    world = World.from_diagram(make_diagram(gravity=gravity))
    scenario = table1(1, initial_velocity=0.3, goal_position=goal, time_step=0.01)
    problem = make_ball_task(world, scenario, UNCONFIRMED)
    found = problem.polish(problem.box.center, ())
    # Held over N = 100 steps, a control costs 1/(4 N²) more than a free one, of its linear part.
    assert 0 < problem.least_flight_cost < found.cost
    assert problem.least_flight_cost == pytest.approx(found.cost, rel=1e-4)


def test_a_flight_has_no_bound_where_something_was_added() -> None:
    scenario = table1(1, **COARSE)
    transcription = RigidTranscription(shipped_world(), scenario)
    transcription.AddRunningCost(transcription.input()[0] ** 2, "more effort")
    assert BallTask(transcription, UNCONFIRMED).least_flight_cost == 0.0


def test_a_flight_that_cannot_win_is_left_out_and_told() -> None:
    few, all_of_them = bounce_plan(), all_candidates()
    flight = next(c for c in all_of_them.candidates if not c.contacts)
    assert few.cost == pytest.approx(all_of_them.cost, rel=1e-4)
    assert few.stats.flight_left_out == pytest.approx(flight.cost, rel=1e-2)
    assert all(candidate.contacts for candidate in few.candidates)
    assert all_of_them.stats.flight_left_out is None


def test_under_gravity_boxes_come_first() -> None:
    world = World.from_diagram(make_diagram(gravity=9.81))
    problem = make_ball_task(world, table1(1, **COARSE), UNCONFIRMED)
    first = next(BallSearch(problem).propose())
    assert [each.origin.rung for each in first] == [*BALL_LADDER]


def test_candidates_are_ranked_by_their_replay() -> None:
    found = all_candidates()
    costs = [c.replay.cost for c in found.candidates if c.is_feasible and c.is_confirmed]
    assert costs == sorted(costs) and len(costs) >= 2
    assert found.best is found.candidates[0]


@pytest.mark.parametrize("gravity", [0.0, *slow(9.81)])
def test_threads_change_no_bit(gravity: float) -> None:
    world = World.from_diagram(make_diagram(gravity=gravity))
    one, three = (
        plan(
            table1(2, **COARSE),
            dataclasses.replace(UNCONFIRMED, threads=threads, exhaustive=gravity == 0),
            world,
        )
        for threads in (1, 3)
    )
    assert one.candidates == three.candidates
    assert one.stats.box_contacts == three.stats.box_contacts
    assert one.stats.aigo_steps == three.stats.aigo_steps


@pytest.mark.slow
def test_boxes_of_many_variables_get_threads() -> None:
    scenario = table1(1, time_step=1e-3)
    several: list[dict[str, Any]] = [{}, {"aigo_steps": 500}, {"aigo_steps": 500, "threads": 3}]
    problems = [
        make_ball_task(shipped_world(), scenario, dataclasses.replace(UNCONFIRMED, **changes))
        for changes in several
    ]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    assert [problem.num_threads for problem in problems] == [1, cores, 3]


def test_ctrl_c_ends_all_threads_and_keeps_what_they_have(monkeypatch: pytest.MonkeyPatch) -> None:
    run_aigo, statuses, interrupts = BallTask.run_aigo, list[Status](), iter([True])
    both_run = threading.Barrier(2)

    main_thread = threading.main_thread().ident
    assert main_thread is not None

    def run_until_stopped(problem: Any, rung: Rung, algorithm: Any, callback: Any) -> AigoResult:
        def wait_for_others(iterate: Iterate) -> None:
            if iterate.inner_steps:  # The first box was shrunk once.
                both_run.wait()
                if next(interrupts, False):
                    signal.pthread_kill(main_thread, signal.SIGINT)
                while True:
                    callback(iterate)
                    time.sleep(1e-3)

        result = run_aigo(problem, rung, algorithm, wait_for_others)
        statuses.append(result.status)
        return result

    monkeypatch.setattr(BallTask, "run_aigo", run_until_stopped)
    options = dataclasses.replace(UNCONFIRMED, threads=2, exhaustive=True)
    found = Planner(table1(1, **COARSE), options).plan()
    assert statuses and set(statuses) == {Status.INTERRUPTED}
    assert found.candidates


def test_what_can_not_win_any_more_gets_no_fine_polish(caplog: pytest.LogCaptureFixture) -> None:
    # With 20,000 steps that would take most of the time.
    caplog.set_level(logging.INFO, "drake_aigto")
    lines: list[str] = []
    scenario = table1(1, duration=20.0)
    found = Planner(scenario, UNCONFIRMED).plan(progress=lines.append)
    flight = next(each for each in found.candidates if not each.contacts)
    assert flight.cost > 3 * found.cost
    assert len(found.trajectory.controls) == scenario.num_steps
    assert len(flight.trajectory.controls) < scenario.num_steps
    assert lines[-1] == f"replaying the best of {len(found.candidates)} candidates, 4000 time steps"


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
    """Returns replays by Drake of a plan, of which the first, to a number, miss by a meter."""
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
