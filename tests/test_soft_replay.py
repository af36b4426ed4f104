"""Walls that are springs: our own integration, Drake's plant and closed forms say the same."""

from __future__ import annotations

import inspect
import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from mechanisms import build
from replay_worlds import make_diagram
from scipy.integrate import quad, solve_ivp

from drake_aigto import Scenario, World
from drake_aigto.contact import calc_dissipation
from drake_aigto.errors import ScenarioError
from drake_aigto.simulation import DRAKE, Replay, make_simulator, replay_drake, replay_event_driven
from drake_aigto.world import TaskCost

read = cache(build)
MODEL = "cart_pole_soft_06"
TIMES = np.linspace(0.0, 1.5, 61)


def ask(q: Any, v: Any, **fields: Any) -> Scenario:
    """Returns SPOT's task: swing up between soft walls."""
    given: dict[str, Any] = {
        "goal_position": [0.0, math.pi],
        "duration": 1.5,
        "time_step": 0.025,
        "goal_weight": [10.0, 10.0],
        "goal_velocity_weight": [0.0, 0.025],
        "position_weight": [20.0, 20.0],
        "velocity_weight": [0.0, 0.05],
        "control_weight": 0.05,
        "angles": "chordal",
    }
    task: dict[str, Any] = {"initial_position": q, "initial_velocity": v, "contact": "compliant"}
    return Scenario(**(given | task | fields))


def draw(seed: int) -> tuple[Scenario, Any]:
    rng = np.random.default_rng(seed)
    start = [rng.uniform(-0.2, 0.2), rng.uniform(-0.6, 0.6)], rng.uniform(-3, 3, 2)
    return ask(*start), rng.uniform(-15, 15, (60, 1))


def bounce(
    v: float = 2.0,
    q: float = 0.5,
    stiffness: float = 400.0,
    dissipation: float = 0.0,
    thickness: float = 0.0,
) -> tuple[Replay, Replay]:
    """Returns both replays of a ball of 1.5 kg before a wall of half this stiffness."""
    diagram = make_diagram(stiffness=stiffness, dissipation=dissipation, thickness=thickness)
    world = World.from_diagram(diagram)
    scenario = Scenario(
        initial_position=q, initial_velocity=-v, goal_position=1.0, contact="compliant"
    )
    task = world, scenario, np.linspace(0, 1, 11), np.zeros((10, 1))
    return replay_event_driven(*task), replay_drake(*task)


@pytest.mark.parametrize("seed", range(3))
def test_drakes_plant_does_what_the_worlds_equations_say(seed: int) -> None:
    scenario, controls = draw(seed)
    own = replay_event_driven(read(MODEL), scenario, TIMES, controls)
    drake = replay_drake(read(MODEL), scenario, TIMES, controls)
    assert (own.simulator, drake.simulator) == ("integrated", "drake")
    assert drake.cost == pytest.approx(own.cost, rel=1e-6)
    assert drake.goal_error == pytest.approx(own.goal_error, rel=1e-6)
    np.testing.assert_allclose(drake.positions[-1], own.positions[-1], atol=1e-6)
    assert drake.bounce_contacts == own.bounce_contacts
    np.testing.assert_allclose(drake.bounce_times, own.bounce_times, atol=1e-6)
    np.testing.assert_allclose(drake.energies_before, own.energies_before, rtol=1e-5)
    assert drake.max_penetration == pytest.approx(own.max_penetration, abs=1e-4)
    assert own.compliance_error == drake.compliance_error == 0.0


def test_a_start_deep_in_a_wall_is_pushed_out_by_both() -> None:
    scenario = ask([0.5, 0.6], [0.0, 0.0])
    controls = np.zeros((60, 1))
    own = replay_event_driven(read(MODEL), scenario, TIMES, controls)
    drake = replay_drake(read(MODEL), scenario, TIMES, controls)
    depth = -float(np.min(read(MODEL).calc_clearance(own.positions[0])))
    assert own.max_penetration >= depth > 0.3
    assert drake.cost == pytest.approx(own.cost, rel=1e-6)
    assert drake.bounce_contacts == own.bounce_contacts
    assert all(time > 0 for time in own.bounce_times)


def test_a_start_in_a_box_that_yields_is_pushed_out_while_the_center_is_outside() -> None:
    # A sphere of 0.1 m before a box: half a radius inside, and lying on it.
    for q in (-0.05, 0.0):
        own, drake = bounce(q=q, v=0.0, thickness=0.5)
        assert own.max_penetration == pytest.approx(-q) and own.positions[-1, 0] >= q
        np.testing.assert_allclose(own.positions[-1], drake.positions[-1], atol=1e-5)
    world = World.from_diagram(make_diagram(stiffness=400.0, thickness=0.5))
    lying: dict[str, Any] = {"initial_velocity": 0.0, "goal_position": 1.0}
    world.check(Scenario(initial_position=-0.05, contact="compliant", **lying))
    for changes in (
        {"initial_position": -0.11, "contact": "compliant"},
        {"initial_position": -0.05},
    ):
        with pytest.raises(ScenarioError, match="initial_position is inside or behind"):
            world.check(Scenario(**lying, **changes))


@pytest.mark.parametrize("dissipation", [0.3, 3.0])
def test_a_ball_that_is_pulled_out_faster_than_the_wall_follows_feels_nothing(
    dissipation: float,
) -> None:
    # It starts 0.1 m inside, and leaves so fast that 1 + d ẋ < 0.
    own, drake = bounce(v=-5.0, q=-0.1, dissipation=dissipation)
    np.testing.assert_allclose(own.positions[-1], drake.positions[-1], atol=1e-7)
    np.testing.assert_allclose(own.velocities[-1], drake.velocities[-1], atol=1e-6)
    assert (own.velocities[-1, 0] == pytest.approx(5.0)) == (dissipation * 5.0 > 1.0)


