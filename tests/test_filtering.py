"""States filtered: as near as they are said to be, between walls, with friction, in space."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from loops import BALL
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto import (
    ModelPredictiveController,
    Plan,
    Planner,
    Scenario,
    TrackingController,
    World,
)
from drake_aigto.control import Disturbance, StateFilter, run_in_loop
from drake_aigto.errors import ControlError
from drake_aigto.show import format_run
from drake_aigto.simulation import EVENT_DRIVEN, HeldControl, tangent_scales
from drake_aigto.world import Scales

POLE, BLOCK = Scenario.named("cart_pole/soft_06"), Scenario.named("pushed_block/slide")
PERIOD = 0.02


@cache
def plan(name: str) -> Plan:
    return Planner(Scenario.named(name)).plan()


def start(scenario: Scenario) -> Any:
    return np.concatenate([scenario.initial_position, scenario.initial_velocity])


def run(world: World, scenario: Scenario, noise: Any, measured: Any, u: Any) -> Any:
    builder, times = DiagramBuilder(), PERIOD * np.arange(len(measured) + 1)
    held = PiecewisePolynomial.ZeroOrderHold(times, np.vstack([measured, measured[-1:]]).T)
    quiet = builder.AddSystem(StateFilter(world, scenario, noise, PERIOD))
    for port, source in (
        ("measured_state", TrajectorySource(held)),
        ("control", ConstantVectorSource(u)),
    ):
        builder.Connect(builder.AddSystem(source).get_output_port(), quiet.GetInputPort(port))
    simulator = Simulator(builder.Build())
    context = quiet.GetMyContextFromRoot(simulator.get_context())
    found = []
    for time in times[:-1]:
        simulator.AdvanceTo(time)
        simulator.AdvancePendingEvents()
        found.append(quiet.get_output_port().Eval(context))
    return np.array(found), quiet.read_covariance(context)


def simulate(world: World, scenario: Scenario, u: Any, count: int, off: Any = 0.0) -> Any:
    """Returns states a period apart, from a start that is off the scenario's."""
    judge: Any = EVENT_DRIVEN
    rows = [start(scenario) + off]
    held = HeldControl(np.array([0.0, PERIOD]), np.array(u)[np.newaxis])
    for _ in range(count - 1):
        end = judge.simulate(world, scenario, held, state=world.split(rows[-1]))
        rows.append(np.concatenate([end.positions[-1], end.velocities[-1]]))
    return np.array(rows)


