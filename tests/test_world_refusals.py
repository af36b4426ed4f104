"""Bad models, and scenarios that do not fit them, each with one clear error."""

from __future__ import annotations

import dataclasses
import importlib.util
import re
from functools import cache
from typing import Any

import numpy as np
import pytest
from mechanisms import DOUBLE_PENDULUM, PASSIVE, build_world
from world_models import (
    AXIS,
    BALL_SHAPE,
    TETRAHEDRON,
    WALL_POSE,
    ModelWriter,
    make_scenario,
    read_thin_walled,
)

from benchmarks.baselines import Recorder
from drake_aigto import Planner, Scenario, World, scenario_names
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.paper import rigid_optimum
from drake_aigto.world import read_model, scenario_summaries

SLIDER_AXIS = """<axis>
        <xyz>1 0 0</xyz>
      </axis>"""
PRISMATIC = '<joint name="slider" type="prismatic">'


def between(start: str, end: str) -> str:
    text = read_thin_walled()
    first = text.index(start)
    return text[first : text.index(end, first) + len(end)]


# Models in which nothing can touch: worlds, but not for balls' plans.
CONTACT_FREE: dict[str, tuple[dict[str, str], str]] = {
    "no wall": (
        {between('<collision name="wall_collision">', "</collision>"): ""},
        "nothing can touch: there is one collision shape",
    ),
    "filtered": (
        {
            "</model>": """<drake:collision_filter_group name="all">
              <drake:member>ball</drake:member> <drake:member>wall</drake:member>
              <drake:ignored_collision_filter_group>all</drake:ignored_collision_filter_group>
            </drake:collision_filter_group></model>"""
        },
        "nothing can touch: Drake lets no two of 2 collision shapes collide .*filter_group",
    ),
}

# name → (replacements in the shipped SDF, message)
BAD_MODELS: dict[str, tuple[dict[str, str], str]] = {
    "ball joint": (
        {PRISMATIC: '<joint name="socket" type="ball">', SLIDER_AXIS: ""},
        r"joint 'socket' \(ball_rpy\): got velocities v that are not q̇, expected q̇ = v",
    ),
    "floating": (
        {between(PRISMATIC, "</joint>"): ""},
        r"no joint attaches link 'ball', so it floats: .*Attach the link by prismatic, ",
    ),
    "welded": (
        {PRISMATIC: '<joint name="slider" type="fixed">'},
        r"the model lacks a joint that moves\. Attach the moving link by a prismatic or",
    ),
    "no actuator": (
        {AXIS: f"{AXIS}<limit><effort>0</effort></limit>"},
        r"the model lacks an actuator: got limits of effort of 0 at slider, .*effort_limits: {sli",
    ),
    "box against box": (
        {BALL_SHAPE: "<box><size>0.1 0.1 0.1</size></box>"},
        "ball_collision with point_mass_and_wall::wall_collision: got Box against Box, expected "
        "Sphere against Box, HalfSpace or Sphere",
    ),
    "mesh": (
        {BALL_SHAPE: "<mesh><uri>tetrahedron.obj</uri></mesh>"},
        r"contact of .*ball_collision with .*: got Mesh against Box, expected Sphere against Box, "
        r"HalfSpace or Sphere, or Capsule against HalfSpace",
    ),
    "loop": (
        {
            "</model>": """<link name="rod"><inertial><mass>1</mass></inertial></link>
              <joint name="one" type="revolute"><parent>ball</parent><child>rod</child>
              <axis><xyz>0 1 0</xyz></axis></joint>
              <joint name="two" type="revolute"><parent>world</parent><child>rod</child>
              <axis><xyz>0 1 0</xyz></axis></joint></model>"""
        },
        r"the links of the model: got a loop of joints in .*variant\.sdf, expected a tree",
    ),
    "constraint": (
        {
            "</model>": """<drake:ball_constraint name="string">
              <drake:ball_constraint_body_A>ball</drake:ball_constraint_body_A>
              <drake:ball_constraint_body_B>wall</drake:ball_constraint_body_B>
              <drake:ball_constraint_p_AP>0 0 0</drake:ball_constraint_p_AP>
              <drake:ball_constraint_p_BQ>0 0 0</drake:ball_constraint_p_BQ>
              </drake:ball_constraint></model>"""
        },
        r"the links of the model: got 1 constraint beside joints, expected a tree: one joint betw",
    ),
    "controller": (
        {SLIDER_AXIS: f"{SLIDER_AXIS}<drake:controller_gains p='100' d='10'/>"},
        r"actuator 'slider': got a PD controller, .* Leave out <drake:controller_gains>",
    ),
    "not XML": ({"<link": "<lin k"}, r"model .*variant\.sdf: got no XML: not well-formed"),
}


