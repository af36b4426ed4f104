"""Rigid plans: optimal, true in simulation, of whatever plant; what their search leaves out."""

from __future__ import annotations

import dataclasses
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
    shipped_world,
    table1,
)

from benchmarks.study import ScenarioQuestion
from drake_aigto import Scenario, World
from drake_aigto.aigo import AigoResult, Iterate, Status
from drake_aigto.paper import rigid_optimum
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
    PlanOptions,
    Rung,
    make_ball_task,
    plan,
)
from drake_aigto.show import format_plan
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
