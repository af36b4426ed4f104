"""Bad models, and scenarios that do not fit them, each with one clear error."""

from __future__ import annotations

import dataclasses
import re
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mechanisms import DOUBLE_PENDULUM, PASSIVE, build_world
from pydrake.geometry import HalfSpace, Role, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import PrismaticJoint, SpatialInertia, UnitInertia
from pydrake.symbolic import Expression
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from world_models import (
    AXIS,
    BALL_SHAPE,
    BOX,
    RELATIVE,
    TETRAHEDRON,
    VARIANTS,
    WALL_POSE,
    ModelWriter,
    differs_by_zero,
    evaluate,
    make_scenario,
    make_world,
    read_thin_walled,
)

from benchmarks.baselines import Recorder
from drake_aigto import Planner, Scenario, World, scenario_names
from drake_aigto.dynamics import Contact
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
    monkeypatch.setattr("drake_aigto.world.files._find_installed", lambda name: None)
    names = {
        "a1/step_ahead",
        "dm_cheetah/leap",
        "dm_finger/turn",
        "dm_walker/step",
        "gymnasium_hopper/hop",
        "half_cheetah/leap",
    }
    names |= {"walker2d/step"}
    assert names == set(scenario_summaries()) - set(scenario_names())
    for name in names:
        message = r"package .*which is not installed.*pip install 'drake_aigto\[models\]'"
        with pytest.raises(ModelError, match=message):
            World.from_scenario(Scenario.named(name))