@pytest.mark.parametrize("name", BAD_MODELS)
def test_a_bad_model_is_refused_by_name(write_model: ModelWriter, name: str) -> None:
    replacements, message = BAD_MODELS[name]
    (write_model.path.parent / "tetrahedron.obj").write_text(TETRAHEDRON, encoding="utf-8")
    with pytest.raises(ModelError, match=message):
        World.from_diagram(read_model(write_model(replacements)).diagram)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ("no/such.sdf", r"model no/such\.sdf: got no file no/such\.sdf, expected an SDF, URDF or"),
        ("package://nowhere/a.sdf", "got the unknown package 'nowhere', expected one of drake"),
        ("package://numpy/a.sdf", r"got no file .*numpy/a\.sdf"),
        ("package://drake_aigto_models/a.sdf", r"got no file .*a\.sdf.*shipped ones lie in"),
        (".", r"model \.: got no file \., expected"),
    ],
)
def test_a_missing_model_is_refused_by_name(model: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        World.from_scenario(make_scenario(model))


@pytest.mark.parametrize("name", CONTACT_FREE)
def test_a_ball_without_a_wall_is_a_world_that_says_so(write_model: ModelWriter, name: str) -> None:
    replacements, note = CONTACT_FREE[name]
    scenario = make_scenario(write_model(replacements))
    world = World.from_scenario(scenario)
    assert world.num_contacts == 0
    assert len(world.notes) == 1 and re.match(note, world.notes[0])
    assert type(Planner(scenario).task).__name__ == "MechanismTask"
    with pytest.raises(ModelError, match="the model lacks a contact: got nothing can touch"):
        world.check_plain(scenario)
    with pytest.raises(ModelError, match="mass: got a model in which nothing touches"):
        World.from_scenario(dataclasses.replace(scenario, mass=2.0))


def test_plans_without_limits_refuse_a_model_that_has_one(write_model: ModelWriter) -> None:
    limited = make_scenario(write_model({AXIS: f"{AXIS}<limit><effort>7.5</effort></limit>"}))
    message = r"actuator 'slider' of joint 'slider': got effort limits from -7\.5 to 7\.5"
    world = World.from_scenario(limited)
    with pytest.raises(ModelError, match=message):
        Recorder(world, limited, seconds=1.0)
    with pytest.raises(ModelError, match=message):
        rigid_optimum(world, limited)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"initial_position": -1e-3},
            r"initial_position is inside or behind the wall \(ball against wall\): got a "
            r"signed distance of -0.001 m, expected at least 0 m",
        ),
        ({"initial_position": -0.02}, r"initial_position is inside.* got .* -0\.02 m"),
        ({"goal_position": -0.02}, r"goal_position is inside.* got .* -0\.02 m"),
        ({"initial_position": -1.0}, r"initial_position is inside or behind .* got .* -1 m"),
        ({"initial_position": [1, 2]}, "initial_position: got 2 values, expected 1, one for each"),
        ({"initial_velocity": [1, 2]}, "initial_velocity: got 2 values, expected 1, one for each"),
        ({"goal_position": [1, 2]}, "goal_position: got 2 values, expected 1, one for each"),
    ],
)
def test_a_scenario_that_does_not_fit_is_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        World.from_scenario(make_scenario(**fields))


def test_a_start_and_a_goal_on_two_sides_of_a_thin_wall_are_refused(
    write_model: ModelWriter,
) -> None:
    message = (
        r"goal_position is inside or behind .*The wall is the face that the sphere faces at "
        r"q = \[-1\.0\]; start and goal must both be in front of it"
    )
    with pytest.raises(ScenarioError, match=message):
        World.from_scenario(make_scenario(write_model({}), initial_position=-1.0))


def test_a_position_beside_the_walls_face_is_refused(write_model: ModelWriter) -> None:
    # The ball moves along x only, askew to the face.
    askew = {WALL_POSE: "<pose>-0.1 0 0 0 0 0.7853981633974483</pose>"}
    fits = make_scenario(write_model(askew), initial_position=0.3, goal_position=0.3)
    world = World.from_scenario(fits)  # 0.28 m off the middle, 0.3 m are there.
    beside = dataclasses.replace(fits, goal_position=0.4)
    with pytest.raises(
        ScenarioError,
        match=r"goal_position is beside the face of the wall .*got the sphere's center "
        r"\[-0\.353553, 0\.0\] m off .* expected within \[0\.3, 0\.3\] m\. Widen the wall",
    ):
        world.check(beside)


