"""Optima of the shipped worlds: known ones, symmetries, replays of them, and what is refused."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from marks import slow
from optimum_worlds import SAMPLES, Leg, draw, ends, legs_of, restitutions, seeds, solve, world_of
from replay_worlds import make_diagram, make_scenario, shipped_world

from benchmarks.optima import ContactOptimum, block_optimum, masses_optimum, walls_optimum
from benchmarks.optima.line_optimum import Line, LineBounce, Wall
from benchmarks.worlds import WORLDS
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.paper import rigid_optimum
from drake_aigto.simulation import replay_event_driven
from drake_aigto.world import Scenario, World

Optimum = Callable[[World, Scenario], Any]


@given(
    st.floats(0.1, 2),
    st.floats(-4, 1),
    st.floats(0.1, 2),
    restitutions,
    st.sampled_from([1e-3, 1.0, 1e3]),
)
def test_one_wall_has_the_optimum_by_algebra(
    p: float, v: float, goal: float, e: float, weight: float
) -> None:
    scenario = dataclasses.replace(
        make_scenario(p, v, restitution=e, goal_weight=weight), goal_position=goal
    )
    known = rigid_optimum(shipped_world(), scenario)
    found = walls_optimum(shipped_world(), scenario)
    assert found.cost == pytest.approx(known.cost, rel=1e-6, abs=1e-14)
    if abs(known.cost - known.flight_cost) > 1e-6 * known.cost + 1e-12:
        times = [touch.start for touch in found.touches]
        assert times == pytest.approx(known.bounce_times, rel=1e-3)


@settings(max_examples=5)
@given(seeds, restitutions)
def test_a_room_costs_what_its_two_corridors_cost(seed: int, e: float) -> None:
    scenario = draw("room", seed, restitution=e)
    room = solve("room", scenario)
    corridors = [
        solve("corridor", draw("corridor", 0, restitution=e, **ends(scenario, axis)))
        for axis in range(2)
    ]
    assert room.cost == pytest.approx(sum(each.cost for each in corridors), rel=1e-9)
    for axis, corridor in enumerate(corridors):
        mine = [touch for touch in room.touches if touch.contact // 2 == axis]
        assert [touch.contact % 2 for touch in mine] == list(corridor.contacts)
        assert [touch.start for touch in mine] == [touch.start for touch in corridor.touches]


@pytest.mark.parametrize("seed", [0, *slow(1)])
def test_a_room_with_a_block_costs_no_more_than_the_empty_one_if_that_is_clear(seed: int) -> None:
    scenario = draw("room_with_block", seed)
    empty = dataclasses.replace(scenario, model=draw("room", 0).model)
    optimum, other = solve("room_with_block", scenario), solve("room", empty)
    if is_off_block(scenario, other):
        assert optimum.cost <= other.cost * (1 + 1e-9)
    else:
        assert optimum.cost != pytest.approx(other.cost, rel=1e-6)


def test_a_block_on_the_way_is_passed_at_its_corner_or_bounced_off() -> None:
    # Straight across the middle, at rest: the way around touches nothing, and passes corners.
    scenario = draw(
        "room_with_block",
        0,
        initial_position=[0.3, 0.35],
        initial_velocity=[0.0, 0.0],
        goal_position=[0.45, 0.7],
        restitution=1.0,
    )
    straight = 3e-3 * np.sum((scenario.goal_position - scenario.initial_position) ** 2) / 1.5**3
    around = solve("room_with_block", scenario)
    assert around.touches == ()
    # The line passes 0.4 at 0.58, inside the block: a detour, but a short one.
    assert straight < around.cost < 1.5 * straight


@pytest.mark.parametrize("name", WORLDS)
def test_random_scenarios_fit_their_world_and_are_the_same_again(name: str) -> None:
    study = WORLDS[name]
    scenarios = list(study.draw(20, seed=3))
    assert scenarios[:5] == list(study.draw(5, seed=3))
    assert scenarios[0] != next(study.draw(1, seed=4))
    assert {scenario.restitution for scenario in scenarios} == set(study.restitutions)
    for scenario in scenarios:
        world_of(name).check(scenario)


def axis_line(scenario: Scenario, axis: int) -> Line:
    """Returns the problem of one axis, in unit time; a wall for each contact, if of this axis."""
    name = scenario.model.rpartition("/")[2].removesuffix(".sdf")
    world, T, q = world_of(name), scenario.duration, scenario.initial_position
    distances, jacobian = world.calc_signed_distance(q), world.calc_contact_jacobian(q)
    walls = tuple(
        Wall(q[axis] - distances[i] / J[axis], int(J[axis]), scenario.restitution)
        if J[axis]
        else Wall(0.0, 0, 0.0)
        for i, J in enumerate(jacobian)
    )
    return Line(
        position=q[axis],
        velocity=scenario.initial_velocity[axis] * T,
        goal=scenario.goal_position[axis],
        weight=scenario.goal_weight * T**3 / scenario.control_weight,
        gravity=world.bias[axis].Evaluate() * T**2,
        walls=walls,
    )


def axis_legs(scenario: Scenario, optimum: ContactOptimum, axis: int) -> list[Leg]:
    line, T = axis_line(scenario, axis), scenario.duration
    bounces = [
        LineBounce(touch.start / T, touch.contact, touch.impact_speed * T)
        for touch in optimum.touches
        if line.walls[touch.contact].side
    ]
    return legs_of(line, bounces)


def passes_corner(scenario: Scenario, optimum: ContactOptimum) -> bool:
    """Returns whether the optimum is dearer than its touches alone make it."""
    cost = 0.0
    for axis in range(len(scenario.initial_position)):
        line, legs = axis_line(scenario, axis), axis_legs(scenario, optimum, axis)
        cost += sum(leg.effort(line.gravity) for leg in legs)
        cost += line.weight * (legs[-1].path()[-1] - line.goal) ** 2
    return optimum.cost > cost * scenario.control_weight / scenario.duration**3 * (1 + 1e-6) + 1e-12


def is_off_block(scenario: Scenario, optimum: ContactOptimum) -> bool:
    paths = []
    for axis in range(2):
        legs = axis_legs(scenario, optimum, axis)
        starts = np.cumsum([0.0, *(leg.time for leg in legs[:-1])])
        times = np.concatenate(
            [t + leg.time * SAMPLES for t, leg in zip(starts, legs, strict=True)]
        )
        path = np.concatenate([leg.path() for leg in legs])
        paths.append(np.interp(np.linspace(0, 1, 5001), times, path))
    return not np.any(np.max(np.abs(np.array(paths) - 0.5), axis=0) < 0.1 - 1e-6)


def optimal_controls(
    scenario: Scenario, optimum: ContactOptimum, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Returns knots, those of touches among them, and what forces are in the middle between."""
    T = scenario.duration
    knots = np.unique([*np.linspace(0, T, steps + 1), *(t.start for t in optimum.touches)])
    middles = (knots[1:] + knots[:-1]) / 2 / T
    columns = []
    for axis in range(len(scenario.initial_position)):
        legs = axis_legs(scenario, optimum, axis)
        gravity = axis_line(scenario, axis).gravity
        starts = np.cumsum([0.0, *(leg.time for leg in legs[:-1])])
        which = np.searchsorted(starts, middles, side="right") - 1
        u = [
            legs[i].a + legs[i].b * (t - starts[i]) + gravity
            for i, t in zip(which, middles, strict=True)
        ]
        columns.append(np.array(u) / T**2)
    return knots, np.column_stack(columns)


