"""Drake's stiff walls around mechanisms: off by what contacts last, and by no more."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from mechanisms import LEFT, MECHANISMS, build, build_stiff, build_world, stiffen

from drake_aigto import Scenario, World
from drake_aigto.contact import contact_delay, contact_delays
from drake_aigto.simulation import confirms, make_simulator, replay_drake, replay_event_driven
from drake_aigto.world import Scales, find_anywhere

TIMES = np.linspace(0.0, 1.0, 21)
SOFT, STIFF = 1e5, 1e7

read = cache(build_stiff)


def ask(name: str, e: float = 1.0) -> Scenario:
    q, v = TASKS[name]
    return Scenario(
        initial_position=q,
        initial_velocity=v,
        goal_position=np.zeros(len(q)),
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
    over_a_floor = MECHANISMS["pendulum"].replace(LEFT, "0 0 -1 0 0 0")
    world = build_world(stiffen(over_a_floor, STIFF))
    assert not np.any(world.calc_contact_jacobian(np.zeros(1)))
    assert np.isinf(world.inertia_at(np.zeros(1)).masses)
    assert 0 < contact_delay(world) < 0.1


def test_no_shipped_wall_is_late_because_a_rod_points_at_it_where_one_looks() -> None:
    # This start and the position beside it are such that the latter's rod lies along the normal.
    assert contact_delay(World.from_scenario(Scenario.named("pendulum/off_the_wall"))) < 1e-3


def test_a_shipped_cart_pole_between_rigid_walls_is_confirmed_by_drake() -> None:
    world: World = build("cart_pole_rigid_06")
    scenario = ask("cart-pole")
    controls = np.full((20, 1), 2.0)
    rigid = replay_event_driven(world, scenario, TIMES, controls)
    drake = replay_drake(world, scenario, TIMES, controls)
    assert rigid.bounce_times
    assert drake.cost == pytest.approx(rigid.cost, rel=1e-3)


def test_where_nothing_touches_drake_integrates_the_same_motion() -> None:
    world, scenario, controls = build("cart_pole"), ask("cart-pole"), np.full((20, 1), 2.0)
    own = replay_event_driven(world, scenario, TIMES, controls)
    drake = replay_drake(world, scenario, TIMES, controls)
    assert drake.cost == pytest.approx(own.cost, rel=1e-8)
    np.testing.assert_allclose(drake.positions[-1], own.positions[-1], atol=1e-8)


def test_a_compliant_wall_may_be_nearly_rigid() -> None:
    world = read("cart-pole", 1e9)
    scenario = dataclasses.replace(ask("cart-pole"), contact="compliant", restitution=1.0)
    controls = np.full((20, 1), 2.0)
    own = replay_event_driven(world, scenario, TIMES, controls)
    drake = replay_drake(world, scenario, TIMES, controls)
    assert own.bounce_contacts == drake.bounce_contacts != ()
    assert drake.cost == pytest.approx(own.cost, rel=1e-5)


def test_a_verdict_is_about_angles_as_about_lengths() -> None:
    world, scenario = read("cart-pole", STIFF), ask("cart-pole")
    scales = Scales.of(world, scenario)
    replay = replay_event_driven(world, scenario, TIMES, np.full((20, 1), 2.0))
    assert confirms(replay.cost, replay, scales, replay.goal_error)
    assert not confirms(0.9 * replay.cost, replay, scales, replay.goal_error)
    miss = 2e-3 * scales.length
    assert confirms(replay.cost, replay, scales, replay.goal_error - 0.9 * miss)
    assert not confirms(replay.cost, replay, scales, replay.goal_error - 1.1 * miss)
