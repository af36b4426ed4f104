"""Shooting on the manifold of a tree's states: derivatives, steps, plans that hold in Drake."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from marks import slow
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    Joint,
    LinearSpringDamper,
    MultibodyForces,
    RevoluteJoint,
    SpatialInertia,
    UnitInertia,
    default_model_instance,
)
from pydrake.systems.analysis import Simulator
from shooting_problems import expand_motion
from space_models import make_scenario
from trees import (
    AXIS,
    JOINTS,
    add_body,
    attach,
    calc_poses,
    difference_slopes,
    make_zoo,
    sample_state,
)

from drake_aigto import Planner, Scenario, TrackingController, World
from drake_aigto.arrays import Floats
from drake_aigto.contact import (
    TreeMechanics,
    TreeMechanicsMemory,
    TreeMechanism,
    accelerate_at_once,
    accelerate_bodies,
    begin_bodies,
    make_mechanics_memory,
)
from drake_aigto.control import Disturbance, run_in_loop
from drake_aigto.dynamics import Thrust, Tree
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.kernels import borrow, kernel
from drake_aigto.planning import MechanismTask, PlanOptions
from drake_aigto.shooting import (
    IMPLICIT,
    TWO_STAGES,
    FreeStart,
    Phases,
    ShootingOptions,
    ShootingProblem,
    Smoothing,
    make_memory,
)
from drake_aigto.simulation import replay_drake, replay_event_driven
from drake_aigto.world import FrameGoal, FrameGoals, Pose, PoseParts, SpaceWorld, TaskCost

Rng = np.random.Generator


def make_hinge(name: str, F: object, M: object) -> Joint:
    return RevoluteJoint(name, F, M, AXIS, damping=0.1)


def make_floating(rng: Rng) -> MultibodyPlant:
    plant = MultibodyPlant(0.0)
    base = add_body(plant, "base", rng)
    for k in range(2):
        arm = add_body(plant, f"arm_{k}", rng)
        plant.AddJointActuator(f"motor_{k}", attach(plant, base, arm, make_hinge, rng))
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -1.0])
    plant.Finalize()
    return plant


def make_stiff_hinge(name: str, F: object, M: object) -> Joint:
    return RevoluteJoint(name, F, M, AXIS, damping=5.0)


def make_arm(rng: Rng, count: int = 7) -> MultibodyPlant:
    plant = MultibodyPlant(0.0)
    last = plant.world_body()
    for k in range(count):
        body = add_body(plant, f"link_{k}", rng)
        plant.AddJointActuator(f"motor_{k}", attach(plant, last, body, make_stiff_hinge, rng))
        last = body
    plant.Finalize()
    return plant


def make_problem(
    plant: MultibodyPlant, start: Floats, goal: Floats, N: int, T: float, weights: Floats
) -> ShootingProblem:
    """Returns the problem of a pose from rest; weights are of final (δ, v), and 1e-3 of u."""
    n, nu = plant.num_velocities(), plant.num_actuators()
    free, limits = np.full(2 * n, np.inf), np.full(nu, 100.0)
    cost = TaskCost(
        R=np.full(nu, 1e-3),
        Q=np.zeros(n),
        Qv=np.full(n, 1e-3),
        QT=np.diag(weights[:n]),
        QTv=np.diag(weights[n:]),
        goal=goal,
        goal_velocity=np.zeros(n),
        is_modulo=np.zeros(n, dtype=bool),
        is_chordal=np.zeros(n, dtype=bool),
        times=np.zeros(1),
        positions=goal[np.newaxis],
        velocities=np.zeros((1, n)),
    )
    return ShootingProblem(
        mechanism=TreeMechanism.of(Tree.of(plant)),
        cost=cost,
        times=np.linspace(0.0, T, N + 1),
        start=np.concatenate([start, np.zeros(n)]),
        scales=np.ones(2 * n),
        state_bounds=np.stack([-free, free]),
        control_bounds=np.stack([-limits, limits]),
        hard_goal=np.full(2 * n, np.nan),
    )


def replay(plant: MultibodyPlant, start: Floats, times: Floats, controls: Floats) -> Floats:
    """Returns Drake's q at the end of held controls, from rest."""
    simulator = Simulator(plant)
    context, integrator = simulator.get_mutable_context(), simulator.get_mutable_integrator()
    plant.SetPositions(context, start)
    integrator.set_target_accuracy(1e-9)
    for u, end in zip(controls, times[1:], strict=True):
        plant.get_actuation_input_port().FixValue(context, u)
        simulator.AdvanceTo(end)
    return plant.GetPositions(context)


