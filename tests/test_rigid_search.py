"""The search for rigid plans: which boxes and flights it leaves out, threads, and Ctrl-C."""

from __future__ import annotations

import dataclasses
import logging
import os
import signal
import threading
import time
from functools import cache
from typing import Any

import pytest
from marks import slow
from replay_worlds import COARSE, UNCONFIRMED, bounce_plan, make_diagram, shipped_world, table1

from benchmarks.study import ScenarioQuestion
from drake_aigto import World
from drake_aigto.aigo import AigoResult, Iterate, Status
from drake_aigto.errors import OptionsError
from drake_aigto.planning import (
    BALL_LADDER,
    BallSearch,
    BallTask,
    Origin,
    Plan,
    Planner,
    PlanOptions,
    Rung,
    make_ball_task,
    plan,
)
from drake_aigto.transcription import RigidTranscription


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


@pytest.mark.parametrize("threads", [0, -1])
def test_no_thread_is_refused(threads: int) -> None:
    with pytest.raises(OptionsError, match=rf"threads: got {threads}, expected 1 or more, or None"):
        PlanOptions(threads=threads)


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
