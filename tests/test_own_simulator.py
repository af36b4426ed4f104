"""A diagram of one's own, in a Simulator whose walls return what the scenario says."""

from __future__ import annotations

import dataclasses
import gc
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

from drake_aigto import Scenario, World
from drake_aigto.contact import contact_delay, contact_delays
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.simulation import confirms, make_simulator, replay_drake, replay_event_driven
from drake_aigto.world import Scales, find_anywhere, package_map

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
    lacking = r"collision shape '.*': got no stiffness, .* 2e9 N/m"
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