# Turns are rotation vectors about a stage's start: moved with it, its steps have other errors.
@pytest.mark.parametrize(
    ("seed", "order", "substeps", "off"),
    [(1, 4, 2, 1e-5), (1, IMPLICIT, 16, 2e-4), (1, TWO_STAGES, 16, 2e-4)],
)
@pytest.mark.parametrize(
    ("phases", "is_free"),
    [
        (None, False),
        (Phases.free(0.2, (0.1, 0.4)), False),
        *slow((Phases.free(0.2, (0.1, 0.4)), True)),
    ],
    ids=["timed", "free", "free start"],
)
def test_expansions_of_a_floating_body_are_differences_along_the_manifold(
    seed: int, order: int, substeps: int, off: float, phases: Phases | None, is_free: bool
) -> None:
    rng = np.random.default_rng(seed)
    plant = make_floating(rng)
    (q, _, _), (goal, _, _), (about, _, _) = (sample_state(plant, rng) for _ in range(3))
    problem = make_problem(plant, q, goal, 3, 0.2, rng.uniform(1.0, 2.0, 16))
    A = rng.normal(size=(8, 8))
    pose, weight = Pose((0.3, -0.2, 0.5), (0.1, 0.5, -0.6, 0.6)), PoseParts((3, 1, 2), (4, 4, 4))
    goals = {name: FrameGoal(pose, weight) for name in ("arm_0", "arm_1_F")}
    frames = FrameGoals.of(plant, Tree.of(plant), goals)
    cost = replace(problem.cost, QT=A @ A.T, Q=np.arange(1.0, 9.0), positions=about[np.newaxis])
    cost = replace(cost, frames=frames)
    problem, n, nq = replace(problem, cost=cost, phases=phases), 8, 9
    if is_free:
        limits = np.stack([-problem.scales, problem.scales])
        problem = replace(problem, free_start=FreeStart(limits, 0.1 * problem.scales))
    program = problem.make_program(ShootingOptions((Smoothing(0.0, 1, 1.0),), substeps, order))
    memory, tree = make_memory(program), Tree.of(plant)
    # Phases add duration and time, and a free start by how much it is moved.
    K, nz = len(program.kinds), 2 * n + (2 if phases else 0) + (2 * n if is_free else 0)
    states, controls = np.zeros((K + 1, nq + nz - n)), rng.normal(size=(K, 2))
    for state in states:  # With gaps of some 0.3 rad and m.
        state[:nq] = tree.add(q, 0.3 * rng.normal(size=n))
        state[nq:] = rng.normal(size=nz - n)
        state[nq + n :] = 0.1 * np.exp(0.3 * state[nq + n :])
    expand_motion(program, states, controls, 0.0, memory)
    F, gradient = memory.expansion.F.copy(), memory.expansion.l1.copy()

    def expand(k: int, column: int, step: float) -> tuple[float, Floats]:
        moved, forced, delta = states.copy(), controls.copy(), step * np.eye(nz + 2)[column]
        moved[k, :nq] = tree.add(states[k, :nq], delta[:n])
        moved[k, nq:] += delta[n:nz]
        if k < K:
            forced[k] += delta[nz:]
        total = expand_motion(program, moved, forced, 0.0, memory)
        return total, memory.expansion.gaps[min(k, K - 1)].copy()

    for k, column in np.ndindex(K + 1, nz + 2):
        if is_free and k == 2 * n // 2 and column < n:
            continue  # What is moved does not change.
        (high, after), (low, before) = expand(k, column, 1e-5), expand(k, column, -1e-5)
        if k < K:
            np.testing.assert_allclose((after - before) / 2e-5, F[k, :, column], atol=2 * off)
        if k < K or column < nz:
            slope = float(gradient[k, column])
            np.testing.assert_allclose((high - low) / 2e-5, slope, atol=off * max(1.0, abs(slope)))


