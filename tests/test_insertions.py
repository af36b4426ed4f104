"""Bounces that a motion might have once more, and the plans that need them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from replay_worlds import make_task, shipped

from benchmarks.optima import masses_optimum
from benchmarks.worlds import WORLDS
from drake_aigto import PlanOptions, Scenario, World, plan
from drake_aigto.planning import (
    BallSearch,
    PhaseMotion,
    PhaseProblem,
    find_insertions,
    kinds,
    make_ball_task,
)
from drake_aigto.transcription import Touch, TouchSequence

QUICK = PlanOptions(confirm=False)


def insertions(model: str, q: Sequence[float], touches: Sequence[Touch]) -> list[tuple[float, int]]:
    """Returns time and contact of what is proposed for a guess, which is a motion for this."""
    scenario = dataclasses.replace(make_task(model, q, np.zeros(len(q))), time_step=0.02)
    phases = PhaseProblem(shipped(model), scenario, touches)
    found = find_insertions(PhaseMotion(phases, phases.guess()))
    return [(touch.start, touch.contact) for touch in found]


def test_a_free_flight_may_touch_every_wall_where_it_is_nearest() -> None:
    found = insertions("corridor", [0.8], ())  # down to 0.3
    assert [contact for _, contact in found] == [0, 1]
    (to_lower, _), (to_upper, _) = found
    assert 0.75 < to_lower < 0.8
    assert 0.2 < to_upper < 0.25


def test_no_wall_is_touched_twice_in_a_row_where_nothing_pulls() -> None:
    found = insertions("corridor", [0.8], [Touch.bounce(0.5, 0)])
    assert [(time > 0.5, contact) for time, contact in found] == [(False, 1), (True, 1)]


def test_gravity_pulls_back_to_the_floor() -> None:
    found = insertions("floor", [0.8], [Touch.bounce(0.5, 0)])
    assert [contact for _, contact in found] == [0] * 4  # At the nearest, and soon before the next.
    times = [time for time, _ in found]
    assert times[0] < 0.45 < times[1] < 0.5 < times[2] < 0.9 < times[3] < 1.0


def test_contacts_that_do_not_feel_each_other_share_no_gaps() -> None:
    names = [contact.name for contact in shipped("two_masses").contacts]
    (between,) = (i for i, name in enumerate(names) if "wall" not in name)
    walls = [i for i in range(3) if i != between]
    touches = list(map(Touch.bounce, (0.3, 0.6), walls))
    # A wall does not feel the other one, and is next to itself; the masses touch in three gaps.
    found = insertions("two_masses", [0.3, 0.7], touches)
    assert [contact for _, contact in found] == [between] * 3


def test_a_bounce_that_no_box_shows_is_inserted() -> None:
    (*_, scenario) = WORLDS["two_masses"].draw(9, seed=21)
    world = World.from_scenario(scenario)
    found = plan(scenario, QUICK, world)
    optimum = masses_optimum(world, scenario)
    assert [contact.index for contact in found.best.contacts] == [2]
    assert found.replay.event_driven.cost <= 1.01 * optimum.cost


def test_a_polish_passes_the_block_on_the_way_to_the_goal_where_the_box_center_misses_it() -> None:
    (*_, scenario) = WORLDS["room_with_block"].draw(5, seed=21)
    problem = make_ball_task(World.from_scenario(scenario), scenario, QUICK)
    rung = next(rung for rung in QUICK.ball_ladder if rung.start == "coast")
    result = problem.run_aigo(rung)
    sequence = problem.find_sequences(result, rung)[0]
    center = problem.transcription.split(result.box.center)[0]
    assert np.linalg.norm(center[-1] - scenario.goal_position) > 0.3
    found = problem.polish(result.box.center, sequence)
    # The best known (`optima.block_optimum`).
    assert found.cost == pytest.approx(3.9686e-4, rel=0.01)


def test_no_neighbor_is_tried_whose_contacts_a_plan_has_that_holds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = Scenario.named("corridor/three_bounces")
    problem = make_ball_task(World.from_scenario(scenario), scenario, QUICK)
    search = BallSearch(problem)
    search.close([search.propose_boxes(rung) for rung in QUICK.ball_ladder])
    held = [kinds(each) for each, it in search.by_sequence.items() if it.is_confirmed]
    tried: list[list[tuple[int, bool]]] = []

    def refuse(self: BallSearch, other: TouchSequence, path: object) -> None:
        tried.append(kinds(other))

    monkeypatch.setattr(BallSearch, "_try", refuse)
    for wave in search.vary():
        search.close(wave)
    assert tried
    assert not [each for each in tried if each in held]
