"""Hinges and sliders: what is read off a mechanism agrees with Drake's own numbers."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from mechanisms import (
    LEFT,
    MECHANISMS,
    ROBOTS,
    ask_robot,
    build,
    build_world,
    joint,
    link,
    plane,
    sphere,
    wall,
)
from numpy import cos, sin
from pydrake.geometry import Role
from pydrake.multibody.tree import BodyIndex, MultibodyForces

from drake_aigto import Scenario, World, scenario_names
from drake_aigto.contact import CompliantLaw, contact_law
from drake_aigto.dynamics import SumMap
from drake_aigto.errors import ModelError
from drake_aigto.world import TaskCost

# Sums over some hundred products, each of a few roundings, of numbers of size 1 to 100.
ROUNDING = 1e-10

read = cache(build)


@pytest.fixture(params=[*MECHANISMS, *ROBOTS])
def world(request: pytest.FixtureRequest) -> World:
    return read(request.param)


def draw(world: World, number: int = 5) -> list[Any]:
    rng = np.random.default_rng(7)
    sizes = 2 * world.num_positions + world.num_actuators
    spread = np.full(sizes, 3.0)
    points = rng.uniform(-spread, spread, (number, sizes))
    return [np.split(p, [world.num_positions, 2 * world.num_positions]) for p in points]


def set_state(world: World, q: Any, v: Any) -> Any:
    context = world.plant.GetMyMutableContextFromRoot(world.create_context())
    world.plant.SetPositions(context, q)
    world.plant.SetVelocities(context, v)
    return context


def test_mass_bias_and_acceleration_are_the_plants(world: World) -> None:
    B = world.plant.MakeActuationMatrix()
    for q, moving, u in draw(world):
        for v in (moving, 0 * moving):  # At rest gravity and springs are left.
            context = set_state(world, q, v)
            M = world.plant.CalcMassMatrix(context)
            forces = MultibodyForces(world.plant)
            world.plant.CalcForceElementsContribution(context, forces)
            h = world.plant.CalcInverseDynamics(context, np.zeros(len(v)), forces)
            np.testing.assert_allclose(world.calc_mass_matrix(q), M, atol=ROUNDING)
            np.testing.assert_allclose(world.calc_bias(q, v), h, atol=ROUNDING)
            left = M @ world.calc_acceleration(q, v, u) + h - B @ u
            np.testing.assert_allclose(left, 0.0, atol=100 * ROUNDING)


def find_distances(world: World, q: Any) -> Any:
    """Returns Drake's own distance of the two shapes of each contact."""
    root = world.create_context()
    world.plant.SetPositions(world.plant.GetMyMutableContextFromRoot(root), q)
    query = world.scene_graph.get_query_output_port().Eval(
        world.scene_graph.GetMyContextFromRoot(root)
    )
    pairs = [query.ComputeSignedDistancePairClosestPoints(*pair) for pair in world.shapes]
    return np.array([pair.distance for pair in pairs])


HALF_SPACES = [
    *("pendulum", "cart-pole", "arm with a slider", "cart_pole_soft_06", "cart_pole_rigid_10"),
    *("acrobot_and_wall", "paddle", "throwing_ball"),
]


@pytest.mark.parametrize("name", HALF_SPACES)
def test_the_distance_of_a_half_space_is_drakes(name: str) -> None:
    world = read(name)
    for q, _, _ in draw(world):
        got = world.calc_signed_distance(q)
        np.testing.assert_allclose(got, find_distances(world, q), atol=ROUNDING)


@pytest.mark.parametrize("name", ["double pendulum", "paddle"])
def test_the_distance_of_a_box_is_drakes_where_the_sphere_is_over_a_face(name: str) -> None:
    world = read(name)
    compared = 0
    for q, _, _ in draw(world, 200):
        distances = world.calc_signed_distance(q)
        nearest = int(np.argmax(distances))
        if distances[nearest] > 0.01 and world.is_on_face(q)[nearest]:
            compared += 1
            expected = find_distances(world, q)[nearest]
            assert distances[nearest] == pytest.approx(expected, abs=ROUNDING)
    assert compared >= 10


def test_two_discs_touch_where_drake_says_with_the_same_gradient() -> None:
    world = read("two discs")
    assert world.num_contacts == 1
    for q, _, _ in draw(world):
        apart = find_distances(world, q)[0] + 0.5
        (distance,) = world.calc_signed_distance(q)
        assert distance == pytest.approx((apart**2 - 0.25) / (2 * 0.5), abs=ROUNDING)
    q, disc = np.zeros(5), world.plant.GetJointByName("one_joint").position_start()
    q[disc : disc + 3] = [1.1 - 0.5 * 0.6, -0.5 * 0.8, 0.4]
    np.testing.assert_allclose(world.calc_signed_distance(q), [0.0], atol=1e-12)
    (J,) = world.calc_contact_jacobian(q)
    np.testing.assert_allclose(J[disc : disc + 3], [-0.6, -0.8, 0.0], atol=1e-12)


