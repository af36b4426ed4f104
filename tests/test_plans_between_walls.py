"""Whole plans in worlds of several contacts, against their optima; the steps that lead there."""

from __future__ import annotations

import dataclasses
from functools import cache
from itertools import islice, pairwise

import numpy as np
import pytest

from benchmarks.optima import walls_optimum
from benchmarks.worlds import WORLDS, load_unequal
from drake_aigto import PlanOptions, Scenario, World, plan, scenario_names
from drake_aigto.planning import BallSearch, Origin, PhaseProblem, find_grazes, make_ball_task
from drake_aigto.transcription import Touch

QUICK = PlanOptions(confirm=False)
NEW = [name for name in scenario_names() if name.partition("/")[0] in WORLDS]


@cache
def world_of(model: str) -> World:
    (scenario,) = WORLDS[model].draw(1, seed=0)
    return World.from_scenario(scenario)


@pytest.mark.parametrize("name", NEW)
def test_shipped_scenarios_have_plans_that_drake_confirms(name: str) -> None:
    scenario = Scenario.named(name)
    found = plan(scenario)
    assert found.holds
    replay = found.replay.event_driven
    assert replay.max_penetration < 1e-9
    assert replay.energy_ratio is None or replay.energy_ratio < 1 + 1e-9
    planned = [contact.index for contact in found.best.contacts]
    assert len(planned) == len(replay.bounce_contacts)
    assert sorted(planned) == sorted(replay.bounce_contacts)
    # The search does not follow chatter, touch after touch.
    for candidate in found.candidates:
        touches = [(c.index, c.time) for c in candidate.contacts]
        for contact, time in touches:
            at_once = [t for i, t in touches if i == contact and 0 <= t - time < 0.02]
            assert len(at_once) <= 3


@pytest.mark.parametrize("model", ["corridor", "floor", "room"])
def test_plans_are_optimal(model: str) -> None:
    world = world_of(model)
    for scenario in WORLDS[model].draw(3, seed=40):
        found = plan(scenario, QUICK, world)
        optimum = walls_optimum(world, scenario)
        assert found.replay.event_driven.cost <= 1.01 * optimum.cost + 1e-7
        assert found.cost >= (1 - 1e-6) * optimum.cost - 1e-9


def test_contacts_of_unequal_masses_that_nothing_but_the_motion_without_control_has_are_found() -> (
    None
):
    scenario = Scenario(
        model="package://drake_aigto_models/two_masses.sdf",
        initial_position=[0.19434618, 0.55799003],
        initial_velocity=[0.18030109, -0.89792862],
        goal_position=[0.62395172, 0.74167857],
        duration=1.5,
        time_step=0.03,
    )
    world = load_unequal(scenario, 5.0)
    found = plan(scenario, QUICK, world)
    # By `masses_optimum` with up to four meetings; doing nothing costs 154 times as much.
    assert found.replay.event_driven.cost == pytest.approx(5.6154e-06, rel=1e-2)


def test_a_block_that_the_motion_without_control_bounces_off_may_be_passed() -> None:
    scenario = next(islice(WORLDS["room_with_block"].draw(16, seed=0), 15, None))
    coarse = dataclasses.replace(scenario, time_step=0.03)
    found = plan(coarse, QUICK, world_of("room_with_block"))
    # By `block_optimum`: one wall, instead of that wall and a face of the block.
    assert found.replay.event_driven.cost == pytest.approx(9.06e-5, rel=0.02)


def test_masses_are_mirrors_to_each_other_if_they_are_equal() -> None:
    scenario = Scenario.named("two_masses/apart")
    unfold = [
        make_ball_task(load_unequal(scenario, ratio), scenario).unfolds for ratio in (1.0, 3.0)
    ]
    assert unfold == [True, False]


def test_plans_between_mirrored_walls_are_mirrored() -> None:
    world = world_of("corridor")
    (scenario,) = WORLDS["corridor"].draw(1, seed=41)
    mirrored = dataclasses.replace(
        scenario,
        initial_position=1 - scenario.initial_position,
        initial_velocity=-scenario.initial_velocity,
        goal_position=1 - scenario.goal_position,
    )
    one, other = (plan(each, QUICK, world) for each in (scenario, mirrored))
    assert one.cost == pytest.approx(other.cost, rel=1e-5, abs=1e-9)
    assert [c.index for c in one.best.contacts] == [1 - c.index for c in other.best.contacts]


def search_of(name: str, **changes: float) -> BallSearch:
    scenario = dataclasses.replace(Scenario.named(name), **changes)  # type: ignore[arg-type]
    problem = make_ball_task(World.from_scenario(scenario), scenario, QUICK)
    return BallSearch(problem)


