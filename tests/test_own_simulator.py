"""A diagram of one's own, in a Simulator whose walls return what the scenario says."""

from __future__ import annotations

import dataclasses
import gc
import inspect
import math
import weakref
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from marks import slow
from mechanisms import LEFT, MECHANISMS, build, build_stiff, build_world, stiffen
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus
from pydrake.systems.primitives import TrajectorySource, ZeroOrderHold
from pydrake.trajectories import PiecewisePolynomial
from replay_worlds import make_diagram, make_scenario
from scipy.integrate import quad, solve_ivp

from drake_aigto import Scenario, World
from drake_aigto.contact import calc_dissipation, contact_delay, contact_delays
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.simulation import (
    DRAKE,
    Replay,
    confirms,
    make_simulator,
    replay_drake,
    replay_event_driven,
)
from drake_aigto.world import Scales, TaskCost, find_anywhere, package_map

CORRIDOR = "package://drake_aigto_models/corridor.sdf"
# What the integrator makes of a control that jumps within its steps [m].
JUMPS = 1e-4


def make_corridor(
    mass: float | None = None,
    controls: npt.NDArray[np.float64] | None = None,
    period: float | None = None,
) -> World:
    """Returns a corridor that is driven in a diagram of one's own, for a second.

    Args:
        mass: of the ball [kg].
        controls: held between even knots, shape (N, 1) [N].
        period: of the sampling that the control goes through [s]; None: it does not.
    """
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    parser = Parser(plant)
    parser.package_map().AddMap(package_map())
    parser.AddModelsFromUrl(CORRIDOR)
    plant.Finalize()
    plant.SetDefaultPositions([0.5])
    if controls is not None:
        knots = np.linspace(0.0, 1.0, len(controls) + 1)
        held = PiecewisePolynomial.ZeroOrderHold(knots, np.vstack([controls, controls[-1:]]).T)
        port = builder.AddSystem(TrajectorySource(held)).get_output_port()
        if period is not None:
            sampler = builder.AddSystem(ZeroOrderHold(period, 1))
            builder.Connect(port, sampler.get_input_port())
            port = sampler.get_output_port()
        builder.Connect(port, plant.get_actuation_input_port())
    return World.from_diagram(builder.Build(), mass)


def make_task(speed: float, **fields: Any) -> Scenario:
    return make_scenario(0.5, -speed, 0.3, model=CORRIDOR, time_step=0.02, duration=1.0, **fields)


def simulate(world: World, scenario: Scenario) -> tuple[float, float]:
    simulator = make_simulator(world, scenario)
    simulator.AdvanceTo(scenario.duration)
    q, v = state_of(world, simulator.get_context())
    return q, v


def state_of(world: World, root: Context) -> list[float]:
    plant = world.plant
    return plant.GetPositionsAndVelocities(plant.GetMyContextFromRoot(root)).tolist()


CASES = [
    (1.0, 2.0, (0.3, None)),
    (0.5, 5.0, (5.0, 0.02)),
    (0.0, 5.0, (5.0, 0.02)),
    *slow((1.0, 5.0, (5.0, 0.02)), (0.5, 2.0, (0.3, None)), (0.9, 20.0, (1.0, None))),
]


@pytest.mark.parametrize(("e", "speed", "driven"), CASES)
def test_it_arrives_where_rigid_walls_lead_but_for_what_compliance_explains(
    e: float, speed: float, driven: tuple[float, float | None]
) -> None:
    mass, period = driven
    times = np.linspace(0.0, 1.0, 51)
    controls = 5 * mass * np.sin(9 * times[:-1])[:, np.newaxis]
    world = make_corridor(mass, controls, period)
    scenario = make_task(speed, restitution=e, mass=mass)
    rigid = replay_event_driven(world, scenario, times, controls)
    explained = replay_drake(world, scenario, times, controls).compliance_error
    end, _ = simulate(world, scenario)
    assert rigid.bounce_times
    assert abs(end - rigid.positions[-1, 0]) < explained + JUMPS
    assert explained < 0.1