def test_a_package_that_is_absent_may_be_given_by_its_folder(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("drake_aigto.world.files._find_installed", lambda name: None)
    robot = tmp_path / "robots" / "a1_description" / "urdf" / "a1.urdf"
    robot.parent.mkdir(parents=True)
    robot.write_text("<robot name='a1'><link name='base'/></robot>", encoding="utf-8")
    given = Scenario.named("a1/step_ahead")
    with pytest.raises(ModelError, match="Python package 'example-robot-data', which is not inst"):
        World.from_scenario(given)
    packages: Any = {"example-robot-data": str(tmp_path)}
    given = dataclasses.replace(given, packages=packages)
    with pytest.raises(ModelError, match=r"actuators in .*, expected one of .none"):
        World.from_scenario(given)


def build_half_space_diagram(time_step: float = 0.0, gravity_axis: int = 2) -> Diagram:
    """Returns a ball over the ground, made in code as a user would."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=time_step)
    inertia = SpatialInertia(mass=1.5, p_PScm_E=np.zeros(3), G_SP_E=UnitInertia.SolidSphere(0.1))
    ball = plant.AddRigidBody("ball", inertia)
    friction = CoulombFriction(0.0, 0.0)
    plant.RegisterCollisionGeometry(ball, RigidTransform(), Sphere(0.1), "ball", friction)
    plant.RegisterCollisionGeometry(
        plant.world_body(), RigidTransform(), HalfSpace(), "ground", friction
    )
    axis = np.eye(3)[gravity_axis]
    joint = plant.AddJoint(
        PrismaticJoint("lift", plant.world_frame(), ball.body_frame(), axis, damping=0.3)
    )
    plant.AddJointActuator("motor", joint)
    plant.Finalize()
    return builder.Build()


def test_a_users_own_diagram_is_read() -> None:
    diagram = build_half_space_diagram()
    world = World.from_diagram(diagram, mass=2.0)
    assert world.diagram is diagram
    (q,), (v,) = world.positions, world.velocities
    assert world.mass_matrix[0, 0].EqualTo(Expression(2.0))
    assert differs_by_zero(world.bias[0], 2.0 * 9.81 + 0.3 * v)
    assert differs_by_zero(world.contacts[0].signed_distance, q - 0.1)
    assert world.contacts[0].name == "ball against ground"


def test_a_plant_inside_a_nested_diagram_is_found() -> None:
    builder = DiagramBuilder()
    builder.AddSystem(build_half_space_diagram())
    world = World.from_diagram(builder.Build())
    assert world.num_positions == 1
    assert world.plant.GetPositions(
        world.plant.GetMyContextFromRoot(world.create_context())
    ) == pytest.approx([0.0])


def test_discrete_plants_massless_links_and_unknown_shapes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"discrete one \(time_step = 0\.001 s\).*contact loses e"):
        World.from_diagram(build_half_space_diagram(time_step=1e-3))
    path = tmp_path / "massless.urdf"
    path.write_text(URDF.replace('<mass value="2"/>', '<mass value="0"/>'), encoding="utf-8")
    with pytest.raises(ModelError, match=r"mass matrix is singular: got no inertia along slider"):
        World.from_scenario(make_scenario(str(path)))
    message = r"ignored_shapes: got 'gound', expected of the collision shapes .*ground"
    with pytest.raises(ModelError, match=message):
        World.from_diagram(build_half_space_diagram(), ignored_shapes=["gound"])


URDF = """<robot name="own">
  <link name="world"/>
  <link name="ball">
    <inertial><mass value="2"/></inertial>
    <collision><geometry><sphere radius="0.05"/></geometry></collision>
  </link>
  <link name="wall"><collision><geometry><box size="0.1 1 1"/></geometry></collision></link>
  <joint name="slider" type="prismatic">
    <parent link="world"/><child link="ball"/><axis xyz="1 0 0"/><dynamics damping="0.4"/>
  </joint>
  <joint name="weld" type="fixed">
    <parent link="world"/><child link="wall"/><origin xyz="-0.1 0 0"/>
  </joint>
  <transmission>
    <type>transmission_interface/SimpleTransmission</type>
    <joint name="slider"/><actuator name="motor"/>
  </transmission>
</robot>"""


def test_a_users_own_urdf_is_read_by_a_relative_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own.urdf").write_text(URDF, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    world = World.from_scenario(make_scenario("own.urdf"))
    assert world.constant_inertia.mass_matrix.tolist() == [[2.0]]
    assert differs_by_zero(world.bias[0], 0.4 * world.velocities[0])
    assert differs_by_zero(world.contacts[0].signed_distance, world.positions[0])


@pytest.mark.parametrize("number", [0, 2])
def test_a_diagram_of_another_number_of_plants_than_one_is_refused(number: int) -> None:
    builder = DiagramBuilder()
    builder.AddSystem(ConstantVectorSource([1.0]))
    for i in range(number):
        builder.AddNamedSystem(f"part {i}", build_half_space_diagram())
    with pytest.raises(ModelError, match=f"got {number} of type MultibodyPlant, expected one"):
        World.from_diagram(builder.Build())


def test_the_mass_of_a_sphere_that_does_not_move_is_refused(write_model: ModelWriter) -> None:
    swapped = {
        BALL_SHAPE: "<box><size>0.1 0.1 0.1</size></box>",
        f"<box>\n            {BOX}\n          </box>": BALL_SHAPE,
    }
    # A box that moves and a sphere that is welded: fine, unless the sphere's mass is replaced.
    World.from_scenario(make_scenario(write_model(swapped)))
    with pytest.raises(ModelError, match="mass: got link 'wall', which carries the contact's"):
        World.from_scenario(make_scenario(write_model(swapped), mass=2.0))


@pytest.mark.parametrize("mass", [0.0, float("nan"), True])
def test_a_users_mass_is_checked(mass: float) -> None:
    with pytest.raises(ScenarioError, match=r"mass: got .*, expected"):
        World.from_diagram(build_half_space_diagram(), mass=mass)


BALL_COLLISION = '<collision name="ball_collision">'
MESHED = f"""<visual name="mesh_visual"><geometry><mesh><uri>tetrahedron.obj</uri></mesh></geometry>
  </visual><collision name="mesh"><pose>-0.5 0 0 0 0 0</pose>
  <geometry><mesh><uri>tetrahedron.obj</uri></mesh></geometry></collision>{BALL_COLLISION}"""


def test_a_mesh_is_left_out_by_name_here_and_in_drake_and_drawn_all_the_same(
    write_model: ModelWriter,
) -> None:
    (write_model.path.parent / "tetrahedron.obj").write_text(TETRAHEDRON, encoding="utf-8")
    diagram = read_model(write_model({BALL_COLLISION: MESHED})).diagram
    with pytest.raises(ModelError, match=r"got Mesh against Box.* Leave shapes out by the scen"):
        World.from_diagram(diagram)
    for name in ("mesh", "point_mass_and_wall::mesh"):
        world = World.from_diagram(diagram, mass=2.0, ignored_shapes=[name])
        assert [contact.name for contact in world.contacts] == ["ball_collision against wall"]
    moved = world.with_wall_moved(0, 0.1)
    assert moved.ignored_shapes == world.ignored_shapes
    for root, meets in ((world.create_context(), False), (diagram.CreateDefaultContext(), True)):
        context = world.plant.GetMyMutableContextFromRoot(root)
        world.plant.SetPositions(context, [0.35])  # The mesh is inside the wall, the ball is not.
        query: Any = world.scene_graph.get_query_output_port().Eval(
            world.scene_graph.GetMyContextFromRoot(root)
        )
        assert query.HasCollisions() == meets
    inspector = world.scene_graph.model_inspector()
    drawn = inspector.GetAllGeometryIds(Role.kIllustration)
    assert any("mesh_visual" in inspector.GetName(shape) for shape in drawn)


def test_a_scenario_names_the_shapes_that_its_world_leaves_out(write_model: ModelWriter) -> None:
    (write_model.path.parent / "tetrahedron.obj").write_text(TETRAHEDRON, encoding="utf-8")
    scenario = make_scenario(write_model({BALL_COLLISION: MESHED}), ignored_shapes=["mesh"])
    scenario.save(write_model.path.with_suffix(".yaml"))
    assert Scenario.load(write_model.path.with_suffix(".yaml")) == scenario
    world = World.from_scenario(scenario)
    assert world.num_contacts == 1
    other = dataclasses.replace(scenario, ignored_shapes=["ball_collision"])
    with pytest.raises(ScenarioError, match=r"ignored_shapes: got ball_collision, expected mesh"):
        world.check(other)


@pytest.mark.parametrize(
    ("model", "ignored", "coordinates"),
    [
        ("pendulum/Pendulum.urdf", [], 1),
        ("multibody/cart_pole/cart_pole.sdf", [], 2),
        ("acrobot/Acrobot.urdf", ["base_link_collision"], 2),
    ],
)
def test_robots_among_drakes_examples_are_read(
    model: str, ignored: list[str], coordinates: int
) -> None:
    diagram = read_model(f"package://drake/examples/{model}").diagram
    world = World.from_diagram(diagram, ignored_shapes=ignored)
    assert (world.num_positions, world.num_actuators, world.num_contacts) == (coordinates, 1, 0)


Array = np.ndarray[Any, np.dtype[np.float64]]

MANY = (4, 3)  # States at once, in two axes.
SHIPPED = ("room_with_block/around", "two_masses/apart")


def bend(world: World) -> World:
    """Returns equations as those of no plant here: M, h and J vary with everything."""
    (x, y), (v, w) = world.positions, world.velocities
    M = np.array([[x**2 + 3.0, x * y], [x * y, y**2 + 2.0]])
    distance = x**2 * y - 0.3 * y
    J = np.array([distance.Differentiate(each) for each in world.positions])
    contacts = (*world.contacts, Contact("bent", distance, J, len(world.solids)))
    bias = np.array([x * v**2 - w, y * v * w + 3.0])
    return dataclasses.replace(world, mass_matrix=M, bias=bias, contacts=contacts)


@cache
def read(name: str) -> World:
    if name in SHIPPED:
        return World.from_scenario(Scenario.named(name))
    if name == "bent":
        return bend(read("cart"))
    with tempfile.TemporaryDirectory() as directory:
        return make_world(ModelWriter(Path(directory)), name, mass=2.5)


@pytest.fixture(params=[*VARIANTS, *SHIPPED, "bent"])
def world(request: pytest.FixtureRequest) -> World:
    return read(request.param)


@pytest.fixture(params=[*VARIANTS, *SHIPPED])
def straight(request: pytest.FixtureRequest) -> World:
    return read(request.param)


def agree(got: Any, expected: Any, where: str = "") -> None:
    """Checks numbers that a few operations on others of size one make."""
    np.testing.assert_allclose(got, expected, RELATIVE, 20 * RELATIVE, err_msg=where)


def draw(world: World, *axes: int) -> tuple[Array, Array, Array, Array]:
    rng = np.random.default_rng(5)
    sizes = world.num_positions, world.num_velocities, world.num_actuators, world.num_contacts
    q, v, u, p = (rng.uniform(-1.0, 1.0, (*axes, size)) for size in sizes)
    return q, v, u, p


def test_functions_compute_what_the_expressions_say(world: World) -> None:
    n = world.num_positions
    q, v, u, p = draw(world)
    state = np.concatenate([world.positions, world.velocities]), np.concatenate([q, v])
    M = evaluate(world.mass_matrix, *state).reshape(n, n)
    h = evaluate(world.bias, *state)
    J = np.array([evaluate(contact.jacobian, *state) for contact in world.contacts])
    distances = [contact.signed_distance for contact in world.contacts]
    agree(world.calc_mass_matrix(q), M)
    agree(world.calc_bias(q, v), h)
    agree(world.calc_signed_distance(q), evaluate(distances, *state))
    agree(world.calc_contact_jacobian(q), J)
    acceleration, kick = world.calc_acceleration(q, v, u), world.calc_velocity_change(q, p)
    agree(M @ acceleration, world.actuation @ u - h)
    agree(M @ kick, J.T @ p)
    agree(world.calc_kinetic_energy(q, v), v @ M @ v / 2)
    # At other expressions: of the same variables, and numbers.
    elsewhere = world.express_bias(np.array([2.0 * each for each in world.positions]), 1.0 - v)
    there = world.calc_bias(2.0 * q, 1.0 - v)
    agree(evaluate(elsewhere, *state), there)


def test_many_states_at_once_are_each_on_its_own(world: World) -> None:
    q, v, u, p = draw(world, *MANY)
    for function, arguments in (
        (world.calc_mass_matrix, (q,)),
        (world.calc_bias, (q, v)),
        (world.calc_signed_distance, (q,)),
        (world.calc_clearance, (q,)),
        (world.calc_contact_jacobian, (q,)),
        (world.calc_acceleration, (q, v, u)),
        (world.calc_velocity_change, (q, p)),
        (world.calc_kinetic_energy, (q, v)),
    ):
        places = [[tuple(each[i, j] for each in arguments) for j in range(3)] for i in range(4)]
        alone = [[function(*place) for place in row] for row in places]
        agree(function(*arguments), alone, str(function))
    # One state goes with many controls, and with many impulses.
    still, moving = np.broadcast_to(q[0, 0], q.shape), np.broadcast_to(v[0, 0], v.shape)
    agree(world.calc_acceleration(q[0, 0], v[0, 0], u), world.calc_acceleration(still, moving, u))
    agree(world.calc_velocity_change(q[0, 0], p), world.calc_velocity_change(still, p))


def test_what_is_constant_is_what_the_functions_say_anywhere_and_lifts_cost_the_mass(
    straight: World,
) -> None:
    inertia = straight.constant_inertia
    q, v, u, p = draw(straight, *MANY)
    agree(straight.calc_mass_matrix(q)[1, 2], inertia.mass_matrix)
    agree(straight.calc_contact_jacobian(q)[3, 0], inertia.jacobian)
    distances = q @ inertia.jacobian.T + inertia.offset
    agree(straight.calc_signed_distance(q), distances)
    agree(straight.calc_velocity_change(q, p), p @ inertia.kicks)
    # What control adds is the same anywhere, whatever else accelerates.
    added = straight.calc_acceleration(q, v, u) - straight.calc_acceleration(q, v, 0.0 * u)
    agree(added, u @ inertia.gain.T)
    assert inertia.solids == straight.solids
    M, J, lifts = inertia.mass_matrix, inertia.jacobian, inertia.lifts
    agree(np.sum(J * lifts, axis=1), 1.0)
    # Of all changes that do so it takes the least energy, ½ m: it is along M⁻¹ Jᵀ.
    agree(M @ lifts.T, J.T * inertia.masses)
    agree(np.sum(lifts @ M * lifts, axis=1), inertia.masses)


def test_dynamics_are_constant_where_a_held_control_flies_parabolas(world: World) -> None:
    q, v, u, _ = draw(world, *MANY)
    accelerations = world.calc_acceleration(q, v, u[0, 0])
    is_same = np.allclose(accelerations, accelerations[0, 0], rtol=1e-9, atol=1e-9)
    assert world.has_constant_dynamics == is_same
    if is_same:
        dynamics = world.constant_dynamics
        assert world.constant_inertia is dynamics
        expected = dynamics.gain @ u[0, 0] + dynamics.drift
        agree(accelerations[1, 1], expected)
    else:
        with pytest.raises(ModelError, match="expected a constant"):
            _ = world.constant_dynamics


def test_what_varies_is_refused_by_name() -> None:
    straight, bent, springy = map(read, ("cart", "bent", "spring"))
    for varied, message in (
        ({"mass_matrix": bent.mass_matrix}, r"the mass matrix M\(q\): got \(3 \+ pow"),
        ({"contacts": bent.contacts}, r"∂φ/∂q of bent: got \(2 \* "),
    ):
        with pytest.raises(ModelError, match=message) as error:
            _ = dataclasses.replace(straight, **varied).constant_inertia
        assert str(error.value).endswith("expected a constant. Use the literal transcription.")
    with pytest.raises(ModelError) as error:
        _ = springy.constant_dynamics
    assert str(error.value) == (
        f"the bias h(q, v): got {springy.bias[0]}, expected a constant. Exact optima and sampling "
        "over controls need flight in parabolas; plans, replays and gradient solvers do not."
    )
    assert springy.constant_inertia.mass_matrix.tolist() == [[2.5]]


def test_what_is_shared_is_read_only() -> None:
    inertia = read("as shipped").constant_dynamics
    given = ("mass_matrix", "actuation", "jacobian", "offset", "bias")
    derived = ("inverse_mass", "kicks", "masses", "lifts", "gain", "drift")
    for array in (getattr(inertia, name) for name in given + derived):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = array[0]
