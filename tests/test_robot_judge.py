"""The judge of robots, with equations by hand, is right, and plans are what they promise."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.rivals import draw_controls, shoot
from benchmarks.robots.judge import Control, judge
from benchmarks.robots.mechanics import MECHANISMS
from benchmarks.robots.setting import model_of
from drake_aigto import PlanOptions, Scenario, World, plan, scenario_names
from drake_aigto.planning import make_mechanism_task
from drake_aigto.shooting import ShootingProblem
from drake_aigto.simulation import replay_drake, replay_event_driven

# Kernels that only the judge has take twenty seconds to compile.
pytestmark = pytest.mark.slow

# Touches both walls thrice, and is unstable.
SOFT = replace(
    Scenario.named("cart_pole/soft_06"),
    initial_position=[0.147, 0.72],
    initial_velocity=[0.383, 2.91],
)
SWING_UP = Scenario.named("acrobot/swing_up")
PENDULUM = Scenario.named("pendulum/off_the_wall")


ROBOTS = [each for each in scenario_names() if model_of(Scenario.named(each)) in MECHANISMS]


def pose(scenario: Scenario) -> ShootingProblem:
    world = World.from_scenario(scenario)
    return make_mechanism_task(world, scenario, PlanOptions()).shooting(scenario.num_steps)


def push(scenario: Scenario, values: Any) -> Control:
    return Control.even(np.reshape(values, (len(values), -1)), scenario.duration)


def integrate(scenario: Scenario, wall: float, controls: np.ndarray) -> float:
    """Returns J of the cart-pole by SciPy, from the mass matrix."""
    mass, tip, length, gravity, stiffness = 1.0, 0.1, 0.8, 9.8, 200.0

    def slope(t: float, x: np.ndarray, u: float) -> np.ndarray:
        a, v, th, w, _ = x
        p = a + length * np.sin(th)
        f = stiffness * (max(0.0, -wall - p) - max(0.0, p - wall))
        coupling = tip * length * np.cos(th)
        inertia = [[mass + tip, coupling], [coupling, tip * length**2]]
        force = [
            u + f + tip * length * np.sin(th) * w**2,
            length * np.cos(th) * f - tip * gravity * length * np.sin(th),
        ]
        dv, dw = np.linalg.solve(inertia, force)
        running = 20 * a**2 + 40 * (1 + np.cos(th)) + 0.05 * w**2 + 0.05 * u**2
        return np.array([v, dv, w, dw, running])

    (a, th), (v, w) = scenario.initial_position, scenario.initial_velocity
    x = np.array([a, v, th, w, 0.0])
    for u in controls:
        span = (0.0, scenario.duration / controls.size)
        x = solve_ivp(slope, span, x, "DOP853", args=(u,), rtol=1e-9, atol=1e-9).y[:, -1]
    return float(x[4] + 10 * x[0] ** 2 + 20 * (1 + np.cos(x[2])) + 0.025 * x[3] ** 2)


@pytest.mark.parametrize("wall", [0.6, 1.0])
def test_the_judge_agrees_with_another_integration_of_the_mass_matrix(wall: float) -> None:
    scenario = replace(SOFT, model=Scenario.named(f"cart_pole/soft_{10 * wall:02.0f}").model)
    controls = 12.0 * np.sin(np.linspace(0.0, 9.0, 30))
    cost = judge(scenario, push(scenario, controls)).cost
    assert cost == pytest.approx(integrate(scenario, wall, controls), rel=1e-6)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_judge_agrees_with_the_event_driven_replay(name: str) -> None:
    scenario = Scenario.named(name)
    control = Control(pose(scenario).times, draw_controls(pose(scenario), np.random.default_rng(4)))
    replay = replay_event_driven(World.from_scenario(scenario), scenario, *control)
    assert judge(scenario, control).cost == pytest.approx(replay.cost, rel=1e-7)


def test_the_judge_lets_carts_push_each_other_and_part_again() -> None:
    scenario = Scenario.named("three_carts/apart")
    control = push(scenario, np.repeat([10.0, -9.0], [7, 13]))
    judgment = judge(scenario, control)
    replay = replay_event_driven(World.from_scenario(scenario), scenario, *control)
    assert judgment.touches == len(replay.bounce_times) == 2
    assert judgment.cost == pytest.approx(replay.cost, rel=1e-8)


def test_the_judge_sees_a_bounce_that_is_shorter_than_its_steps() -> None:
    """The weakest torque that touches the wall at all is the same for the replay."""
    scenario = replace(PENDULUM, initial_position=[0.719], initial_velocity=[0.814], duration=1.42)
    misses, touches = 8.0, -8.0
    for _ in range(27):
        middle = (misses + touches) / 2
        is_touched = judge(scenario, push(scenario, [middle])).touches > 0
        misses, touches = (misses, middle) if is_touched else (middle, touches)
    for torque, is_touched in (misses, False), (touches, True):
        control = push(scenario, [torque])
        replay = replay_event_driven(World.from_scenario(scenario), scenario, *control)
        assert (len(replay.bounce_times) > 0) == is_touched


def test_the_judge_clips_forces_and_refuses_a_cart_that_leaves_its_range() -> None:
    most = judge(SOFT, push(SOFT, np.full(10, 20.0)))
    assert judge(SOFT, push(SOFT, np.full(10, 90.0))) == most
    assert most.excess > 0.5
    assert math.isinf(most.score)


def test_a_control_that_ends_early_or_late_costs_the_whole_duration() -> None:
    held = push(SOFT, np.ones(10))
    for end in (1.4, 1.6):
        off = held._replace(times=np.append(held.times[:-1], end))
        assert judge(SOFT, off) == judge(SOFT, held)


def test_a_throw_that_misses_its_goal_is_no_solution() -> None:
    scenario = Scenario.named("throwing_ball/bounces")
    judgment = judge(scenario, push(scenario, np.zeros((10, 2))))
    assert judgment.excess == pytest.approx(4.0)
    assert math.isinf(judgment.score)


@pytest.mark.parametrize("scenario", [SOFT, SWING_UP, PENDULUM, Scenario.named("paddle/bat")])
def test_a_plan_is_judged_to_cost_what_it_promises_and_drake_agrees(scenario: Scenario) -> None:
    found = plan(scenario, PlanOptions(confirm=False))
    control = Control(found.trajectory.times, found.trajectory.controls)
    judgment = judge(scenario, control)
    assert judgment.score == pytest.approx(found.cost, rel=1e-3)
    replay = replay_drake(World.from_scenario(scenario), scenario, *control)
    assert replay.cost == pytest.approx(judgment.cost, rel=1e-2)


# Another search found these optima: Pontryagin's principle leaves u(0) and u̇(0), gridded, polished.
@pytest.mark.parametrize(
    ("start", "velocity", "goal", "duration", "e", "by_principle"),
    [
        (-0.2875964, 2.91362379, 0.777216, 0.8, 0.8, 0.0020460108962915436),
        (-0.15199959, 0.53295805, 1.13381413, 1.24, 0.5, 0.1904961066732006),
    ],
)
def test_plans_of_a_pendulum_find_the_optima_of_pontryagins_principle(
    start: float, velocity: float, goal: float, duration: float, e: float, by_principle: float
) -> None:
    scenario = replace(
        PENDULUM,
        initial_position=[start],
        initial_velocity=[velocity],
        goal_position=[goal],
        duration=duration,
        restitution=e,
    )
    found = plan(scenario, PlanOptions(confirm=False))
    assert found.cost == pytest.approx(by_principle, rel=5e-3)
    control = Control(found.trajectory.times, found.trajectory.controls)
    assert judge(scenario, control).score == pytest.approx(by_principle, rel=5e-3)


@pytest.mark.parametrize("scenario", [SOFT, SWING_UP])
def test_what_random_shooting_promises_is_what_the_judge_finds(scenario: Scenario) -> None:
    problem, rng = pose(scenario), np.random.default_rng(0)
    (promised, control), *_ = shoot([problem], [draw_controls(problem, rng)])
    assert judge(scenario, control).score == pytest.approx(promised, rel=1e-4)