@pytest.mark.parametrize("name", ["corridor", "floor", "room", "room_with_block"])
@pytest.mark.parametrize(("seed", "e"), [(0, 1.0), *slow((1, 0.8), (2, 0.8))])
def test_the_replayed_optimum_touches_and_costs_as_it_says(name: str, seed: int, e: float) -> None:
    scenario = draw(name, seed, restitution=e)
    optimum = solve(name, scenario)
    if any(touch.lasts for touch in optimum.touches) or passes_corner(scenario, optimum):
        return
    knots, controls = optimal_controls(scenario, optimum, 1000)
    replay = replay_event_driven(world_of(name), scenario, knots, controls)
    assert replay.cost == pytest.approx(optimum.cost, rel=1e-3, abs=1e-9)
    assert replay.bounce_contacts == optimum.contacts
    assert replay.bounce_times == pytest.approx([t.start for t in optimum.touches], abs=1e-4)


@pytest.mark.parametrize("optimum", [rigid_optimum, walls_optimum])
def test_a_spring_is_refused(optimum: Optimum) -> None:
    world = World.from_diagram(make_diagram(spring=3.0, reference=0.5))
    with pytest.raises(ModelError, match=r"the bias h\(q, v\): got .*3 \*.*, expected a constant"):
        optimum(world, make_scenario())


def test_coupled_coordinates_are_refused() -> None:
    world = World.from_diagram(make_diagram(num_joints=2))
    with pytest.raises(ModelError, match=r"got M = \[\[.*, expected a diagonal matrix"):
        walls_optimum(world, make_scenario([0.0, 1.0], [0.0, -2.0]))


@pytest.mark.parametrize(
    ("optimum", "model", "message"),
    [
        (walls_optimum, "room_with_block", "a box with several faces, expected walls. For other"),
        (walls_optimum, "two_masses", r"right_ball, expected a wall across one axis. For other wo"),
        (masses_optimum, "corridor", "expected two masses on a line: a wall, a mass, a mass"),
        (masses_optimum, "room", r"got ∂φ/∂q = \[\(1.0, 0.0\), \(-1.0, 0.0\)"),
        (block_optimum, "room", "expected four walls and one box across two axes"),
    ],
)
def test_worlds_of_another_shape_are_refused(optimum: Optimum, model: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        optimum(world_of(model), draw(model, 0))


@pytest.mark.parametrize("optimum", [rigid_optimum, walls_optimum, masses_optimum, block_optimum])
def test_a_scenario_of_another_world_is_refused(optimum: Optimum) -> None:
    with pytest.raises(ScenarioError, match="mass: got 3 kg, expected None, the model's"):
        optimum(world_of("corridor"), draw("corridor", 0, mass=3.0))