def test_a_contact_is_half_a_period_of_the_mass_on_the_spring() -> None:
    own, drake = bounce()
    omega = math.sqrt(200.0 / 1.5)
    for replay in (own, drake):
        assert replay.bounce_times == pytest.approx((0.25,), abs=1e-8)
        assert replay.max_penetration == pytest.approx(2.0 / omega, rel=1e-4)
        assert replay.energy_ratio == pytest.approx(1.0, abs=1e-4)
        end = 2.0 * (0.75 - math.pi / omega)
        assert replay.positions[-1, 0] == pytest.approx(end, abs=1e-7)


@pytest.mark.parametrize("e", [0.9, 0.5, 0.1])
def test_dissipation_returns_the_restitution_that_it_was_made_for(e: float) -> None:
    own, _ = bounce(stiffness=4e4, dissipation=2 * calc_dissipation(e, 2.0) / 2)
    assert own.velocities[-1, 0] == pytest.approx(2.0 * e, rel=1e-8)


def test_without_dissipation_and_control_mechanism_and_springs_keep_their_energy() -> None:
    world, scenario = read(MODEL), ask([0.1, 0.5], [2.0, -3.0])
    replay = replay_event_driven(world, scenario, TIMES, np.zeros((60, 1)))
    assert len(replay.bounce_times) >= 2
    context = world.plant.GetMyMutableContextFromRoot(world.create_context())
    energies = []
    for q, v in zip(replay.positions, replay.velocities, strict=True):
        world.plant.SetPositions(context, q)
        world.plant.SetVelocities(context, v)
        depths = np.maximum(0.0, -world.calc_signed_distance(q))
        springs = world.stiffness @ depths**2 / 2
        energies.append(
            world.plant.CalcPotentialEnergy(context)
            + world.plant.CalcKineticEnergy(context)
            + springs
        )
    np.testing.assert_allclose(energies, energies[0], atol=1e-10)


def test_running_costs_are_those_of_the_integral() -> None:
    scenario, controls = draw(3)
    world = read(MODEL)
    stiffness, task = world.stiffness, TaskCost.of(world, scenario)

    def rates(t: float, y: Any, u: Any) -> Any:
        q, v = y[:2], y[2:4]
        forces = stiffness * np.maximum(0.0, -world.calc_signed_distance(q))
        a = world.calc_acceleration(q, v, u) + world.calc_velocity_change(q, forces)
        return [*v, *a, float(task.running(t, q, v, u))]

    y = np.array([*scenario.initial_position, *scenario.initial_velocity, 0.0])
    for start, end, u in zip(TIMES, TIMES[1:], controls, strict=False):
        run = solve_ivp(rates, (start, end), y, args=(u,), rtol=1e-11, atol=1e-11)
        y = run.y[:, -1]
    expected = y[4] + float(task.final(y[:2], y[2:4]))
    replay = replay_event_driven(world, scenario, TIMES, controls)
    assert replay.cost == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("contact", ["rigid", "compliant"])
def test_a_reference_between_knots_is_followed_exactly(contact: Any) -> None:
    # A ball flies freely, away from the wall: q = 1 + 2t; the reference has a kink at 0.37 s.
    world = World.from_diagram(make_diagram())
    scenario = Scenario(
        initial_position=1.0,
        initial_velocity=2.0,
        goal_position=3.0,
        goal_weight=0.0,
        position_weight=1.0,
        reference_times=[0.0, 0.37, 1.0],
        reference_positions=[[1.0], [0.0], [4.0]],
        contact=contact,
    )

    def error(t: float) -> float:
        return float((1 + 2 * t - np.interp(t, [0, 0.37, 1.0], [1.0, 0.0, 4.0])) ** 2)

    expected = quad(error, 0, 0.37)[0] + quad(error, 0.37, 1.0)[0]
    for run in (replay_event_driven, replay_drake):
        replay = run(world, scenario, [0.0, 0.5, 1.0], [[0.0], [0.0]])
        assert replay.cost == pytest.approx(expected, rel=1e-8)


def test_a_simulator_of_a_soft_task_has_the_models_walls() -> None:
    scenario, _ = draw(1)
    world = read(MODEL)
    simulator = make_simulator(world, scenario)
    context = world.plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    world.plant.get_actuation_input_port().FixValue(context, [3.0])
    simulator.AdvanceTo(1.5)
    expected = replay_event_driven(world, scenario, TIMES, np.full((60, 1), 3.0))
    q = world.plant.GetPositions(context)
    np.testing.assert_allclose(q, expected.positions[-1], atol=1e-6)
    assert expected.bounce_times


def test_error_control_shortens_steps_no_further_after_many(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = Scenario.named("pushed_block/slide")
    world, times = World.from_scenario(scenario), np.linspace(0.0, scenario.duration, 41)
    push = 2.0 * np.cos(3.0 * times[:-1, np.newaxis])
    judge: Any = inspect.getmodule(type(DRAKE))
    simulators, start = [], judge.start_plant

    def remember(*given: Any) -> Any:
        simulators.append(start(*given)[0])
        return simulators[-1], None

    monkeypatch.setattr(judge, "start_plant", remember)
    fine = replay_drake(world, scenario, times, push)
    monkeypatch.setattr(judge, "_MOST_STEPS", 50)
    coarse = replay_drake(world, scenario, times, push)
    shortest, longest = (each.get_integrator() for each in simulators)
    assert shortest.get_smallest_adapted_step_size_taken() < 1e-6
    assert longest.get_smallest_adapted_step_size_taken() > 1e-5
    assert coarse.cost == pytest.approx(fine.cost, rel=1e-4)
