"""Motions that repeat: free starts, against calculus; refusals; a hopper's gait."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mechanisms import WORLD_AT, build_world, joint, link
from test_tree_shooting import make_floating, make_problem
from trees import sample_state

from drake_aigto import Plan, Planner, Scenario, TrackingController
from drake_aigto.arrays import Floats
from drake_aigto.control import ModelPredictiveController
from drake_aigto.dynamics import Tree
from drake_aigto.errors import ControlError, ScenarioError
from drake_aigto.kernels import borrow, kernel
from drake_aigto.planning import Feedback, PlanOptions
from drake_aigto.shooting import (
    EXPAND,
    PENALIZE,
    FreeStart,
    Phases,
    ShootingOptions,
    Smoothing,
    make_memory,
    visit_bounds,
)
from drake_aigto.show import format_plan
from drake_aigto.simulation import EVENT_DRIVEN
from drake_aigto.world import SpaceWorld, World

MASS, DAMPING, WAY, PRICE = 2.0, 0.7, 0.4, 0.1
QUICK = PlanOptions(starts=4, renewals=0, finalists=1)


@cache
def cart(in_space: bool = False) -> World:
    damping = f"<dynamics><damping>{DAMPING}</damping></dynamics>"
    parts = link("cart", MASS, WORLD_AT) + joint("prismatic", "world", "cart", "1 0 0", damping)
    kind = SpaceWorld if in_space else World
    return kind.from_diagram(build_world(parts).diagram)


def ask(**changed: Any) -> Scenario:
    """Returns the task of a cart that advances, in a second."""
    fields: dict[str, Any] = {
        "initial_position": [0.1],
        "initial_velocity": [0.0],
        "periodic": {"cart_joint": WAY},
        "control_weight": PRICE,
        "time_step": 0.05,
        "contact": "compliant",
    }
    return Scenario(**{**fields, **changed})


@pytest.mark.parametrize("in_space", [False, True])
def test_a_damped_cart_advances_at_one_speed(in_space: bool) -> None:
    # v repeats, so ∫ u dt = d·WAY, and of all such u a constant one has the least ∫ u² dt.
    best = PRICE * (DAMPING * WAY) ** 2
    plan = Planner(ask(), QUICK, cart(in_space)).plan()
    assert plan.holds and plan.reached
    assert plan.cost == pytest.approx(best, rel=1e-3)
    x = plan.trajectory.states
    np.testing.assert_allclose(x[0], [0.1, WAY], atol=1e-4)
    np.testing.assert_allclose(x[-1] - x[0], [WAY, 0.0], atol=1e-4)


def calc_cost(times: Floats, wave: Floats, price: float) -> tuple[float, float, float]:
    """Returns the least ∫ (x − wave)² + price u² over a period, and x(0) and v(0) of that.

    Of each harmonic r e^{iωt} of the wave, with u = P x and P = −m ω² + i d ω, x is
    r/(1 + price |P|²), and price |P|² |r|²/(1 + price |P|²) is left.
    """
    T, N = times[-1], len(times) - 1
    r, omega = np.fft.fft(wave[:-1]) / N, 2 * np.pi * np.fft.fftfreq(N, T / N)
    P = price * np.abs(-MASS * omega**2 + 1j * DAMPING * omega) ** 2
    x = r / (1 + P)
    left = T * np.sum(P / (1 + P) * np.abs(r) ** 2)
    return float(left), float(np.sum(x).real), float(np.sum(1j * omega * x).real)


def test_a_cart_follows_a_wave_as_its_harmonics_say() -> None:
    corners, heights = [0.0, 0.3, 0.9, 1.2], [0.0, 0.5, -0.3, 0.0]
    times = np.linspace(0.0, 1.2, 1201)
    best, place, speed = calc_cost(times, np.interp(times, corners, heights), 1e-3)
    scenario = ask(
        initial_position=[0.0],
        periodic={},
        duration=1.2,
        time_step=0.02,
        control_weight=1e-3,
        position_weight=1.0,
        reference_times=corners,
        reference_positions=[[height] for height in heights],
    )
    plan = Planner(scenario, QUICK, cart()).plan()
    assert plan.holds
    assert plan.cost == pytest.approx(best, rel=5e-3)
    assert abs(place) > 0.03  # It does not begin on the wave.
    np.testing.assert_allclose(plan.trajectory.states[0], [place, speed], atol=5e-3)
    np.testing.assert_allclose(plan.trajectory.states[-1], [place, speed], atol=5e-3)


def test_starts_stay_within_bounds_and_where_joints_are_named() -> None:
    scenario = ask(velocity_upper=WAY, velocity_lower=-1.0, position_lower=0.1, position_upper=0.6)
    plan = Planner(scenario, QUICK, cart()).plan()
    assert plan.trajectory.positions[0, 0] == 0.1
    assert plan.trajectory.velocities[0, 0] <= WAY
    assert plan.holds


@kernel
def measure_bounds(program: Any, states: Floats, controls: Floats, job: int, memory: Any) -> float:
    program, memory = borrow(program), borrow(memory)
    return visit_bounds(program, borrow(states), borrow(controls), 2.0, job, memory)


@pytest.mark.slow
def test_slopes_of_a_return_are_differences_along_the_manifold() -> None:
    rng = np.random.default_rng(4)
    plant = make_floating(rng)
    (q, _, _), n, nq, tree = sample_state(plant, rng), 8, 9, Tree.of(plant)
    problem = make_problem(plant, q, q, 3, 0.2, np.zeros(16))
    limits = np.stack([-problem.scales, problem.scales])
    goal = np.concatenate([np.where(tree.places >= 0, q[tree.places], 0.0), np.zeros(n)])
    problem = dataclasses.replace(
        problem,
        phases=Phases.free(0.2, (0.2, 0.2)),
        free_start=FreeStart(limits, np.zeros(16)),
        hard_goal=goal,
    )
    program = problem.make_program(ShootingOptions((Smoothing(0.0, 1, 1.0),)))
    memory, K = make_memory(program), len(program.kinds)
    states, controls = np.zeros((K + 1, nq + n + 2 + 2 * n)), np.zeros((K, 2))
    change = 0.6 * rng.normal(size=2 * n)
    # Rotation vectors are moved by their turn where they are small.
    off = 1e-4 * rng.normal(size=2 * n)
    states[:, :nq] = tree.add(tree.add(q, change[:n]), off[:n])
    states[:, nq:] = np.concatenate([change[n:] + off[n:], [0.2, 0.2], change])
    measure_bounds(program, states, controls, EXPAND, memory)
    gradient = memory.expansion.l1[K].copy()
    hessian = np.triu(memory.expansion.l2[K]) + np.triu(memory.expansion.l2[K], 1).T

    def measure(delta: Floats) -> float:
        moved = states.copy()
        moved[K, :nq] = tree.add(states[K, :nq], delta[:n])
        moved[K, nq:] += delta[n:]
        return float(measure_bounds(program, moved, controls, PENALIZE, memory))

    nz = 2 * n + 2 + 2 * n
    steps = 1e-5 * np.eye(nz)
    slopes = np.array([(measure(step) - measure(-step)) / 2e-5 for step in steps])
    np.testing.assert_allclose(gradient[:nz], slopes, atol=1e-7)
    curves = np.array([(measure(s) + measure(-s) - 2 * measure(0 * s)) / 1e-10 for s in steps])
    np.testing.assert_allclose(np.diag(hessian)[:nz], curves, atol=1e-3)
    # At no distance, moves of the end and of the start along with it cost nothing.
    assert np.linalg.eigvalsh(hessian[:nz, :nz]).min() > -1e-9
    assert np.linalg.matrix_rank(hessian[:nz, :nz], tol=1e-6) == 2 * n


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"periodic": {"cart": 0.4}}, r"periodic\[cart\]: .*expected one of cart_joint"),
        ({"periodic": {"cart_joint": [0.4, 0.0]}}, r"periodic\[cart_joint\]: got 2 numbers"),
        ({"periodic": {"cart_joint": "far"}}, r"periodic\[cart_joint\]: .*a number"),
        ({"periodic": 0.4}, "periodic: got 0.4, expected a mapping of names"),
        ({"goal_position": {"cart_joint": 0.5}}, "goal_position: .*and periodic"),
        ({"goal_position": [0.7]}, "goal_position or goal_velocity: .*advanced by what periodic"),
        ({"goal_velocity": [0.1]}, "goal_position or goal_velocity: .*Leave them out"),
        ({"goal_velocity_weight": 1.0}, "goal_velocity_weight: .*and periodic"),
        ({"position_weight": 1.0}, "position_weight: got periodic, and no reference"),
        ({"periodic": None}, "missing goal_position"),
    ],
)
def test_what_contradicts_a_motion_that_repeats_is_refused(
    changed: dict[str, Any], message: str
) -> None:
    with pytest.raises(ScenarioError, match=message):
        Planner(ask(**changed), QUICK, cart())


@pytest.mark.parametrize("name", ["room/two_walls", "pendulum/off_the_wall"])
def test_rigid_walls_and_balls_are_refused(name: str) -> None:
    given = {**Scenario.named(name).to_plain(), "periodic": {}}
    for field in ("goal_position", "goal_velocity", "position_weight", "goal_velocity_weight"):
        given.pop(field, None)
    with pytest.raises(ScenarioError, match="periodic: got rigid walls"):
        Planner(Scenario.from_plain(given))


def test_a_controller_that_plans_again_refuses_motions_that_repeat() -> None:
    planner = Planner(ask(), QUICK, cart())
    with pytest.raises(ControlError, match=r"a motion that repeats.*TrackingController"):
        ModelPredictiveController(planner, period=0.01)


def test_a_start_may_press_feet_and_is_at_bounds_to_rounding() -> None:
    given = Scenario.named("quadruped/leap_up").to_plain() | {"periodic": {"body": [0.2, 0, None]}}
    del given["goal_position"], given["goal_velocity_weight"]
    given["initial_position"]["body"]["xyz"][2] -= 5e-3  # A gait steps down on them so.
    world = SpaceWorld.from_scenario(Scenario.from_plain(given))
    scenario = world.place(Scenario.from_plain(given))
    advance = world.find_advance(scenario)
    assert np.flatnonzero(np.isfinite(advance)).tolist() == [3, 4]
    with pytest.raises(ScenarioError, match="overlap"):
        world.check(dataclasses.replace(scenario, periodic=None))
    bounded = ask(velocity_upper=WAY, velocity_lower=-1.0)
    cart().bounds(cart().place(bounded).starting_at(np.array([0.1, WAY * (1 + 1e-15)])))
    with pytest.raises(ScenarioError, match="initial_velocity"):
        cart().bounds(cart().place(bounded).starting_at(np.array([0.1, WAY * (1 + 1e-5)])))


def test_a_motion_from_another_guess_returns_to_its_own_start() -> None:
    planner = Planner(ask(), QUICK, cart())
    plan = planner.plan(initial_position=[0.3])
    np.testing.assert_allclose(plan.trajectory.positions[[0, -1], 0], [0.3, 0.7], atol=1e-4)
    with pytest.raises(ScenarioError, match="goal_position or goal_velocity"):
        planner.plan(goal_position=[0.9])


def test_plans_keep_their_start_in_files_and_for_controllers(tmp_path: Path) -> None:
    plan = Planner(ask(), QUICK, cart()).plan()
    plan.save(tmp_path / "plan.json")
    again = Plan.load(tmp_path / "plan.json")
    start = plan.trajectory.states[0]
    np.testing.assert_array_equal(again.scenario.initial_state, start)
    assert dict(again.scenario.periodic or {}) == {"cart_joint": (WAY,)}
    assert Scenario.from_plain(again.scenario.to_plain()) == plan.scenario
    controller = TrackingController(again, cart())
    state = start
    for _ in range(3):  # Periods, each by the same feedback from where the last one ended.
        begin = state[:1], state[1:]
        recording = EVENT_DRIVEN.simulate(cart(), again.scenario, controller.feedback, begin)
        state = np.concatenate([recording.positions[-1] - WAY, recording.velocities[-1]])
    np.testing.assert_allclose(state, start, atol=1e-4)


def test_a_free_duration_is_chosen_with_the_start() -> None:
    # At one speed w, ∫ (u² price + W (v − PACE)²) dt = (price d² w² + W (w − PACE)²) WAY / w, which
    # is least where price d² w² + W w² = W PACE².
    pace, weight = 0.5, 0.2
    scenario = ask(
        duration_range=(0.4, 2.0),
        velocity_weight=weight,
        reference_times=[0.0, 1.0],
        reference_velocities=[[pace], [pace]],
    )
    plan = Planner(scenario, QUICK, cart()).plan()
    assert plan.holds
    speed = pace * np.sqrt(weight / (PRICE * DAMPING**2 + weight))
    rate = PRICE * (DAMPING * speed) ** 2 + weight * (speed - pace) ** 2
    assert plan.trajectory.velocities[0, 0] == pytest.approx(speed, rel=1e-2)
    assert plan.trajectory.times[-1] == pytest.approx(WAY / speed, rel=1e-2)
    assert plan.cost == pytest.approx(rate * WAY / speed, rel=1e-3)


@pytest.mark.slow
def test_a_hopper_hops_on_and_on() -> None:
    given = Scenario.named("hopper/hop").to_plain()
    for name in ("goal_position", "goal_weight", "goal_velocity_weight"):
        del given[name]
    given |= {
        "periodic": {"along": 0.4},
        "duration": 0.75,
        "reference_times": [0.0, 0.375, 0.75],
        "reference_positions": [[0.1, 0.5, 0, 0.5], [0.3, 0.8, 0, 0.1], [0.5, 0.5, 0, 0.5]],
    }
    options = PlanOptions(starts=8, renewals=8, finalists=1, seed=1)
    plan = Planner(Scenario.from_plain(given), options).plan()
    assert plan.holds and plan.reached
    assert plan.best.contacts and np.ptp(plan.trajectory.positions[:, 1]) > 0.05
    world, scenario, state = plan.find_world(), plan.scenario, plan.scenario.initial_state
    way = scenario.goal_position - scenario.initial_position
    np.testing.assert_allclose(way, [0.4, 0.0, 0.0, 0.0], atol=1e-12)
    for _ in range(3):
        begin = state[:4], state[4:]
        feedback = Feedback(world, scenario, plan.trajectory)
        recording = EVENT_DRIVEN.simulate(world, scenario, feedback, begin)
        state = np.concatenate([recording.positions[-1] - way, recording.velocities[-1]])
        np.testing.assert_allclose(state, scenario.initial_state, atol=2e-3)
    assert "chosen by the plan" in format_plan(plan)