@pytest.mark.parametrize("e", [1.0, 0.6])
def test_what_the_model_says_of_dissipation_does_not_count(e: float) -> None:
    # The shapes give none, so Drake's default: nearly nothing would come back.
    world = World.from_diagram(make_diagram(dissipation=None))
    scenario = dataclasses.replace(make_task(2.0), restitution=e)
    _, v = simulate(world, scenario)
    assert v == pytest.approx(2.0 * e, rel=1e-3)
    # The diagram is as it was.
    simulator = Simulator(world.diagram)
    plant = world.plant
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetPositionsAndVelocities(context, [0.5, -2.0])
    simulator.AdvanceTo(1.0)
    assert state_of(world, simulator.get_context())[1] < 0.5


def test_the_scenarios_restitution_and_start_count_and_each_run_is_its_own() -> None:
    world = make_corridor()
    speeds = [simulate(world, make_task(2.0, restitution=e))[1] for e in (0.5, 1.0, 0.5)]
    assert speeds == pytest.approx([1.0, -2.0, 1.0], rel=1e-3)


def test_a_monitor_of_ones_own_calls_the_one_that_is_there() -> None:
    world, scenario, times = make_corridor(), make_task(2.0, restitution=0.5), list[float]()
    simulator = make_simulator(world, scenario)
    contacts = simulator.get_monitor()

    def watch(root: Context) -> EventStatus:
        times.append(root.get_time())
        return contacts(root)

    simulator.set_monitor(watch)
    simulator.AdvanceTo(1.0)
    assert tuple(state_of(world, simulator.get_context())) == simulate(world, scenario)
    assert times[0] == 0.0 and times[-1] == 1.0


def test_it_may_be_set_back_and_run_again() -> None:
    world, scenario = make_corridor(), make_task(2.0, restitution=0.5)
    simulator = make_simulator(world, scenario)
    start = simulator.get_context().Clone()
    ends = []
    for _ in range(2):
        simulator.get_mutable_context().SetTimeStateAndParametersFrom(start)
        simulator.Initialize()
        simulator.AdvanceTo(1.0)
        ends.append(state_of(world, simulator.get_context()))
    assert ends[0] == pytest.approx(ends[1], abs=1e-6)


def test_simulators_are_freed() -> None:
    simulator = make_simulator(make_corridor(), make_task(2.0))
    simulator.AdvanceTo(0.1)
    gone = weakref.ref(simulator)
    del simulator
    gc.collect()
    assert gone() is None


def test_what_does_not_fit_is_refused_by_name() -> None:
    with pytest.raises(ScenarioError, match="mass: got 2 kg"):
        make_simulator(make_corridor(), make_task(2.0, mass=2.0))
    world, scenario = World.from_diagram(make_diagram(stiffness=None)), make_task(2.0)
    lacking = r"collision shape '.*' of '.*': got no stiffness, .*{stiffness: 2e9}}: 2e9 N/m"
    with pytest.raises(ModelError, match=lacking):
        make_simulator(world, scenario)
    with pytest.raises(ModelError, match=lacking):
        replay_drake(world, scenario, [0.0, 1.0], [[0.0]])


TIMES = np.linspace(0.0, 1.0, 21)
SOFT, STIFF = 1e5, 1e7

read = cache(build_stiff)


def ask(name: str, e: float = 1.0) -> Scenario:
    q, v = TASKS[name]
    return make_scenario(
        q,
        v,
        np.zeros(len(q)),
        goal_weight=np.ones(len(q)),
        position_weight=np.full(len(q), 0.5),
        control_weight=np.full(3 if name == "arm with a slider" else 1, 1e-3),
        restitution=e,
    )


