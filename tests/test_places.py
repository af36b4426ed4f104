"""Positions, velocities, weights and bounds in a scenario, by names of joints and of bodies."""

from __future__ import annotations

import dataclasses
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.math import RollPitchYaw, RotationMatrix
from space_models import build, make_scenario
from trees import make_zoo, sample_state

from drake_aigto import Planner, PlanOptions, Scenario, World, plan
from drake_aigto.dynamics import Tree
from drake_aigto.errors import ScenarioError
from drake_aigto.simulation import CLEARANCE, Arrival, replay_event_driven
from drake_aigto.world import FrameGoal, FrameGoals, Pose, PoseParts, TaskCost


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