def test_steps_of_a_turning_body_are_of_fourth_order() -> None:
    rng = np.random.default_rng(2)
    plant = make_floating(rng)
    q, _, _ = sample_state(plant, rng)
    problem = make_problem(plant, q, q, 4, 0.4, np.ones(16))
    problem = replace(problem, start=np.concatenate([q, rng.normal(size=8)]))
    controls = rng.normal(size=(4, 2))
    ends = [problem.simulate(controls, count).states[-1] for count in (1, 2, 16)]
    first, second = (np.abs(end - ends[-1]).max() for end in ends[:2])
    assert 10 < first / second < 24
    assert np.isclose(np.linalg.norm(ends[0][:4]), 1.0, atol=1e-14)


@kernel
def answer(
    mechanics: TreeMechanics,
    q: Floats,
    v: Floats,
    u: Floats,
    is_at_once: bool,
    memory: TreeMechanicsMemory,
) -> Floats:
    """Returns ∂v̇/∂v and v̇, shape (n, n + 1), in one go or where q was placed before."""
    mechanics, memory, n = borrow(mechanics), borrow(memory), v.size
    found = np.zeros((n, n + 1))
    if is_at_once:
        begin_bodies(mechanics, q, 0.01, memory)
        accelerate_at_once(mechanics, q, -v, u, 0.01, memory)
        accelerate_at_once(mechanics, q, v, u, 0.01, memory)
    else:
        accelerate_bodies(mechanics, q, v, u, 0.01, True, memory)
    for i in range(n):
        found[i, n] = memory.acceleration[0, i]
        for j in range(n):
            found[i, j] = memory.tree.slopes[i, n + j]
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", ["arm_and_box/push", "quadruped/leap_up"])
def test_velocities_change_alone_to_the_same_bits(name: str) -> None:
    scenario = Scenario.named(name)
    world = SpaceWorld.from_scenario(scenario)
    scenario, rng = world.place(scenario), np.random.default_rng(0)
    mechanism = MechanismTask(world, scenario, PlanOptions()).mechanism
    assert isinstance(mechanism, TreeMechanism)
    mechanics = mechanism.fit(0.01, 1.0, 1.0)
    q = scenario.initial_position
    for _ in range(3):
        q = world.add(q, rng.uniform(-0.02, 0.02, world.num_velocities))
        v, u = rng.uniform(-1, 1, world.num_velocities), rng.uniform(-1, 1, world.num_actuators)
        whole, alone = (
            answer(mechanics, q, v, u, at_once, make_mechanics_memory(mechanics))
            for at_once in (False, True)
        )
        np.testing.assert_array_equal(alone, whole)


@pytest.mark.parametrize(("order", "falls"), [(IMPLICIT, 2), (TWO_STAGES, 4)])
def test_the_error_of_implicit_steps_falls_with_their_length(order: int, falls: float) -> None:
    rng = np.random.default_rng(5)
    plant = make_arm(rng, 2)
    problem = make_problem(plant, np.zeros(2), np.zeros(2), 10, 1.0, np.ones(4))
    controls = rng.normal(size=(10, 2))
    problem = replace(problem, cost=replace(problem.cost, Q=np.ones(2), Qv=np.ones(2)))
    exact = problem.simulate(controls, 256)
    found = [problem.simulate(controls, n, order=order) for n in (16, 32, 64)]
    ends = [np.abs(each.states[-1] - exact.states[-1]).max() for each in found]
    costs = [abs(each.cost - exact.cost) for each in found]
    for off in (ends, costs):
        np.testing.assert_allclose(np.divide(off[:-1], off[1:]), falls, rtol=0.15)


@pytest.mark.slow
def test_an_arm_of_seven_joints_goes_to_a_pose_and_drake_agrees() -> None:
    rng = np.random.default_rng(3)
    plant = make_arm(rng)
    start, goal = np.zeros(7), rng.uniform(-0.5, 0.5, 7)
    problem = make_problem(plant, start, goal, 40, 1.0, np.full(14, 1e4))
    weight = Tree.of(plant).calc_bias(start, np.zeros(7))  # Of all links, which each motor bears.
    result = problem.solve(np.tile(weight, (40, 1)), options=ShootingOptions(substeps=8))
    assert np.abs(result.states[-1, :7] - goal).max() < 0.02
    assert problem.estimate_error(result) < 1e-3
    end = replay(plant, start, result.times, result.controls)
    np.testing.assert_allclose(end, result.states[-1, :7], atol=1e-4)


