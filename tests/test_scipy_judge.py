"""Replays of worlds with friction and of balls agree with equations by hand, by SciPy."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.robots.judge import Control
from benchmarks.robots.mechanics import MECHANISMS
from benchmarks.robots.scipy_judge import BODIES, integrate
from benchmarks.robots.setting import model_of
from drake_aigto import Scenario, World, scenario_names
from drake_aigto.simulation import replay_event_driven
from drake_aigto.world import SpaceWorld

SCENARIOS = {name: Scenario.named(name) for name in scenario_names()}
NAMES = [name for name, each in SCENARIOS.items() if model_of(each) in BODIES]
# Worlds whose forces are not about 2 N.
FORCES = {
    "hopper": 10.0,
    "spinner": 3.0,
    "cart_pole_on_dry_rail": 8.0,
    "payload": 10.0,
    "sliding_block": 6.0,
    "pushed_block": 8.0,
    "push_circle": 1.0,
}


def draw(world: World, scenario: Scenario, seed: int) -> Control:
    size = 10, world.num_actuators
    values = np.random.default_rng(seed).normal(size=size)
    if model_of(scenario) in ("push_circle", "pushed_block"):  # The way to what is pushed.
        values = 1.0 + 0.2 * values
    return Control.even(FORCES.get(model_of(scenario), 2.0) * values, scenario.duration)


@pytest.mark.parametrize("name", NAMES)
def test_a_replay_is_what_another_integration_of_other_equations_gives(name: str) -> None:
    world, touched = World.from_scenario(SCENARIOS[name]), 0.0
    scenario = world.place(SCENARIOS[name])
    for seed in range(3):
        control = draw(world, scenario, seed)
        replay = replay_event_driven(world, scenario, *control)
        own = integrate(scenario, control)
        end = np.concatenate([replay.positions[-1], replay.velocities[-1]])
        assert replay.cost == pytest.approx(own.cost, rel=1e-7)
        np.testing.assert_allclose(end, own.end, rtol=1e-6, atol=1e-6)
        touched += own.touched
    assert touched > 0 or not BODIES[model_of(scenario)].pairs(scenario.initial_position)


def test_every_planar_world_has_equations_by_hand() -> None:
    planar = set[str]()
    for scenario in SCENARIOS.values():
        # Other people's robots come with packages, and live in space.
        if scenario.model.startswith("package://drake_aigto_models/"):
            world = World.from_scenario(scenario)
            planar |= set() if isinstance(world, SpaceWorld) else {model_of(scenario)}
    assert planar == set(BODIES) | set(MECHANISMS)