def test_a_scenario_of_another_mass_is_refused() -> None:
    world = World.from_scenario(make_scenario(mass=2.0))
    world.check(make_scenario(mass=2.0))
    with pytest.raises(ScenarioError, match=r"mass: got 3 kg, expected 2 kg\. Give the scenario"):
        world.check(make_scenario(mass=3.0))
    with pytest.raises(ScenarioError, match="mass: got 3 kg, expected None, the model's"):
        World.from_scenario(make_scenario()).check(make_scenario(mass=3.0))


LIMIT = "<limit><lower>-1</lower><upper>4</upper><velocity>5</velocity><effort>20</effort></limit>"
INF = np.inf


@cache
def arm() -> World:
    return build_world(DOUBLE_PENDULUM.replace(PASSIVE, LIMIT))


def ask(**fields: Any) -> Scenario:
    ends = {"initial_position": [0.0, 0.0], "initial_velocity": [0.0, 0.0]}
    return Scenario(**{**ends, "goal_position": [3.0, 0.0], **fields})


def test_without_bounds_of_the_scenario_the_models_count() -> None:
    bounds = arm().bounds(ask())
    assert bounds is arm().limits
    np.testing.assert_array_equal(bounds.position, [[-1.0, -INF], [4.0, INF]])
    np.testing.assert_array_equal(bounds.control, [[-20.0, -INF], [20.0, INF]])


def test_the_narrower_of_both_bounds_counts_coordinate_by_coordinate() -> None:
    bounds = arm().bounds(
        ask(
            position_lower=[-2.0, -1.5],
            position_upper=[3.5, INF],
            velocity_upper=6.0,
            control_lower=-3.0,
            control_upper=[30.0, 2.0],
        )
    )
    np.testing.assert_array_equal(bounds.position, [[-1.0, -1.5], [3.5, INF]])
    np.testing.assert_array_equal(bounds.velocity, [[-5.0, -INF], [5.0, 6.0]])
    np.testing.assert_array_equal(bounds.control, [[-3.0, -3.0], [20.0, 2.0]])
    assert not bounds.control.flags.writeable
    np.testing.assert_array_equal(arm().limits.control[0], [-20.0, -INF])


@pytest.mark.parametrize("turns", [-2, -1, 1, 2])
def test_a_goal_of_an_angle_may_be_turns_beyond_the_bounds_where_turns_do_not_count(
    turns: int,
) -> None:
    goal = [3.0 + 2 * np.pi * turns, 0.0]
    for angles in ("modulo", "chordal"):
        arm().check(ask(goal_position=goal, angles=angles))
    with pytest.raises(ScenarioError, match=r"goal_position\[0\]: got .* from -1 to 4"):
        arm().check(ask(goal_position=goal))
    with pytest.raises(ScenarioError, match=r"goal_position\[0\]: got .* from -1 to 2"):
        arm().check(ask(goal_position=goal, angles="modulo", position_upper=2.0))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"position_lower": 0.5}, "initial_position[0]: got 0, expected from 0.5 to 4, by its joi"),
        ({"position_upper": 2.0}, "goal_position[0]: got 3, expected from -1 to 2"),
        ({"velocity_lower": [-INF, 1.0]}, "initial_velocity[1]: got 0, expected from 1 to inf"),
        (
            {"goal_velocity": [6.0, 0.0], "goal_velocity_weight": 1.0},
            "goal_velocity[0]: got 6, expected from -5 to 5",
        ),
        ({"control_upper": [1.0] * 3}, "control_upper: got 3 values, expected 2, or one for all"),
        (
            {"control_lower": [30.0, 0.0]},
            "control_lower and control_upper, [0]: got nothing from 30 to 20, expected bounds "
            "within the model's limits, -20 to 20",
        ),
    ],
)
def test_bounds_that_leave_out_what_is_asked_are_refused(
    fields: dict[str, Any], message: str
) -> None:
    with pytest.raises(ScenarioError, match=re.escape(message)):
        arm().check(ask(**fields))


def test_a_model_of_a_package_that_is_absent_names_the_extra_that_brings_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    known = importlib.util.find_spec
    away = {"gymnasium", "dm_control"}
    monkeypatch.setattr(
        "drake_aigto.world.files.find_spec", lambda name: None if name in away else known(name)
    )
    names = {"dm_cheetah/leap", "gymnasium_hopper/hop", "half_cheetah/leap", "walker2d/step"}
    assert names == set(scenario_summaries()) - set(scenario_names())
    for name in names:
        message = r"package .*which is not installed.*pip install 'drake_aigto\[models\]'"
        with pytest.raises(ModelError, match=message):
            World.from_scenario(Scenario.named(name))
