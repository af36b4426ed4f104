"""The shipped robots: each is what its comment says."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from mechanisms import ROBOTS, ask_robot, build
from numpy import cos, sin
from pydrake.geometry import Role
from pydrake.multibody.tree import BodyIndex

from drake_aigto import Scenario, World, scenario_names
from drake_aigto.contact import CompliantLaw, contact_law
from drake_aigto.world import TaskCost

read = cache(build)

# Sums of a few roundings, of numbers of size 1 to 100.
ROUNDING = 1e-12
CART_POLES = [name for name in ROBOTS if name.startswith("cart_pole_")]

# name → φ(q), h(q, v) at v = 1, and M(q), as the models' comments have them
NUMBERS: dict[str, Any] = {
    "cart_pole": lambda q: (
        [],
        [-0.08 * sin(q[1]), 0.08 * 9.8 * sin(q[1])],
        [[1.1, 0.08 * cos(q[1])], [0.08 * cos(q[1]), 0.064]],
    ),
    "pendulum": lambda q: ([0.5 + sin(q[0])], [9.81 * sin(q[0])], [[1.0]]),
    "acrobot": lambda q: (
        [],
        [
            9.81 * (1.5 * sin(q[0]) + sin(q[0] + q[1])) + 0.1 - 3 * sin(q[1]),
            9.81 * sin(q[0] + q[1]) + 0.1 + sin(q[1]),
        ],
        [
            [0.083 + 0.25 + 0.33 + 2 + 2 * cos(q[1]), 1.33 + cos(q[1])],
            [1.33 + cos(q[1]), 1.33],
        ],
    ),
    "paddle": lambda q: (
        [(q[3] - q[0]) * cos(q[1]) + q[2] * sin(q[1])],
        [9.81, 0.0, 0.0, 0.981],
        np.diag([1.0, 0.06, 0.1, 0.1]),
    ),
    "three_carts": lambda q: ([q[1] - q[0] - 2, q[2] - q[1] - 2], [2.0, 2.0, 2.0], np.eye(3)),
    "throwing_ball": lambda q: ([q[1]], [0.0, 9.81], np.eye(2)),
    "two_discs": lambda q: (
        [(q[0] - q[2]) ** 2 + (q[1] - q[3]) ** 2 - 0.25],
        np.zeros(4),
        np.diag([2.0, 2.0, 1.0, 1.0]),
    ),
}


def draw(world: World) -> Any:
    return np.random.default_rng(3).uniform(-3.0, 3.0, (5, world.num_positions))


@pytest.mark.parametrize("name", NUMBERS)
def test_a_robot_has_the_equations_of_its_comment(name: str) -> None:
    world = read(name)
    for q in draw(world):
        distance, bias, mass = NUMBERS[name](q)
        np.testing.assert_allclose(world.calc_signed_distance(q), distance, atol=ROUNDING)
        np.testing.assert_allclose(world.calc_bias(q, np.ones_like(q)), bias, atol=1e-10)
        np.testing.assert_allclose(world.calc_mass_matrix(q), mass, atol=ROUNDING)


@pytest.mark.parametrize("name", CART_POLES)
def test_a_cart_pole_touches_walls_as_far_apart_and_as_stiff_as_its_name_says(name: str) -> None:
    world, free = read(name), read("cart_pole")
    _, _, kind, decimeters = name.split("_")
    assert [each.name for each in world.contacts] == [
        "pole against left_wall",
        "pole against right_wall",
    ]
    for q in draw(world):
        tip, d = q[0] + 0.8 * sin(q[1]), int(decimeters) / 10
        np.testing.assert_allclose(world.calc_signed_distance(q), [d + tip, d - tip], atol=ROUNDING)
        np.testing.assert_array_equal(world.calc_mass_matrix(q), free.calc_mass_matrix(q))
        np.testing.assert_array_equal(world.calc_bias(q, q), free.calc_bias(q, q))
    law = contact_law(world, dataclasses.replace(ask_robot(name), contact="compliant"))
    assert isinstance(law, CompliantLaw)
    expected = 200.0 if kind == "soft" else 1e9
    np.testing.assert_allclose(law.stiffness, expected, rtol=2 * np.finfo(float).eps)
    np.testing.assert_array_equal(law.dissipation, [0.0, 0.0])


def test_the_wall_of_the_acrobot_is_what_its_comment_adds() -> None:
    world, free = read("acrobot_and_wall"), read("acrobot")
    for q in draw(world):
        reach = sin(q[0]) + 2 * sin(q[0] + q[1])
        np.testing.assert_allclose(world.calc_signed_distance(q), [1.2 - reach], atol=ROUNDING)
        np.testing.assert_array_equal(world.calc_bias(q, q), free.calc_bias(q, q))


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_is_driven_and_stopped_where_its_comment_says(name: str) -> None:
    world = read(name)
    driven = {"acrobot": [1], "three_carts": [1], "throwing_ball": [0, 1]}
    found = np.flatnonzero(world.actuation.any(axis=1)).tolist()
    family = name.split("_and_")[0]
    several = {"paddle", "two_discs"}
    assert found == ([0, 1] if name in several else driven.get(family, [0]))
    np.testing.assert_array_equal(world.actuation[found], np.eye(len(found)))
    assert not np.isfinite(world.limits.velocity).any()
    is_cart_pole = name.startswith("cart_pole")
    effort = 20.0 if is_cart_pole or name in ("three_carts", "two_discs") else np.inf
    assert (world.limits.control == [[-effort], [effort]]).all()
    stops = np.full(world.num_positions, np.inf)
    stops[0] = 1.0 if is_cart_pole else np.inf
    np.testing.assert_array_equal(world.limits.position, [-stops, stops])


@pytest.mark.parametrize("name", ROBOTS)
def test_every_link_of_a_robot_that_weighs_something_is_drawn_and_nothing_rubs(name: str) -> None:
    world = read(name)
    assert not world.frictions
    plant, inspector = world.plant, world.scene_graph.model_inspector()
    links = [plant.get_body(BodyIndex(i)) for i in range(1, plant.num_bodies())]
    heavy = [link for link in links if link.default_mass() > 0]
    assert heavy
    for link in heavy:
        frame = plant.GetBodyFrameIdOrThrow(link.index())
        assert inspector.NumGeometriesForFrameWithRole(frame, Role.kIllustration)


@pytest.mark.parametrize("name", CART_POLES)
def test_the_task_of_a_cart_pole_is_spots_sum_as_an_integral(name: str) -> None:
    scenario = Scenario.named(name.replace("cart_pole_", "cart_pole/"))
    assert scenario.model.endswith(f"/{name}.sdf")
    task = TaskCost.of(read(name), scenario)
    dt = 0.05
    for a, theta, rate, u in np.random.default_rng(4).uniform(-3.0, 3.0, (5, 4)):
        # f, the increment of the angle, is (1, θ̇ dt) to first order.
        spot = a**2 + (cos(theta) + 1) ** 2 + sin(theta) ** 2 + (rate * dt) ** 2
        state = [a, theta], [7.0, rate]
        running = task.running(0.3, *state, [u]) * dt
        assert running == pytest.approx(spot + (u / 20) ** 2, rel=1e-12)
        assert task.final(*state) == pytest.approx(10 * spot, rel=1e-12)


ROBOT_SCENARIOS = [
    name for name in scenario_names() if name.partition("/")[0] in {*ROBOTS, "cart_pole"}
]


@pytest.mark.parametrize("name", ROBOT_SCENARIOS)
def test_the_scenario_of_a_robot_is_one_that_its_law_and_bounds_allow(name: str) -> None:
    scenario = Scenario.named(name)
    world = World.from_scenario(scenario)
    law = contact_law(world, scenario)
    assert isinstance(law, CompliantLaw) == ("soft" in name)
    assert {len(each) for each in vars(law).values()} == {world.num_contacts}
    bounds = world.bounds(scenario)
    assert (bounds.velocity[1] == (5.0 if name == "three_carts/apart" else np.inf)).all()