def test_in_free_flight_it_is_kalmans_filter() -> None:
    world, rng = World.from_scenario(BALL), np.random.default_rng(3)
    n, count = world.num_positions, 10
    noise = np.repeat([2e-3, 2e-2], n)
    u = 0.1 * rng.normal(size=world.num_actuators)
    # Half of the noise, so that no sample is doubted.
    true = simulate(world, BALL, u, count, 10 * noise)
    measured = true + noise / 2 * rng.normal(size=(count, 2 * n))
    found, covariance = run(world, BALL, noise, measured, u)
    F, R = np.eye(2 * n) + PERIOD * np.eye(2 * n, k=n), np.diag(noise**2)
    _, speeds = np.split(tangent_scales(world, BALL), 2)
    unknown = (0.05 * speeds) ** 2 * PERIOD / Scales.of(world, BALL).time
    Q = np.diag(np.concatenate([unknown * PERIOD**2 / 3, unknown]))
    a = world.calc_acceleration(*world.split(start(BALL)), u)
    moved = np.concatenate([PERIOD**2 / 2 * a, PERIOD * a])
    x, P = measured[0], R
    for z in measured[1:]:
        x, P = F @ x + moved, F @ P @ F.T + Q
        gain = P @ np.linalg.inv(P + R)
        x, P = x + gain @ (z - x), P - gain @ P
    np.testing.assert_allclose(found[-1], x, rtol=0, atol=1e-9)
    np.testing.assert_allclose(covariance, P, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("scenario", [POLE, BLOCK], ids=["pole", "block"])
def test_estimates_are_as_near_as_they_are_said_to_be(scenario: Scenario) -> None:
    world, rng = World.from_scenario(scenario), np.random.default_rng(1)
    n, count = world.num_positions, 40
    noise = np.repeat([2e-3, 2e-2], n)
    u = np.max(np.abs(np.clip(world.bounds(scenario).control, -5, 5)), axis=0)
    true = simulate(world, scenario, u, count, 10 * noise)
    ratios, shares = [], []
    for _ in range(2):
        measured = true + noise * rng.normal(size=true.shape)
        found, P = run(world, scenario, noise, measured, u)
        error = world.calc_error(found[-1], true[-1])
        ratios.append(error @ np.linalg.solve(P, error) / (2 * n))
        both = [world.calc_error(each, true)[5:] / noise for each in (found, measured)]
        shares.append(np.linalg.norm(both[0]) / np.linalg.norm(both[1]))
    assert np.mean(ratios) < 3.0
    assert max(shares) < 0.6


@pytest.mark.parametrize("push", [0.0, 0.5])
def test_what_nothing_disturbs_is_where_the_model_says(push: float) -> None:
    """And what something pushes, if slowly, is where samples say."""
    world, rng, count = World.from_scenario(BALL), np.random.default_rng(6), 50
    noise, u = np.array([5e-3, 5e-2]), np.array([0.1])
    true = simulate(world, BALL, u + push, count)
    found, _ = run(world, BALL, noise, true + noise * rng.normal(size=true.shape), u)
    errors = np.abs(found - true) / noise
    assert np.max(errors[1:]) < 4.0
    assert push or np.max(errors) < 1e-6


def test_a_kick_is_believed_at_once_and_a_gap_goes_through() -> None:
    world, n = World.from_scenario(BALL), len(BALL.initial_position)
    noise, u = np.repeat([2e-3, 2e-2], n), np.zeros(len(BALL.initial_position))
    measured = simulate(world, BALL, u, 12)
    measured[6:, n] += 1.0
    measured[6:, 0] += PERIOD * np.arange(6)
    measured[9] = np.nan
    found, _ = run(world, BALL, noise, measured, u)
    assert np.all(np.abs(found[6] - measured[6]) < 3 * noise)
    assert np.all(np.isnan(found[9]))
    assert np.all(np.abs(found[10] - measured[10]) < 3 * noise)


def test_a_bounce_is_no_surprise() -> None:
    """After an impact that the model has, estimates are no farther off than samples."""
    corridor = Scenario.named("corridor/three_bounces")
    world, rng, found = World.from_scenario(corridor), np.random.default_rng(2), []
    n, u = world.num_positions, np.zeros(world.num_actuators)
    noise = np.repeat([2e-3, 2e-2], n)
    true = simulate(world, corridor, u, 40, 10 * noise)
    turned = np.flatnonzero(np.any(true[1:, n:] * true[:-1, n:] < 0, axis=1)) + 1
    assert len(turned)
    for _ in range(3):
        measured = true + noise * rng.normal(size=true.shape)
        found.append((run(world, corridor, noise, measured, u)[0] - true) / noise)
    assert np.all(np.abs(np.array(found)[:, turned]) < 4.0)


def test_a_turn_in_space_is_filtered() -> None:
    asked, rng = Scenario.named("drone/perch"), np.random.default_rng(4)
    world = World.from_scenario(asked)
    perch = world.place(asked)
    noise = np.concatenate(
        [np.full(world.num_positions, 2e-3), np.full(world.num_velocities, 2e-2)]
    )
    u = np.zeros(world.num_actuators)
    true = simulate(world, perch, u, 12)
    measured = true + noise * rng.normal(size=true.shape)
    found, _ = run(world, perch, noise, measured, u)
    errors = [np.linalg.norm(world.calc_error(each[4:], true[4:])) for each in (found, measured)]
    assert errors[0] < 0.7 * errors[1]
    assert np.linalg.norm(found[-1][:4]) == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["floor/rebound", "room/bank_shot"])
def test_no_command_answers_a_bounce_with_what_was_before_it(name: str) -> None:
    """It would take 54 N for a moment: felt and filtered, a bounce is not at the same time."""
    rebound = plan(name)
    noise = Disturbance(noise=np.repeat([2e-3, 2e-2], len(rebound.scenario.initial_position)))
    controller = TrackingController(rebound, period=0.01)
    loop = run_in_loop(controller, rebound.scenario, disturbance=noise, filters=True)
    assert loop.is_filtered and "(seed 0), filtered before the controller" in format_run(loop)
    assert np.max(np.abs(loop.controls)) < 3.0
    assert loop.cost < 1.2 * rebound.cost


@pytest.mark.slow
@pytest.mark.parametrize("again", [False, True])
def test_a_loop_costs_less_with_a_filter(again: bool) -> None:
    base, planner = plan("table1/1"), Planner(BALL)
    noise = Disturbance(noise=5e-3 * np.array([1.0, 10.0]))

    def cost(filters: bool) -> float:
        controller: Any = TrackingController(base, period=0.01)
        if again:
            controller = ModelPredictiveController(planner, 0.01, horizon="shrinking", plan=base)
        return run_in_loop(controller, BALL, disturbance=noise, filters=filters).cost

    assert cost(True) < 0.8 * cost(False)


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        ([1e-3], "got .*0.001.*expected standard deviations of q and v, 2 numbers"),
        ([0.0, 0.0], "some above zero"),
        ([1e-3, -1e-3], "standard deviations"),
        ([1e-3, np.inf], "standard deviations"),
    ],
)
def test_noise_that_is_none_is_refused(noise: Any, message: str) -> None:
    with pytest.raises(ControlError, match=f"(?s){message}"):
        StateFilter(World.from_scenario(BALL), BALL, noise, PERIOD)


def test_nothing_to_filter_is_refused() -> None:
    with pytest.raises(ControlError, match="without noise"):
        run_in_loop(TrackingController(plan("table1/1")), BALL, filters=True)
    with pytest.raises(ControlError, match="period"):
        StateFilter(World.from_scenario(BALL), BALL, np.ones(2), 0.0)