TASKS: dict[str, tuple[Any, Any]] = {
    "pendulum": ([-1.0], [3.0]),
    "cart-pole": ([0.1, 0.5], [2.0, 3.0]),
    "arm with a slider": ([-0.5, -0.5, 0.2], [1.0, 1.5, 1.0]),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "e"), [("pendulum", 1.0), ("cart-pole", 0.6), ("arm with a slider", 1.0)]
)
def test_drake_is_late_by_what_contacts_last_at_two_stiffnesses(name: str, e: float) -> None:
    scenario = ask(name, e)
    misses, bounds = [], []
    for stiffness in (SOFT, STIFF):
        world = read(name, stiffness)
        rng = np.random.default_rng(2)
        controls = 5 * rng.uniform(-1, 1, (20, world.num_actuators))
        rigid = replay_event_driven(world, scenario, TIMES, controls)
        drake = replay_drake(world, scenario, TIMES, controls)
        assert drake.bounce_contacts == rigid.bounce_contacts != ()
        np.testing.assert_allclose(drake.energies_before, rigid.energies_before, rtol=0.1)
        np.testing.assert_allclose(drake.energy_ratios, rigid.energy_ratios, atol=0.03)
        miss = float(np.linalg.norm(drake.positions[-1] - rigid.positions[-1]))
        assert miss <= 1.2 * drake.compliance_error + 2e-5
        assert abs(drake.cost - rigid.cost) <= 1.2 * drake.compliance_cost + 1e-4
        misses.append(miss)
        bounds.append(drake.compliance_error)
    # √100 = 10 times as stiff in time.
    assert bounds[1] == pytest.approx(bounds[0] / 10, rel=0.3)
    assert misses[1] <= misses[0] / 5 + 2e-5
    assert bounds[0] <= 20 * misses[0] + 1e-3


def test_a_simulator_of_ones_own_bounces_a_mechanism_as_the_replay_does() -> None:
    world, scenario = read("cart-pole", STIFF), ask("cart-pole", 0.7)
    simulator = make_simulator(world, scenario)
    context = world.plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    world.plant.get_actuation_input_port().FixValue(context, [1.0])
    simulator.AdvanceTo(1.0)
    rigid = replay_event_driven(world, scenario, TIMES, np.ones((20, 1)))
    assert rigid.bounce_times
    np.testing.assert_allclose(world.plant.GetPositions(context), rigid.positions[-1], atol=2e-3)


def test_how_long_a_contact_lasts_is_told_by_the_mass_that_it_feels() -> None:
    world = read("cart-pole", STIFF)
    delays = []
    for q in (world.plant.GetDefaultPositions(), find_anywhere(world.plant)):
        J, M = world.calc_contact_jacobian(q)[0], world.calc_mass_matrix(q)
        mass = 1 / (J @ np.linalg.solve(M, J))
        delays.append(np.pi * np.sqrt(mass / STIFF))
        assert contact_delays(world, q)[0] == pytest.approx(delays[-1])
    assert delays[0] != delays[1]
    assert contact_delays(world)[0] == pytest.approx(min(delays))


def test_a_contact_lasts_a_while_also_where_a_rod_hangs_along_the_walls_normal() -> None:
    over_a_floor = MECHANISMS["pendulum"].replace(LEFT, "0 0 -0.85 0 0 0")
    world = build_world(stiffen(over_a_floor, STIFF))
    assert not np.any(world.calc_contact_jacobian(np.zeros(1)))
    assert np.isinf(world.inertia_at(np.zeros(1)).masses)
    assert 0 < contact_delay(world) < 0.1


def test_no_shipped_wall_is_late_because_a_rod_points_at_it_where_one_looks() -> None:
    # This start and the position beside it are such that the latter's rod lies along the normal.
    assert contact_delay(World.from_scenario(Scenario.named("pendulum/off_the_wall"))) < 1e-3