def test_a_body_without_a_foothold_turns_by_its_arms_and_drake_agrees() -> None:
    rng = np.random.default_rng(4)
    plant = make_floating(rng)
    start, _, _ = sample_state(plant, rng)
    tree = Tree.of(plant)
    goal = tree.add(start, np.array([0.1, -0.05, 0.1, 0, 0, 0, 0, 0]))
    weights = np.concatenate([np.full(3, 1e2), np.zeros(5), np.full(8, 1e-2)])
    problem = make_problem(plant, start, goal, 40, 1.0, weights)
    controls = 0.1 * rng.normal(size=(40, 2))
    result = problem.solve(controls, options=ShootingOptions(substeps=8))
    before = problem.simulate(controls, 4)
    assert result.cost < 0.5 * before.cost
    end = replay(plant, start, result.times, result.controls)
    assert np.abs(tree.subtract(end, result.states[-1, :9])).max() < 1e-4


@pytest.mark.parametrize(
    ("order", "substeps", "left", "back"),
    [(2, 2, 0.05, 1e-3), (IMPLICIT, 1, 5e-4, 5e-3), (TWO_STAGES, 1, 5e-4, 1e-2)],
)
def test_a_slip_ends_in_long_steps_without_turning_round(
    tmp_path: Path, order: int, substeps: int, left: float, back: float
) -> None:
    speed = [*[0.0] * 6, 0.5, 0.0, 0.0]  # The ball moves along x.
    scenario = make_scenario(tmp_path, initial_velocity=speed)
    planner = Planner(scenario, PlanOptions())
    task = MechanismTask(planner.world, planner.scenario, planner.options)
    # Friction of 0.5 at 10 m/s² slows the slip of a ball by 17 m/s², 0.17 m/s in each step.
    found = task.shooting(50).simulate(np.zeros((50, 3)), substeps, order=order)
    assert isinstance(task.world, SpaceWorld)
    slips = task.world.calc_slides(*task.world.split(found.states))
    names = [contact.name for contact in task.world.contacts]
    along = slips[:, names.index("m::ball with ground::floor"), 0]
    assert along[0] == pytest.approx(0.5) and abs(along[-1]) < left
    assert np.all(along >= -back)  # The exact one is −0.0034 m/s once, as the ball bounces.


@pytest.mark.slow
def test_damped_steps_bring_a_quadruped_of_stiff_servos_down_in_few_iterations() -> None:
    planner = Planner(Scenario.named("quadruped/leap_up"))
    task = MechanismTask(planner.world, planner.scenario, planner.options)
    problem, controls = task.shooting(20), np.zeros((20, 12))
    options = ShootingOptions((Smoothing(1e-3, 20, 1e-4),), substeps=5, order=IMPLICIT)
    before = problem.simulate(controls, 5, order=IMPLICIT)
    # Damping of controls leaves 4.1 of 222 then.
    assert problem.solve(controls, options=options).cost < 1e-3 * before.cost


@pytest.mark.slow
def test_a_finalist_costs_what_the_exact_law_says_of_its_controls(tmp_path: Path) -> None:
    planner = Planner(make_scenario(tmp_path, duration=0.5, time_step=0.05), PlanOptions())
    task = MechanismTask(planner.world, planner.scenario, planner.options)
    pushed = task.shooting(10).simulate(np.tile([2.0, 0.0, 0.9], (10, 1)), 4)
    polished = task.polish(pushed)
    assert polished.replay is not None
    again = replay_event_driven(task.world, task.scenario, polished.times, polished.controls)
    assert polished.replay.cost == pytest.approx(again.cost, rel=1e-9)
    assert polished.replay.cost <= 1.01 * polished.exact_cost < pushed.exact_cost
    # Far above what is known, it is left after a first pass.
    assert task.polish(pushed, most=0.1 * polished.exact_cost).replay is None


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