def test_the_jacobian_is_the_slope_of_the_distance(world: World) -> None:
    step = 1e-6
    for q, _, _ in draw(world):
        moves = step * np.eye(world.num_positions)
        slopes = (world.calc_signed_distance(q + moves) - world.calc_signed_distance(q - moves)).T
        np.testing.assert_allclose(world.calc_contact_jacobian(q), slopes / (2 * step), atol=1e-7)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("ball", r"joint 'rod_joint' \(ball_rpy\): got velocities v that are not q̇"),
        ("screw", r"joint 'rod_joint' \(screw\): got a motion that is neither a slider's nor"),
    ],
)
def test_other_joints_are_refused_by_name(kind: str, message: str) -> None:
    rod = link("rod", 1.3, ">0 0 0 0 0 0", "0 0 -0.7", sphere("tip", "0 0 -0.8"))
    with pytest.raises(ModelError, match=message):
        build_world(rod + joint(kind, "world", "rod", "0 1 0") + wall(plane("left", LEFT)))


@pytest.mark.parametrize("name", ["pendulum", "cart-pole", "double pendulum", "two discs"])
def test_no_distance_is_out_of_its_range(name: str) -> None:
    world, rng = build(name), np.random.default_rng(1)
    low, high = np.sort(rng.normal(scale=2.0, size=(2, world.num_positions)), axis=0)
    distances = SumMap(np.array([each.signed_distance for each in world.contacts]), world.positions)
    least, most = distances.calc_range(low, high)
    found = world.calc_signed_distance(rng.uniform(low, high, (500, world.num_positions)))
    assert np.all(found >= least - 1e-12) and np.all(found <= most + 1e-12)
    none = np.full(world.num_positions, np.inf)
    least, most = distances.calc_range(-none, none)
    assert np.all(least <= found.min(axis=0)) and np.all(most >= found.max(axis=0))


def test_a_wall_out_of_reach_of_all_links_is_dropped_with_a_note() -> None:
    near, far = MECHANISMS["pendulum"], "-0.9 0 0 0 1.5707963267948966 0"
    scenario = Scenario(
        initial_position=0.1, initial_velocity=0.0, goal_position=0.2, angles="exact"
    )
    build_world(near).check(scenario)  # The tip comes 0.85 m far.
    world = build_world(near.replace(LEFT, far))
    assert world.notes == ("rod against wall can't touch: they stay 0.05 m apart",)
    assert world.num_contacts == 0
    world.check(scenario)


# Sums of a few roundings, of numbers of size 1 to 100.
TIGHT = 1e-12
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
        [[0.083 + 0.25 + 0.33 + 2 + 2 * cos(q[1]), 1.33 + cos(q[1])], [1.33 + cos(q[1]), 1.33]],
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


def draw_positions(world: World) -> Any:
    return np.random.default_rng(3).uniform(-3.0, 3.0, (5, world.num_positions))


@pytest.mark.parametrize("name", NUMBERS)
def test_a_robot_has_the_equations_of_its_comment(name: str) -> None:
    world = read(name)
    for q in draw_positions(world):
        distance, bias, mass = NUMBERS[name](q)
        np.testing.assert_allclose(world.calc_signed_distance(q), distance, atol=TIGHT)
        np.testing.assert_allclose(world.calc_bias(q, np.ones_like(q)), bias, atol=1e-10)
        np.testing.assert_allclose(world.calc_mass_matrix(q), mass, atol=TIGHT)


@pytest.mark.parametrize("name", CART_POLES)
def test_a_cart_pole_touches_walls_as_far_apart_and_as_stiff_as_its_name_says(name: str) -> None:
    world, free = read(name), read("cart_pole")
    _, _, kind, decimeters = name.split("_")
    assert [each.name for each in world.contacts] == [
        "pole against left_wall",
        "pole against right_wall",
    ]
    for q in draw_positions(world):
        tip, d = q[0] + 0.8 * sin(q[1]), int(decimeters) / 10
        np.testing.assert_allclose(world.calc_signed_distance(q), [d + tip, d - tip], atol=TIGHT)
        np.testing.assert_array_equal(world.calc_mass_matrix(q), free.calc_mass_matrix(q))
        np.testing.assert_array_equal(world.calc_bias(q, q), free.calc_bias(q, q))
    law = contact_law(world, dataclasses.replace(ask_robot(name), contact="compliant"))
    assert isinstance(law, CompliantLaw)
    expected = 200.0 if kind == "soft" else 1e9
    np.testing.assert_allclose(law.stiffness, expected, rtol=2 * np.finfo(float).eps)
    np.testing.assert_array_equal(law.dissipation, [0.0, 0.0])


def test_the_wall_of_the_acrobot_is_what_its_comment_adds() -> None:
    world, free = read("acrobot_and_wall"), read("acrobot")
    for q in draw_positions(world):
        reach = sin(q[0]) + 2 * sin(q[0] + q[1])
        np.testing.assert_allclose(world.calc_signed_distance(q), [1.2 - reach], atol=TIGHT)
        np.testing.assert_array_equal(world.calc_bias(q, q), free.calc_bias(q, q))


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_is_driven_stopped_and_drawn_as_its_comment_says_and_nothing_rubs(
    name: str,
) -> None:
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
    assert not world.frictions
    plant, inspector = world.plant, world.scene_graph.model_inspector()
    links = [plant.get_body(BodyIndex(i)) for i in range(1, plant.num_bodies())]
    heavy = [body for body in links if body.default_mass() > 0]
    assert heavy
    for body in heavy:
        frame = plant.GetBodyFrameIdOrThrow(body.index())
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
