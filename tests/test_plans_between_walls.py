"""Whole plans in worlds of several contacts, against their optima; the steps that lead there."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache
from itertools import islice, pairwise
from typing import Any

import numpy as np
import pytest
from marks import slow
from pydrake.solvers import MathematicalProgram
from replay_worlds import make_diagram, shipped_world

from benchmarks.optima import walls_optimum
from benchmarks.study import ScenarioQuestion
from benchmarks.worlds import WORLDS, load_unequal
from drake_aigto import PlanOptions, Scenario, World, plan, scenario_names
from drake_aigto.errors import OptionsError, ScenarioError
from drake_aigto.planning import (
    BallSearch,
    Origin,
    PhaseProblem,
    Plan,
    Planner,
    find_grazes,
    make_ball_task,
)
from drake_aigto.simulation import replay_event_driven
from drake_aigto.terms import TermBlock, parse_costs
from drake_aigto.transcription import OpenProgram, RigidTranscription, Touch

QUICK = PlanOptions(confirm=False)
NEW = [name for name in scenario_names() if name.partition("/")[0] in WORLDS]
FIRST = ("corridor/lossy", "two_masses/apart")


@cache
def world_of(model: str) -> World:
    (scenario,) = WORLDS[model].draw(1, seed=0)
    return World.from_scenario(scenario)


@pytest.mark.parametrize("name", [*FIRST, *slow(*(name for name in NEW if name not in FIRST))])
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


@pytest.mark.parametrize("model", ["corridor", *slow("floor", "room")])
def test_plans_are_optimal(model: str) -> None:
    world = world_of(model)
    for scenario in WORLDS[model].draw(2, seed=40):
        found = plan(scenario, QUICK, world)
        optimum = walls_optimum(world, scenario)
        assert found.replay.event_driven.cost <= 1.01 * optimum.cost + 1e-7
        assert found.cost >= (1 - 1e-6) * optimum.cost - 1e-9


def test_a_fast_ball_bounces_as_often_as_by_itself() -> None:
    times, shipped = 3, Scenario.named("corridor/six_bounces")
    T = shipped.duration * times
    scenario = dataclasses.replace(shipped, duration=T, time_step=shipped.time_step * times)
    world = World.from_scenario(scenario)
    found = plan(scenario, QUICK, world)
    # Elastic walls reflect what control adds: of a free flight, d short of the goal in the end,
    # least w d² + 3 R m² (d₀ − d)²/T³.
    idle = replay_event_driven(world, scenario, [0.0, T], [[0.0]])
    d, m = idle.goal_error, world.calc_mass_matrix(scenario.initial_position)[0, 0]
    w, R = scenario.goal_weight, scenario.control_weight
    assert len(found.best.contacts) == 6 * times
    assert found.cost == pytest.approx(d**2 / (1 / w + T**3 / (3 * R * m**2)), rel=1e-4)


@pytest.mark.slow
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


@pytest.mark.slow
def test_masses_that_meet_in_front_of_a_wall_may_hit_it_first() -> None:
    scenario = Scenario(
        model="package://drake_aigto_models/two_masses.sdf",
        initial_position=[0.13597, 0.788208],
        initial_velocity=[1.224014, 0.220224],
        goal_position=[0.262026, 0.80505],
        duration=1.5,
        time_step=0.03,
    )
    found = plan(scenario, QUICK, load_unequal(scenario, 3.0))
    # Wall, mass, wall; mass, wall, mass cost 12 % more, all three at one moment.
    assert [each.index for each in found.best.contacts] == [2, 1, 2]
    assert found.cost == pytest.approx(2.639e-4, rel=1e-3)


@pytest.mark.slow
def test_a_block_that_the_motion_without_control_bounces_off_may_be_passed() -> None:
    scenario = next(islice(WORLDS["room_with_block"].draw(16, seed=0), 15, None))
    coarse = dataclasses.replace(scenario, time_step=0.03)
    found = plan(coarse, QUICK, world_of("room_with_block"))
    # By `block_optimum`: one wall, instead of that wall and a face of the block.
    assert found.replay.event_driven.cost == pytest.approx(9.06e-5, rel=0.02)


@pytest.mark.slow
def test_a_block_is_passed_where_the_straight_way_goes_through_its_middle() -> None:
    shipped = Scenario.named("room_with_block/around")
    scenario = dataclasses.replace(shipped, mass=7.5, restitution=0.4)
    assert (
        scenario.initial_position[1] == scenario.goal_position[1] == 0.5
    )  # As the block's middle.
    found = plan(scenario, QUICK)
    assert not found.best.contacts and not found.best.is_idle
    assert found.cost < 0.0374  # By cross-entropy; 0.107 where no flight had a side to pass on.


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


UNCONFIRMED = PlanOptions(confirm=False)
# Planning again runs the boxes that a new planner's first plan runs, too.
EXHAUSTIVE = PlanOptions(confirm=False, exhaustive=True)
CHANGING = (
    *("initial_position", "initial_velocity", "goal_position"),
    *("control_weight", "goal_weight", "duration"),
)


def changes(scenario: Scenario) -> dict[str, Any]:
    """Returns what `Planner.plan` is to be given to plan for a scenario."""
    return {name: getattr(scenario, name) for name in CHANGING}


def assert_same(one: Plan, other: Plan) -> None:
    assert one.scenario == other.scenario
    assert len(one.candidates) == len(other.candidates)
    for mine, yours in zip(one.candidates, other.candidates, strict=True):
        assert mine.trajectory == yours.trajectory
        assert mine.origin == yours.origin
        assert (mine.cost, mine.defects) == (yours.cost, yours.defects)


def draw(world: str, count: int, seed: int) -> list[Scenario]:
    if world == "point mass":
        found = list(ScenarioQuestion(count=count, seed=seed, num_steps=50).scenarios())
    else:
        found = list(WORLDS[world].draw(count, seed))
    return [dataclasses.replace(s, restitution=0.8, time_step=s.duration / 50) for s in found]


# Corridors and rooms have a floor's kind of walls; rooms with a block have a pair, as two masses.
@pytest.mark.parametrize("world", ["point mass", *slow("floor", "two_masses")])
def test_a_changed_scenario_is_planned_as_by_a_new_planner_to_the_last_bit(world: str) -> None:
    first, *others = draw(world, 2, seed=5)
    planner = Planner(first, EXHAUSTIVE)
    for scenario in others:
        assert_same(planner.plan(**changes(scenario)), Planner(scenario, EXHAUSTIVE).plan())
    *before, last = planner.plans()
    assert before and all(plan.holds and plan.cost >= last.cost for plan in before)
    assert_same(last, Planner(first, EXHAUSTIVE).plan())


@pytest.mark.slow
@pytest.mark.parametrize(
    "changed",
    [{"control_weight": 3e-3}, {"duration": 0.8, "goal_weight": 0.2, "goal_position": 0.6}],
)
def test_weights_and_duration_change_as_ends_do(changed: dict[str, Any]) -> None:
    # Of a spring, as its bias reads the time step.
    world = World.from_diagram(make_diagram(spring=3.0))
    scenario = Scenario(
        initial_position=0.5, initial_velocity=-1.0, goal_position=0.9, time_step=0.02
    )
    found = Planner(scenario, EXHAUSTIVE, world).plan(**changed)
    after = dataclasses.replace(scenario, **changed)
    assert_same(found, Planner(after, EXHAUSTIVE, world).plan())


def test_a_goal_that_costs_nothing_at_first_counts_once_it_is_given_a_weight() -> None:
    scenario = Scenario(
        initial_position=0.5, initial_velocity=-1.0, goal_position=0.9, goal_weight=0.0
    )
    found = Planner(scenario, EXHAUSTIVE, shipped_world()).plan(goal_weight=1.0)
    after = dataclasses.replace(scenario, goal_weight=1.0)
    assert_same(found, Planner(after, EXHAUSTIVE, shipped_world()).plan())


def running_cost(program: RigidTranscription) -> None:
    q, v = np.split(program.state(), 2)
    program.AddRunningCost(1e-3 * (q[0] ** 2 + v[0] ** 2))


def cost_at_a_knot(program: RigidTranscription) -> None:
    program.prog().AddQuadraticCost(1e-2 * (program.state(20)[0] - 0.4) ** 2)


def bounds_on_the_control(program: RigidTranscription) -> None:
    program.AddConstraintToAllKnotPoints(program.input()[0] <= 8.0)


def sum_at_two_knots(program: RigidTranscription) -> None:
    program.prog().AddConstraint(program.state(15)[0] + program.state(30)[0] >= 0.7)


@pytest.mark.parametrize(
    "add", [*slow(running_cost, cost_at_a_knot, bounds_on_the_control), sum_at_two_knots]
)
def test_what_users_added_counts_as_much_when_a_planner_plans_again(
    add: Callable[[OpenProgram], None],
) -> None:
    scenario = Scenario(
        initial_position=0.5, initial_velocity=-2.0, goal_position=0.8, time_step=0.02
    )
    after = dataclasses.replace(
        scenario, initial_position=0.6, initial_velocity=-2.2, goal_position=0.9
    )
    planner, new = (Planner(each, UNCONFIRMED, shipped_world()) for each in (scenario, after))
    for each in (planner, new):
        add(each.transcription)
    first, found = planner.plan(), planner.plan(**changes(after))
    assert_same(found, new.plan())
    assert found.additions == first.additions != ()
    assert found.cost != Planner(after, UNCONFIRMED, shipped_world()).plan().cost


def test_programs_are_compiled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    parsed: list[int] = []

    def count(prog: MathematicalProgram) -> tuple[TermBlock, ...]:
        parsed.append(prog.num_vars())
        return parse_costs(prog)

    monkeypatch.setattr("drake_aigto.planning.programs.parse_costs", count)
    first, *others = draw("point mass", 6, seed=3)
    planner = Planner(first, dataclasses.replace(EXHAUSTIVE, aigo_steps=10))
    for scenario in (first, *others, first):
        planner.plan(**changes(scenario))
    assert len(parsed) == len(set(parsed)), "once for each number of steps"
    # Three steps to the wall are finer than the first plan's.
    near: dict[str, Any] = {"initial_position": 0.1, "initial_velocity": -2.0}
    planner.plan(**near)
    planner.plan(**near, goal_position=0.7)
    assert len(parsed) == len(set(parsed)) >= 2


@pytest.mark.parametrize("world", ["corridor", "room"])
def test_boxes_know_what_walls_return_and_where_they_stand(world: str) -> None:
    scenario = draw(world, 1, seed=5)[0]
    here = World.from_scenario(scenario)
    problem = make_ball_task(here, scenario, UNCONFIRMED)
    there = here.with_walls_nearer(np.linspace(0.02, -0.01, here.num_contacts))
    after = dataclasses.replace(scenario, restitution=0.7)
    again, new = problem.in_world(there).again(after), make_ball_task(there, after, UNCONFIRMED)
    rng = np.random.default_rng(3)
    box = rng.normal(size=problem.box.center.size), rng.uniform(size=problem.box.center.size)
    assert again.polynomial.mean(*box) == pytest.approx(new.polynomial.mean(*box), rel=1e-12)
    assert problem.polynomial.mean(*box) != pytest.approx(new.polynomial.mean(*box), rel=1e-3)
    np.testing.assert_array_equal(again.box.half_width, new.box.half_width)


def test_what_does_not_fit_is_refused_by_name() -> None:
    planner = Planner(draw("point mass", 1, seed=3)[0], UNCONFIRMED)
    refused: list[tuple[dict[str, Any], str]] = [
        ({"duration": 1.005}, "duration"),
        ({"goal_weight": -1.0}, "goal_weight"),
        ({"goal_position": -0.3}, "goal_position is inside"),
    ]
    for changed, message in refused:
        with pytest.raises(ScenarioError, match=message):
            planner.plan(**changed)
    with pytest.raises(OptionsError, match="got model, expected one of initial_position"):
        next(planner.plans(model="other.sdf"))
