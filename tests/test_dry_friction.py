"""Dry friction in joints: its law in all simulations, in shooting, and in plans."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest

from drake_aigto import ModelError, Planner, Scenario, ScenarioError, World
from drake_aigto.contact import contact_law
from drake_aigto.dynamics import calc_friction_share
from drake_aigto.planning import MECHANISM_LADDER, PlanOptions
from drake_aigto.shooting import Mechanism
from drake_aigto.simulation import replay_drake, replay_event_driven


def ask(**changes: Any) -> Scenario:
    """Returns a swing of the pole on a dry rail, too short to be unstable."""
    fields: dict[str, Any] = {
        "duration": 1.0,
        "initial_position": [1.0, 1.5],
        "initial_velocity": [-1.0, 0.0],
    }
    return dataclasses.replace(Scenario.named("cart_pole/dry"), **{**fields, **changes})


@cache
def read_dry() -> World:
    return World.from_scenario(ask())


def test_friction_grows_smoothly_from_rest_to_all_of_it() -> None:
    speeds = np.array([-3.0, -1.0, -0.5, 0.0, 0.25, 1.0, 7.0])
    x = 0.25
    expected = [-1, -1, -0.5, 0, 10 * x**3 - 15 * x**4 + 6 * x**5, 1, 1]
    np.testing.assert_allclose(calc_friction_share(0.01 * speeds, 0.01), expected, atol=1e-15)


def calc_energy(x: Any) -> float:
    """Returns that of the cart-pole at (q, v), of 1 kg, 0.1 kg and 1 m [J]."""
    q, v = x[:2], x[2:]
    kinetic = float(read_dry().calc_kinetic_energy(q, v))
    return kinetic - 0.1 * 9.81 * float(np.cos(q[1]))


def test_what_slides_loses_the_friction_times_its_way_and_what_rests_stays() -> None:
    world, start = read_dry(), {"initial_position": [0.0, 0.0], "initial_velocity": [3.0, 2.0]}
    times, rest = np.array([0.0, 0.3]), {**start, "initial_velocity": [0.0, 0.0]}
    for replay in (replay_event_driven, replay_drake):
        slid = replay(world, ask(**start), times, np.zeros((1, 1)))
        x = np.hstack([slid.positions, slid.velocities])
        assert x[-1, 2] > 1.0
        lost = calc_energy(x[0]) - calc_energy(x[-1])
        assert lost == pytest.approx(2.0 * (x[-1, 0] - x[0, 0]), rel=1e-7)
        held = replay(world, ask(**rest), times, np.array([[1.8]]))
        assert 0 < held.positions[-1, 0] < 0.3 * world.stiction_speed


def test_both_replays_agree_on_what_rubs() -> None:
    times = np.linspace(0.0, 1.0, 21)
    controls = 6 * np.sin(9 * times[:-1, np.newaxis])
    own, drake = (
        replay(read_dry(), ask(), times, controls) for replay in (replay_event_driven, replay_drake)
    )
    np.testing.assert_allclose(own.positions[-1], drake.positions[-1], atol=1e-6)
    assert own.cost == pytest.approx(drake.cost, rel=1e-7)
    smooth = dataclasses.replace(ask(), dry_friction=None)
    without = replay_drake(World.from_scenario(smooth), smooth, times, controls)
    assert np.abs(without.positions[-1] - drake.positions[-1]).max() > 0.1


def test_shooting_has_the_law_and_its_derivatives() -> None:
    scenario = ask(dry_friction=[2.0, 0.3])
    world, rng, step = World.from_scenario(scenario), np.random.default_rng(1), 1e-7
    mechanism = Mechanism.of(world, contact_law(world, scenario))
    for speed in (1.0, 0.3 * scenario.stiction_speed):
        q, v, u = rng.normal(size=2), speed * rng.normal(size=2), rng.normal(size=1)
        z = np.concatenate([q, v, u])
        got, slopes = mechanism.calc_acceleration(z[:4], z[4:])
        np.testing.assert_allclose(got, world.calc_acceleration(q, v, u), rtol=1e-10)
        ends = [
            mechanism.calc_acceleration(y[:4], y[4:])[0]
            for y in np.concatenate([z + step * np.eye(5), z - step * np.eye(5)])
        ]
        differences = np.subtract(ends[:5], ends[5:]).T / (2 * step)
        np.testing.assert_allclose(slopes, differences, rtol=1e-5, atol=1e-5)


def test_a_plan_on_a_dry_rail_holds_in_both_simulations_and_pays_for_the_friction() -> None:
    options = PlanOptions(renewals=0, finalists=1, ladder=MECHANISM_LADDER[:2])
    plan = Planner(ask(), options).plan()
    assert plan.holds
    for replay in plan.replay:
        assert replay.cost == pytest.approx(plan.cost, rel=1e-3)
    smooth = dataclasses.replace(ask(), dry_friction=None)
    assert Planner(smooth, options).plan().cost < 0.99 * plan.cost


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("dry_friction", [-1.0, 0.0], "dry_friction: got -1, expected at least 0"),
        ("dry_friction", [np.nan, 0.0], "dry_friction: got nan, expected a finite number"),
        ("dry_friction", [1.0], "dry_friction: got 1 value, expected 2, one for each coordinate"),
        ("stiction_speed", 0.0, "stiction_speed: got 0 m/s, expected more than 0 m/s"),
    ],
)
def test_bad_friction_is_refused(field: str, value: Any, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        World.from_scenario(ask(**{field: value}))


def test_a_world_with_other_friction_is_refused() -> None:
    for field, value in (("dry_friction", [1.0, 0.0]), ("stiction_speed", 0.5)):
        with pytest.raises(ScenarioError, match=f"{field}: got .* The world was made with that"):
            read_dry().check(ask(**{field: value}))
    smooth = World.from_scenario(dataclasses.replace(ask(), dry_friction=None))
    with pytest.raises(ModelError, match="dry_friction: got a diagram in which nothing applies"):
        World.from_diagram(smooth.diagram, dry_friction=np.ones(2))