@pytest.mark.parametrize(
    ("name", "contact", "same"),
    [
        *slow(("cart_pole_rigid_06", "rigid", 1e-3)),
        ("cart_pole", "rigid", 1e-8),
        *slow(("", "compliant", 1e-5)),
    ],
)
def test_both_replays_agree_on_cart_poles(name: str, contact: Any, same: float) -> None:
    # Between shipped rigid walls, where nothing touches, and at a compliant wall, nearly rigid.
    world = build(name) if name else read("cart-pole", 1e9)
    scenario = dataclasses.replace(ask("cart-pole"), contact=contact)
    controls = np.full((20, 1), 2.0)
    own = replay_event_driven(world, scenario, TIMES, controls)
    drake = replay_drake(world, scenario, TIMES, controls)
    assert drake.cost == pytest.approx(own.cost, rel=same)
    assert own.bounce_contacts == drake.bounce_contacts
    assert bool(own.bounce_contacts) == (name != "cart_pole")
    if not own.bounce_contacts:
        np.testing.assert_allclose(drake.positions[-1], own.positions[-1], atol=1e-8)


def test_a_verdict_is_about_angles_as_about_lengths() -> None:
    world, scenario = read("cart-pole", STIFF), ask("cart-pole")
    scales = Scales.of(world, scenario)
    replay = replay_event_driven(world, scenario, TIMES, np.full((20, 1), 2.0))
    assert confirms(replay.cost, replay, scales, replay.goal_error)
    assert not confirms(0.9 * replay.cost, replay, scales, replay.goal_error)
    miss = 2e-3 * scales.length
    assert confirms(replay.cost, replay, scales, replay.goal_error - 0.9 * miss)
    assert not confirms(replay.cost, replay, scales, replay.goal_error - 1.1 * miss)


read_soft = cache(build)
MODEL = "cart_pole_soft_06"
SWING_TIMES = np.linspace(0.0, 1.5, 61)


def ask_swing(q: Any, v: Any, **fields: Any) -> Scenario:
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
    return ask_swing(*start), rng.uniform(-15, 15, (60, 1))


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
    own = replay_event_driven(read_soft(MODEL), scenario, SWING_TIMES, controls)
    drake = replay_drake(read_soft(MODEL), scenario, SWING_TIMES, controls)
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
    scenario = ask_swing([0.5, 0.6], [0.0, 0.0])
    controls = np.zeros((60, 1))
    own = replay_event_driven(read_soft(MODEL), scenario, SWING_TIMES, controls)
    drake = replay_drake(read_soft(MODEL), scenario, SWING_TIMES, controls)
    depth = -float(np.min(read_soft(MODEL).calc_clearance(own.positions[0])))
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
    world, scenario = read_soft(MODEL), ask_swing([0.1, 0.5], [2.0, -3.0])
    replay = replay_event_driven(world, scenario, SWING_TIMES, np.zeros((60, 1)))
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
    world = read_soft(MODEL)
    stiffness, task = world.stiffness, TaskCost.of(world, scenario)

    def rates(t: float, y: Any, u: Any) -> Any:
        q, v = y[:2], y[2:4]
        forces = stiffness * np.maximum(0.0, -world.calc_signed_distance(q))
        a = world.calc_acceleration(q, v, u) + world.calc_velocity_change(q, forces)
        return [*v, *a, float(task.running(t, q, v, u))]

    y = np.array([*scenario.initial_position, *scenario.initial_velocity, 0.0])
    for start, end, u in zip(SWING_TIMES, SWING_TIMES[1:], controls, strict=False):
        run = solve_ivp(rates, (start, end), y, args=(u,), rtol=1e-11, atol=1e-11)
        y = run.y[:, -1]
    expected = y[4] + float(task.final(y[:2], y[2:4]))
    replay = replay_event_driven(world, scenario, SWING_TIMES, controls)
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
    world = read_soft(MODEL)
    simulator = make_simulator(world, scenario)
    context = world.plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    world.plant.get_actuation_input_port().FixValue(context, [3.0])
    simulator.AdvanceTo(1.5)
    expected = replay_event_driven(world, scenario, SWING_TIMES, np.full((60, 1), 3.0))
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
