"""Shooting on the manifold of a tree's states: derivatives, steps, plans that hold in Drake."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from marks import slow
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, RevoluteJoint
from pydrake.systems.analysis import Simulator
from shooting_problems import expand_motion
from space_models import make_scenario
from trees import AXIS, add_body, attach, sample_state

from drake_aigto import Planner, Scenario
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
from drake_aigto.dynamics import Tree
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
from drake_aigto.simulation import replay_event_driven
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
