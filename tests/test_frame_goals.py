"""Goals of frames: their cost beside Drake's poses, where they lead, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.math import RollPitchYaw, RotationMatrix
from space_models import make_scenario
from trees import make_zoo, sample_state

from drake_aigto import Scenario, World
from drake_aigto.dynamics import Tree
from drake_aigto.errors import ScenarioError
from drake_aigto.simulation import Arrival
from drake_aigto.world import FrameGoal, FrameGoals, Pose, PoseParts, TaskCost

PLACE = [0.3, 0.1, 0.4]  # [m]
GOAL = {"finger": {"xyz": PLACE, "weight": {"xyz": 50.0}}}


def reach(folder: Path, **changes: Any) -> Scenario:
    """Returns a scenario in which the finger has to go to a place, and all else is free."""
    given: dict[str, Any] = {"frame_goals": GOAL, "goal_position": {}, "goal_weight": 0.0} | changes
    return make_scenario(folder, **given)


def test_costs_are_those_of_drakes_poses() -> None:
    plant, rng = make_zoo(0), np.random.default_rng(1)
    tree, context = Tree.of(plant), plant.CreateDefaultContext()
    names = [plant.get_body(i).name() for i in plant.GetFloatingBaseBodies()]
    turn = RollPitchYaw(rng.normal(size=3)).ToQuaternion()
    pose, weight = Pose((0.1, 0.2, 0.3), tuple(turn.wxyz())), PoseParts((1, 2, 3), (5, 5, 5))
    frames = FrameGoals.of(plant, tree, {name: FrameGoal(pose, weight) for name in names})
    assert names and frames is not None
    for _ in range(3):
        q, _, _ = sample_state(plant, rng)
        plant.SetPositions(context, q)
        expected = 0.0
        for name in names:
            X = plant.GetFrameByName(name).CalcPoseInWorld(context)
            angle = (RotationMatrix(turn).inverse() @ X.rotation()).ToAngleAxis().angle()
            off = X.translation() - pose.xyz
            expected += off**2 @ weight.xyz + 5 * (2 * np.sin(angle / 2)) ** 2
        assert frames.cost(q) == pytest.approx(expected, rel=1e-12)
        assert frames.cost(np.array([q, q])) == pytest.approx(expected, rel=1e-12)


def test_joints_that_nothing_names_go_where_the_frame_has_to_be(tmp_path: Path) -> None:
    scenario = reach(tmp_path)
    world = World.from_scenario(scenario)
    placed = world.place(scenario)
    np.testing.assert_allclose(placed.goal_position[:3], PLACE, atol=1e-3)
    np.testing.assert_array_equal(placed.goal_position[3:], placed.initial_position[3:])
    cost = TaskCost.of(world, placed)
    assert not cost.is_asked.any()
    still = np.zeros((2, 9))
    at_goal, at_start = (
        Arrival.of(world, placed, np.array([placed.initial_position, end]), still)
        for end in (placed.goal_position, placed.initial_position)
    )
    assert at_goal.is_reached and not at_start.is_reached
    assert at_start.distance == pytest.approx(float(cost.goal_error(placed.initial_position)))
    assert at_start.angle is None


def test_goals_of_frames_are_saved(tmp_path: Path) -> None:
    reach(tmp_path).save(tmp_path / "s.yaml")
    assert Scenario.load(tmp_path / "s.yaml").frame_goals == reach(tmp_path).frame_goals


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"frame_goals": {"fingr": GOAL["finger"]}}, r"Did you mean 'finger'\?"),
        ({"frame_goals": {"floor_link": GOAL["finger"]}}, "no such frame"),
        ({"frame_goals": {"ground": GOAL["finger"]}}, "stands still"),
        ({"frame_goals": {"finger": {"xyz": [0, 0, 1]}}}, "weight"),
        (
            {"frame_goals": {"finger": {"xyz": [0, 0, 1], "weight": {"turn": [1, 2, 3]}}}},
            "one number",
        ),
        ({"frame_goals": {"finger": {"xyz": PLACE, "weight": {"xyz": 0.0}}}}, "above 0"),
        ({"hard_goal": True}, "these are costs"),
    ],
)
def test_goals_that_can_not_be_are_refused(
    tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(ScenarioError, match=words):
        World.from_scenario(reach(tmp_path, **changes))
