"""The world: what is read off a plant agrees with Drake's own numbers, and bad models are named."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.geometry import HalfSpace, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import PrismaticJoint, SpatialInertia, UnitInertia
from pydrake.symbolic import Expression, Variable, cos, sin
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from drake_aigto import ModelError, Scenario, ScenarioError, World
from drake_aigto.world import files
from drake_aigto.world.diagram import build_diagram, find_joint
from drake_aigto.world.polynomials import PolynomialMap, find_nonpolynomial_variable, tidy

SHIPPED = files.models_directory() / "point_mass_and_wall.sdf"
# Drake's recursive dynamics and ours differ by rounding only: some tens of operations.
RELATIVE = 1e-12

AXIS = "<xyz>1 0 0</xyz>"
SPRING = (
    "<dynamics><spring_stiffness>3</spring_stiffness>"
    "<spring_reference>0.4</spring_reference></dynamics>"
)
DAMPER = "<dynamics><damping>0.7</damping></dynamics>"
WALL_POSE = "<pose>-0.1 0 0 0 0 0</pose>"
BOX = "<size>0.1 0.6 0.6</size>"
# The shipped wall's collision shape is deep; variants turn and shift a thin one.
THIN_WALL = {
    "<pose>-0.05 0 0 0 0 0</pose>": WALL_POSE,
    "<pose>-8 0 0 0 0 0</pose>": "",
    "<size>16 16 16</size>": BOX,
}
# The slider no longer moves the ball but a cart along y, and the ball moves on the cart along x.
CART = """<link name="cart">
      <inertial><mass>3</mass></inertial>
    </link>
    <joint name="rail" type="prismatic">
      <parent>world</parent>
      <child>cart</child>
      <axis><xyz>0.6 0.8 0</xyz><dynamics><damping>0.2</damping></dynamics></axis>
    </joint>
    <joint name="slider" type="prismatic">
      <parent>cart</parent>"""
SLIDER = """<joint name="slider" type="prismatic">
      <parent>world</parent>"""

# name → replacements in the shipped SDF
VARIANTS: dict[str, dict[str, str]] = {
    "as shipped": {},
    "2 kg": {"<mass>1.0</mass>": "<mass>2.0</mass>"},
    "spring": {AXIS: AXIS + SPRING},
    "damper": {AXIS: AXIS + DAMPER},
    "gravity": {AXIS: "<xyz>0 0 1</xyz>", WALL_POSE: "<pose>0 0 -0.1 0 1.570796 0</pose>"},
    "slope": {
        AXIS: f"<xyz>0.8 0 0.6</xyz>{SPRING}",
        WALL_POSE: "<pose>-0.08 0 -0.06 0 -0.6435011087932844 0</pose>",
    },
    "shifted wall": {WALL_POSE: "<pose>0.15 0 0 0 0 0</pose>"},
    "turned wall": {WALL_POSE: "<pose>-0.1 0 0 0 0.4 1.5707963267948966</pose>"},
    "half space": {
        WALL_POSE: "<pose>-0.05 0 0 0 1.5707963267948966 0</pose>",
        f"<box>\n            {BOX}\n          </box>": "<plane><normal>0 0 1</normal></plane>",
    },
    "ball off its link's origin": {
        '<collision name="ball_collision">': '<collision name="ball_collision">'
        "<pose>0.2 0.1 0 0 0 0</pose>"
    },
    "geared motor": {
        "</axis>": "</axis><drake:rotor_inertia>0.3</drake:rotor_inertia>"
        "<drake:gear_ratio>2</drake:gear_ratio>"
    },
    "cart": {SLIDER: CART, BOX: "<size>0.1 9 9</size>"},
}


def read_thin_walled() -> str:
    """Returns the shipped SDF with a thin wall."""
    text = SHIPPED.read_text(encoding="utf-8")
    for old, new in THIN_WALL.items():
        assert old in text, f"the shipped model has no {old!r} to replace"
        text = text.replace(old, new)
    return text


class ModelWriter:
    """Writes variants of the thin-walled SDF by text replacement."""

    def __init__(self, directory: Path) -> None:
        self.path = directory / "variant.sdf"

    def __call__(self, replacements: dict[str, str]) -> str:
        text = read_thin_walled()
        for old, new in replacements.items():
            assert old in text, f"the shipped model has no {old!r} to replace"
            text = text.replace(old, new)
        self.path.write_text(text, encoding="utf-8")
        return str(self.path)


@pytest.fixture
def write_model(tmp_path: Path) -> ModelWriter:
    return ModelWriter(tmp_path)


def make_scenario(model: str | None = None, size: int = 1, **fields: Any) -> Scenario:
    fields = {
        "initial_position": np.full(size, 1.0),
        "initial_velocity": np.full(size, -2.0),
        "goal_position": np.full(size, 0.73),
        **fields,
    }
    return Scenario(**fields) if model is None else Scenario(model=model, **fields)


def make_world(write_model: ModelWriter, name: str, mass: float | None = None) -> World:
    size = 2 if name == "cart" else 1
    return World.from_scenario(make_scenario(write_model(VARIANTS[name]), size, mass=mass))


def evaluate(expressions: Any, variables: Any, values: Any) -> np.ndarray:
    environment = dict(zip(variables, values, strict=True))
    return np.array([(e * Expression(1.0)).Evaluate(environment) for e in np.ravel(expressions)])


def differs_by_zero(first: Expression, second: Any) -> bool:
    return (first - second).Expand().EqualTo(Expression(0.0))


# What the shipped world is.


def test_the_shipped_world_is_a_unit_mass_whose_signed_distance_is_its_position() -> None:
    world = World.from_scenario(Scenario.named("table1/1"))
    (q,) = world.positions
    assert world.mass_matrix.shape == (1, 1)
    assert world.mass_matrix[0, 0].EqualTo(Expression(1.0))
    assert world.bias[0].EqualTo(Expression(0.0))
    np.testing.assert_array_equal(world.actuation, [[1.0]])
    (contact,) = world.contacts
    assert contact.name == "ball against wall"
    assert contact.signed_distance.EqualTo(Expression(q))
    assert contact.jacobian[0].EqualTo(Expression(1.0))
    sizes = (world.num_positions, world.num_velocities, world.num_actuators, world.num_contacts)
    assert sizes == (1, 1, 1, 1)


def test_the_shipped_material_is_stiff_and_elastic() -> None:
    world = World.from_scenario(Scenario.named("table1/1"))
    inspector = world.scene_graph.model_inspector()
    ((first, second),) = inspector.GetCollisionCandidates()
    for geometry in (first, second):
        material = inspector.GetProximityProperties(geometry)
        assert material.GetProperty("material", "point_contact_stiffness") == 2e9
        assert material.GetProperty("material", "hunt_crossley_dissipation") == 0.0


def test_the_worlds_parts_are_read_only() -> None:
    world = World.from_scenario(Scenario.named("table1/1"))
    with pytest.raises(dataclasses.FrozenInstanceError):
        world.mass = 2.0  # type: ignore[misc]
    names = ("positions", "velocities", "controls", "mass_matrix", "bias", "actuation")
    arrays = [getattr(world, name) for name in names]
    for array in [*arrays, world.mass_matrix_values, world.contacts[0].jacobian]:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = array[0]


# Physics: a changed model changes what is read.


@pytest.mark.parametrize("mass", [None, 2.5])
@pytest.mark.parametrize("name", VARIANTS)
def test_acceleration_is_the_plants(write_model: ModelWriter, name: str, mass: float) -> None:
    world = make_world(write_model, name, mass)
    root = world.create_context()
    context = world.plant.GetMyMutableContextFromRoot(root)
    generator = np.random.default_rng(1)
    n = world.num_positions
    for _ in range(5):
        q = generator.uniform(0.6, 2.0, n)  # Away from contact.
        v = generator.uniform(-3.0, 3.0, n)
        u = generator.uniform(-5.0, 5.0, world.num_actuators)
        world.plant.SetPositions(context, q)
        world.plant.SetVelocities(context, v)
        world.plant.get_actuation_input_port().FixValue(context, u)
        expected = world.plant.EvalTimeDerivatives(context).CopyToVector()[n:]
        got = world.calc_acceleration(q, v, u)
        np.testing.assert_allclose(got, expected, rtol=RELATIVE, atol=10 * RELATIVE)


@pytest.mark.parametrize("name", VARIANTS)
def test_expressions_say_what_the_compiled_functions_compute(
    write_model: ModelWriter, name: str
) -> None:
    world = make_world(write_model, name, mass=2.5)
    n = world.num_positions
    generator = np.random.default_rng(2)
    q, v, u = generator.uniform(-1.0, 1.0, (3, n))
    state = (np.concatenate([world.positions, world.velocities]), np.concatenate([q, v]))
    M = evaluate(world.mass_matrix, *state).reshape(n, n)
    np.testing.assert_array_equal(world.mass_matrix_values, M)
    h = evaluate(world.bias, *state)
    acceleration = world.calc_acceleration(q, v, u)
    force = world.actuation @ u - h
    np.testing.assert_allclose(M @ acceleration, force, rtol=RELATIVE, atol=10 * RELATIVE)
    distances = [contact.signed_distance for contact in world.contacts]
    np.testing.assert_allclose(
        world.calc_signed_distance(q), evaluate(distances, *state), rtol=RELATIVE, atol=RELATIVE
    )


@pytest.mark.parametrize("name", VARIANTS)
def test_signed_distance_is_that_of_the_geometry_and_the_jacobian_its_derivative(
    write_model: ModelWriter, name: str
) -> None:
    world = make_world(write_model, name)
    root = world.create_context()
    context = world.plant.GetMyMutableContextFromRoot(root)
    ((sphere, wall),) = world.scene_graph.model_inspector().GetCollisionCandidates()
    generator = np.random.default_rng(3)
    previous = None
    for _ in range(5):
        # "turned wall" shows the ball a face 0.3 m across; stay in front of it.
        q = generator.uniform(0.5, 0.6, world.num_positions)
        world.plant.SetPositions(context, q)
        query = world.scene_graph.get_query_output_port().Eval(
            world.scene_graph.GetMyContextFromRoot(root)
        )
        expected = query.ComputeSignedDistancePairClosestPoints(sphere, wall).distance
        (got,) = world.calc_signed_distance(q)
        assert got == pytest.approx(expected, abs=RELATIVE)
        if previous is not None:  # φ is linear here, so a difference is a derivative.
            J = evaluate(world.contacts[0].jacobian, world.positions, q)
            assert J @ (q - previous[0]) == pytest.approx(got - previous[1], abs=RELATIVE)
        previous = q, got


@pytest.mark.parametrize(("name", "override"), [("as shipped", 2.0), ("2 kg", None)])
def test_a_2_kg_mass_is_read_as_such(
    write_model: ModelWriter, name: str, override: float | None
) -> None:
    world = make_world(write_model, name, override)
    assert world.mass_matrix[0, 0].EqualTo(Expression(2.0))
    acceleration = world.calc_acceleration(np.zeros(1), np.zeros(1), np.array([3.0]))
    np.testing.assert_array_equal(acceleration, [1.5])


def test_replacing_the_mass_edits_neither_the_plant_nor_the_inertias_shape() -> None:
    world = World.from_scenario(make_scenario(mass=4.0))
    ball = world.plant.GetBodyByName("ball")
    assert ball.default_mass() == 1.0
    context = world.plant.GetMyContextFromRoot(world.create_context())
    assert ball.get_mass(context) == 4.0
    moments = ball.CalcSpatialInertiaInBodyFrame(context).CalcRotationalInertia().get_moments()
    np.testing.assert_allclose(moments, 4.0 * 0.001, rtol=RELATIVE)  # 2/5 m r²


def test_a_spring_on_the_joint_pushes_towards_its_reference(write_model: ModelWriter) -> None:
    world = make_world(write_model, "spring")
    (q,) = world.positions
    assert differs_by_zero(world.bias[0], 3.0 * q - 3.0 * 0.4)


def test_a_damper_on_the_joint_resists_its_velocity(write_model: ModelWriter) -> None:
    world = make_world(write_model, "damper")
    (v,) = world.velocities
    assert differs_by_zero(world.bias[0], 0.7 * v)


def test_gravity_pulls_down_a_vertical_joint(write_model: ModelWriter) -> None:
    world = make_world(write_model, "gravity", mass=2.0)
    assert differs_by_zero(world.bias[0], 2.0 * 9.81)


def test_a_shifted_wall_is_reached_sooner(write_model: ModelWriter) -> None:
    world = make_world(write_model, "shifted wall")
    (distance,) = world.calc_signed_distance(np.array([1.0]))
    assert distance == pytest.approx(0.75, abs=RELATIVE)  # 0.25 m nearer than shipped.
    assert world.contacts[0].jacobian[0].EqualTo(Expression(1.0))


def test_from_behind_a_thin_wall_its_other_face_counts(write_model: ModelWriter) -> None:
    model = write_model({})
    world = World.from_scenario(make_scenario(model, initial_position=-1.0, goal_position=-0.5))
    # The box is 0.1 m thick and the ball 0.1 m across: contact at q = -0.2.
    np.testing.assert_allclose(world.calc_signed_distance(np.array([-1.0])), [0.8])


def test_a_floor_along_the_motion_is_no_contact(write_model: ModelWriter) -> None:
    floor = """<link name="floor"><pose>0 0 -0.2 0 0 0</pose><collision name="floor_collision">
      <geometry><box><size>9 9 0.1</size></box></geometry></collision></link>
    <joint name="floor_to_world" type="fixed"><parent>world</parent><child>floor</child></joint>
    <link name="wall">"""
    world = World.from_scenario(make_scenario(write_model({'<link name="wall">': floor})))
    assert [contact.name for contact in world.contacts] == ["ball against wall"]


# A diagram of the user's own.


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


def test_a_discrete_plant_is_refused_with_the_reason() -> None:
    with pytest.raises(
        ModelError, match=r"discrete one \(time_step = 0\.001 s\).*contact loses energy"
    ):
        World.from_diagram(build_half_space_diagram(time_step=1e-3))


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
    assert world.mass_matrix_values.tolist() == [[2.0]]
    assert differs_by_zero(world.bias[0], 0.4 * world.velocities[0])
    assert differs_by_zero(world.contacts[0].signed_distance, world.positions[0])


def test_a_massless_link_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "massless.urdf"
    path.write_text(URDF.replace('<mass value="2"/>', '<mass value="0"/>'), encoding="utf-8")
    with pytest.raises(ModelError, match=r"mass matrix is singular: got \[\[0\.0\]\]\. Give every"):
        World.from_scenario(make_scenario(str(path)))


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


@pytest.mark.parametrize("mass", [0.0, -1.0, float("nan"), True])
def test_a_users_mass_is_checked(mass: float) -> None:
    with pytest.raises(ScenarioError, match=r"mass: got .*, expected"):
        World.from_diagram(build_half_space_diagram(), mass=mass)


# Bad models, each with one clear error.

SLIDER_AXIS = """<axis>
        <xyz>1 0 0</xyz>
      </axis>"""
PRISMATIC = '<joint name="slider" type="prismatic">'
BALL_SHAPE = """<sphere>
            <radius>0.05</radius>
          </sphere>"""
STOP = """<link name="stop"><pose>2 0 0 0 0 0</pose>
      <collision name="stop"><geometry><box><size>0.1 1 1</size></box></geometry></collision>
    </link>
    <joint name="stop_to_world" type="fixed"><parent>world</parent><child>stop</child></joint>"""
ARM = """<link name="arm">
      <inertial><pose>0.3 0 0 0 0 0</pose><mass>1</mass></inertial>
    </link>
    <joint name="shoulder" type="revolute">
      <parent>world</parent><child>arm</child><axis><xyz>0 1 0</xyz></axis>
    </joint>
    <link name="hand"><inertial><mass>1</mass></inertial></link>
    <joint name="elbow" type="prismatic">
      <parent>arm</parent><child>hand</child><axis><xyz>1 0 0</xyz></axis>
    </joint>"""
WALL_LINK = '<link name="wall">'


def between(start: str, end: str) -> str:
    """Returns a piece of the shipped SDF, both marks included."""
    text = read_thin_walled()
    first = text.index(start)
    return text[first : text.index(end, first) + len(end)]


# name → (replacements in the shipped SDF, message)
BAD_MODELS: dict[str, tuple[dict[str, str], str]] = {
    "pendulum": (
        {
            PRISMATIC: '<joint name="hinge" type="revolute"><pose>0 0 1 0 0 0</pose>',
            AXIS: "<xyz>0 1 0</xyz>",
        },
        r"joint 'hinge' \(revolute\): got a coordinate that enters the distance of ball against "
        r"wall in a way that is not polynomial, expected .*\. Use prismatic joints; weld this one",
    ),
    "a swinging arm beside the ball": (
        {WALL_LINK: f"{ARM}{WALL_LINK}"},
        r"joint 'shoulder' \(revolute\): got a coordinate that enters the mass matrix in a way",
    ),
    "ball joint": (
        {PRISMATIC: '<joint name="socket" type="ball">', SLIDER_AXIS: ""},
        r"joint 'socket' \(ball_rpy\): got velocities v that are not q̇, expected q̇ = v",
    ),
    "floating": (
        {between(PRISMATIC, "</joint>"): ""},
        r"no joint attaches link 'ball', so it floats: .*Attach the link by prismatic joints",
    ),
    "welded": (
        {PRISMATIC: '<joint name="slider" type="fixed">'},
        r"the model lacks a joint that moves\. Attach the moving link by a prismatic joint",
    ),
    "no actuator": (
        {AXIS: f"{AXIS}<limit><effort>0</effort></limit>"},
        r"the model lacks an actuator\. In SDF drop <effort>0</effort>",
    ),
    "effort limit": (
        {AXIS: f"{AXIS}<limit><effort>7.5</effort></limit>"},
        r"actuator 'slider' of joint 'slider': got an effort limit of 7\.5, expected none",
    ),
    "no wall": (
        {between('<collision name="wall_collision">', "</collision>"): ""},
        "the model lacks contact geometry: expected a sphere, and a box or half space",
    ),
    "two walls": (
        {WALL_LINK: f"{STOP}{WALL_LINK}"},
        "more than one contact: got ball against stop, ball against wall, expected one",
    ),
    "box against box": (
        {BALL_SHAPE: "<box><size>0.1 0.1 0.1</size></box>"},
        "ball_collision with point_mass_and_wall::wall_collision: got Box against Box, expected "
        "Sphere against Box or HalfSpace",
    ),
    "not XML": ({"<link": "<lin k"}, r"Drake can't parse the model .*variant\.sdf: got "),
}


@pytest.mark.parametrize("name", BAD_MODELS)
def test_a_bad_model_is_refused_by_name(write_model: ModelWriter, name: str) -> None:
    replacements, message = BAD_MODELS[name]
    with pytest.raises(ModelError, match=message):
        World.from_diagram(build_diagram(write_model(replacements)))


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ("no/such.sdf", r"model no/such\.sdf: got no file no/such\.sdf, expected an SDF or URDF"),
        ("package://nowhere/a.sdf", "got the unknown package 'nowhere', expected one of drake"),
        ("package://drake_aigto_models/a.sdf", r"got no file .*a\.sdf.*shipped ones lie in"),
        (".", r"model \.: got no file \., expected"),
    ],
)
def test_a_missing_model_is_refused_by_name(model: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        World.from_scenario(make_scenario(model))


# Scenarios that don't fit the world.


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"initial_position": 0.0},
            r"initial_position is inside, behind or against the wall \(ball against wall\): got a "
            r"signed distance of 0 m, expected more than 0 m",
        ),
        ({"initial_position": -0.02}, r"initial_position is inside.* got .* -0\.02 m"),
        ({"goal_position": -0.02}, r"goal_position is inside.* got .* -0\.02 m"),
        ({"initial_position": -1.0}, r"initial_position is inside, behind .* got .* -1 m"),
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
        r"goal_position is inside, behind .*The wall is the face that the sphere faces at "
        r"q = \[-1\.0\]; start and goal must both be in front of it"
    )
    with pytest.raises(ScenarioError, match=message):
        World.from_scenario(make_scenario(write_model({}), initial_position=-1.0))


def test_a_position_beside_the_walls_face_is_refused(write_model: ModelWriter) -> None:
    small = {SLIDER: CART, BOX: "<size>0.1 4 0.6</size>"}
    fits = make_scenario(write_model(small), 2, goal_position=[2.4, 1.0])
    world = World.from_scenario(fits)  # 1.92 m off the middle, 2 m are there.
    beside = dataclasses.replace(fits, goal_position=[2.6, 1.0])
    with pytest.raises(
        ScenarioError,
        match=r"goal_position is beside the face of the wall .*got the sphere's centre "
        r"\[2\.08, 0\.0\] m off .* expected within \[2\.0, 0\.3\] m\. Widen the wall",
    ):
        world.check(beside)


def test_a_scenario_of_another_mass_is_refused() -> None:
    world = World.from_scenario(make_scenario(mass=2.0))
    world.check(make_scenario(mass=2.0))
    with pytest.raises(ScenarioError, match=r"mass: got 3 kg, expected 2 kg\. The world"):
        world.check(make_scenario(mass=3.0))
    with pytest.raises(ScenarioError, match="mass: got 3 kg, expected None, the model's"):
        World.from_scenario(make_scenario()).check(make_scenario(mass=3.0))


# The parts.


def test_tidying_drops_rounding_and_keeps_physics() -> None:
    x, y = Variable("x"), Variable("y")
    first, second = tidy(np.array([2.0 * (x + 1e-9 * y) + 6e-17 * x * y, Expression(0.0)]))
    assert differs_by_zero(first, 2.0 * x + 2e-9 * y)
    assert second.EqualTo(Expression(0.0))


@pytest.mark.parametrize("function", [sin, cos, lambda x: 1.0 / x])
def test_the_variable_that_is_not_polynomial_is_found(function: Callable[[Any], Any]) -> None:
    x, y = Variable("x"), Variable("y")
    expression = x * x * function(y) + x
    found = find_nonpolynomial_variable(expression)
    assert found is not None
    assert found.EqualTo(y)
    assert find_nonpolynomial_variable(x * y * y + 1.0) is None


def test_compiled_polynomials_agree_with_drakes_expressions() -> None:
    x, y = Variable("x"), Variable("y")
    expressions = np.array([3.0 * x**3 * y - y + 2.0, x + y, Expression(0.0), Expression(4.0)])
    compiled = PolynomialMap(expressions, np.array([x, y]))
    for point in np.random.default_rng(4).uniform(-2.0, 2.0, (5, 2)):
        np.testing.assert_allclose(
            compiled(point), evaluate(expressions, (x, y), point), rtol=RELATIVE, atol=RELATIVE
        )


@pytest.mark.parametrize("place", ["drake_aigto/models", "models"])
def test_the_models_are_found_in_a_wheel_and_in_a_checkout(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / place).mkdir(parents=True)
    (tmp_path / place / "package.xml").write_text(
        (SHIPPED.parent / "package.xml").read_text(encoding="utf-8"), encoding="utf-8"
    )
    monkeypatch.setattr("drake_aigto.world.files.resources.files", lambda name: tmp_path / name)
    assert files.models_directory() == tmp_path / place


def test_an_installation_without_models_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drake_aigto.world.files.resources.files", lambda name: tmp_path / name)
    with pytest.raises(ModelError, match=r"shipped models are missing.*Install drake_aigto again"):
        files.models_directory()


def test_every_coordinate_has_its_joint(write_model: ModelWriter) -> None:
    world = make_world(write_model, "cart")
    names = {find_joint(world.plant, i).name() for i in range(2)}
    assert names == {"rail", "slider"}
    with pytest.raises(IndexError):
        find_joint(world.plant, 2)
