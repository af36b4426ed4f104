"""Pairs that a scenario keeps apart: in plans, in simulations, and what is refused."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from space_models import make_scenario

from drake_aigto import Planner, PlanOptions, Scenario, World, plan
from drake_aigto.errors import ScenarioError
from drake_aigto.simulation import CLEARANCE, replay_event_driven

SOFT, RIGID = "cart_pole/soft_06", "cart_pole/rigid_06"
QUICK = PlanOptions(renewals=0, starts=4, finalists=1)
DISTANCE = 0.05


def keep_apart(name: str, clearance: dict[str, float]) -> Scenario:
    changes: Any = {"clearance": clearance}
    return dataclasses.replace(Scenario.named(name), **changes)


@pytest.mark.slow
@pytest.mark.parametrize("name", [SOFT, RIGID])
def test_a_pole_swings_up_at_a_distance_from_its_walls(name: str) -> None:
    scenario = keep_apart(name, {"pole against *": DISTANCE})
    found = plan(scenario, QUICK)
    assert found.holds and not found.best.is_idle and not found.best.contacts
    world = World.from_scenario(scenario)
    for replay in found.replay:
        nearest = world.calc_signed_distance(replay.positions).min()
        assert nearest > DISTANCE - 2e-3 * found.best.scales.length
        assert replay.violations[CLEARANCE] <= 2e-3
    assert not found.additions
    # The pole of the plain plan comes nearer, and its motion breaks what is asked here.
    plain = plan(Scenario.named(name), QUICK).trajectory
    replay = replay_event_driven(world, scenario, plain.times, plain.controls)
    assert CLEARANCE in replay.broken


@pytest.mark.slow  # Shooting over trees is compiled.
def test_a_finger_passes_a_ball_in_space_at_a_distance_and_as_slowly_as_users_ask(
    tmp_path: Path,
) -> None:
    changes: Any = {
        "goal_weight": {"x": 100.0, "y": 100.0, "z": 100.0},
        "clearance": {"*ball*tip*": 0.02},
        "material": {"*": {"friction": 0.0}},
    }
    goal = {"x": 0.15, "y": 0.0, "z": 0.07}
    planner = Planner(make_scenario(tmp_path, goal_position=goal, **changes), QUICK)
    program, world = planner.transcription, planner.world
    *_, z = program.state()[:3]
    vx = program.state()[world.num_positions]
    program.AddConstraintToAllKnotPoints(vx <= 0.4, "slow")
    program.AddFinalCost(100.0 * (z - 0.11) ** 2, "high")
    found = planner.plan()
    assert found.holds and not found.best.is_idle
    near = [contact.name for contact in world.contacts].index("m::ball with m::tip")
    for replay in found.replay:
        assert world.calc_signed_distance(replay.positions)[:, near].min() > 0.0185
        assert not replay.broken and 0.3 < replay.velocities[:, 0].max() < 0.402
        assert replay.positions[-1, 2] == pytest.approx(0.09, abs=2e-3)
    assert found.best.added_costs["high"] == pytest.approx(0.04, rel=0.1)


def test_the_distance_of_two_spheres_is_that_between_their_surfaces() -> None:
    world = World.from_scenario(scenario := keep_apart("two_discs/swap", {"*": 0.3}))
    (reach,) = world.reaches
    q = np.array([0.0, 0.0, reach + 0.3, 0.0])
    np.testing.assert_allclose(world.least_distances(scenario), world.calc_signed_distance(q))


def test_what_is_kept_apart_is_read_back(tmp_path: Any) -> None:
    scenario = keep_apart(SOFT, {"pole against left_wall": DISTANCE})
    scenario.save(tmp_path / "apart.yaml")
    assert Scenario.load(tmp_path / "apart.yaml").clearance == scenario.clearance
    assert "clearance" not in Scenario.named(SOFT).to_plain()


@pytest.mark.parametrize(
    ("name", "clearance", "message"),
    [
        (
            SOFT,
            {"pole against left_wal": 0.1},
            "Did you mean 'pole against left_wall'[?] clearance: 'pole against left_wal': got no "
            "pair of this name that can touch, expected one of pole against left_wall, pole",
        ),
        (SOFT, {"*left*": 0.0}, "0 m, expected more than 0 m"),
        (SOFT, {"*right*": 0.5}, "0.227 m too near .pole against right_wall"),
        ("room_with_block/around", {"*block*": 0.1}, "a box with 4 faces that can be touched"),
    ],
)
def test_a_clearance_that_cannot_be_kept_is_refused(
    name: str, clearance: dict[str, float], message: str
) -> None:
    with pytest.raises(ScenarioError, match=message):
        Planner(keep_apart(name, clearance))
