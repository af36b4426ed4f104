"""Positions, velocities, weights and bounds in a scenario, by names of joints and of bodies."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from space_models import build, make_scenario

from drake_aigto import Scenario, World
from drake_aigto.errors import ScenarioError
from drake_aigto.world import TaskCost


def test_goals_by_a_shift_are_so_far_from_the_start_and_keep_its_attitude(tmp_path: Path) -> None:
    begin = {"thing": {"xyz": [0.1, 0.2, 0.5], "rpy_deg": [10, 20, 30]}, "x": 0.3, "z": 1.0}
    goal = {"thing": {"by": [0.4, 0, -0.1]}, "x": {"by": 0.2}}
    asked = make_scenario(tmp_path, initial_position=begin, goal_position=goal)
    assert Scenario.from_plain(asked.to_plain()) == asked
    world, scenario = build(asked)
    moved = scenario.goal_position - scenario.initial_position
    expected = np.zeros(world.num_positions)
    expected[world.plant.GetJointByName("thing").position_start() + np.arange(4, 7)] = 0.4, 0, -0.1
    expected[world.plant.GetJointByName("x").position_start()] = 0.2
    np.testing.assert_allclose(moved, expected, atol=1e-15)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"goal_position": {"thing": {"by": 0.1}}}, r"\[thing\]: got 1 number, expected 3"),
        ({"goal_position": {"thing": {"by": [0, 0, 1], "rpy": [0, 0, 0]}}}, "or by, alone"),
        ({"initial_position": {"x": {"by": 0.1}}}, r"got by \[0.1\].*Only goals are relative"),
        ({"frame_goals": {"thing": {"by": [0, 0, 1], "weight": {"xyz": 1}}}}, "expected a pose"),
        ({"initial_position": [0.0, 0.0], "goal_position": {"x": {"by": 1}}}, "got 2 values"),
    ],
)
def test_shifts_that_can_not_be_are_refused(
    tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(ScenarioError, match=words):
        World.from_scenario(make_scenario(tmp_path, **changes))


def test_poses_are_written_in_degrees_radians_or_quaternions(tmp_path: Path) -> None:
    turns: list[dict[str, Any]] = [
        {"rpy_deg": [0, 0, 90]},
        {"rpy": [0, 0, np.pi / 2]},
        {"quaternion": [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]},
    ]
    for turn in turns:
        goal = {"thing": {"xyz": [0.3, 0, 0.05], **turn}}
        weight = {"thing": {"xyz": 10.0, "turn": 1.0}, "x": 2.0}
        asked = make_scenario(tmp_path, goal_position=goal, goal_weight=weight)
        assert Scenario.from_plain(asked.to_plain()) == asked
        world, scenario = build(asked)
        cost = TaskCost.of(world, scenario)
        error = cost.goal_errors(scenario.initial_position)
        start = world.plant.GetJointByName("thing").velocity_start()
        along = [0, 0, -np.pi / 2, -0.3, 0, -0.0007]
        np.testing.assert_allclose(error[start : start + 6], along, atol=1e-12)
        assert sorted(cost.QT.diagonal()) == [0, 0, 1, 1, 1, 2, 10, 10, 10]
        # By angle: q and −q are the same turn.
        other = np.array(scenario.goal_position)
        first = world.plant.GetJointByName("thing").position_start()
        other[first : first + 4] *= -1
        assert cost.goal_error(other) == pytest.approx(0.0, abs=1e-12)


def test_bounds_and_velocities_by_names_are_those_of_their_coordinates(tmp_path: Path) -> None:
    begin = {"thing": {"xyz": [0.1, 0, 0.5]}, "x": -0.3, "z": 0.3}
    given: dict[str, Any] = {
        "initial_velocity": {"thing": {"xyz": [1, 0, -2]}, "x": -0.1},
        "position_lower": {"thing": {"xyz": [-1, -np.inf, 0]}, "x": -0.5},
        "position_upper": {"z": 0.4},
        "velocity_upper": {"thing": {"turn": 3}, "z": 1.0},
        "control_lower": {"x": -2.0},
    }
    asked = make_scenario(tmp_path, initial_position=begin, **given)
    asked.save(tmp_path / "asked.yaml")
    assert Scenario.load(tmp_path / "asked.yaml") == asked
    world, scenario = build(asked)
    joints = {name: world.plant.GetJointByName(name) for name in ("thing", "x", "z")}
    q, v = (
        {n: getattr(j, f"{k}_start")() for n, j in joints.items()} for k in ("position", "velocity")
    )
    sizes = {"position": world.num_positions, "velocity": world.num_velocities, "control": 3}
    named = {
        "initial_velocity": {v["thing"] + 3: 1.0, v["thing"] + 5: -2.0, v["x"]: -0.1},
        "position_lower": {q["thing"] + 4: -1.0, q["thing"] + 6: 0.0, q["x"]: -0.5},
        "position_upper": {q["z"]: 0.4},
        "velocity_upper": {**dict.fromkeys(v["thing"] + np.arange(3), 3.0), v["z"]: 1.0},
        "control_lower": {world.plant.GetJointActuatorByName("x").input_start(): -2.0},
    }
    for name, entries in named.items():
        rest = {"lower": -np.inf, "upper": np.inf}.get(name.split("_")[1], 0.0)
        expected = np.full(sizes.get(name.split("_")[0], world.num_velocities), rest)
        expected[list(entries)] = list(entries.values())
        np.testing.assert_array_equal(getattr(scenario, name), expected)


def test_a_quaternion_that_is_not_of_unit_length_is_made_one_and_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pose = {"xyz": [0, 0, 0.05], "quaternion": [0.7, 0, 0, -0.7]}
    asked = make_scenario(tmp_path, initial_position={"thing": pose, "x": -0.2, "z": 0.05})
    with caplog.at_level(logging.WARNING):
        _, scenario = build(asked)
    assert "the quaternion of 'thing' has the length 0.989949" in caplog.text
    assert np.linalg.norm(scenario.initial_position[3:7]) == pytest.approx(1.0, abs=1e-15)


OVERLAP = {"thing": {"xyz": [0, 0, 0.05]}, "x": -0.08, "z": 0.05}


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        (
            {"goal_position": {"thin": {"xyz": [0, 0, 0]}}},
            r"Did you mean 'thing'\? goal_position\[thin\]: got no joint that moves, and no "
            "floating body, of this name, expected one of thing, x, y, z.$",
        ),
        ({"goal_position": {"x": [1, 2]}}, r"goal_position\[x\]: got 2 numbers, expected 1"),
        ({"goal_position": {"x": {"xyz": [1, 2, 3]}}}, "a pose of 'x', which prismatic joint"),
        ({"goal_position": {"thing": {"xyz": [1, 2]}}}, "got 2 and 4 numbers, expected 3 of xyz"),
        (
            {"initial_position": {"thing": {"xyz": [0, 0, 0], "quaternion": [0, 0, 0, 0]}}},
            "the quaternion .0.0, 0.0, 0.0, 0.0. of 'thing', expected one of unit length",
        ),
        ({"initial_position": OVERLAP}, "got bodies that overlap by 0.02 m, expected no more than"),
        ({"mass": 2.0}, "mass: got 2 kg, in space"),
        ({"goal_weight": {"thing": {"xyx": 1.0}}}, "expected xyz and turn"),
        ({"position_lower": {"thing": 0.0}}, r"lower\[thing\]: got \[0.0\].*a bound of xyz alone"),
        ({"position_upper": {"thing": {"turn": 1}}}, "expected a bound of xyz alone.*no bounds"),
        ({"velocity_upper": {"x": {"xyz": 1}}}, "which prismatic joint holds, expected numbers"),
        ({"initial_velocity": {"thing": [1.0, 2.0]}}, "got 2 numbers, expected 6"),
        ({"initial_velocity": {"thing": 1.0}}, "got 1 number, expected 6"),
        ({"control_upper": {"w": 1.0}}, r"control_upper\[w\]: got no actuator of this name"),
        ({"control_upper": {"x": [1.0, 2.0]}}, r"control_upper\[x\]: got 2 numbers, expected 1"),
        (
            {"position_lower": {"x": 0.3}, "position_upper": {"x": 0.2}},
            "position_lower: got 0.3, with position_upper = 0.2",
        ),
    ],
)
def test_what_does_not_fit_is_refused_by_name(
    tmp_path: Path, changes: dict[str, Any], match: str
) -> None:
    with pytest.raises(ScenarioError, match=match):
        World.from_scenario(make_scenario(tmp_path, **changes))
