"""Thrusters: forces that turn with their links, equal to those of Drake's Propeller."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from space_models import make_scenario
from trees import difference_slopes, make_zoo, sample_state

from drake_aigto import Planner, PlanOptions, Scenario, TrackingController, World
from drake_aigto.control import Disturbance, run_in_loop
from drake_aigto.dynamics import Thrust, Tree
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.simulation import replay_drake, replay_event_driven
from drake_aigto.world import SpaceWorld, TaskCost


def test_slopes_of_thrusts_are_differences_along_the_manifold() -> None:
    plant, rng = make_zoo(0), np.random.default_rng(5)
    bodies = range(1, plant.num_bodies())
    moved = [b for b in bodies if Tree.of(plant).body_links[b] >= 0]
    thrusts = [Thrust(int(rng.choice(moved)), rng.normal(size=6)) for _ in range(6)]
    tree = Tree.of(plant, thrusts=thrusts)
    q, v, u = sample_state(plant, rng)
    u = np.append(u, rng.normal(size=6))
    expected = difference_slopes(tree, q, v, u)
    found = tree.calc_acceleration_slopes(q, v, u)
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()


def hover(folder: Path, **changes: Any) -> Scenario:
    """Returns a scenario of a ball with two thrusters, and a finger with three motors."""
    thrusters = [
        {"body": "thing", "xyz": [0.1, 0.2, 0.0], "direction": [0.0, 0.6, 0.8], "drag": 0.02},
        {"body": "thing", "direction": [1.0, 0.0, 0.0]},
    ]
    return make_scenario(folder, **({"thrusters": thrusters} | changes))


def test_thrusts_are_those_of_drakes_propeller_and_drive_both_simulations(tmp_path: Path) -> None:
    world = World.from_scenario(scenario := hover(tmp_path, duration=0.1))
    assert isinstance(world, SpaceWorld)
    assert world.num_actuators == 5
    rng, start = np.random.default_rng(0), world.place(scenario).initial_position
    q, v, u = world.add(start, rng.normal(size=9)), rng.normal(size=9), rng.normal(size=5)
    q[-1] += 5.0  # Nothing touches.
    root = world.create_context()
    context = world.plant.GetMyMutableContextFromRoot(root)
    world.plant.SetPositionsAndVelocities(context, np.concatenate([q, v]))
    world.fix_control(root, u)
    assert np.array_equal(world.read_control(root), u)
    rate = world.plant.EvalTimeDerivatives(context).CopyToVector()[-9:]
    np.testing.assert_allclose(world.calc_acceleration(q, v, u), rate, rtol=1e-9, atol=1e-9)
    times, controls = np.linspace(0.0, 0.1, 3), rng.uniform(-1.0, 1.0, (2, 5))
    placed = world.place(scenario)
    ours, drake = (
        judge(world, placed, times, controls) for judge in (replay_event_driven, replay_drake)
    )
    np.testing.assert_allclose(ours.positions[-1], drake.positions[-1], atol=1e-5)


def test_thrusters_are_saved_and_named(tmp_path: Path) -> None:
    scenario = hover(tmp_path)
    scenario.save(tmp_path / "s.yaml")
    assert Scenario.load(tmp_path / "s.yaml").thrusters == scenario.thrusters
    world = World.from_scenario(scenario)
    bounded = dataclasses.replace(scenario, control_lower=0.0)
    items = world.limits.control_items(world.plant, bounded)
    assert items[-1] == "thruster_2 from 0 (scenario) to inf (model) N"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"thrusters": [{"body": "thingy"}]}, "'thing'"),
        ({"thrusters": [{"body": "ground"}]}, "a body that nothing moves"),
        ({"thrusters": [{"body": "thing"}], "contact": "rigid"}, "contact: compliant"),
        ({"thrusters": [{"xyz": [0, 0, 0]}]}, "a mapping of body"),
        ({"thrusters": [{"body": "thing", "direction": [0, 0, 0]}]}, "not 0"),
    ],
)
def test_thrusters_that_can_not_be_are_refused(
    tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    with pytest.raises((ModelError, ScenarioError), match=words):
        World.from_scenario(hover(tmp_path, **changes))


@pytest.mark.slow
def test_friction_holds_a_perched_drone_without_thrust_in_drake() -> None:
    asked = Scenario.named("drone/perch")
    perched = dataclasses.replace(asked, initial_position=asked.goal_position, duration=1.0)
    world = World.from_scenario(perched)
    perched = world.place(perched)
    replay = replay_drake(world, perched, np.array([0.0, 1.0]), np.zeros((1, 4)))
    assert replay.goal_error < 0.01  # [m, rad]; it creeps, as friction is regularized.
    slippery = dataclasses.replace(perched, friction=0.4)  # Less than tan 25° = 0.47.
    world = World.from_scenario(slippery)
    assert replay_drake(world, slippery, np.array([0.0, 1.0]), np.zeros((1, 4))).goal_error > 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("name", "renewals"), [("drone/deliver", 2), ("drone/perch", 48)])
def test_drones_reach_their_goals_and_both_replays_confirm_it(name: str, renewals: int) -> None:
    plan = Planner(Scenario.named(name), PlanOptions(renewals=renewals, finalists=1)).plan()
    assert plan.holds and plan.reached
    arrival = plan.find_arrival()
    assert arrival.distance is not None and arrival.distance < 0.02
    assert arrival.angle is not None and arrival.angle < 0.1
    for replay in plan.replay:
        assert replay.cost == pytest.approx(plan.cost, rel=0.02)
    world = plan.find_world()
    if frames := TaskCost.of(world, world.place(plan.scenario)).frames:
        assert np.linalg.norm(frames.errors(plan.trajectory.positions[-1])[0, :3]) < 0.01
        kick = np.array([0.0, 0.0, 0.0, 0.3, -0.2, 0.2, 0.0, 0.0])
        kicked = Disturbance(kick=kick, kick_time=0.5)
        run = run_in_loop(TrackingController(plan, world), plan.scenario, world, kicked)
        assert run.cost < 2 * plan.cost  # 200 times as much without feedback.
