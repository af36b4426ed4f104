"""Hinges and sliders: what is read off a mechanism agrees with Drake's own numbers."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from mechanisms import (
    LEFT,
    MECHANISMS,
    ROBOTS,
    build,
    build_world,
    joint,
    link,
    plane,
    sphere,
    wall,
)
from pydrake.multibody.tree import MultibodyForces

from drake_aigto import ModelError, Scenario, World
from drake_aigto.dynamics import SumMap

# Sums over some hundred products, each of a few roundings, of numbers of size 1 to 100.
ROUNDING = 1e-10

read = cache(build)


@pytest.fixture(params=[*MECHANISMS, *ROBOTS])
def world(request: pytest.FixtureRequest) -> World:
    return read(request.param)


def draw(world: World, number: int = 5) -> list[Any]:
    """Returns states (q, v, u) by chance, with angles on the whole circle."""
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


# What is refused.


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


def test_a_wall_out_of_reach_of_all_links_is_refused() -> None:
    near, far = MECHANISMS["pendulum"], "-0.9 0 0 0 1.5707963267948966 0"
    scenario = Scenario(
        initial_position=0.1, initial_velocity=0.0, goal_position=0.2, angles="exact"
    )
    build_world(near).check(scenario)  # The tip comes 0.85 m far.
    with pytest.raises(ModelError, match=r"out of reach .*: got at least 0\.05 m between them"):
        build_world(near.replace(LEFT, far)).check(scenario)