def test_touches_that_no_motion_has_are_refused_once_and_stop_nothing() -> None:
    search = search_of("corridor/three_bounces")
    center = search.task.box.center
    at_once = (Touch.bounce(0.5, 0), Touch.bounce(0.5, 1))
    search.add(Origin("by hand"), center, at_once)
    assert not search.by_sequence
    assert search.is_known(at_once)
    search.add(Origin("by hand"), center, (Touch.bounce(0.5, 1),))
    assert search.by_sequence


def test_a_touch_too_many_is_dropped() -> None:
    scenario = Scenario.named("corridor/three_bounces")
    optimum = walls_optimum(World.from_scenario(scenario), scenario)
    search = search_of("corridor/three_bounces")
    times = np.linspace(0, scenario.duration, len(optimum.contacts) + 3)[1:-1]
    more = (*optimum.contacts, 1 - optimum.contacts[-1])
    search.add(Origin("by hand"), search.task.box.center, tuple(map(Touch.bounce, times, more)))
    for wave in search.vary():
        search.close(wave)
    best = search.ranked()[0]
    assert [contact.index for contact in best.contacts] == list(optimum.contacts)
    assert best.replay.cost <= 1.01 * optimum.cost + 1e-7
    assert {change.kind for change in best.origin.changes} == {"dropped"}
    assert len(best.origin.changes[0].of) == len(more)
    assert str(best.origin) == "by hand; a touch dropped"


def test_bounces_in_the_wrong_order_change_places() -> None:
    scenario = Scenario.named("room/two_walls")
    optimum = walls_optimum(World.from_scenario(scenario), scenario)
    touches = [Touch.bounce(touch.start, touch.contact) for touch in optimum.touches]
    J = World.from_scenario(scenario).calc_contact_jacobian(np.full(2, 0.5))
    place = next(
        k
        for k, (one, other) in enumerate(pairwise(touches))
        if J[one.contact] @ J[other.contact] == 0
    )
    first, second = touches[place : place + 2]
    touches[place : place + 2] = [
        Touch.bounce(first.start, second.contact),
        Touch.bounce(second.start, first.contact),
    ]
    search = search_of("room/two_walls")
    search.add(Origin("by hand"), search.task.box.center, tuple(touches))
    best = search.ranked()[0]
    assert [contact.index for contact in best.contacts] == list(optimum.contacts)
    assert best.replay.cost <= 1.01 * optimum.cost + 1e-7


def test_a_guess_falls_from_stop_to_stop_as_gravity_has_it() -> None:
    scenario = Scenario.named("floor/rebound")
    world = World.from_scenario(scenario)
    phases = PhaseProblem(world, scenario, [Touch.bounce(0.4 * scenario.duration)])
    guess = phases.guess()
    t, q, v = guess.times, guess.positions[:, 0], guess.velocities[:, 0]
    g = -float(world.calc_acceleration(np.zeros(1), np.zeros(1), np.zeros(1))[0])
    knot = int(np.argmin(np.abs(t - 0.4 * scenario.duration)))
    assert q[0] == scenario.initial_position[0]
    assert q[knot] == pytest.approx(0.0, abs=1e-12)
    assert q[-1] == pytest.approx(scenario.goal_position[0])
    for part in (slice(0, knot + 1), slice(knot, None)):
        s = t[part] - t[part][0]
        launch = (q[part][-1] - q[part][0]) / s[-1] + g * s[-1] / 2
        np.testing.assert_allclose(q[part], q[part][0] + launch * s - g * s**2 / 2, atol=1e-12)
        np.testing.assert_allclose(v[part][1:], launch - g * s[1:], atol=1e-12)


def test_a_motion_that_keeps_off_a_wall_by_control_grazes_it() -> None:
    scenario = dataclasses.replace(
        Scenario.named("corridor/three_bounces"),
        initial_position=0.3,
        initial_velocity=-2.0,
        goal_position=0.4,
        time_step=0.025,
    )
    world = World.from_scenario(scenario)
    problem = make_ball_task(world, scenario, QUICK)
    flight = problem.polish(problem.box.center, ())
    (graze,) = find_grazes(flight)
    assert graze.contact == 0
    nearest = np.argmin(flight.distances[:, 0])
    assert graze.start == pytest.approx(flight.trajectory.times[nearest], abs=0.1)
    # Where it bounces, it does not keep off.
    bounce = problem.polish(problem.box.center, (graze,))
    assert [other.contact for other in find_grazes(bounce)] in ([], [1])
