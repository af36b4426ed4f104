"""Trees of joints: equal to Drake's numbers, derivatives along the manifold, closed forms."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    LinearSpringDamper,
    MultibodyForces,
    RevoluteJoint,
    SpatialInertia,
    UnitInertia,
    default_model_instance,
)
from space_models import make_scenario
from trees import JOINTS, add_body, attach, calc_poses, difference_slopes, make_zoo, sample_state

from drake_aigto import Planner, PlanOptions, Scenario, TrackingController, World
from drake_aigto.control import Disturbance, run_in_loop
from drake_aigto.dynamics import Thrust, Tree
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.simulation import replay_drake, replay_event_driven
from drake_aigto.world import SpaceWorld, TaskCost


@pytest.fixture(scope="module", params=[0, 1, 2])
def plant(request: pytest.FixtureRequest) -> MultibodyPlant:
    return make_zoo(request.param)


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.abs(found - expected).max() / max(1.0, np.abs(expected).max()))


def test_numbers_are_drakes(plant: MultibodyPlant) -> None:
    tree, context, rng = Tree.of(plant), plant.CreateDefaultContext(), np.random.default_rng(3)
    assert tree.num_positions == plant.num_positions()
    for _ in range(3):
        q, v, u = sample_state(plant, rng)
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        M = plant.CalcMassMatrix(context)
        h = plant.CalcInverseDynamics(context, np.zeros(len(v)), forces)
        acceleration = np.linalg.solve(M, plant.MakeActuationMatrix() @ u - h)
        assert relative(tree.calc_mass_matrix(q), M) < 1e-10
        assert relative(tree.calc_bias(q, v), h) < 1e-10
        assert relative(tree.calc_acceleration(q, v, u), acceleration) < 1e-10
        assert relative(tree.calc_position_rate(q, v), plant.MapVelocityToQDot(context, v)) < 1e-12
        for b, pose in enumerate(zip(*calc_poses(tree, q), strict=True)):
            expected = plant.EvalBodyPoseInWorld(context, plant.get_body(BodyIndex(b)))
            assert relative(np.column_stack(pose), expected.GetAsMatrix34()) < 1e-12


def test_many_states_at_once_are_each_by_itself(plant: MultibodyPlant) -> None:
    tree, rng = Tree.of(plant), np.random.default_rng(4)
    states = [sample_state(plant, rng) for _ in range(3)]
    q, v, u = (np.array(each) for each in zip(*states, strict=True))
    assert np.array_equal(tree.calc_mass_matrix(q)[1], tree.calc_mass_matrix(q[1]))
    assert np.array_equal(tree.calc_acceleration(q, v, u)[2], tree.calc_acceleration(*states[2]))


def test_slopes_are_differences_along_the_manifold(plant: MultibodyPlant) -> None:
    tree, rng = Tree.of(plant), np.random.default_rng(5)
    q, v, u = sample_state(plant, rng)
    expected = difference_slopes(tree, q, v, u)
    assert relative(tree.calc_acceleration_slopes(q, v, u), expected) < 1e-6


def test_differences_of_positions_undo_sums(plant: MultibodyPlant) -> None:
    tree, rng = Tree.of(plant), np.random.default_rng(6)
    q, delta, _ = sample_state(plant, rng)
    delta *= 0.3  # Turns by less than π.
    assert np.allclose(tree.subtract(tree.add(q, delta), q), delta, atol=1e-13)
    # The tangent is that of v: q̇ = N(q) v.
    rate = (tree.add(q, 1e-6 * delta) - tree.add(q, -1e-6 * delta)) / 2e-6
    assert np.allclose(rate, tree.calc_position_rate(q, delta), atol=1e-8)


def test_dry_friction_is_of_the_joint_that_has_it() -> None:
    plant = make_zoo()
    friction = np.linspace(0.0, 1.0, plant.num_velocities())
    q, _, _ = sample_state(plant, np.random.default_rng(7))
    v = np.linspace(-1.0, 1.0, plant.num_velocities())  # All slide: fast beside v_s.
    slides = Tree.of(plant, dry_friction=friction).calc_bias(q, v) - Tree.of(plant).calc_bias(q, v)
    assert np.allclose(slides, friction * np.sign(v), atol=1e-12)


def integrate(tree: Tree, q: np.ndarray, v: np.ndarray, step: float, count: int):  # type: ignore[no-untyped-def]
    """Returns the state after Runge-Kutta steps of q ⊕ δ, with the midpoint rule for turns."""
    nothing = np.zeros(tree.actuation.shape[1])
    for _ in range(count):
        middle = v + step / 2 * tree.calc_acceleration(q, v, nothing)
        half = tree.add(q, step / 2 * v)
        v = v + step * tree.calc_acceleration(half, middle, nothing)
        q = tree.add(q, step * middle)
    return q, v


def test_free_fall_keeps_energy_and_angular_momentum() -> None:
    rng, plant = np.random.default_rng(8), MultibodyPlant(0.0)
    base, arm = add_body(plant, "base", rng), add_body(plant, "arm", rng)
    attach(plant, base, arm, lambda name, F, M: RevoluteJoint(name, F, M, [0, 0, 1]), rng)
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    plant.Finalize()
    tree, context = Tree.of(plant), plant.CreateDefaultContext()
    q, v, _ = sample_state(plant, rng)

    def measure(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        momentum = plant.CalcSpatialMomentumInWorldAboutPoint(context, np.zeros(3))
        energy = v @ tree.calc_mass_matrix(q) @ v / 2
        return np.array([energy, *momentum.rotational(), *momentum.translational()])

    errors = [
        np.abs(measure(*integrate(tree, q, v, 1 / count, count)) - measure(q, v)).max()
        for count in (200, 400)
    ]
    assert errors[1] < 1e-4
    assert errors[0] / errors[1] > 3.5  # Of second order: the motion keeps them, steps do not.


def test_a_symmetric_top_precesses() -> None:
    # A free body with moments I, I, C turns about its axis while that precesses about L at |L|/I.
    plant, spin, tilt = MultibodyPlant(0.0), 3.0, 0.4
    moment, other = 2.0, 0.8
    plant.AddRigidBody("top", SpatialInertia(1.0, np.zeros(3), UnitInertia(moment, moment, other)))
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    plant.Finalize()
    tree = Tree.of(plant)
    momentum = np.array([moment * tilt, 0.0, other * spin])
    rate, time, count = np.linalg.norm(momentum) / moment, 1.0, 2000
    q = np.array([1.0, 0, 0, 0, 0, 0, 0])
    after, _ = integrate(tree, q, np.array([tilt, 0, spin, 0, 0, 0]), time / count, count)
    R, _ = calc_poses(tree, after)
    L = momentum / np.linalg.norm(momentum)
    z, angle = np.array([0.0, 0.0, 1.0]), rate * time
    expected = (
        z * np.cos(angle) + np.cross(L, z) * np.sin(angle) + L * (L @ z) * (1 - np.cos(angle))
    )
    assert np.allclose(R[1][:, 2], expected, atol=1e-6)


@pytest.mark.parametrize("name", ["revolute", "prismatic"])
def test_a_joint_may_lead_towards_the_world(name: str) -> None:
    rng, plant = np.random.default_rng(9), MultibodyPlant(0.0)
    body = add_body(plant, "body", rng)
    attach(plant, body, plant.world_body(), JOINTS[name], rng)
    plant.Finalize()
    q, _, _ = sample_state(plant, rng)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    tree = Tree.of(plant)
    R, p = calc_poses(tree, q)
    pose = plant.EvalBodyPoseInWorld(context, body).GetAsMatrix34()
    assert np.allclose(np.column_stack([R[1], p[1]]), pose, atol=1e-12)
    assert np.allclose(tree.calc_mass_matrix(q), plant.CalcMassMatrix(context), atol=1e-12)


def test_what_is_no_tree_is_refused() -> None:
    rng, plant = np.random.default_rng(10), MultibodyPlant(0.0)
    first, second = add_body(plant, "first", rng), add_body(plant, "second", rng)
    plant.AddForceElement(
        LinearSpringDamper(first, np.zeros(3), second, np.zeros(3), 1.0, 1.0, 1.0)
    )
    plant.Finalize()
    with pytest.raises(ModelError, match="LinearSpringDamper: got a force that is not gravity"):
        Tree.of(plant)


def test_gravity_on_part_of_a_tree_is_refused() -> None:
    rng, plant = np.random.default_rng(11), MultibodyPlant(0.0)
    other = plant.AddModelInstance("other")
    inertia = SpatialInertia.SolidBoxWithMass(1.0, 0.1, 0.2, 0.3)
    first = plant.AddRigidBody("first", default_model_instance(), inertia)
    second = plant.AddRigidBody("second", other, inertia)
    attach(plant, first, second, JOINTS["revolute"], rng)
    plant.set_gravity_enabled(other, False)
    plant.Finalize()
    with pytest.raises(ModelError, match=r"'second'.*gravity on some bodies of its tree"):
        Tree.of(plant)


def test_slopes_of_thrusts_are_differences_along_the_manifold() -> None:
    plant, rng = make_zoo(0), np.random.default_rng(5)
    bodies = range(1, plant.num_bodies())
    moved = [b for b in bodies if Tree.of(plant).body_links[b] >= 0]
    thrusts = [Thrust(int(rng.choice(moved)), rng.normal(size=6)) for _ in range(6)]
    tree = Tree.of(plant, thrusts=thrusts)
    q, v, u = sample_state(plant, rng)
    u = np.append(u, rng.normal(size=6))
    expected = difference_slopes(tree, q, v, u)
    found = tree.calc_acceleration_slopes(q, v, u)
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()


def hover(folder: Path, **changes: Any) -> Scenario:
    thrusters = [
        {"body": "thing", "xyz": [0.1, 0.2, 0.0], "direction": [0.0, 0.6, 0.8], "drag": 0.02},
        {"body": "thing", "direction": [1.0, 0.0, 0.0]},
    ]
    return make_scenario(folder, **({"thrusters": thrusters} | changes))


def test_thrusts_are_those_of_drakes_propeller_and_drive_both_simulations(tmp_path: Path) -> None:
    world = World.from_scenario(scenario := hover(tmp_path, duration=0.1))
    assert isinstance(world, SpaceWorld)
    assert world.num_actuators == 5
    rng, start = np.random.default_rng(0), world.place(scenario).initial_position
    q, v, u = world.add(start, rng.normal(size=9)), rng.normal(size=9), rng.normal(size=5)
    q[-1] += 5.0  # Nothing touches.
    root = world.create_context()
    context = world.plant.GetMyMutableContextFromRoot(root)
    world.plant.SetPositionsAndVelocities(context, np.concatenate([q, v]))
    world.fix_control(root, u)
    assert np.array_equal(world.read_control(root), u)
    rate = world.plant.EvalTimeDerivatives(context).CopyToVector()[-9:]
    np.testing.assert_allclose(world.calc_acceleration(q, v, u), rate, rtol=1e-9, atol=1e-9)
    times, controls = np.linspace(0.0, 0.1, 3), rng.uniform(-1.0, 1.0, (2, 5))
    placed = world.place(scenario)
    ours, drake = (
        judge(world, placed, times, controls) for judge in (replay_event_driven, replay_drake)
    )
    np.testing.assert_allclose(ours.positions[-1], drake.positions[-1], atol=1e-5)


def test_thrusters_are_saved_and_named(tmp_path: Path) -> None:
    scenario = hover(tmp_path)
    scenario.save(tmp_path / "s.yaml")
    assert Scenario.load(tmp_path / "s.yaml").thrusters == scenario.thrusters
    world = World.from_scenario(scenario)
    bounded = dataclasses.replace(scenario, control_lower=0.0)
    items = world.limits.control_items(world.plant, bounded)
    assert items[-1] == "thruster_2 from 0 (scenario) to inf (model) N"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"thrusters": [{"body": "thingy"}]}, "'thing'"),
        ({"thrusters": [{"body": "ground"}]}, "a body that nothing moves"),
        ({"thrusters": [{"body": "thing"}], "contact": "rigid"}, "contact: compliant"),
        ({"thrusters": [{"xyz": [0, 0, 0]}]}, "a mapping of body"),
        ({"thrusters": [{"body": "thing", "direction": [0, 0, 0]}]}, "not 0"),
    ],
)
def test_thrusters_that_can_not_be_are_refused(
    tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    with pytest.raises((ModelError, ScenarioError), match=words):
        World.from_scenario(hover(tmp_path, **changes))


@pytest.mark.slow
def test_friction_holds_a_perched_drone_without_thrust_in_drake() -> None:
    asked = Scenario.named("drone/perch")
    perched = dataclasses.replace(asked, initial_position=asked.goal_position, duration=1.0)
    world = World.from_scenario(perched)
    perched = world.place(perched)
    replay = replay_drake(world, perched, np.array([0.0, 1.0]), np.zeros((1, 4)))
    assert replay.goal_error < 0.01  # [m, rad]; it creeps, as friction is regularized.
    slippery = dataclasses.replace(perched, friction=0.4)  # Less than tan 25° = 0.47.
    world = World.from_scenario(slippery)
    assert replay_drake(world, slippery, np.array([0.0, 1.0]), np.zeros((1, 4))).goal_error > 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("name", "renewals"), [("drone/deliver", 2), ("drone/perch", 48)])
def test_drones_reach_their_goals_and_both_replays_confirm_it(name: str, renewals: int) -> None:
    plan = Planner(Scenario.named(name), PlanOptions(renewals=renewals, finalists=1)).plan()
    assert plan.holds and plan.reached
    arrival = plan.find_arrival()
    assert arrival.distance is not None and arrival.distance < 0.02
    assert arrival.angle is not None and arrival.angle < 0.1
    for replay in plan.replay:
        assert replay.cost == pytest.approx(plan.cost, rel=0.02)
    world = plan.find_world()
    if frames := TaskCost.of(world, world.place(plan.scenario)).frames:
        assert np.linalg.norm(frames.errors(plan.trajectory.positions[-1])[0, :3]) < 0.01
        kick = np.array([0.0, 0.0, 0.0, 0.3, -0.2, 0.2, 0.0, 0.0])
        kicked = Disturbance(kick=kick, kick_time=0.5)
        run = run_in_loop(TrackingController(plan, world), plan.scenario, world, kicked)
        assert run.cost < 2 * plan.cost  # 200 times as much without feedback.
